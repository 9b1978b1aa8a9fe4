"""Sensitivities of the tool to geometric errors and commands: exact Jacobians of the closed-loop kinematics.

With the joints' velocities dq, including the commands du, and small errors dp, a closed loop stays closed and the
tool moves by

    0  = G dq + P_G dp,      dx = J dq + P_x dp

G is the constraint Jacobian, J the tool's, P_G and P_x the effects of the errors alone on closures and tool. An error
is a twist of everything beyond its place, like the rate of a joint located there, so one piece of code gives all four.

More drives than degrees of freedom agree only on some commands, and errors change these. Such drives are taken for
equally stiff: they give way by the least norm, in radians and characteristic lengths, and the tool moves accordingly.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.arrays import frozen, require_choice, require_kind
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.loop_covectors import RankInDoubtError, covectors, inverses
from pm3dof_pin.exceptions import InvalidValueError, ProgramError, SingularConfigurationError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.reference import assemble_at
from pm3dof_pin.mechanism.closure_wrenches import held_directions
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.programs.geometry import frame_names
from pm3dof_pin.typing import Array, Engine, Indices, Mask, Vector

_POSES_TO_CLOSE_TOGETHER = 3
_SMALL = 1e-3  # largest errors [m, rad] with which closing is tested; displacements by other causes have unit size
_POSES_TO_CLOSE_AT = 20  # at a single pose, such as a symmetric home, more errors let the loops close than elsewhere
logger = logging.getLogger(__name__)

_PROGRAM_FROM = 100
"""Poses of a small robot: a calibration, which comes back to them, then gains by tracing and compiling."""
_LARGE = 12_000  # errors times joints: of larger robots the square of as many times more, as compiling takes minutes,
_DRIVES = 300  # for the drives as long as for so many errors
_MANY_JOINTS = 40  # that follow; of fewer, closures are not eliminated one by one
_NUMBERS = 1e7  # that are computed at once with Pinocchio


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of the tool's pose, [position; rotation vector] in world axes, at n poses, and of joints."""

    errors: Array  #: by the error parameters at fixed commands, shape=(n, 6, number of parameters) [1, m/rad; rad/m, 1]
    commands: Array  #: by the commands, shape=(n, 6, number of commands)

    def __getitem__(self, chosen: Mask) -> Sensitivities:
        """Return those at some of the poses."""
        return Sensitivities(frozen(self.errors[chosen]), frozen(self.commands[chosen]))


def sensitivities(
    errors: GeometricErrors,
    poses: Poses,
    values: ArrayLike | Mapping[str, float] | None = None,
    *,
    joints: Sequence[str] = (),
    engine: Engine | None = None,
) -> Sensitivities:
    """Compute the derivatives of the tool's pose by errors and commands, and of some joints' coordinates.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> errors = pm.GeometricErrors.load("pm3dof")
        >>> poses = pm.reachable_poses(errors.robot, 50, np.random.default_rng(0))
        >>> derivatives = pm.sensitivities(errors, poses)
        >>> derivatives.errors.shape, derivatives.commands.shape
        ((50, 6, 40), (50, 6, 3))

    Args:
        errors: the parameters.
        poses: assembled poses of the robot as described, or of `errors.apply(values)`, shape=(n,).
        values: p of the poses, at which to differentiate; 0 by default.
        joints: single-DoF joints, whose rows follow the tool's, shape=(n, 6 + joints, ...) [m, rad].
        engine: instead of the robot's, see :meth:`Robot.with_engine <pm3dof_pin.kinematics.robot.Robot.with_engine>`.

    Raises:
        InvalidValueError: a pose is not solved; or the loops cannot close with an error (for overconstrained or planar
            robots); see :func:`closable`.
        SingularConfigurationError: at some pose, or nearly so at all, the tool can move with all drives locked, or
            independent drives cannot move one by one.
    """
    require_kind("errors", errors, GeometricErrors, "pm.GeometricErrors.load")
    require_kind("poses", poses, Poses, "Robot.solve")
    poses.robot.require_regular_drives(from_home=False)
    engine = errors.robot.engine if engine is None else engine
    require_choice("engine", engine, Engine)
    p = errors.zeros if values is None else errors.values(values)
    if errors.components is not errors:
        found = sensitivities(errors.components, poses, errors.combinations @ p, joints=joints, engine=engine)
        return Sensitivities(frozen(found.errors @ errors.combinations), found.commands)
    unsolved = np.flatnonzero(~np.isfinite(poses.q).all(axis=-1))
    if unsolved.size:
        raise InvalidValueError("poses", problem=f"include pose {unsolved[0]}, which was not solved")
    if joints:
        tool = sensitivities(errors, poses, p, engine=engine)
        rates = _Loops(errors, poses, p).followed_rates()[0][:, poses.robot.velocity_indices(joints)]
        by_drives, by_errors = np.split(rates, [len(poses.robot.actuated_indices)], axis=2)
        own = _of_motions(poses, by_errors, by_drives)
        parts = [(tool.errors, own.errors), (tool.commands, own.commands)]
        return Sensitivities(*(frozen(np.concatenate(pair, axis=1)) for pair in parts))
    size = (len(errors) + _DRIVES) * poses.robot.model.nv
    fewest = _PROGRAM_FROM * max(1.0, size / _LARGE) ** 2
    if engine == "program" and len(poses) >= fewest:
        from pm3dof_pin.errors.sensitivity_program import evaluated

        try:
            by_errors, by_drives, sound = evaluated(poses.robot, poses.q, errors, errors.local_twists(p))
        except ProgramError as error:
            logger.debug("%s: sensitivities without a program (%s)", poses.robot.name, error)
        else:
            doubtful = np.flatnonzero(~sound)
            if doubtful.size:
                motions = _careful_motions(errors, poses, p, doubtful)
                by_errors[doubtful], by_drives[doubtful] = np.split(motions, [len(errors)], axis=2)
            return _of_motions(poses, by_errors, by_drives)
    motions = _careful_motions(errors, poses, p, np.arange(len(poses)))
    return _of_motions(poses, *np.split(motions, [len(errors)], axis=2))


