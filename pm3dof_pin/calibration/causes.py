"""Why measurements do not fit a machine: the usual mistakes, tried one after the other.

Each is a change of the measurements. The machine as described, which is at most tolerances away from the real one, is
compared with what was measured before and after the change; the base of the instrument is found anew where that was
asked for. A mistake that explains most of what does not fit is likely the one that was made.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pm3dof_pin.errors.pose_error import TIP_LENGTH, quaternion, rotation_of_quaternion, tip_weights
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.registration import register
from pm3dof_pin.typing import Array

_EXPLAINS = 0.25  # of what did not fit is left, at most
_FEWEST = 4  # poses: with fewer nearly any mistake explains all
_MANY_DRIVES = 4  # more are not permuted in every way
_SHIFTS = (1, -1, 2, -2)
_LENGTHS = {"millimetres": 1e-3, "inches": 25.4e-3, "thousandths of a metre's unit": 1e3}


@dataclass(frozen=True)
class Cause:
    """A mistake that explains why measurements do not fit.

    Attributes:
        text: the mistake, and what to do about it.
        before: tip error of the machine as described, median [m].
        after: the same without the mistake [m].
    """

    text: str
    before: float
    after: float

    def __str__(self) -> str:
        return f"{self.text}; that explains all but {1e3 * self.after:.3g} mm of {1e3 * self.before:.3g} mm"


def likely_cause(
    measurements: Measurements, robot: Robot, eta: float = TIP_LENGTH, *, least: float = 0.0
) -> Cause | None:
    """Find the mistake that explains best why measurements do not fit a robot; None if none of the usual ones does.

    Args:
        measurements: as they were read.
        robot: the robot as described.
        eta: weight of the orientation [m/rad].
        least: tip error that needs no mistake to explain it [m].
    """
    own_frame = measurements.registration is not None
    before = _misfit(measurements, robot, eta, own_frame)
    if before <= least or len(measurements.visits) < _FEWEST:
        return None
    found: list[Cause] = []
    for text, changed, free in _mistakes(measurements, robot):
        try:
            after = _misfit(changed, robot, eta, own_frame or free)
        except PM3DofError:
            continue
        if after < _EXPLAINS * before:
            found.append(Cause(text, before, after))
    return min(found, key=lambda cause: cause.after, default=None)


def _mistakes(measurements: Measurements, robot: Robot) -> Iterator[tuple[str, Measurements, bool]]:
    """Give each mistake in words, the measurements without it, and whether the base has to be found anew."""
    if measurements.registration is None:
        text = "the instrument's frame is not that of the base: --own-frame finds the base in it"
        yield text, measurements, True
    yield from _of_drives(measurements, robot)
    for shift in _SHIFTS:
        rolled = np.roll(measurements.commands, shift, axis=0)
        ways = f"{abs(shift)} row{'s' * (abs(shift) > 1)} {'below' if shift > 0 else 'above'}"
        yield f"the poses stand {ways} their commands", replace(measurements, commands=rolled), False
    yield from _of_axes(measurements)
    if measurements.rotations is not None:
        inverse = np.swapaxes(measurements.rotations, 1, 2)
        yield "the orientations are inverse, of the base in the tool's axes", _turned(measurements, inverse), False
        scalar_last = rotation_of_quaternion(np.roll(quaternion(measurements.rotations), 1, axis=1))
        text = "the quaternions hold their numbers in the order x, y, z, w"
        yield text, _turned(measurements, scalar_last), False
    for unit, factor in _LENGTHS.items():
        yield f"the positions are in {unit}", replace(measurements, positions=factor * measurements.positions), False
    yield from _of_the_tool(measurements, robot)


def _of_drives(measurements: Measurements, robot: Robot) -> Iterator[tuple[str, Measurements, bool]]:
    drives = range(len(robot.commands))
    orders = itertools.permutations(drives) if len(drives) <= _MANY_DRIVES else _transpositions(len(drives))
    for order in orders:
        if list(order) == list(drives):
            continue
        moved = [f"u{k + 1} holds u{order[k] + 1}" for k in drives if order[k] != k]
        # column k of the file holds what drive order[k] showed
        commands = np.empty_like(measurements.commands)
        commands[:, list(order)] = measurements.commands
        yield f"the drives' columns are permuted: {', '.join(moved)}", replace(measurements, commands=commands), False
    home = robot.home.commands
    for count in (1, len(drives)):
        for chosen in itertools.combinations(drives, count):
            commands = measurements.commands.copy()
            commands[:, chosen] = 2.0 * home[list(chosen)] - commands[:, chosen]
            names = ", ".join(f"u{k + 1}" for k in chosen)
            yield f"the sign of {names} is that of the other direction", replace(measurements, commands=commands), False


def _transpositions(count: int) -> Iterator[tuple[int, ...]]:
    for first, second in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[first], order[second] = second, first
        yield tuple(order)


def _of_axes(measurements: Measurements) -> Iterator[tuple[str, Measurements, bool]]:
    """Axes swapped or mirrored: in the positions alone, in whole poses, as a frame of the other hand."""
    rotations = measurements.rotations
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3))
            axes[range(3), order] = signs
            if np.array_equal(axes, np.eye(3)):
                continue
            names = ", ".join(f"{'-' if sign < 0.0 else ''}{'xyz'[k]}" for k, sign in zip(order, signs, strict=True))
            hand = "mirrored" if np.linalg.det(axes) < 0.0 else "swapped"
            moved = replace(measurements, positions=measurements.positions @ axes.T)
            what = "the axes of the positions" if rotations is None else "the axes of the positions alone"
            yield f"{what} are {hand}: x, y, z of the base are their {names}", moved, False
            if rotations is not None:
                turned = axes @ rotations @ (axes.T if hand == "mirrored" else np.eye(3))
                text = f"the axes of the poses are {hand}: x, y, z of the base are their {names}"
                yield text, _turned(moved, turned), False


def _of_the_tool(measurements: Measurements, robot: Robot) -> Iterator[tuple[str, Measurements, bool]]:
    nominal = robot.forward(measurements.commands, on_failure="nan")
    seen = nominal.rotations if measurements.rotations is None else measurements.rotations
    offsets = np.einsum("nji,nj->ni", seen, measurements.positions - nominal.positions)
    shift = np.nanmedian(offsets - measurements.points, axis=0)
    if np.isfinite(shift).all():
        words = ", ".join(f"{1e3 * value:.3g}" for value in shift)
        text = f"the point seen is about ({words}) mm from where it is said to be, in the tool's axes"
        yield text, measurements.with_points(measurements.points + shift), False
    if measurements.rotations is not None:
        turns = np.swapaxes(nominal.rotations, 1, 2) @ measurements.rotations
        mean = turns[np.isfinite(turns).all(axis=(1, 2))].sum(axis=0)
        left, _, right = np.linalg.svd(mean)
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        yield "the tool's axes are other ones", _turned(measurements, measurements.rotations @ turn.T), False


def _turned(measurements: Measurements, rotations: Array) -> Measurements:
    return replace(measurements, rotations=rotations)


def _misfit(measurements: Measurements, robot: Robot, eta: float, own_frame: bool) -> float:
    """Return the tip error of the machine as described against the measurements, median over the rows [m].

    Raises:
        PM3DofError: the commands cannot be taken, or no base can be found.
    """
    nominal = robot.forward(measurements.commands, on_failure="nan")
    if np.mean(nominal.solved) < 0.9:
        raise InvalidValueError("commands", "out of reach", "commands that the machine can take")
    measurements, nominal = measurements[nominal.solved], nominal[nominal.solved]
    if own_frame:
        expected = nominal.positions + np.einsum("nij,nj->ni", nominal.rotations, measurements.points)
        found = register(measurements.positions, expected, measurements.rotations, nominal.rotations, eta=eta)
        measurements = replace(measurements, registration=measurements.registration or found)
        turned = None if measurements.rotations is None else found.rotations(measurements.rotations)
        measurements = replace(measurements, positions=found.positions(measurements.positions), rotations=turned)
    residuals = measurements.residuals(nominal) * tip_weights(eta)[: measurements.sigmas.shape[1]]
    return float(np.median(np.linalg.norm(residuals, axis=1)))
