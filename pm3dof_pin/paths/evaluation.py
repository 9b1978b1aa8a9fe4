"""A tool path judged on a robot: commands, limits, motion in time, forces, deflections, errors and corrections."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from pm3dof_pin.arrays import finite_array, require_kind
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.batch import natural_frequencies
from pm3dof_pin.dynamics.motion_forces import DriveMotions, drive_motions, motion_forces
from pm3dof_pin.elastic.batch import compliance, elastic_model
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.errors.command_correction import best_commands
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.error_sums import kinematic_sum
from pm3dof_pin.errors.pose_error import TIP_LENGTH, moved_pose, pose_difference
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity_measures import least_singularity_measures
from pm3dof_pin.measuring.wrenches import WRENCH_COLUMNS, is_wrench
from pm3dof_pin.mechanism.loads import Payloads
from pm3dof_pin.paths.bounds import DriveForces, MotionLimits, along_path, drive_limits, path_metric
from pm3dof_pin.paths.cutting import Milling
from pm3dof_pin.paths.drive_side import DriveSide, rates_of_redundant_drives
from pm3dof_pin.paths.follower import Follower, Motion, with_tool_length
from pm3dof_pin.paths.planning import BLOCK, PathPoints, TimedPoints, choose_points, in_blocks, plan_motion
from pm3dof_pin.paths.summary import PathSummary
from pm3dof_pin.paths.tool_path import ToolPath
from pm3dof_pin.typing import Array, Indices, Matrix, Vector

TOLERANCE = 1e-5
"""Greatest deviation from the path between points by default [m]."""

_THINNED = 4000  # points
_JUMP = 0.1  # of an open chain between points, beyond what its motion explains [rad, characteristic lengths]

Columns = dict[str, Array]
"""Columns of numbers by name, shape=(n,) each."""


@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """How a path is run and judged."""

    tool_length: float = 0.0  #: of the tool point along the z axis of the tool frame [m]
    table: Sequence[str] = ()  #: directions x, y or z in which a table moves the workpiece
    limits: MotionLimits = field(default_factory=MotionLimits)  #: of the motion in time
    tolerance: float = TOLERANCE  #: greatest deviation between points [m]
    spacing: float | None = (
        None  #: greatest distance of points [m]; see :func:`~pm3dof_pin.paths.planning.choose_points`
    )
    #: cutting force on the tool point during moves with a feed, base axes, shape=(3,) [N]
    force: Sequence[float] | None = None
    milling: Milling | None = None  #: cutting force by the feed, during moves with one
    payload: float = 0.0  #: mass at the tool frame [kg]
    large: bool = False  #: whether deflections are those of the loaded equilibrium, pose by pose
    errors: GeometricErrors | None = None  #: errors of the robot, for the expected error
    calibration: Compensation | None = None  #: calibration of the robot, for its commands and expected error
    #: temperatures, loads that were learned from, and the time, by name, on which the calibration depends; wrenches on
    #: springs are those of the path
    conditions: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the conditions, and fill in those that are missing."""
        known = self.calibration
        if self.conditions and known is None:
            raise InvalidValueError("conditions", sorted(self.conditions), "a calibration that depends on them")
        if known is None:
            return
        if known.bears_wrenches and (loads := sorted(filter(is_wrench, self.conditions))):
            raise InvalidValueError("conditions", loads, "no loads, which are those of the path")
        object.__setattr__(self, "conditions", known.with_usual_conditions(self.conditions))