def _of_motions(poses: Poses, by_errors: Array, by_drives: Array) -> Sensitivities:
    by_commands = by_drives / [command.scale for command in poses.robot.commands]
    return Sensitivities(frozen(by_errors), frozen(by_commands))


def _careful_motions(errors: GeometricErrors, poses: Poses, p: Array, numbers: Indices) -> Array:
    """Return the tool's motion by one unit of each error, then of each drive's coordinate, at poses by number.

    Its shape is (numbers, 6, k + u).
    """
    motions = np.empty((len(numbers), 6, len(errors) + len(poses.robot.actuated_indices)))
    done = 0
    for loops in _blocks(errors, poses, p, numbers, dense=False):
        here = slice(done, done + len(loops))
        found = loops.regular_motions()
        if found is None:
            dense = _blocks(errors, poses, p, numbers[here])
            found = np.concatenate([_followed_motions(few) for few in dense])
        motions[here] = found
        done = here.stop
    return motions


def _blocks(
    errors: GeometricErrors, poses: Poses, p: Array, numbers: Indices, *, dense: bool = True
) -> Iterator[_Loops]:
    """Yield the loops at poses by number, in blocks whose matrices, of all closures by all columns, fit into memory.

    If these are not dense, each closure has few columns.
    """
    robot = poses.robot
    columns, rows = robot.model.nv + len(errors), robot.closure_scale.size
    size = columns * (robot.model.nv + rows + 24) if dense else columns * 40 + robot.model.nv * rows
    block = max(1, int(_NUMBERS / size))
    for start in range(0, len(numbers), block):
        own = numbers[start : start + block]
        yield _Loops(errors, poses[own], p, own)


def _followed_motions(loops: _Loops) -> Array:
    rates, strain = loops.followed_rates()
    strained = np.flatnonzero(strain.max(axis=0, initial=0.0) > RANK_TOLERANCE)
    if strained.size:
        names = ", ".join(loops.input_names[k] for k in strained)
        raise InvalidValueError(
            "geometric errors", names, "errors with which the loops close (closable() leaves out the others)"
        )
    return loops.tool_motions(rates)


