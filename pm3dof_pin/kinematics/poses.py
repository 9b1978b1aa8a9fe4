"""Batches of poses of a robot: joint configurations with closed loops, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.kinematics.branches import branches_of
from pm3dof_pin.mechanism.configuration import LIMIT_TOLERANCE, Configuration
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.typing import Array, Mask

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

REACH = 1
"""Bit of :attr:`Poses.broken_limits` for an unsolved pose; limit group k has bit k + 1."""

_KNOWN = ("residual", "broken_limits", "transforms", "branch")  # what the solver may provide besides q


def limit_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of the bits of :attr:`Poses.broken_limits`, in order."""
    return ("reach", *(group.name for group in robot.limit_groups))


class Poses:
    """A batch of poses, of any shape. Read-only.

    Returned by :meth:`Robot.solve <pm3dof_pin.kinematics.robot.Robot.solve>` and similar methods. An unsolved pose is
    NaN throughout. Batches have a length and are indexed like arrays. A single pose, of shape (), is like a batch of
    one: its length is 1, and `poses[0]` is the pose itself.

    Example:
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("pm3dof")
        >>> poses = robot.solve(robot.grid(theta_x=(-0.2, 1.0, 5), z_e=0.5))
        >>> poses.commands.shape
        (5, 3)
        >>> poses.within_limits
        array([ True,  True,  True,  True, False])

    Args:
        robot: the robot.
        q: joint configurations with closed loops, NaN for unsolved poses, shape=(..., nq) [m, rad].
        residual: greatest closure error, shape=(...) [m, rad]; computed by Pinocchio if not given.
        broken_limits: bit masks, shape=(...); computed by Pinocchio if not given.
        transforms: placements of the tool, shape=(..., 4, 4); computed by Pinocchio if not given.
        branch: branch numbers, shape=(...); computed by Pinocchio if not given.

    Attributes:
        robot: the robot.
        q: joint configurations, shape=(..., nq) [m, rad].
    """

    def __init__(
        self,
        robot: Robot,
        q: Array,
        residual: Array | None = None,
        broken_limits: NDArray[np.uint32] | None = None,
        transforms: Array | None = None,
        branch: NDArray[np.int64] | None = None,
    ) -> None:
        self.robot = robot
        self.q: Array = _kept(np.asarray(q, dtype=float))
        for name, values in zip(_KNOWN, (residual, broken_limits, transforms, branch), strict=True):
            if values is not None:
                self.__dict__[name] = _kept(np.asarray(values))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.robot, np.array(self.q))

    def __repr__(self) -> str:
        return f"Poses({self.robot.name}, shape={self.shape}, {int(self.solved.sum())} solved)"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch."""
        return self.q.shape[:-1]

    def __len__(self) -> int:
        """Return the number of poses along the first dimension; 1 for a single pose."""
        return self.shape[0] if self.shape else 1

    def __iter__(self) -> Iterator[Configuration]:
        """Iterate over the configurations of a one-dimensional batch, or of a single pose."""
        batch = self if self.shape else self.reshape(1)
        return (batch.configuration(index) for index in range(len(batch)))

    def __getitem__(self, index: Any) -> Poses:
        """Return part of the batch; the index is over the batch dimensions. A single pose is like a batch of one."""
        batch = self if self.shape or index is Ellipsis or index == () else self.reshape(1)
        if isinstance(index, np.ndarray) and index.ndim == 1 and index.dtype.kind == "i":  # in half the time
            return batch._mapped(lambda values: values.take(index, axis=0))
        return batch._mapped(lambda values: values[index])

    def reshape(self, *shape: int) -> Poses:
        """Return the same poses in another shape.

        Raises:
            ShapeError: it has another number of poses.
        """
        dimensions = len(self.shape)
        try:
            return self._mapped(lambda values: values.reshape((*shape, *values.shape[dimensions:])))
        except ValueError:
            raise ShapeError("poses", self.shape, f"as many as in the shape {shape}") from None

    def configuration(self, index: int | tuple[int, ...] = ()) -> Configuration:
        """Return the configuration at an index.

        Raises:
            InvalidValueError: the pose was not solved.
            ShapeError: the index is of several poses.
        """
        if several := self.q[index].shape[:-1]:
            raise ShapeError(f"poses {index}", several, "the index of one pose; reshape(-1) puts all in a row")
        return self.robot.configuration(self.q[index])

    @cached_property
    def solved(self) -> Mask:
        """Whether a configuration with closed loops was found, shape=(...)."""
        if "broken_limits" in self.__dict__:
            return frozen(np.asarray((self.broken_limits & REACH) == 0))
        return frozen(np.asarray(np.isfinite(self.q).all(axis=-1)))

    @cached_property
    def coordinates(self) -> Array:
        """Values of the robot's coordinates, shape=(..., number of coordinates) [m, rad]."""
        return frozen(self.robot.read(self.robot.coordinates, self.q, self._transforms_if_needed))

    @cached_property
    def commands(self) -> Array:
        """Counter readings of the drives, shape=(..., number of commands) [m, rad]."""
        return frozen(self.robot.read(self.robot.command_coordinates, self.q))

    @cached_property
    def transforms(self) -> Array:
        """Homogeneous transforms of the tool frame in the base, shape=(..., 4, 4).

        Raises:
            DescriptionError: the robot has no tool frame.
        """
        model, frame = self.robot.model, self.robot.tool_frame_id
        if "residual" in self.__dict__:  # solved by programs, which can also place the tool
            return self.robot.at(self.q).transforms
        data = scratch_data(model)
        transforms = np.full((*self.shape, 4, 4), np.nan)
        for index in map(tuple, np.argwhere(self.solved)):
            pin.forwardKinematics(model, data, self.q[index])
            transforms[index] = pin.updateFramePlacement(model, data, frame).homogeneous
        return frozen(transforms)

    @property
    def positions(self) -> Array:
        """Positions of the tool point, shape=(..., 3) [m]."""
        return self.transforms[..., :3, 3]

    @property
    def rotations(self) -> Array:
        """Orientations of the tool, shape=(..., 3, 3)."""
        return self.transforms[..., :3, :3]

    @cached_property
    def residual(self) -> Array:
        """Greatest absolute entry of the closure error, shape=(...) [m, rad]."""
        residual = np.full(self.shape, np.nan)
        for index in map(tuple, np.argwhere(self.solved)):
            residual[index] = np.abs(self.robot.loop_kinematics.closures(self.q[index])[0]).max(initial=0.0)
        return frozen(residual)

    @cached_property
    def branch(self) -> NDArray[np.int64]:
        """Branch of each pose, shape=(...): 0 for home's, otherwise bits that say which determinants differ in sign.

        Of 53 signs or more, other numbers: see :func:`~pm3dof_pin.mechanism.loop_systems.sign_weights`.

        Poses on different branches are separated by singular ones, see :mod:`pm3dof_pin.kinematics.branches`. 0 for
        unsolved poses, and for serial arms, which have no branches.

        Raises:
            ConvergenceError: the loops do not close at home.
            SingularConfigurationError: several branches meet at home.
        """
        numbers = np.zeros(self.shape, dtype=np.int64)
        for index in map(tuple, np.argwhere(self.solved)) if self.robot.has_branches else ():
            numbers[index] = branches_of(self.robot).number(self.q[index])
        return frozen(numbers)

    @cached_property
    def broken_limits(self) -> NDArray[np.uint32]:
        """Limits that a pose breaks: a bit mask of :data:`REACH` and the robot's limit groups, shape=(...)."""
        robot = self.robot
        flags = np.where(self.solved, 0, REACH).astype(np.uint32)
        outside = (self.q < robot.lower_limits - LIMIT_TOLERANCE) | (self.q > robot.upper_limits + LIMIT_TOLERANCE)
        for bit, group in enumerate(robot.limit_groups, start=1):
            for name in group.joints:
                joint = robot.model.joints[robot.model.getJointId(name)]
                broken = outside[..., joint.idx_q : joint.idx_q + joint.nq].any(axis=-1)
                flags |= np.where(broken, 1 << bit, 0).astype(np.uint32)
            for index in group.closures:
                flags |= np.where(self._beyond_swing(index), 1 << bit, 0).astype(np.uint32)
        return frozen(flags)

    @property
    def within_limits(self) -> Mask:
        """Whether a pose is solved and breaks no joint or closure limit, shape=(...)."""
        return np.asarray(self.broken_limits == 0)

    def _beyond_swing(self, closure: int) -> Mask:
        beyond = np.zeros(self.shape, dtype=bool)
        limit = self.robot.closures[closure].swing_limit
        if limit is None:
            raise InvalidValueError("limit group", self.robot.closures[closure], "a closure with a swing limit")
        for index in map(tuple, np.argwhere(self.solved)):
            beyond[index] = self.configuration(index).swing(closure) > limit + LIMIT_TOLERANCE
        return beyond

    def _mapped(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Poses:
        known = (frozen(np.asarray(change(self.__dict__[n]))) if n in self.__dict__ else None for n in _KNOWN)
        return Poses(self.robot, frozen(change(self.q)), *known)

    @property
    def _transforms_if_needed(self) -> Array | None:
        return self.transforms if any(c.tool is not None for c in self.robot.coordinates) else None


def _kept(values: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only array: the array itself if it is one, or else a copy."""
    return frozen(values.copy()) if values.flags.writeable else values
