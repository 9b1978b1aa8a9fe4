"""The usual mistakes in files of measurements, each with the corrected measurements.

Simple ones come first: those that one word or number repairs, then those with a few fitted numbers (a frame, a tool
point, the zero of a drive). For columns that do not fit when all others do, see :mod:`.wrong_columns`.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.errors.pose_error import quaternion, rotation_of_quaternion, tip_weights
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.measuring.registration import fitted_sphere, register
from pm3dof_pin.typing import Array, Indices, Mask

_MANY_DRIVES = 4  # with more, not every permutation is tried
SHIFTS = 20
"""Numbers of rows by which poses may be shifted from their commands."""
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "micrometres": 1e-6, "inches": 25.4e-3, "feet": 0.3048}
_SAME = 1e-9
_ANOTHER = 3e-3  # a scale or angle [rad] above this is not an error of the machine
_LEAST_LEAD = 1e-4  # of all drives alike
_BESIDE = 3.0  # times the width of a drive's range
_STEPS = 3  # times the steps of one descent
_FAR = 2.0  # times the median: rows beyond it get less weight
_FEWEST = 4  # touches to find a fixed point, poses before and after a change
_QUATERNION = "wxyz"


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake that may have been made."""

    text: str  #: the mistake, in words
    without: Measurements  #: the measurements without it
    #: poses of the robot as described at their commands; None if the commands differ from those in the file
    nominal: Poses | None
    free: bool = False  #: whether the base must be located again


def near_their_ranges(commands: Array, robot: Robot) -> Mask:
    """Tell which commands are in the drives' ranges, or not more than a few range widths outside, shape=(n,).

    Others take long to reach, and explain nothing.
    """
    lower, upper = np.array([robot.range_of(command) for command in robot.command_coordinates]).T
    beside = _BESIDE * (upper - lower)
    return np.asarray(((commands > lower - beside) & (commands < upper + beside)).all(axis=1))


def usual_mistakes(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Iterable[Mistake]]:
    """Yield the usual mistakes, grouped by kind, simple kinds first, relative to nominal poses.

    Mistakes of one kind are equally simple. eta weighs the orientation [m/rad].
    """
    yield _of_units(measurements, nominal)
    if measurements.registration is None:
        yield _of_units(measurements, nominal, free=True)
    yield _of_command_units(measurements)
    yield _of_drives(measurements, nominal)
    yield _of_row_order(measurements, nominal)
    yield _of_axes(measurements, nominal)
    yield _of_quaternions(measurements, nominal)
    yield _of_scale(measurements, nominal)
    yield from _of_distances(measurements, nominal)
    yield from _of_counters(measurements, nominal, eta)
    if measurements.registration is None:
        text = "the measurements are in the instrument's own frame, not the base's: use --own-frame"
        yield [Mistake(text, measurements, nominal, free=True)]
        yield _of_scale(measurements, nominal, free=True)
    yield from _of_the_tool(measurements, nominal, eta)
    yield from _of_positions(measurements, nominal)
    yield of_a_change(measurements, nominal, eta)


def _of_units(measurements: Measurements, nominal: Poses, *, free: bool = False) -> Iterator[Mistake]:
    for unit, factor in _LENGTHS.items():
        text = f"the positions are in {unit}" + (", and in the instrument's own frame: --own-frame" if free else "")
        yield Mistake(text, replace(measurements, positions=factor * measurements.positions), nominal, free)


def _of_command_units(measurements: Measurements) -> Iterator[Mistake]:
    """Yield units that make commands too small; those that make them too large break the joint limits."""
    for heading, unit, factor in (("degrees", "radians", 180.0 / np.pi), ("millimetres", "metres", 1e3)):
        without = replace(measurements, commands=factor * measurements.commands)
        yield Mistake(f"the commands are in {unit}, but the header says {heading}", without, None)
    every = replace(without, positions=1e3 * measurements.positions, points=1e3 * measurements.points)
    yield Mistake("all lengths are in metres, but the header says millimetres", every, None)


