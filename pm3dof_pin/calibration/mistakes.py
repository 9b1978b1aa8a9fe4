"""The mistakes that people make in files of measurements, each with the measurements corrected for it.

Those that a word or a number repairs come first, then those with a few fitted numbers: another frame, tool point or
zero of a drive, a change in the middle. Whether a corrected file fits is judged elsewhere.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pm3dof_pin.csv_table import usual_orders
from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.errors.pose_error import quaternion, tip_weights
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.angles import other_orders
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.typing import Array, Indices

_LENGTHS = {"millimetres": 1e-3, "inches": 25.4e-3, "centimetres": 1e-2}
_SAME_SIZE = 0.2  # relative difference of sizes for which a unit can be right
_TOO_SMALL = (("rad", "degrees", "radians", 180.0 / np.pi), ("m", "millimetres", "metres", 1e3))
_SHIFTS = 20  # rows by which poses may be shifted from their commands
_MANY = 4  # drives, above which not every permutation is tried
_STEPS = 3  # of a fit that is not quite linear
_FAR = 2.0  # times the median: rows beyond it get less weight
_MIN_ROWS = 4  # poses before and after a change
_POINT_SIGMA = 1e-3  # of a point on the tool that was fitted by the machine as described [m]


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake that may have been made."""

    text: str  #: the mistake, in words
    corrected: Measurements  #: the measurements without it
    #: corrects what is left of it in corrected measurements, given the poses of a machine that fits them better; None
    #: if the machine's parameters can take that
    again: Callable[[Measurements, Poses], Measurements] | None = None


