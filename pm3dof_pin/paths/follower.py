"""A robot that follows a tool path: the numbers that place it, what a table adds, and joint motions along the path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import finite_array, frozen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, tool_coordinates
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.actuation import motion_components
from pm3dof_pin.kinematics.mobility import generic_configuration
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.paths.tool_path import ToolPath
from pm3dof_pin.typing import Array, Indices, Matrix, Vector

_POINT = "tool_point"
_STEP = 5e-4  # of finite differences along the path [characteristic lengths]: errors of 1e-7 by truncation and rounding
_TIME_STEP = 2.0  # greatest of these on a path in time: shares of a move


def with_tool_length(robot: Robot, length: float) -> Robot:
    """Return a robot whose tool point is moved along the z axis of its tool frame [m].

    Raises:
        DescriptionError: the robot has no tool frame.
        InvalidValueError: the length is not a finite number.
    """
    number = float(finite_array("tool length", length, ()))
    name = robot.frame_name()
    if number == 0.0:
        return robot
    model = robot.model.copy()
    frame = model.frames[robot.frame_id(name)]
    point = frame.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, number]))
    model.addFrame(pin.Frame(_POINT, frame.parentJoint, point, pin.FrameType.OP_FRAME))
    return robot.replace(model=model, tool_frame=_POINT)


class Motion(NamedTuple):
    """Poses at points of a path, and the derivatives there by the share of the move."""

    poses: Poses
    targets: Matrix  #: numbers of the path, shape=(n, k) [m, rad]
    target_slope: Matrix  #: their first derivative, shape=(n, k)
    joints: Matrix  #: first derivative of all joints as velocities, shape=(n, nv)
    joints_second: Matrix  #: second derivative, shape=(n, nv)
    tool: Matrix  #: first derivative of the tool: translation, rotation in world axes, shape=(n, 6)
    tool_second: Matrix  #: second derivative of the tool's position, shape=(n, 3)


class Follower:
    """A robot on a path.

    A robot with fewer than six degrees of freedom takes as many components of the tool's placement as it has motions;
    others that the path sets are given to a table, or must agree with the path.

    Args:
        robot: the robot.
        path: the path.
        table: directions x, y or z in which a table moves the workpiece.

    Attributes:
        robot: the robot, with coordinates that are numbers of the path.

    Raises:
        InvalidValueError: a table is given for a direction in which the robot moves its tool itself, or for a path of
            the robot's coordinates.
        DescriptionError: the robot has no tool frame.
    """

    def __init__(self, robot: Robot, path: ToolPath, table: Sequence[str] = ()) -> None:
        self.path, self.table = path, tuple(table)
        self._latest: tuple[Indices, Array, Motion] | None = None
        self.unit = robot.characteristic_length
        if path.components is None:
            if table:
                expected = "none for a path of the robot's own coordinates, which place the tool"
                raise InvalidValueError("table", ", ".join(table), expected)
            self.robot, self.taken, self.judged = robot, list(range(len(robot.coordinates))), []
            return
        components = motion_components(generic_configuration(robot.home))
        for axis in self.table:
            if axis not in TOOL_COMPONENTS[:3] or axis in components:
                free = [name for name in TOOL_COMPONENTS[:3] if name not in components]
                expected = f"one of {', '.join(free)}" if free else f"none: {robot.name} moves its tool in x, y and z"
                raise InvalidValueError("table", axis, expected)
        self.taken = [TOOL_COMPONENTS.index(name) for name in components]
        needed = [name for name in path.components if name not in components and name not in self.table]
        self.judged = [TOOL_COMPONENTS.index(name) for name in needed]
        chosen = tool_coordinates(components)
        self.robot = robot if robot.coordinates == chosen else robot.replace(coordinates=chosen)

    @property
    def scale(self) -> Vector:
        """Lengths for the numbers of the path: 1 for lengths, the characteristic length for angles, shape=(k,)."""
        if self.path.components is None:
            return np.where([c.unit == "m" for c in self.robot.coordinates], 1.0, self.unit)
        return np.repeat([1.0, self.unit], 3)

    def solve(self, targets: Matrix, guess: Matrix | None = None) -> Poses:
        """Return the poses at numbers of the path, NaN where they are out of reach, of any branch."""
        values = targets[:, self.taken]
        if guess is None:
            return self.robot.solve(values, on_failure="nan", branches="all")
        return self.robot.solve(values, guess=guess, on_failure="nan", branches="all")

    def sizes(self, moves: Indices) -> Vector:
        """Return the lengths of moves through their middles, angles times the characteristic length, shape=(n,) [m]."""
        points = np.stack([self.path.values(moves, np.full(len(moves), share)) for share in (0.0, 0.5, 1.0)])
        return np.asarray(np.linalg.norm(np.diff(points, axis=0) * self.scale, axis=2).sum(axis=0))

    def motion(self, moves: Indices, shares: Array, sizes: Vector) -> Motion:
        """Return the motion at points of the path, by central differences of solved poses; read-only.

        The latest is kept: a path of one block is solved once, for its motion in time and for its columns. Sizes are
        those of all moves of the path, see :meth:`sizes`.
        """
        latest = self._latest
        if latest is None or not (np.array_equal(latest[0], moves) and np.array_equal(latest[1], shares)):
            latest = self._latest = moves.copy(), shares.copy(), self._motion(moves, shares, sizes)
        return latest[2]

    def _motion(self, moves: Indices, shares: Array, sizes: Vector) -> Motion:
        size = sizes[moves]
        step = np.where(size > 0.0, _STEP * self.unit / np.where(size > 0.0, size, 1.0), 1.0)
        if self.path.times is not None:  # the mean speed counts: at rest, steps by length would go far beyond a move
            whole = self.path.times[-1] - self.path.times[0]
            mean = _STEP * self.unit * whole / (sizes.sum() * self.path.lasting[moves])
            step = np.minimum(mean, _TIME_STEP)
        targets = self.path.values(moves, shares)
        poses = self.solve(targets)
        rows = np.flatnonzero(poses.solved)
        nv, n = self.robot.model.nv, len(moves)
        joints, joints_second = np.full((2, n, nv), np.nan)
        tool, tool_second = np.full((n, 6), np.nan), np.full((n, 3), np.nan)
        slope = np.full_like(targets, np.nan)
        if len(rows):
            q, h = poses.q[rows], step[rows, None]
            ends = [self.path.values(moves[rows], shares[rows] + sign * step[rows]) for sign in (-1.0, 1.0)]
            slope[rows] = (ends[1] - ends[0]) / (2.0 * h)
            before, after = (self.solve(points, q) for points in ends)
            back, forth = (self.difference(q, other.q) for other in (before, after))
            joints[rows], joints_second[rows] = (forth - back) / (2.0 * h), (forth + back) / h**2
            places = [before.transforms, poses.transforms[rows], after.transforms]
            first, here, last = (place[:, :3, 3] for place in places)
            tool[rows, :3] = (last - first) / (2.0 * h)
            tool_second[rows] = (last - 2.0 * here + first) / h**2
            turn = places[2][:, :3, :3] @ np.swapaxes(places[0][:, :3, :3], 1, 2)
            axis = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
            axis -= np.stack([turn[:, 1, 2], turn[:, 2, 0], turn[:, 0, 1]], axis=1)
            tool[rows, 3:] = axis / (4.0 * h)  # sine of a small angle
        return Motion(poses, *map(frozen, (targets, slope, joints, joints_second, tool, tool_second)))

    def difference(self, q: Matrix, other: Matrix) -> Matrix:
        """Return the velocities that lead from q to others in unit time, shape=(n, nv)."""
        model = self.robot.model
        if model.nq == model.nv:
            return other - q
        found = np.full((len(q), model.nv), np.nan)
        for row in np.flatnonzero(np.isfinite(other).all(axis=1)):
            found[row] = pin.difference(model, q[row], other[row])
        return found

    def beside(self, poses: Poses, targets: Matrix) -> Matrix:
        """Return how far the tool is from the path in the directions of the table, shape=(n, number of these) [m]."""
        columns = [TOOL_COMPONENTS.index(axis) for axis in self.table]
        return np.asarray(poses.positions[:, columns] - targets[:, columns])

    def require_agreement(self, poses: Poses, targets: Matrix, moves: Indices, tolerance: float) -> None:
        """Refuse a path that sets components of the placement that the robot cannot give.

        Raises:
            UnreachablePoseError: the tool misses them by more than the tolerance [m].
        """
        if not self.judged:
            return
        reached = tool_components(poses.transforms)
        off = (reached - targets)[:, self.judged]
        angular = np.array(self.judged) >= len(TOOL_COMPONENTS) // 2
        off[:, angular] = ((off[:, angular] + np.pi) % (2.0 * np.pi) - np.pi) * self.unit
        with np.errstate(invalid="ignore"):
            missed = np.abs(off) > tolerance
        if missed.any():
            row, column = np.argwhere(missed)[0]
            names = [TOOL_COMPONENTS[k] for k in self.taken]
            index = self.judged[column]
            name, line = TOOL_COMPONENTS[index], self.path.lines[moves[row]]
            factor, unit = (1e3, "mm") if index < len(TOOL_COMPONENTS) // 2 else (180.0 / np.pi, "deg")
            wanted, found = (f"{factor * values[row, index]:.6g}" for values in (targets, reached))
            advice = "; a table can move the workpiece there: --table" if index < len(TOOL_COMPONENTS) // 2 else ""
            message = f"line {line}: {self.robot.name} places its tool by {', '.join(names)}, and then it is at "
            message += f"{name} = {found} {unit}, not {wanted}{advice}"
            raise UnreachablePoseError(message, None, "the path sets what the robot cannot move")