def closable(errors: GeometricErrors, poses: Poses | None = None) -> GeometricErrors:
    """Return the errors with which the loops can close, at assembled poses of the robot as described.

    The poses are random by default. A planar four-bar with parallel axes cannot close when one axis is tilted: it
    would bend or bind, so such an error is not kinematic. Each parameter is first judged by itself, to first order. If
    the loops do not close with all the remaining ones together, they are added in turn, and those with which the loops
    stay open are left out: lengths come first, then rotations, then parameters that move no loop by themselves, such as
    the rotation of a rod about its own axis.
    """
    if not len(errors) or not errors.robot.closures:
        return errors
    if poses is None:
        poses = reachable_poses(errors.robot, _POSES_TO_CLOSE_AT, np.random.default_rng(0))
    if errors.components is not errors:  # a tied parameter needs all of its parts
        closing = closable(errors.components, poses).names
        lost = np.array([name not in closing for name in errors.components.names])
        return errors.select(_names(errors, ~(errors.combinations[lost] != 0.0).any(axis=0)))
    idle, strains = np.ones(len(errors), dtype=bool), np.zeros(len(errors))
    for loops in _blocks(errors, poses, errors.zeros, np.arange(len(poses))):
        idle &= loops.idle()
        strains = np.maximum(strains, loops.strains())
    turning = np.array([parameter.motion == "rotation" for parameter in errors.parameters])
    order = np.lexsort((turning, idle))
    fitting = order[strains[order] <= RANK_TOLERANCE]
    kept = np.zeros(len(errors), dtype=bool)
    small = np.minimum(errors.tolerances, _SMALL) * np.random.default_rng(0).standard_normal(len(errors))
    _keep_closable(errors, small, fitting, kept, poses[:_POSES_TO_CLOSE_TOGETHER])
    return errors.select(_names(errors, kept))


def _keep_closable(errors: GeometricErrors, values: Vector, more: NDArray[np.intp], kept: Mask, poses: Poses) -> None:
    """Extend `kept` in place by those of `more` with which the loops close at these values, bisecting if needed."""
    trial = kept.copy()
    trial[more] = True
    crooked = errors.apply(np.where(trial, values, 0.0))
    # one pose is enough: the others may be out of reach of such a machine
    shared = len(poses.robot.placing_drives) < len(poses.robot.commands)  # their commands agree only without errors
    there = crooked.coordinates if shared else crooked.command_coordinates
    values_there = poses.coordinates if shared else poses.commands
    if any(assemble_at(crooked, there, *pair).converged for pair in zip(values_there, poses.q, strict=True)):
        kept[:] = trial
    elif len(more) > 1:
        for half in np.array_split(more, 2):
            _keep_closable(errors, values, half, kept, poses)


def _names(errors: GeometricErrors, chosen: Mask) -> list[str]:
    return [name for name, is_chosen in zip(errors.names, chosen, strict=True) if is_chosen]


