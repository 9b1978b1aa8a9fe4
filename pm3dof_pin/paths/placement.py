"""Where in the workspace a path is stiffest, most accurate or fastest: a search over placements of the workpiece.

Differential evolution of SciPy (R. Storn and K. Price, Journal of Global Optimization 11, 1997), with a fixed seed. The
cost of a placement is that of the worst point of the path; a placement with points beyond limits costs more than any
without, and more the more points there are.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.arrays import require_choice
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.errors.error_sums import kinematic_sum
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_range
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.tool_components import rotation_of_angles, tool_components
from pm3dof_pin.paths.bounds import drive_limits
from pm3dof_pin.paths.evaluation import PathOptions
from pm3dof_pin.paths.follower import Follower, with_tool_length
from pm3dof_pin.paths.gcode import MACHINE, Systems, from_machine, in_machine
from pm3dof_pin.paths.tool_path import ToolPath
from pm3dof_pin.typing import Array, Matrix, Vector

Goal: TypeAlias = Literal["stiffest", "accurate", "fastest"]
"""What a placement is best for: least deflection under the force, or under 1 N in the softest direction; least expected
error; greatest speed of the tool that the drives give in every direction."""

_POINTS = 240  # of the path, at which a placement is judged
_POPULATION, _GENERATIONS = 10, 40  # per variable; at most
_BEYOND = 1e6  # cost of points beyond limits, much more than of any other

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class WorkpiecePlacement:
    """The placement that a search has found."""

    #: placements of the path's coordinate systems in the base, by number, to read the program again with
    workpiece: Systems
    goal: Goal  #: what it is best for
    unit: str  #: of the costs: "m"; "m/N" of the stiffest without a force; "s/m" of the fastest
    motion: Matrix  #: by which the workpiece was moved, in the base, shape=(4, 4)
    cost: float  #: at the worst point of the path
    cost_before: float  #: that where the path was; NaN if it broke a limit there
    variables: tuple[str, ...]  #: what was searched over: x, y, z, rz


class PlacementSearch:
    """The cost of placements of a path."""

    def __init__(self, robot: Robot, path: ToolPath, goal: Goal, options: PathOptions) -> None:
        self._follower = Follower(with_tool_length(robot, options.tool_length), path, options.table)
        self.robot, self._options, self._goal = self._follower.robot, options, goal
        own = path.system != MACHINE
        # moves that start where another one, or home, has left the machine count at their ends only
        after_own = np.insert(own[:-1] & (path.named[1:] == path.named[:-1]).all(axis=1), 0, False)
        count = len(path)
        shares = np.linspace(0.0, 1.0, max(-(-_POINTS // count), 1) + 1)[1:]
        moves, along = np.repeat(np.arange(count), len(shares)), np.tile(shares, count)
        kept = own[moves] & (after_own[moves] | (along == 1.0))
        if not kept.any():
            raise InvalidValueError("path", problem="is all in the base, G53", expected="moves of a workpiece")
        every = max(-(-int(kept.sum()) // _POINTS), 1)
        moves, along = moves[kept][::every], along[kept][::every]
        self.targets = path.values(moves, along)
        self._home = tool_components(self.robot.home.tool_placement.homogeneous)
        unnamed, systems = ~path.named[moves], path.system[moves]
        unnamed[:, 3:] &= path.turns
        #: points with axes that the program has not named yet: rows, placement of their system, and the axes
        self._unnamed = [
            (rows, path.placements.get(int(system), np.eye(4)), unnamed[rows])
            for system in np.unique(systems)
            if len(rows := np.flatnonzero((systems == system) & unnamed.any(axis=1)))
        ]
        cutting = ~path.rapid[moves]
        self.cutting = cutting if cutting.any() else ~cutting
        placed = np.where(unnamed[:, :3].all(axis=0) | ~unnamed[:, :3], self.targets[:, :3], np.nan)
        self.centre = 0.5 * (np.nanmin(placed, axis=0) + np.nanmax(placed, axis=0))
        self.force = None if self._options.force is None else np.asarray(self._options.force, dtype=float)
        self._quality = self._measure(robot)

    def _measure(self, robot: Robot) -> Callable[[Poses], Vector]:
        """Return the function from poses to their costs, shape=(n,)."""
        options = self._options
        if self._goal == "stiffest":
            force = self.force

            def deflection(poses: Poses) -> Vector:
                translations = compliance(self.robot, poses, on_failure="nan")[:, :3, :3]
                if force is not None:
                    return np.asarray(np.linalg.norm(translations @ force, axis=1))
                known = np.isfinite(translations).all(axis=(1, 2))
                found = np.full(len(poses), np.nan)
                found[known] = np.linalg.eigvalsh(translations[known])[:, -1]
                return found

            return deflection
        if self._goal == "accurate":
            if options.errors is None:
                raise InvalidValueError("goal", problem=f"accurate: {robot.name} has no error file", expected="one")
            sources, eta = ErrorSources(options.errors), abs(options.tool_length) or TIP_LENGTH

            def error(poses: Poses) -> Vector:
                own = Poses(sources.robot, poses.q, poses.residual, poses.broken_limits)
                return kinematic_sum(sources, own, "tip_rms", eta=eta, on_failure="nan").values

            return error
        limits = drive_limits(self.robot, options.limits.drive_speed, "speed")
        if not np.isfinite(limits).any():
            raise InvalidValueError("goal", problem=f"fastest: {robot.name} has no speed limits", expected="some")
        linear = [k for k, c in enumerate(self.robot.coordinates) if c.unit == "m"]

        def slowness(poses: Poses) -> Vector:
            drives = self.robot.actuated_joints
            rates = jacobian(self.robot, poses, of=drives, by="coordinates", on_failure="nan").values[:, :, linear]
            return np.asarray((np.linalg.norm(rates, axis=2) / limits).max(axis=1))

        return slowness

    def moved(self, motions: Array) -> Array:
        """Return the points of the path after motions of the workpiece, shape=(m, 4, 4), as shape=(m, n, 6)."""
        turns = self._follower.path.turns
        found = np.stack([in_machine(motion, self.targets, turns=turns) for motion in motions])
        for rows, placement, unnamed in self._unnamed:  # there the machine stands where home, not the workpiece, is
            local, home = (from_machine(placement, each, turns=turns) for each in (self.targets[rows], self._home))
            for own, motion in zip(found, motions, strict=True):
                moved = motion @ placement
                shift = from_machine(moved, self._home, turns=turns) - home
                own[rows] = in_machine(moved, local + unnamed * shift, turns=turns)
        return found

    def costs(self, motions: Array) -> Vector:
        """Return the costs of motions of the workpiece, shape=(m, 4, 4), as shape=(m,)."""
        targets = self.moved(motions)
        quality, within = self.judged(targets.reshape(-1, 6))
        quality, within = quality.reshape(targets.shape[:2]), within.reshape(targets.shape[:2])
        beyond = np.mean(~within | ~np.isfinite(quality), axis=1)
        worst = np.nanmax(np.where(within & self.cutting, quality, 0.0), axis=1, initial=0.0)
        return np.asarray(np.where(beyond > 0.0, _BEYOND * (1.0 + beyond), worst))

    def judged(self, targets: Matrix) -> tuple[Vector, NDArray[np.bool_]]:
        """Return cost and legality of points, shape=(n, 6)."""
        poses = self._follower.solve(targets)
        return self._quality(poses), poses.within_limits & (poses.branch == 0)

    def ends(self, turn: bool) -> dict[str, tuple[float, float]]:
        """Return the ranges of the middle of the path and of its turn, by name [m, rad]."""
        found = {}
        named = self._follower.path.components or ()  # others stay where the machine is, wherever the workpiece is
        for coordinate in self.robot.coordinates:
            if coordinate.tool in TOOL_COMPONENTS[:3] and coordinate.tool in named:
                first, last = coordinate_range(self.robot, coordinate)
                middle, width = float(self.centre[TOOL_COMPONENTS.index(coordinate.tool)]), self._follower.unit
                ends = first if np.isfinite(first) else middle - width, last if np.isfinite(last) else middle + width
                found[coordinate.name] = ends
        if turn:
            found["rz"] = (-np.pi, np.pi)
        return found

    def motions(self, names: tuple[str, ...], values: Matrix) -> Array:
        """Return the motions that bring the middle of the path to values, shape=(m, number of names)."""
        motions = np.tile(np.eye(4), (len(values), 1, 1))
        middle = np.tile(self.centre, (len(values), 1))
        for name, column in zip(names, values.T, strict=True):
            if name == "rz":
                angles = np.zeros((len(values), 3))
                angles[:, 2] = column
                motions[:, :3, :3] = rotation_of_angles(angles)
            else:
                middle[:, TOOL_COMPONENTS.index(name)] = column
        motions[:, :3, 3] = middle - motions[:, :3, :3] @ self.centre
        return motions


def place_path(
    robot: Robot,
    path: ToolPath,
    goal: Goal = "stiffest",
    options: PathOptions | None = None,
    *,
    turn: bool = False,
    seed: int = 0,
) -> WorkpiecePlacement:
    r"""Search the placement of the workpiece at which a path is best.

    The workpiece is moved in the directions in which the robot moves its tool and which the program names, within the
    ranges of its coordinates; axes that it has not named yet stay where the machine is. Moves that start at home of the
    machine, or name an axis for the first time, count at their ends only; rapids count for the limits alone.

    Args:
        robot: the robot.
        path: the path, of a program.
        goal: what it is to be best for.
        options: how the path is run, as for :func:`~pm3dof_pin.paths.evaluation.evaluate_path`.
        turn: whether the workpiece may also be turned about z.
        seed: of the search.

    Raises:
        UnreachablePoseError: no placement was found at which the whole path is within limits.
        InvalidValueError: the path is one of coordinates or has no moves of the workpiece, or the robot lacks what the
            goal needs.
    """
    require_choice("goal", goal, Goal)
    if path.components is None:
        raise InvalidValueError("path", problem="is one of the robot's coordinates", expected="a program in G-code")
    from scipy.optimize import differential_evolution  # slow to load

    search = PlacementSearch(robot, path, goal, options or PathOptions())
    ends = search.ends(turn)
    names = tuple(ends)
    if not names:
        raise InvalidValueError(
            "path", problem=f"names no axis along which {robot.name} moves its tool", expected="one"
        )
    before = float(search.costs(np.eye(4)[None])[0])
    start = [{**dict(zip("xyz", search.centre, strict=True)), "rz": 0.0}[name] for name in names]
    result = differential_evolution(
        lambda values: search.costs(search.motions(names, np.reshape(values, (len(names), -1)).T)),
        list(ends.values()),
        popsize=_POPULATION,
        maxiter=_GENERATIONS,
        rng=np.random.default_rng(seed),
        polish=False,
        updating="deferred",
        vectorized=True,
        x0=start if all(low <= x <= high for x, (low, high) in zip(start, ends.values(), strict=True)) else None,
    )
    motion, cost = search.motions(names, result.x[None])[0], float(result.fun)
    if before <= cost < _BEYOND:
        motion, cost = np.eye(4), before
    if cost >= _BEYOND:
        message = f"{robot.name}: no placement of the path is within all limits; {cost / _BEYOND - 1.0:.0%} of it is "
        message += "beyond them at the best one"
        raise UnreachablePoseError(message, None, "the path is too large or in the wrong orientation")
    unit = {"accurate": "m", "fastest": "s/m"}.get(goal, "m/N" if search.force is None else "m")
    _log.info("%s: %d placements judged", robot.name, result.nfev)
    placements = {
        number: motion @ path.placements.get(number, np.eye(4))
        for number in {*path.placements, *np.unique(path.system).tolist()} - {MACHINE}
    }
    return WorkpiecePlacement(placements, goal, unit, motion, cost, before if before < _BEYOND else float("nan"), names)