class PathEvaluation:
    """A path judged on a robot, see :func:`evaluate_path`.

    Attributes:
        robot: the robot, with its tool at the tool point.
        bare: the robot as given.
        path: the path.
        options: how it is run and judged.
        timed: the points and the motion in time.
    """

    def __init__(self, robot: Robot, path: ToolPath, options: PathOptions) -> None:
        self.path, self.options = path, options
        self.bare = robot
        pointed = with_tool_length(robot, options.tool_length)
        self._follower = Follower(pointed, path, options.table)
        self.robot = self._follower.robot
        self._payloads: Payloads = {robot.frame_name(): options.payload} if options.payload else {}
        self._summary: dict[str, Any] | None = None
        self._thinned: Columns | None = None
        points = choose_points(self._follower, options.tolerance, options.spacing)
        self.timed: TimedPoints = plan_motion(
            self._follower, points, options.limits, options.tolerance, self._drive_forces
        )

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def __repr__(self) -> str:
        return f"PathEvaluation({self.robot.name}, {len(self.path)} moves, {len(self)} points)"

    @property
    def points(self) -> PathPoints:
        """The points."""
        return self.timed.points

    @cached_property
    def columns(self) -> Columns:
        """All columns of all points."""
        parts = list(self.blocks())
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def blocks(self) -> Iterator[Columns]:
        """Yield the columns block by block; only a few blocks are in memory."""
        if "columns" in vars(self):
            yield self.columns
            return
        energy, before = 0.0, None
        side = DriveSide()
        lasting = self.timed.speeds.duration
        summary = PathSummary(self.robot, self.path.lines, self._force_limits)
        every, thinned = -(-len(self) // _THINNED), []
        for part, (columns, work, rates) in in_blocks(self._block, self.points.blocks(), self.robot.threads):
            # work has places and forces of the drives' joints
            work = work if before is None else np.concatenate([before, work], axis=1)
            self._mark_jumps(columns, work, part)
            beyond = np.flatnonzero(side.is_other(rates))
            columns["branch"][beyond], columns["within_limits"][beyond] = 1.0, 0.0
            steps = 0.5 * (work[1, 1:] + work[1, :-1]) * np.diff(work[0], axis=0)
            total = energy + np.cumsum(np.nan_to_num(steps.sum(axis=1)))
            columns["energy_J"] = np.append(0.0, total) if before is None else total
            energy, before = float(columns["energy_J"][-1]), work[:, -1:]
            after = np.append(lasting[part.start + 1 : part.stop + 1], [] if part.stop < len(self) else [0.0])
            summary.add(columns, 0.5 * (lasting[part] + after))
            first = -part.start % every
            thinned.append({name: values[first::every].copy() for name, values in columns.items()})  # no views
            yield columns
        self._summary = summary.as_data()
        self._thinned = {name: np.concatenate([some[name] for some in thinned]) for name in thinned[0]}

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The path in numbers, with the line of the worst point for each; keys end in their unit."""
        self._read()
        assert self._summary is not None
        return self._summary

    def _read(self) -> None:
        """Go over all points, once; the columns of few are kept."""
        if self._summary is None and len(self) <= BLOCK:
            assert self.columns
        elif self._summary is None:
            deque(self.blocks(), maxlen=0)

    @property
    def thinned(self) -> Columns:
        """All columns of at most a few thousand points, evenly chosen, for pictures."""
        self._read()
        assert self._thinned is not None
        return self._thinned

    @property
    def _force_limits(self) -> Vector:
        robot = self.robot
        limits = drive_limits(robot, self.options.limits.drive_force, "effort")
        return limits[[robot.actuated_joints.index(command.joint) for command in robot.commands]]

    @cached_property
    def _drive_names(self) -> list[str]:
        return [f"u{k}" for k in range(1, len(self.robot.commands) + 1)]

    def _block(self, part: slice) -> tuple[Columns, Array, Array]:
        timed, follower, robot, path = self.timed, self._follower, self.robot, self.path
        moves, shares = self.points.moves[part], self.points.shares[part]
        motion = follower.motion(moves, shares, self.points.sizes)
        poses = motion.poses
        metric, change, turns = path_metric(path, motion)
        if path.times is not None:
            steps = path.times[moves + 1] - path.times[moves]
            metric, change = steps, np.zeros_like(steps)
        first, second = along_path(motion, metric, change)
        v, a = timed.speeds.speed[part, None], timed.speeds.acceleration[part, None]
        velocities, accelerations = first * v, second * v**2 + first * a
        with np.errstate(divide="ignore", invalid="ignore"):
            tool = np.nan_to_num(motion.tool / np.where(metric > 0.0, metric, np.inf)[:, None])
        columns: Columns = {
            "line": path.lines[moves].astype(float),
            "share": shares,
            "time_s": timed.time[part],
            **dict(zip(self.coordinate_names, motion.targets[:, follower.taken].T, strict=True)),
            **{f"tool_{name}_m": x for name, x in zip("xyz", poses.positions.T, strict=True)},
        }
        if follower.table:
            beside = follower.beside(poses, motion.targets)
            columns |= {f"table_{axis}_m": x for axis, x in zip(follower.table, beside.T, strict=True)}
        columns |= self._numbered("", poses.commands)
        columns |= {
            "within_limits": (poses.within_limits & (poses.branch == 0)).astype(float),
            "broken_limits": poses.broken_limits.astype(float),
            "branch": np.where(poses.solved, poses.branch, np.nan).astype(float),
            "limit_margin": self._margins(poses),
            "singularity_distance": self._singularity(poses),
            "feed_m_s": np.where(turns, 0.0, timed.speeds.speed[part]),
            "feed_ceiling_m_s": np.where(turns, np.nan, timed.ceiling[part]),
        }
        if path.times is not None:
            columns["feed_m_s"] = np.linalg.norm(tool[:, :3] * v, axis=1)
        wrenches = self._wrenches(moves, shares, columns["feed_m_s"], tool, poses.rotations)
        motions = drive_motions(robot, poses)
        forces = motion_forces(
            robot, poses, motions, velocities, accelerations, payloads=self._payloads, wrenches=wrenches
        )
        columns |= self._drive_columns(velocities, accelerations, forces)
        if wrenches.any():
            columns |= {f"force_{axis}_N": x for axis, x in zip("xyz", wrenches.T[:3], strict=True)}
        if robot.springs:
            columns |= self._elastic(poses, motions, wrenches, tool)
        columns |= self._errors(poses, wrenches)
        joints = [robot.single_joint(name).coordinate(poses.q) for name in robot.actuated_joints]
        slopes = first[:, robot.actuated_indices]
        work = np.stack([np.unwrap(np.stack(joints, axis=-1), axis=0), forces, slopes])
        return columns, work, rates_of_redundant_drives(robot, poses)

    def _mark_jumps(self, columns: Columns, work: Array, part: slice) -> None:
        """Mark points to which an open chain gets from the point before by a jump: to another of its solutions.

        A robot with loops has numbered branches instead. `work` has places, forces and rates by the length of the path
        of the drives' joints, of the points and if there is one of the point before.
        """
        if self.robot.has_branches:
            return
        scale = self.robot.velocity_scale[self.robot.actuated_indices]
        steps, length = np.abs(np.diff(work[0], axis=0)), self.timed.length[part]
        most = _JUMP * scale + 2.0 * np.abs(work[2, 1:]) * length[-len(steps) :, None] if len(steps) else steps
        jumps = np.flatnonzero((steps > most).any(axis=1)) + len(length) - len(steps)
        columns["branch"][jumps], columns["within_limits"][jumps] = 1.0, 0.0

    @property
    def coordinate_names(self) -> list[str]:
        """Columns of the coordinates."""
        return [f"{coordinate.name}_{coordinate.unit}" for coordinate in self.robot.coordinates]

    def _numbered(self, prefix: str, commands: Matrix) -> Columns:
        return {
            f"{prefix}{name}_{command.unit}": column
            for name, command, column in zip(self._drive_names, self.robot.commands, commands.T, strict=True)
        }

    def _drive_columns(self, velocities: Matrix, accelerations: Matrix, forces: Matrix) -> Columns:
        robot = self.robot
        found: Columns = {}
        for name, command in zip(self._drive_names, robot.commands, strict=True):
            index = robot.single_joint(command.joint).v_index
            drive = robot.actuated_joints.index(command.joint)
            unit = "N" if robot.single_joint(command.joint).translates else "N m"
            rate, force = velocities[:, index], forces[:, drive]
            found |= {
                f"{name}_speed_{command.unit}_s": command.scale * rate,
                f"{name}_acceleration_{command.unit}_s2": command.scale * accelerations[:, index],
                f"{name}_force_{_key(unit)}": force,
                f"{name}_power_W": force * rate,
            }
        return found

    def _margins(self, poses: Poses) -> Vector:
        """Return the least distance of a limited joint from its ends, relative to its range; negative beyond."""
        robot = self.robot
        lower, upper = robot.lower_limits, robot.upper_limits
        limited = np.flatnonzero(np.isfinite(upper - lower) & (upper > lower))
        if not limited.size:
            return np.full(len(poses), np.nan)
        q, low, high = poses.q[:, limited], lower[limited], upper[limited]
        return np.asarray((np.minimum(q - low, high - q) / (high - low)).min(axis=1))

    @cached_property
    def _mobility(self) -> Any:
        return instantaneous_mobility(generic_configuration(self.robot.home))

    def _singularity(self, poses: Poses) -> Vector:
        return np.asarray(least_singularity_measures(self.robot, poses, self._mobility, on_failure="nan"))

    def _drive_forces(
        self, motion: Motion, moves: Indices, shares: Array, feed: Vector, first: Matrix, second: Matrix
    ) -> DriveForces:
        """Return the forces of the drives by speed and acceleration, with the cutting force at a feed."""
        robot, poses, none = self.robot, motion.poses, np.zeros_like(first)
        motions = drive_motions(robot, poses)
        wrenches = self._wrenches(moves, shares, feed, motion.tool, poses.rotations)
        still, moving, accelerating = (
            motion_forces(robot, poses, motions, *rates, payloads=self._payloads)
            for rates in ((none, none), (first, second), (none, first))
        )
        at_rest = still - np.einsum("niu,ni->nu", motions.tool, wrenches)
        return DriveForces(at_rest, moving - still, accelerating - still)

    def _wrenches(self, moves: Indices, shares: Array, feed: Vector, tool: Matrix, rotations: Array) -> Matrix:
        """Return the wrenches on the tool point, world axes, shape=(n, 6) [N, N m]."""
        path = self.path
        wrenches = np.zeros((len(moves), 6))
        if path.wrenches is not None:
            first, last = path.wrenches[moves], path.wrenches[moves + 1]
            wrenches += first + shares[:, None] * (last - first)
        cuts = ~path.rapid[moves]
        if self.options.force is not None:
            wrenches[cuts, :3] += finite_array("force", self.options.force, (3,))
        if self.options.milling is not None:
            sizes = np.linalg.norm(tool[:, :3], axis=1, keepdims=True)
            direction = np.divide(tool[:, :3], sizes, out=np.zeros((len(moves), 3)), where=sizes > 0.0)
            spindle = -math.copysign(1.0, self.options.tool_length) * np.nan_to_num(rotations[:, :, 2])
            wrenches[cuts, :3] += self.options.milling(feed[cuts], direction[cuts], spindle[cuts])
        return wrenches

    def _elastic(self, poses: Poses, motions: DriveMotions, wrenches: Matrix, tool: Matrix) -> Columns:
        robot = self.robot
        compliances = compliance(robot, poses, on_failure="nan")
        deflection = self._deflection(poses, compliances, wrenches)
        names = [f"deflection_{c}_{'m' if c in 'xyz' else 'rad'}" for c in TOOL_COMPONENTS]
        columns: Columns = dict(zip(names, deflection.T, strict=True))
        columns |= _directional(compliances[:, :3, :3], tool[:, :3])
        model = elastic_model(robot)
        frequencies = natural_frequencies(model, poses, count=1, payloads=self._payloads, on_failure="nan")
        columns["lowest_frequency_Hz"] = frequencies[:, 0]
        if wrenches.any() or self._payloads:
            columns |= self._numbered("compensated_", self._compensated(poses, motions, deflection, wrenches))
        return columns

    def _deflection(self, poses: Poses, compliances: Array, wrenches: Matrix) -> Matrix:
        """Return the displacement of the tool point by the wrenches and the payload, shape=(n, 6) [m, rad]."""
        if self.options.large:
            return self._large(poses, wrenches)
        whole = wrenches.copy()
        weight = self.options.payload * np.array(self.robot.model.gravity.linear)
        whole[:, :3] += weight
        whole[:, 3:] += np.cross(-self.options.tool_length * poses.rotations[:, :, 2], weight)
        return np.asarray(np.einsum("nij,nj->ni", compliances, whole))

    def _large(self, poses: Poses, wrenches: Matrix) -> Matrix:
        model, found = elastic_model(self.robot), np.full((len(poses), 6), np.nan)
        for row in np.flatnonzero(poses.solved):
            loads = Loads(wrenches={self.robot.frame_name(): wrenches[row]}, payloads=self._payloads)
            try:
                found[row] = loaded_equilibrium(model, poses.q[row], loads).displacement()
            except PM3DofError:
                continue
        return found

    def _compensated(self, poses: Poses, motions: DriveMotions, deflection: Matrix, wrenches: Matrix) -> Matrix:
        """Return commands that bring the loaded tool nearest to the path, tip-weighted, shape=(n, commands)."""
        robot = self.robot
        scales = np.array([command.scale for command in robot.commands])
        order = [robot.actuated_joints.index(command.joint) for command in robot.commands]
        known = np.flatnonzero(np.isfinite(deflection).all(axis=1) & np.isfinite(motions.tool).all(axis=(1, 2)))
        commands = np.full_like(poses.commands, np.nan)
        if not len(known):
            return commands
        control, eta = motions.tool[known][:, :, order], self._eta
        wanted, start = poses.transforms[known], poses.commands[known]
        found = start + scales * best_commands(control, deflection[known], eta, robot.tool_motions)
        for _ in range(2 if self.options.large else 1):
            reached = robot.forward(found, guess=poses.q[known], on_failure="nan")
            loaded = self._deflection(reached, compliance(robot, reached, on_failure="nan"), wrenches[known])
            left = pose_difference(wanted, moved_pose(reached.transforms, loaded))
            found = found + scales * best_commands(control, np.nan_to_num(left), eta, robot.tool_motions)
        commands[known] = found
        return commands

    @property
    def _eta(self) -> float:
        return abs(self.options.tool_length) or TIP_LENGTH

    @cached_property
    def _sources(self) -> ErrorSources:
        assert self.options.errors is not None
        return ErrorSources(self.options.errors)

    def _errors(self, poses: Poses, wrenches: Matrix) -> Columns:
        columns: Columns = {}
        if self.options.calibration is not None:
            known = self.options.calibration
            own = Poses(known.errors.robot, poses.q, poses.residual, poses.broken_limits)
            conditions: dict[str, Array | float] = {**self.options.conditions}
            if wrenches.any() and known.bears_wrenches:
                moved = wrenches.copy()
                arm = self.options.tool_length * poses.rotations[:, :, 2]
                moved[:, 3:] += np.cross(np.nan_to_num(arm), wrenches[:, :3])
                conditions |= dict(zip(WRENCH_COLUMNS, moved.T, strict=True))
            answer = known.compensate(own, conditions, on_failure="nan", with_deviations=False)
            columns |= self._numbered("calibrated_", answer.commands)
            columns |= {"expected_error_m": answer.predicted_error, "error_95_percent_m": answer.error_bound}
        elif self.options.errors is not None:
            sources = self._sources
            own = Poses(sources.robot, poses.q, poses.residual, poses.broken_limits)
            for name, kind in (("expected_error_m", "tip_rms"), ("error_bound_m", "worst_tip")):
                columns[name] = kinematic_sum(sources, own, kind, eta=self._eta, on_failure="nan").values  # type: ignore[arg-type]
        return columns


def evaluate_path(robot: Robot, path: ToolPath, options: PathOptions | None = None) -> PathEvaluation:
    r"""Judge a tool path on a robot, before it is run.

    Between the points of the path the robot is solved wherever joints that move evenly would leave the path by more
    than the tolerance. Points that break a limit or are out of reach are kept, in order.

    Args:
        robot: the robot.
        path: the path, read for the robot with the same tool length.
        options: how it is run and judged.

    Raises:
        UnreachablePoseError: the path sets components of the placement of the tool that the robot cannot give.
        SingularConfigurationError: the drives do not determine the pose anywhere.
        InvalidValueError: an option is wrong.
        DescriptionError: the robot has no tool frame or no drives.
    """
    require_kind("robot", robot, Robot, "pm.load")
    require_kind("path", path, ToolPath, "read_path")
    if not robot.commands:
        raise InvalidValueError("robot", problem=f"{robot.name} has no drives", expected="actuated joints")
    robot.require_regular_drives(from_home=False)
    return PathEvaluation(robot, path, options or PathOptions())


def _key(unit: str) -> str:
    return unit.replace(" ", "_")


def _directional(translations: Array, tool: Matrix) -> Columns:
    """Return the stiffness felt along the feed, and the least one across it; NaN at rest."""
    sizes = np.linalg.norm(tool, axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(sizes > 0.0, tool / sizes, np.nan)
        soft = np.einsum("ni,nij,nj->n", along, translations, along)
        across = np.eye(3) - along[:, :, None] * along[:, None, :]
        matrices = across @ translations @ across
        greatest = np.full(len(tool), np.nan)
        known = np.isfinite(matrices).all(axis=(1, 2))
        greatest[known] = np.linalg.eigvalsh(matrices[known])[:, -1]
        return {"stiffness_along_N_m": 1.0 / soft, "stiffness_across_N_m": 1.0 / greatest}