class _Loops:
    """Closures and tool as linear functions of joint velocities and errors, at many poses.

    Columns are the twists [v; omega] of whatever is attached, for one unit of each velocity, then of each error; linear
    part at the world's origin, world axes.
    """

    def __init__(
        self,
        errors: GeometricErrors,
        poses: Poses,
        values: ArrayLike | Mapping[str, float],
        numbers: Indices | None = None,
    ) -> None:
        """Take poses, and by what numbers messages name them."""
        self._errors = errors
        self._numbers = np.arange(len(poses)) if numbers is None else numbers
        self._robot = poses.robot
        self._model = poses.robot.model
        self._q = poses.q
        self._lengths: dict[str, list[int]] = {}  # columns of the errors of each rod
        for k, parameter in enumerate(errors.parameters, start=self._model.nv):
            if parameter.place in errors.robot.rods:
                self._lengths.setdefault(parameter.place, []).append(k)
        self._joints, twists = _tree(self._model, poses.q, self._carriers())
        self._columns = np.concatenate([twists, self._error_twists(errors.local_twists(values))], axis=2)

    def __len__(self) -> int:
        return len(self._q)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of drives and errors."""
        return (*self._robot.actuated_joints, *self._errors.names)

    def regular_motions(self) -> Array | None:
        """Return what :meth:`tool_motions` does; None if some rank is in doubt, or an error strains the closures.

        They take part by their six covectors at the tool, not by the rates of all joints: otherwise most of the time
        of large robots.
        """
        robot, nv = self._robot, self._model.nv
        driven, free = robot.actuated_indices, robot.passive_indices
        if not robot.has_loops:
            return None
        blocks, tool, excess = list(self._closure_blocks()), self._tool(), self._excess
        if excess and len(free) + excess != robot.closure_scale.size:
            return None
        scale = np.ones(tool.shape[2])
        scale[free] = robot.velocity_scale[free]
        if excess:
            scale[driven] = self._give
        parts = blocks if len(free) > _MANY_JOINTS else [(self._stacked(blocks)[:, :, :nv], np.arange(nv))]
        sizes = np.split(robot.closure_scale[:, None], np.cumsum([rows.shape[1] for rows, _ in parts])[:-1])
        scaled = [(rows * scale[moving] / size, moving) for (rows, moving), size in zip(parts, sizes, strict=True)]
        try:
            found = covectors(scaled, tool * scale, free, driven, excess)
        except RankInDoubtError:
            return None
        acting, unmet = (part / robot.closure_scale for part in found)
        strains, first = np.zeros((len(tool), unmet.shape[1], tool.shape[2])), 0
        for rows, moving in blocks:
            own = slice(first, first + rows.shape[1])
            tool[:, :, moving] -= acting[:, :, own] @ rows
            strains[:, :, moving] += unmet[:, :, own] @ rows
            first = own.stop
        inputs = np.concatenate([driven, np.arange(nv, tool.shape[2])])
        if np.abs(strains[:, :, inputs]).max(initial=0.0) > RANK_TOLERANCE:
            return None
        return np.concatenate([tool[:, :, nv:], tool[:, :, driven]], axis=2)

    @property
    def _excess(self) -> int:
        """How many more drives there are than degrees of freedom."""
        return len(self._robot.actuated_indices) - len(self._robot.placing_drives)

    @property
    def _give(self) -> Vector:
        """The units of the drives in which equally stiff ones give way by the least norm, shape=(drives,) [rad, m]."""
        robot = self._robot
        return np.where(robot.velocity_scale[robot.actuated_indices] == 1.0, 1.0, robot.length_unit)

    def strains(self) -> Array:
        """Return the scaled closure error that each error leaves at the worst pose, shape=(errors,)."""
        _, strain = self.followed_rates()
        return np.asarray(strain[:, len(self._robot.actuated_joints) :].max(axis=0, initial=0.0))

    def idle(self) -> Mask:
        """Tell which errors move no closure at any pose, shape=(errors,)."""
        moved = self._closures()[:, :, self._model.nv :]
        return np.asarray(np.abs(moved).max(axis=(0, 1), initial=0.0) < RANK_TOLERANCE)

    def followed_rates(self) -> tuple[Array, Array]:
        """Return the velocities that result from one unit of each drive and error, and the remaining closure error.

        Shapes are (n, nv, drives + errors) and (n, drives + errors). SingularConfigurationError is raised if the tool
        can move with all drives locked, or if a drive cannot move without others.
        """
        robot, nv = self._robot, self._model.nv
        driven, free = robot.actuated_indices, robot.passive_indices
        inputs = np.concatenate([driven, np.arange(nv, self._columns.shape[2])])
        rates = np.zeros((len(self._columns), nv, len(inputs)))
        rates[:, driven, np.arange(len(driven))] = 1.0
        if not robot.has_loops:
            self._require_tool_at_rest(free, np.eye(len(free)))
            return rates, np.zeros((len(rates), len(inputs)))
        closures = self._closures() / robot.closure_scale[:, None]
        velocity_scale = robot.velocity_scale[free]
        passive, pushed = closures[:, :, free] * velocity_scale, closures[:, :, inputs]
        inverse, sound = inverses(passive)
        if sound.all():
            rates[:, free] = -velocity_scale[:, None] * (inverse @ pushed)
            return rates, np.zeros((len(rates), len(inputs)))
        left, values, right = np.linalg.svd(passive, full_matrices=False)
        noise = RANK_TOLERANCE * values.max(axis=1, initial=0.0, keepdims=True)
        inverse = np.where(values > noise, 1.0 / np.where(values > noise, values, 1.0), 0.0)
        kept = np.where(values > noise, 1.0, 0.0)[:, :, None] * right
        self._require_tool_at_rest(free, np.eye(len(free)) - np.swapaxes(kept, 1, 2) @ kept)
        if self._excess:
            return self._shared_rates(rates, passive, pushed)
        in_range = np.swapaxes(left, 1, 2) @ pushed
        followed = np.swapaxes(right, 1, 2) @ (inverse[:, :, None] * in_range)
        rates[:, free] = -velocity_scale[:, None] * followed
        strain = pushed - left @ (np.where(values > noise, 1.0, 0.0)[:, :, None] * in_range)
        unit = np.abs(pushed).max(axis=1) + 1.0
        strain = np.abs(strain).max(axis=1) / unit
        bound = np.flatnonzero(strain[:, : len(driven)].max(axis=0, initial=0.0) > RANK_TOLERANCE)
        if bound.size:
            raise SingularConfigurationError(
                f"{robot.name}: drives {', '.join(robot.actuated_joints[k] for k in bound)} cannot move one by one: "
                "a pose is singular, or there are more drives than needed: expected independent drives (name_mot)"
            )
        return rates, strain

    def _shared_rates(self, rates: Array, passive: Array, pushed: Array) -> tuple[Array, Array]:
        """Return what :meth:`followed_rates` does, of more drives than degrees of freedom.

        They give way by the least norm, in radians and units of length, as equally stiff drives do.
        """
        robot, driven = self._robot, self._robot.actuated_indices
        free, scale = robot.passive_indices, robot.velocity_scale
        inverse = np.linalg.pinv(passive, rcond=RANK_TOLERANCE)
        unmet = pushed - passive @ (inverse @ pushed)
        give, excess = self._give, self._excess
        by_drives = unmet[:, :, : len(driven)] * give
        sizes = np.linalg.svd(by_drives, compute_uv=False)
        noise = RANK_TOLERANCE * np.abs(pushed).max(axis=(1, 2), initial=0.0)
        singular = np.flatnonzero((sizes > noise[:, None]).sum(axis=1) != excess)
        if singular.size:
            where = self._numbers[singular[0]]
            raise SingularConfigurationError(f"{robot.name}: its drives lose or gain a relation at pose {where}")
        given = -(np.linalg.pinv(by_drives, rcond=0.5 * sizes[:, excess - 1 : excess].min() / sizes.max()) @ unmet)
        given *= give[:, None]
        followed = -(inverse @ (pushed + pushed[:, :, : len(driven)] @ given))
        rates[:, free] = scale[free][:, None] * followed
        rates[:, driven] += given
        left = pushed + passive @ followed + pushed[:, :, : len(driven)] @ given
        return rates, np.abs(left).max(axis=1) / (np.abs(pushed).max(axis=1) + 1.0)

    def tool_motions(self, rates: Array) -> Array:
        """Return the tool's motion by errors, then by drives, given the velocities that result from them."""
        driven, tool = len(self._robot.actuated_indices), self._tool()
        motions = tool[:, :, : self._model.nv] @ rates
        return np.concatenate([motions[:, :, driven:] + tool[:, :, self._model.nv :], motions[:, :, :driven]], axis=2)

    def _error_twists(self, local: Array) -> Array:
        columns: dict[str, list[int]] = {}
        for k, parameter in enumerate(self._errors.parameters):
            columns.setdefault(parameter.place, []).append(k)
        twists = np.zeros((len(self._joints), 6, len(self._errors)))
        for place, own in columns.items():
            if place in self._errors.robot.rods:
                continue
            at = self._place(place)
            linear, angular = at[:, :3, :3] @ local[:3, own], at[:, :3, :3] @ local[3:, own]
            twists[:, :3, own] = linear + _crossed(at[:, :3, 3, None], angular)
            twists[:, 3:, own] = angular
        return twists

    def _carriers(self) -> list[int]:
        """Return the joints that carry closures, tool and places of errors."""
        places = {parameter.place for parameter in self._errors.parameters} - self._errors.robot.rods.keys()
        joints = {place for place in places if self._model.existJointName(place)}
        frames = {self._robot.frame_id(name) for name in (*frame_names(self._robot), *(places - joints))}
        on_frames = {self._model.frames[frame].parentJoint for frame in frames}
        return sorted(on_frames | {self._model.parents[self._model.getJointId(name)] for name in joints})

    def _place(self, place: str) -> Array:
        """Return the displaced origin of a place, before its joint moves, shape=(n, 4, 4)."""
        model = self._model
        if model.existJointName(place):
            joint = model.getJointId(place)
            return np.asarray(self._joints[:, model.parents[joint]] @ model.jointPlacements[joint].homogeneous)
        return self._frame(self._robot.frame_id(place))

    def _frame(self, frame: int) -> Array:
        entry = self._model.frames[frame]
        return np.asarray(self._joints[:, entry.parentJoint] @ entry.placement.homogeneous)

    def _closures(self) -> Array:
        """Return the closures' velocities for all columns, as in Configuration.constraint_jacobian."""
        return self._stacked(self._closure_blocks())

    def _stacked(self, blocks: Iterable[tuple[Array, Indices]]) -> Array:
        """Return blocks of rows, which have some of the columns, below each other, shape=(n, rows, columns)."""
        stacked = np.zeros((len(self._columns), self._robot.closure_scale.size, self._columns.shape[2]))
        first = 0
        for rows, moving in blocks:
            stacked[:, first : first + rows.shape[1], moving] = rows
            first += rows.shape[1]
        return stacked

    def _closure_blocks(self) -> Iterator[tuple[Array, Indices]]:
        """Yield the closures' velocities, shape=(n, rows, k), for the columns that move them, shape=(k,)."""
        for loop in self._robot.closures:
            a, b = (self._robot.frame_id(name) for name in (loop.frame_a, loop.frame_b))
            movers = self._errors.movers(b) - self._errors.movers(a)
            longer = np.zeros(len(movers))
            longer[self._lengths.get(loop.name, [])] = 1.0
            moving = np.flatnonzero((movers != 0.0) | (longer != 0.0))  # few of a large robot
            relative = self._columns[:, :, moving] * movers[moving]
            at_a, at_b = self._frame(a), self._frame(b)
            axes = [(at[:, :3, :3] @ turn).T for at, turn in zip((at_a, at_b), _bases(loop), strict=True)]
            between = (at_b - at_a)[:, :3, 3]
            toward = (between / np.linalg.norm(between, axis=1)[:, None]).T if loop.kind.is_distance else between.T
            along, about = held_directions(loop.kind, axes[0], axes[1], toward)
            angular = relative[:, 3:]
            linear = relative[:, :3] + _crossed(angular, at_b[:, :3, 3, None])
            for directions, part in ((along, linear), (about, angular)):
                if directions:
                    yield np.asarray(np.einsum("kin,nij->nkj", np.array(directions), part) - longer[moving]), moving
        for coupled in self._robot.loop_kinematics.couplings:
            slopes = [np.ones(len(self._q)), *(-slope * np.ones(len(self._q)) for slope in coupled.slopes(self._q))]
            moving = np.array([coupled.joint.v_index, *(joint.v_index for joint in coupled.others)])
            yield np.stack(slopes, axis=1)[:, None], moving

    def _tool(self) -> Array:
        """Return the tool's twist for all columns, linear part at the tool point, shape=(n, 6, nv + errors)."""
        tool = self._robot.tool_frame_id
        columns = self._columns * self._errors.movers(tool)
        linear = columns[:, :3] + _crossed(columns[:, 3:], self._frame(tool)[:, :3, 3, None])
        return np.concatenate([linear, columns[:, 3:]], axis=1)

    def _require_tool_at_rest(self, free: NDArray[np.intp], idle: Array) -> None:
        """Check that velocities possible with the drives locked do not move the tool."""
        length = self._robot.characteristic_length
        tool = self._tool()[:, :, free] * self._robot.velocity_scale[free]
        tool[:, :3] /= length
        loose = np.flatnonzero(np.abs(tool @ idle).max(axis=(1, 2), initial=0.0) > RANK_TOLERANCE)
        if loose.size:
            raise SingularConfigurationError(
                f"{self._robot.name}: the tool can move with all drives locked at pose "
                f"{', '.join(map(str, self._numbers[loose[:5]]))}{' ...' if loose.size > 5 else ''}"
            )


