"""Closed-loop forward kinematics of many commands at once: the actuated joints held, everything else follows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.mechanism.arrays import Matrix, frozen
from pm3dof_pin.mechanism.assembly import CLOSURE_TOLERANCE
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism

Array = NDArray[np.float64]
Unreachable = Literal["raise", "drop"]

_NEWTON_STEPS = 8
_NEARLY_CLOSED = 1e-9  # from here one quadratic step ends in rounding
_LONGEST_STEP = 0.5  # rad, or characteristic lengths, as in mechanism.assembly
_LONGEST_LEG = 0.25  # of the way to far commands, so that no other assembly mode is met [rad, characteristic lengths]


@dataclass(frozen=True, eq=False)
class ToolPoses:
    """Assembled configurations of one mechanism and its tool in each, row after row.

    Attributes:
        mechanism: the mechanism, with its errors if it has some.
        q: joint configurations, shape=(n, nq).
    """

    mechanism: Mechanism
    q: Array

    def __post_init__(self) -> None:
        """Freeze the configurations."""
        frozen(self.q)

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[Configuration]:
        return (self.mechanism.configuration(q) for q in self.q)

    def __getitem__(self, rows: slice | NDArray[Any] | list[int]) -> ToolPoses:
        """Return some of the poses."""
        return ToolPoses(self.mechanism, np.array(self.q[rows]))

    @cached_property
    def transforms(self) -> Array:
        """Homogeneous transforms of the tool frame in the world, shape=(n, 4, 4)."""
        mechanism = self.mechanism
        model, data, frame = mechanism.model, mechanism.model.createData(), mechanism.tool_frame_id
        transforms = np.empty((len(self), 4, 4))
        for row, q in enumerate(self.q):
            pin.forwardKinematics(model, data, q)
            transforms[row] = pin.updateFramePlacement(model, data, frame).homogeneous
        return frozen(transforms)

    @property
    def positions(self) -> Array:
        """Positions of the tool point, shape=(n, 3) [m]."""
        return self.transforms[:, :3, 3]

    @property
    def rotations(self) -> Array:
        """Orientations of the tool, shape=(n, 3, 3)."""
        return self.transforms[:, :3, :3]

    @property
    def commands(self) -> Array:
        """Coordinates of the actuated joints, shape=(n, number of actuated joints) [m, rad]."""
        return self.coordinates(self.mechanism.actuated_joints)

    def coordinates(self, joints: tuple[str, ...]) -> Array:
        """Return the coordinates of joints with one freedom, shape=(n, number of joints) [m, rad]."""
        singles = [self.mechanism.single_joint(name) for name in joints]
        return np.array([[single.coordinate(q) for single in singles] for q in self.q]).reshape(len(self), len(singles))

    def within_limits(self) -> NDArray[np.bool_]:
        """Tell which poses break no joint limit and no swing limit of a closure, shape=(n,)."""
        return np.array([not configuration.violated_limits() for configuration in self], dtype=bool)


def forward_poses(mechanism: Mechanism, commands: ArrayLike, guesses: ArrayLike | None = None) -> ToolPoses:
    """Find the tool poses that belong to commands.

    Newton on the loop closures of all poses together, to rounding; a pose that does not converge goes to the damped
    solver of :mod:`pm3dof_pin.mechanism.assembly`. Freedoms that move nothing, such as a link that spins about itself,
    stay where they are. A serial robot needs no step at all.

    Args:
        mechanism: the mechanism, nominal or with errors.
        commands: coordinates of the actuated joints, shape=(n, number of actuated joints) [m, rad].
        guesses: configurations to start from, one for all or one each, shape=(nq,) or (n, nq): those of the nominal
            poses, for a mechanism with errors. Without them the way from the home configuration is walked in steps
            short enough to stay in its assembly mode.

    Raises:
        ConvergenceError: no closed configuration was found for a command.
        InvalidValueError: commands or guesses of a wrong shape or not finite.
    """
    return poses_at(mechanism, mechanism.actuated_joints, commands, guesses)


def poses_at(
    mechanism: Mechanism,
    joints: tuple[str, ...],
    values: ArrayLike,
    guesses: ArrayLike | None = None,
    *,
    unreachable: Unreachable = "raise",
) -> ToolPoses:
    """Find the assembled configurations at which some joints have given coordinates.

    Args:
        mechanism: the mechanism.
        joints: joints to hold, each with one freedom: the motion coordinates, for instance.
        values: their coordinates, shape=(n, number of joints) [m, rad].
        guesses: see :func:`forward_poses`.
        unreachable: "raise", or "drop" to leave out rows for which no closed configuration was found.

    Raises:
        ConvergenceError: no closed configuration was found for a row of values, and `unreachable` is "raise".
        InvalidValueError: values or guesses of a wrong shape or not finite.
    """
    targets = _finite_rows(f"coordinates of {', '.join(joints)}", values, len(joints))
    q = _first(mechanism, guesses, len(targets))
    if not len(targets):
        return ToolPoses(mechanism, q)
    held = _Held(mechanism, joints)
    legs = 1 if guesses is not None else held.legs(q, targets)
    starts = held.read(q)
    for leg in range(1, legs + 1):
        q = held.write(q, starts + (targets - starts) * (leg / legs))
        q = held.close(q)
    return ToolPoses(mechanism, held.assembled(held.write(q, targets), targets, unreachable))


def _finite_rows(name: str, values: ArrayLike, columns: int) -> Matrix:
    rows = np.array(values, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise InvalidValueError(name, f"an array of shape {rows.shape}", f"shape (n, {columns})")
    if not np.isfinite(rows).all():
        raise InvalidValueError(name, f"not finite in row {int(np.argmin(np.isfinite(rows).all(1)))}", "finite numbers")
    return rows


def _first(mechanism: Mechanism, guesses: ArrayLike | None, count: int) -> Matrix:
    nq = mechanism.model.nq
    start = mechanism.home.q if guesses is None else np.asarray(guesses, dtype=float)
    if start.shape not in ((nq,), (count, nq)):
        raise InvalidValueError("guesses", f"an array of shape {start.shape}", f"shape ({nq},) or ({count}, {nq})")
    return np.array(np.broadcast_to(start, (count, nq)))


class _Held:
    """A mechanism with some joints held, many configurations at a time."""

    def __init__(self, mechanism: Mechanism, joints: tuple[str, ...]) -> None:
        self._mechanism = mechanism
        self._model = mechanism.model
        self._joints = joints
        self._singles = [mechanism.single_joint(name) for name in joints]
        self._indices = mechanism.velocity_indices(joints)
        self._free = np.setdiff1d(np.arange(mechanism.model.nv), self._indices)
        self._scale = mechanism.velocity_scale[self._free]

    def read(self, q: Matrix) -> Matrix:
        return np.array([[single.coordinate(row) for single in self._singles] for row in q])

    def write(self, q: Matrix, values: Matrix) -> Matrix:
        q = np.array(q)
        for row, numbers in zip(q, values, strict=True):
            for single, number in zip(self._singles, numbers, strict=True):
                single.set_coordinate(row, float(number))
        return q

    def legs(self, q: Matrix, targets: Matrix) -> int:
        """Count the steps in which to walk from q to the targets; one for a serial robot."""
        if not self._mechanism.closures:
            return 1
        way = np.abs(targets - self.read(q)) / self._mechanism.velocity_scale[self._indices]
        return max(1, int(np.ceil(way.max(initial=0.0) / _LONGEST_LEG)))

    def close(self, q: Matrix) -> Matrix:
        """Take Newton steps until the loops of all configurations are closed, or the steps are used up."""
        if not self._mechanism.closures:
            return q
        q, open_rows, last = np.array(q), np.arange(len(q)), np.zeros(len(q), dtype=bool)
        for _ in range(_NEWTON_STEPS):
            errors, jacobians = self._closures(q[open_rows])
            moves = self._moves(errors, jacobians)
            for row, move in zip(open_rows, moves, strict=True):
                velocity = np.zeros(self._model.nv)
                velocity[self._free] = move
                q[row] = pin.integrate(self._model, q[row], velocity)
            last = np.abs(errors).max(axis=1) <= _NEARLY_CLOSED
            open_rows = open_rows[~last]
            if not open_rows.size:
                break
        return q

    def assembled(self, q: Matrix, targets: Matrix, unreachable: Unreachable) -> Matrix:
        """Close what Newton left open with the damped solver; drop what does not close, or raise.

        Raises:
            ConvergenceError: a row did not close either, and is not to be dropped.
        """
        if not self._mechanism.closures:
            return q
        residuals = np.abs(self._closures(q)[0]).max(axis=1)
        closed = residuals <= CLOSURE_TOLERANCE
        for row in np.flatnonzero(~closed):
            held = dict(zip(self._joints, targets[row].tolist(), strict=True))
            guess = q[row] if residuals[row] < 1.0 else None
            try:
                q[row] = self._mechanism.assemble(guess, held=held).q
                closed[row] = True
            except ConvergenceError as error:
                if unreachable == "raise":
                    raise ConvergenceError(
                        f"closing the loops of row {row}, {held},", error.residual, "m or rad", error.steps
                    ) from error
        return np.asarray(q[closed])

    def _closures(self, q: Matrix) -> tuple[Matrix, Array]:
        kinematics = self._mechanism.loop_kinematics
        errors = np.empty((len(q), kinematics.row_count))
        jacobians = np.empty((len(q), kinematics.row_count, self._model.nv))
        for row, positions in enumerate(q):
            errors[row], jacobians[row] = kinematics.closures(positions)
        return errors, jacobians

    def _moves(self, errors: Matrix, jacobians: Array) -> Matrix:
        """Return the shortest velocities (in scaled numbers) that close the linearised loops, shape=(n, free)."""
        scale = self._mechanism.closure_scale
        scaled = jacobians[:, :, self._free] * self._scale / scale[:, None]
        moves = -np.einsum("nij,nj->ni", np.linalg.pinv(scaled, rcond=1e-10), errors / scale)
        longest = np.abs(moves).max(axis=1, initial=0.0, keepdims=True)
        short: Matrix = moves * self._scale * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _LONGEST_STEP))
        return short