def _of_drives(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    robot = nominal.robot
    drives, home = range(len(robot.commands)), robot.home.commands

    def changed(order: tuple[int, ...], turned: tuple[int, ...]) -> Measurements:
        # column k of the file holds the counter of drive order[k]
        commands = np.empty_like(measurements.commands)
        commands[:, list(order)] = measurements.commands
        commands[:, turned] = 2.0 * home[list(turned)] - commands[:, turned]
        return replace(measurements, commands=commands)

    every = tuple(drives)
    sets = [chosen for size in range(1, len(drives) + 1) for chosen in itertools.combinations(drives, size)]
    for chosen in sets if len(drives) <= _MANY_DRIVES else [*((k,) for k in drives), every]:
        names = ", ".join(f"u{k + 1}" for k in chosen)
        without = changed(every, tuple(chosen))
        yield Mistake(f"the sign of {names} is reversed", without, None)
    without = replace(measurements, commands=-measurements.commands)
    yield Mistake("the sign of all commands is reversed", without, None)
    for order in itertools.permutations(drives) if len(drives) <= _MANY_DRIVES else _orders(len(drives)):
        if order == every:
            continue
        moved = ", ".join(f"u{k + 1} holds u{order[k] + 1}" for k in drives if order[k] != k)
        yield Mistake(f"the drives' columns are permuted: {moved}", changed(order, ()), None)


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Yield likely permutations of many columns: two exchanged, cyclic, reversed."""
    for first, second in itertools.combinations(range(count), 2):
        order = list(range(count))
        order[first], order[second] = second, first
        yield tuple(order)
    for shift in range(1, count):
        yield tuple(np.roll(np.arange(count), shift).tolist())
    yield tuple(range(count))[::-1]


def _of_row_order(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    count = len(measurements)

    def taken(rows: Indices) -> tuple[Measurements, Poses]:
        return replace(measurements, commands=measurements.commands[rows]), nominal[rows]

    for size in range(1, min(SHIFTS, count - 1) + 1):
        for shift in (size, -size):
            text = f"the poses are {rows_apart(shift)} their commands"
            yield Mistake(text, *taken(np.roll(np.arange(count), shift)))
    yield Mistake("the poses are in the reverse order of their commands", *taken(np.arange(count)[::-1]))
    nearest = _nearest_rows(measurements, nominal)
    if np.array_equal(np.sort(nearest), np.arange(count)):
        yield Mistake("the poses are in a different order than their commands", *taken(nearest))
    step = int(measurements.target_numbers.max()) + 1  # rows of a visit
    for shift in (step, -step):
        # stale commands: some rows hold those of a neighbouring row
        neighbour = np.clip(np.arange(count) - shift, 0, count - 1)
        late, poses = taken(neighbour)
        stale = late.tip_misfits(poses) < measurements.tip_misfits(nominal)
        mixed = np.where(stale, neighbour, np.arange(count))
        moved = np.flatnonzero(mixed != np.arange(count))
        if moved.size:
            first = f"from line {measurements.lines[moved[0]]} on the" if np.ptp(moved) > 0.5 * moved.size else "the"
            text = f"{first} poses of {moved.size} rows are {rows_apart(shift)} their commands: stale commands"
            yield Mistake(text, *taken(mixed))


def rows_apart(shift: int) -> str:
    """Say how many rows below (positive) or above (negative) something is."""
    return f"{abs(shift)} row{'s' * (abs(shift) > 1)} {'below' if shift > 0 else 'above'}"


def _nearest_rows(measurements: Measurements, nominal: Poses) -> Indices:
    """Return, for each row, the row at whose commands the robot as described is nearest to the measurement."""
    expected = measurements.points_on(nominal)
    seen = measurements.positions
    squares = np.sum((seen[:, None] - expected) ** 2, axis=2)
    if measurements.rotations is not None:
        traces = np.einsum("nij,mij->nm", measurements.rotations, nominal.rotations)
        size = np.mean(np.sum((expected - expected.mean(axis=0)) ** 2, axis=1))
        squares = squares + size * (3.0 - traces)
    return np.asarray(np.argmin(squares, axis=1))


def _of_axes(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    """Yield axes swapped or mirrored: in the positions alone, or in full poses as a left-handed frame."""
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
            if rotations is not None:
                turned = axes @ rotations @ (axes.T if hand == "mirrored" else np.eye(3))
                text = f"the axes of the poses are {hand}: x, y, z of the base are their {names}"
                yield Mistake(text, replace(moved, rotations=turned), nominal)
            if measurements.points.any():
                text = f"the axes of the positions and of the targets' points are {hand}: x, y, z are their {names}"
                yield Mistake(text, moved.with_points(measurements.points @ axes.T), nominal)
            what = "the axes of the positions" if rotations is None else "the axes of the positions alone"
            yield Mistake(f"{what} are {hand}: x, y, z of the base are their {names}", moved, nominal)


def _of_quaternions(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    if measurements.rotations is None:
        return
    inverse = np.swapaxes(measurements.rotations, 1, 2)
    text = "the orientations are inverse: of the base in the tool's axes"
    yield Mistake(text, replace(measurements, rotations=inverse), nominal)
    positions = -np.einsum("nij,nj->ni", inverse, measurements.positions)
    text = "the poses are inverse: of the base in the tool's axes"
    yield Mistake(text, replace(measurements, positions=positions, rotations=inverse), nominal)
    numbers = quaternion(measurements.rotations)
    for order in itertools.permutations(range(4)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            if order == (0, 1, 2, 3) and min(signs) > 0.0:
                continue
            read = rotation_of_quaternion(np.array([1.0, *signs]) * numbers[:, np.argsort(order)])
            text = f"the quaternions are in the order {', '.join(_QUATERNION[k] for k in order)}"
            if order == (0, 1, 2, 3):
                names = ", ".join(f"q{_QUATERNION[k + 1]}" for k in range(3) if signs[k] < 0.0)
                text = f"the sign of {names} in the quaternions is reversed"
            elif min(signs) < 0.0:
                text += ", some with reversed signs"
            yield Mistake(text, replace(measurements, rotations=read), nominal)


def _of_the_tool(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Iterable[Mistake]]:
    shift = np.zeros(3)
    for _ in range(_STEPS):  # distances are not linear in it
        moved = measurements.with_points(measurements.points + shift)
        shift = shift + explained_by(moved, nominal, eta, datum_motions(nominal)[:, :, 6:9])
    shifted = measurements.with_points(measurements.points + shift)
    text = f"the point seen is about ({_in_millimetres(shift)}) mm from where the file has it, in the tool's axes"
    yield [Mistake(text, shifted, nominal)]
    yield _of_targets(measurements, nominal)
    if measurements.rotations is not None:
        mean = (np.swapaxes(nominal.rotations, 1, 2) @ measurements.rotations).sum(axis=0)
        left, _, right = np.linalg.svd(mean)
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        if np.linalg.norm(turn - np.eye(3)) < _ANOTHER:
            return
        turned = replace(measurements, rotations=measurements.rotations @ turn.T)
        yield [Mistake("the tool's axes are different", turned, nominal)]
        text = "the tool's axes are different, and the point seen is elsewhere"
        yield [Mistake(text, replace(shifted, rotations=turned.rotations), nominal)]


def _of_targets(measurements: Measurements, nominal: Poses) -> Iterator[Mistake]:
    if not measurements.points.any() or not measurements.seen[:, :3].all():
        return
    numbers = measurements.target_numbers
    points = measurements.points[np.unique(numbers, return_index=True)[1]]
    for order in itertools.permutations(range(len(points))) if len(points) <= _MANY_DRIVES else ():
        if order != tuple(range(len(points))):
            text = f"the targets are exchanged: the first are really numbers {', '.join(str(k + 1) for k in order)}"
            yield Mistake(text, measurements.with_points(points[list(order)][numbers]), nominal)
    yield Mistake("the targets' points have reversed signs", measurements.with_points(-measurements.points), nominal)
    off = np.einsum("nji,nj->ni", nominal.rotations, measurements.positions - measurements.points_on(nominal))
    shifts = np.array([np.median(off[numbers == k], axis=0) for k in range(len(points))])
    words = ", ".join(f"target {k + 1} ({_in_millimetres(points[k] + shifts[k])})" for k in range(len(points)))
    text = f"the targets are not where the file has them, but at about [mm]: {words}"
    yield Mistake(text, measurements.with_points(measurements.points + shifts[numbers]), nominal)


def _of_scale(measurements: Measurements, nominal: Poses, *, free: bool = False) -> Iterator[Mistake]:
    expected, seen = measurements.points_on(nominal), measurements.positions
    spreads = [np.sqrt(np.var(points, axis=0).sum()) for points in (expected, seen)]
    sizes = [np.median(np.linalg.norm(points, axis=1)) for points in (expected, seen)]
    for right, found in (spreads,) if free else (spreads, sizes):
        if min(right, found) > 0.0 and abs(found / right - 1.0) > _ANOTHER:
            text = f"the positions have the wrong scale: {found / right:.6g} times what they should be"
            text += ", and are not in the base's frame" if free else ""
            yield Mistake(text, replace(measurements, positions=seen * right / found), nominal, free)
    if measurements.rotations is None and not free:
        shift = np.median(expected - seen, axis=0)
        text = f"the positions are relative to another origin, ({_in_millimetres(shift)}) mm away"
        yield Mistake(text, replace(measurements, positions=seen + shift), nominal)


def _of_positions(measurements: Measurements, nominal: Poses) -> Iterator[Iterable[Mistake]]:
    """Yield another origin or other axes of the positions, if orientations fit."""
    if measurements.rotations is None:
        return
    expected, seen = measurements.points_on(nominal), measurements.positions
    shift = np.median(expected - seen, axis=0)
    text = f"the positions, not the orientations, are relative to another origin, ({_in_millimetres(shift)}) mm away"
    yield [Mistake(text, replace(measurements, positions=seen + shift), nominal)]
    with contextlib.suppress(InvalidValueError):  # positions on a line
        moved = register(seen, expected).positions(seen)
        text = "the positions are in another frame than the orientations"
        yield [Mistake(text, replace(measurements, positions=moved), nominal)]


def _of_distances(measurements: Measurements, nominal: Poses) -> Iterator[Iterable[Mistake]]:
    """Yield mistakes of distances: their unit, a common offset, a scale, or their fixed points."""
    distances, origins, partners = measurements.distances, measurements.origins, measurements.partners
    if distances is None or origins is None or partners is None:
        return
    rows = np.flatnonzero(np.isfinite(distances))
    expected = distances[rows] - measurements.residuals(nominal)[rows, 0]

    def with_distances(text: str, changed: Array) -> Mistake:
        return Mistake(text, replace(measurements, distances=changed), nominal)

    yield [with_distances(f"the distances are in {unit}", factor * distances) for unit, factor in _LENGTHS.items()]
    longer = float(np.median(distances[rows] - expected))
    yield [with_distances(f"all distances are {1e3 * longer:.4g} mm too long", distances - longer)]
    scale = float(np.median(distances[rows] / np.maximum(expected, np.finfo(float).tiny)))
    if abs(scale - 1.0) > _ANOTHER:
        yield [with_distances(f"the distances are {scale:.6g} times what they should be", distances / scale)]
    fixed = rows[partners[rows] < 0]
    places, points = np.unique(origins[fixed], axis=0), measurements.points_on(nominal)
    centres = origins.copy()
    for place in places:
        touching = fixed[(origins[fixed] == place).all(axis=1)]
        if len(touching) >= _FEWEST:
            with contextlib.suppress(np.linalg.LinAlgError):
                centres[touching] = fitted_sphere(points[touching], distances[touching])
    if len(places):
        found = [centres[fixed][(origins[fixed] == place).all(axis=1)][0] for place in places[:2]]
        centre_words = "), (".join(map(_in_millimetres, found))
        text = f"the fixed points are not where the file has them, but at ({centre_words}) mm"
        yield [Mistake(text, measurements.with_origins(centres), nominal)]


def explained_by(measurements: Measurements, poses: Poses, eta: float, motions: Array) -> Array:
    """Fit amounts of given tool motions, shape=(n, 6, k), to the measurements by robust least squares.

    The base may be anywhere if the instrument has a frame of its own.
    """
    count, columns = motions.shape[2], measurements.tool_columns
    if measurements.registration is not None:
        motions = np.concatenate([motions, datum_motions(poses)[:, :, :6]], axis=2)
    seen = measurements.seen[:, :columns] * tip_weights(eta)[:columns]
    residuals = measurements.residuals(poses)[:, :columns] * seen
    sizes = np.linalg.norm(residuals, axis=1)
    trust = 1.0 / np.maximum(sizes, _FAR * np.median(sizes) + _SAME)
    rows = measurements.derivatives(poses, motions)[:, :columns] * (seen * trust[:, None])[:, :, None]
    answer = np.linalg.lstsq(rows.reshape(-1, motions.shape[2]), (residuals * trust[:, None]).reshape(-1), rcond=1e-9)
    return np.asarray(answer[0][:count])


def _of_counters(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Iterable[Mistake]]:
    """Yield the zero or lead of one drive, then of all drives, fitted to all rows together."""
    commands, count = measurements.commands, measurements.commands.shape[1]

    def without(changes: Array) -> tuple[Array, Measurements] | None:
        """Fit amounts of given command changes, shape=(n, drives, k); return them and the corrected measurements."""
        poses, found = nominal, np.zeros(changes.shape[2])
        with contextlib.suppress(PM3DofError, np.linalg.LinAlgError):
            for _ in range(_STEPS):
                found = found + explained_by(measurements, poses, eta, command_jacobians(poses) @ changes)
                moved = commands + changes @ found
                if not near_their_ranges(moved, nominal.robot).all():
                    return None
                poses = nominal.robot.forward(moved, guess=poses.q)
            return found, replace(measurements, commands=commands + changes @ found)
        return None

    def of_one() -> Iterator[Mistake]:
        for k in range(count):
            column = np.zeros((len(commands), count, 2))
            column[:, k] = np.column_stack([np.ones(len(commands)), commands[:, k]])
            if (fitted := without(column[:, :, :1])) is not None:
                text = f"the zero of u{k + 1} is off by about {-1e3 * fitted[0][0]:.3g} mm or mrad"
                yield Mistake(text, fitted[1], None)
            if (fitted := without(column)) is not None and abs(fitted[0][1]) > _ANOTHER:
                times = 1.0 / (1.0 + fitted[0][1])
                text = f"u{k + 1} is {times:.5g} times what it should be: another lead, unit or sign"
                yield Mistake(text, fitted[1], None)

    yield of_one()
    if (fitted := without(commands[:, :, None])) is not None and abs(fitted[0][0]) > _LEAST_LEAD:
        text = f"all commands are {1.0 / (1.0 + fitted[0][0]):.6g} times what they should be: another lead or unit"
        yield [Mistake(text, fitted[1], None)]
    if (fitted := without(np.tile(np.eye(count), (len(commands), 1, 1)))) is not None:
        text = f"the zeros of the drives are off by about ({_in_millimetres(-fitted[0])}) mm or mrad"
        yield [Mistake(text, fitted[1], None)]


def of_a_change(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    """Yield changes of the set-up in the middle of a file: of the instrument's place, or of the point seen."""
    seen = measurements.seen[:, : measurements.tool_columns] * tip_weights(eta)[: measurements.tool_columns]
    datum = datum_motions(nominal)
    for what, motions in (
        ("the instrument or the base has moved", datum[:, :, :6]),
        ("the point seen is elsewhere on the tool", datum[:, :, 6:9]),
    ):
        rows = measurements.derivatives(nominal, motions)[:, : seen.shape[1]] * seen[:, :, None]
        # over the rows up to each, and over all later ones
        sums = np.cumsum(np.swapaxes(rows, 1, 2) @ rows, axis=0)
        inverses = np.linalg.pinv(np.stack([sums, sums[-1] - sums]), rcond=1e-9, hermitian=True)
        moved, change, first = measurements, np.zeros(motions.shape[2]), 0
        for _ in range(_STEPS):
            residuals = moved.residuals(nominal)[:, : seen.shape[1]] * seen
            pull = np.einsum("nij,ni->nj", rows, residuals)
            before = np.cumsum(pull, axis=0)
            pulls = np.stack([before, before[-1] - before])
            fits = np.einsum("pnij,pnj->pni", inverses, pulls)
            if not first:
                ends = np.flatnonzero(np.diff(measurements.visit_numbers) != 0)[_FEWEST - 1 : -_FEWEST]
                if not ends.size:
                    return
                explained = np.einsum("pni,pni->n", fits, pulls)
                first = int(ends[np.argmax(explained[ends])]) + 1
            step = fits[1, first - 1] - fits[0, first - 1]
            change = change + step
            later = np.arange(len(moved))[:, None] >= first
            moved = moved.without_motions(nominal, np.where(later, motions @ step, 0.0))
        text = f"from line {measurements.lines[first]} on {what}, by about ({_in_millimetres(change[:3])}) mm"
        yield Mistake(text, moved, nominal)


def _in_millimetres(values: Array) -> str:
    return ", ".join(f"{1e3 * value:.3g}" for value in values)