def _bases(loop: LoopClosure) -> tuple[Array, Array]:
    return loop.bases or (np.eye(3), np.eye(3))


def _crossed(a: Array, b: Array) -> Array:
    """Return cross products along the middle axis, shape=(n, 3, k), faster than np.cross."""
    return np.stack([a[:, i] * b[:, j] - a[:, j] * b[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)


def _tree(model: pin.Model, q: Array, joints: list[int]) -> tuple[Array, Array]:
    """Return placements of some joints, shape=(n, all joints, 4, 4), and the twists of all velocities, (n, 6, nv)."""
    data = scratch_data(model)
    placements = np.zeros((len(q), model.njoints, 4, 4))
    placements[:, :, 3, 3] = 1.0
    twists = np.empty((len(q), 6, model.nv))
    # arrays on Pinocchio's memory, five times as fast to read as placements
    rotations = [data.oMi[joint].rotation for joint in joints]
    translations = [data.oMi[joint].translation for joint in joints]
    for row, positions in enumerate(q):
        pin.computeJointJacobians(model, data, positions)
        twists[row] = data.J.reshape(6, model.nv)
        placements[row, joints, :3, :3] = np.concatenate(rotations).reshape(-1, 3, 3)
        placements[row, joints, :3, 3] = np.concatenate(translations).reshape(-1, 3)
    return placements, twists