def usual_mistakes(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    """Yield the usual mistakes, relative to the machine's poses as described; eta weighs the orientation [m/rad]."""
    for each in (_units, _drives, _rows, _axes, _quaternions):
        yield from each(measurements, nominal)
    for fitted in (_frame, _points, _counters, changes_in_the_middle):
        with contextlib.suppress(PM3DofError, np.linalg.LinAlgError):  # positions on a line, commands out of reach
            yield from fitted(measurements, nominal, eta)


def _units(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    expected, positions, distances = measurements.points_on(nominal), measurements.positions, measurements.distances
    if measurements.registration is not None:  # then only distances between positions are known
        expected, positions = (points - np.median(points, axis=0) for points in (expected, positions))
    size, found = (np.linalg.norm(points[measurements.seen[:, :3]]) for points in (expected, positions))
    for unit, factor in _LENGTHS.items():
        if distances is not None:
            yield Mistake(f"the distances are in {unit}", replace(measurements, distances=factor * distances))
        elif abs(factor * found - size) < _SAME_SIZE * size:
            other = replace(measurements, positions=factor * measurements.positions)
            yield Mistake(f"the positions are in {unit}", other)
    # too small; units that make commands too large break the joint limits
    units = np.array([command.unit for command in nominal.robot.commands])
    for own, heading, unit, factor in _TOO_SMALL:
        if own in units:
            commands = measurements.commands * np.where(units == own, factor, 1.0)
            text = f"the commands are in {unit}, but the header says {heading}"
            yield Mistake(text, replace(measurements, commands=commands))
    larger = replace(
        measurements.with_points(1e3 * measurements.points),
        positions=1e3 * measurements.positions,
        commands=measurements.commands * np.where(units == "m", 1e3, 1.0),
        sigmas=measurements.sigmas * np.where(np.arange(measurements.sigmas.shape[1]) < 3, 1e3, 1.0),
    )
    yield Mistake("all lengths are in metres, but the header says millimetres", larger)


def _drives(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    commands, home = measurements.commands, nominal.robot.home.commands
    every = tuple(range(len(home)))
    sizes = every if len(home) <= _MANY else (0, len(home) - 1)
    for chosen in itertools.chain.from_iterable(itertools.combinations(every, size + 1) for size in sizes):
        names, turned = ", ".join(f"u{k + 1}" for k in chosen), np.isin(every, chosen)
        for about in (home, 0.0 * home):
            without = replace(measurements, commands=np.where(turned, 2.0 * about - commands, commands))
            yield Mistake(f"the sign of {names} is reversed", without)
    orders = itertools.permutations(every)
    for order in orders if len(every) <= _MANY else usual_orders(len(every)):
        if order != every:
            # column k of the file holds the counter of drive order[k]
            moved = ", ".join(f"u{k + 1} holds u{order[k] + 1}" for k in every if order[k] != k)
            without = replace(measurements, commands=commands[:, np.argsort(order)])
            yield Mistake(f"the drives' columns are permuted: {moved}", without)


def _rows(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    count, commands = len(measurements), measurements.commands
    for size in range(1, min(_SHIFTS, (count - 1) // 2) + 1):
        for shift in (size, -size):
            words = f"{size} row{'s' * (size > 1)} {'below' if shift > 0 else 'above'}"
            shifted = replace(measurements, commands=np.roll(commands, shift, axis=0))
            yield Mistake(f"the poses are {words} their commands", shifted)
    yield Mistake("the poses are in the reverse order", replace(measurements, commands=commands[::-1]))


def _axes(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    positions, rotations = measurements.positions, measurements.rotations
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)):
        axes = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.array_equal(axes, np.eye(3)):
            continue
        names = ", ".join(f"{'-' if sign < 0.0 else ''}{'xyz'[k]}" for k, sign in zip(order, signs, strict=True))
        mirrored = np.linalg.det(axes) < 0.0
        text = f"the axes are {'mirrored' if mirrored else 'swapped'}: x, y, z of the base are their {names}"
        moved = replace(measurements, positions=positions @ axes.T)
        if rotations is not None:
            turned = axes @ rotations @ (axes.T if mirrored else np.eye(3))
            yield Mistake(text, replace(moved, rotations=turned))
            text = f"{text}, of the positions only"
        yield Mistake(text, moved)


def _quaternions(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    if measurements.rotations is not None:
        for words, rotations in other_orders(quaternion(measurements.rotations)).items():
            yield Mistake(f"the quaternions are in the order {words}", replace(measurements, rotations=rotations))


def _frame(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    if measurements.registration is None:
        found = measurements.registered_at(nominal, eta)
        text = "the measurements are in the instrument's own frame, not the base's: use --own-frame"
        yield Mistake(text, replace(measurements.in_axes(found), registration=found))


def _points(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    """Yield another point of the tool, with other axes of the tool, and targets elsewhere."""
    shift = np.zeros(3)
    for _ in range(_STEPS):  # distances are not linear in it
        moved = measurements.with_points(measurements.points + shift)
        shift = shift + _explained_by(moved, nominal, eta, datum_motions(nominal)[:, :, 6:9])
    shifted = replace(measurements.with_points(measurements.points + shift), tool_point_sigma=_POINT_SIGMA)
    words = f"about ({millimetres(shift)}) mm from where the file has it, in the tool's axes"
    yield Mistake(f"the point seen is {words}", shifted)
    if measurements.rotations is not None:
        left, _, right = np.linalg.svd((np.swapaxes(nominal.rotations, 1, 2) @ measurements.rotations).sum(axis=0))
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        turned = replace(shifted, rotations=measurements.rotations @ turn.T)
        yield Mistake(f"the tool's axes are different, and the point seen is {words}", turned)
    numbers = measurements.target_numbers
    points = measurements.points[np.unique(numbers, return_index=True)[1]]
    if len(points) > 1 and measurements.seen[:, :3].all():
        off = np.einsum("nji,nj->ni", nominal.rotations, measurements.positions - measurements.points_on(nominal))
        for k in range(len(points)):
            place = points[k] + np.median(off[numbers == k], axis=0)
            text = f"target {k + 1} is not where the file has it, but at about ({millimetres(place)}) mm"
            yield Mistake(text, measurements.with_points(np.where((numbers == k)[:, None], place, measurements.points)))


def _counters(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    """Yield the zero of each drive, and of all drives, fitted to all rows together."""
    commands, drives = measurements.commands, np.eye(measurements.commands.shape[1])
    described = command_jacobians(nominal)
    for each in (*np.split(drives, len(drives), axis=1), drives):
        off = f"zero of u{int(np.argmax(each)) + 1} is" if each.shape[1] == 1 else "zeros of the drives are"
        with contextlib.suppress(PM3DofError, np.linalg.LinAlgError):
            poses, zeros = nominal, np.zeros(each.shape[1])
            for _ in range(_STEPS):
                motions = described if poses is nominal else command_jacobians(poses)
                zeros = zeros + _explained_by(measurements, poses, eta, motions @ each)
                poses = nominal.robot.forward(commands + each @ zeros, guess=poses.q)
            amounts = millimetres(-zeros) if len(zeros) == 1 else f"({millimetres(-zeros)})"
            text = f"the {off} off by about {amounts} mm or mrad"
            yield Mistake(text, replace(measurements, commands=commands + each @ zeros))


def changes_in_the_middle(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    """Yield changes in the middle of a file: of the instrument's place, or of the point seen; none in short files."""
    if not _middle(measurements).size:
        return
    kinds = {"the instrument or the base has moved": slice(6), "the point seen is elsewhere on the tool": slice(6, 9)}
    for what, columns in kinds.items():
        yield _change(measurements, nominal, eta, what, columns)


def _middle(measurements: Measurements) -> Indices:
    """Return the last rows of visits with enough before and after them."""
    return np.flatnonzero(np.diff(measurements.visit_numbers) != 0)[_MIN_ROWS - 1 : -_MIN_ROWS]


def _change(measurements: Measurements, nominal: Poses, eta: float, what: str, columns: slice) -> Mistake:
    """Return the change, at the row and by the motion that explain most of the misfit."""
    seen = measurements.seen[:, : measurements.tool_columns] * tip_weights(eta)[: measurements.tool_columns]
    motions = datum_motions(nominal)[:, :, columns]
    rows = measurements.derivatives(nominal, motions)[:, : seen.shape[1]] * seen[:, :, None]
    # over the rows up to each, and over all later ones
    sums = np.cumsum(np.swapaxes(rows, 1, 2) @ rows, axis=0)
    inverses = np.linalg.pinv(np.stack([sums, sums[-1] - sums]), rcond=1e-9, hermitian=True)
    ends = _middle(measurements)
    moved, change, first = measurements, np.zeros(motions.shape[2]), 0
    for _ in range(_STEPS):
        residuals = moved.residuals(nominal)[:, : seen.shape[1]] * seen
        before = np.cumsum(np.einsum("nij,ni->nj", rows, residuals), axis=0)
        pulls = np.stack([before, before[-1] - before])
        fits = np.einsum("pnij,pnj->pni", inverses, pulls)
        first = first or int(ends[np.argmax(np.einsum("pni,pni->n", fits, pulls)[ends])]) + 1
        step = fits[1, first - 1] - fits[0, first - 1]
        change = change + step
        later = np.arange(len(moved))[:, None] >= first
        moved = moved.without_motions(nominal, np.where(later, motions @ step, 0.0))
    text = f"from line {measurements.lines[first]} on {what}, by about ({millimetres(change[:3])}) mm"
    return Mistake(text, moved, lambda rows, poses: _change(rows, poses, eta, what, columns).corrected)


def _explained_by(measurements: Measurements, poses: Poses, eta: float, motions: Array) -> Array:
    """Fit amounts of given tool motions, shape=(n, 6, k), to the measurements by robust least squares.

    The base may be anywhere if the instrument has a frame of its own.
    """
    count, columns = motions.shape[2], measurements.tool_columns
    if measurements.registration is not None:
        motions = np.concatenate([motions, datum_motions(poses)[:, :, :6]], axis=2)
    seen = measurements.seen[:, :columns] * tip_weights(eta)[:columns]
    residuals = measurements.residuals(poses)[:, :columns] * seen
    sizes = np.linalg.norm(residuals, axis=1)
    trust = 1.0 / np.maximum(sizes, _FAR * np.median(sizes) + np.finfo(float).eps)
    rows = measurements.derivatives(poses, motions)[:, :columns] * (seen * trust[:, None])[:, :, None]
    answer = np.linalg.lstsq(rows.reshape(-1, motions.shape[2]), (residuals * trust[:, None]).reshape(-1), rcond=1e-9)
    return np.asarray(answer[0][:count])


def millimetres(values: Array) -> str:
    """Return lengths in metres as words in millimetres."""
    return ", ".join(f"{round(1e3 * value, 3) + 0.0:.3g}" for value in values)
