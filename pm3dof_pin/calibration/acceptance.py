"""Tests of a calibrated machine after ISO 230: planned as commands, evaluated from what was measured, with uncertainty.

positioning (ISO 230-2): targets on a line, approached from both sides in n runs. With the means and standard deviations
of the deviations at target i, up and down, and B_i their difference,

    B = max |B_i|,   R = max of R_i = max(2 s_up + 2 s_down + |B_i|, 4 s_up, 4 s_down),
    E = range of all means,   M = range of (up + down) / 2,   A = max(mean + 2 s) - min(mean - 2 s).

diagonals (ISO 230-6): the same on the four body diagonals of a box; the greatest of each.
circular (ISO 230-4): G, the range of radii about the least-squares centre, of each direction; H, the greatest
difference between the directions at one angle, interpolated between samples; F, greatest and least deviation from the
nominal radius.
probing (after ISO 230-10): P, the range of the distances of 25 touches from the centre of the least-squares sphere, and
its size error.

The test uncertainty U is twice the root mean square change of each result under errors of the instrument, drawn at
random (JCGM 101): noise, an error in proportion to length, and drift during the test as given. With u the standard
deviation of the results drawn and b their mean less the result,

    U = 2 (u^2 + b^2)^(1/2).

Noise makes every range larger, by about b; the result is stated as it was measured, so b counts (GUM, F.2.4.5).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from pm3dof_pin.calibration.compensation import Compensation, Conditions
from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, MeasurementError, UnreachablePoseError
from pm3dof_pin.files import csv_text, read_text, write_text_atomically
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.mobility import instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import ColumnMap, Export
from pm3dof_pin.measuring.joint_columns import command_columns
from pm3dof_pin.typing import Array

AcceptanceTest = Literal["positioning", "diagonals", "circular", "probing"]
STANDARDS: dict[AcceptanceTest, str] = {
    "positioning": "ISO 230-2",
    "diagonals": "ISO 230-6",
    "circular": "ISO 230-4",
    "probing": "after ISO 230-10",
}
_COLUMNS: dict[AcceptanceTest, tuple[str, ...]] = {
    "positioning": ("target_m", "direction", "deviation_m"),
    "diagonals": ("diagonal", "target_m", "direction", "deviation_m"),
    "circular": ("angle_rad", "direction", "radius_m"),
    "probing": ("x_m", "y_m", "z_m"),
}
_MIN_RUNS, _MIN_TARGETS, _MIN_ANGLES = 2, 5, 12
_RUNS = 5  # of ISO 230-2
_DIAGONALS = 4
_MIN_ARC = np.radians(90.0)  # of a shorter one, the centre is hardly known
_FULL_GAP = 2.0 * np.pi / _MIN_ANGLES + 1e-6  # between neighbours on a whole circle, at most
_MIN_HEIGHT = 0.4  # of touches over their width, rms: 0.65 as planned, 0.5 all over a hemisphere, 0.4 up to 75 degrees
_RADIUS_OFF = 0.05  # a measured radius farther from the nominal one is of another circle or sphere
_FAR_APART = np.radians(5.0)  # samples of a path farther apart have nothing to say of what is between
_DRAWS = 400
_RINGS = ((0.0, 1, 0.0), (22.5, 4, 0.0), (45.0, 8, 22.5), (67.5, 4, 0.0), (90.0, 8, 22.5))  # ISO 10360-5
_ROUNDS = 10  # of Gauss-Newton
_SAME = 1e-7  # [m, rad]
_SIDES = (1.0, -1.0)


@dataclass(frozen=True)
class InstrumentErrors:
    """Standard deviations of what an instrument adds to a test."""

    noise: float = 0.0  #: of a reading [m]
    per_length: float = 0.0  #: of an error in proportion to length, such as of expansion or wavelength [1]
    drift: float = 0.0  #: from the first reading to the last [m]

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf:
                raise InvalidValueError(name, value, "a standard deviation of at least 0")


@dataclass(frozen=True)
class AcceptanceResult:
    """Results of a test, each with its test uncertainty.

    Raises:
        InvalidValueError: an unknown test, results without uncertainties or the reverse, a result or an uncertainty
            that is not a finite number, or an uncertainty below 0.
    """

    test: AcceptanceTest  #: which
    values: dict[str, float]  #: results by their symbols [m]
    uncertainties: dict[str, float | None]  #: expanded test uncertainty U of each, k = 2 [m]; None if not stated
    readings: int  #: number of readings
    notes: tuple[str, ...] = ()  #: what the standard asks for and the readings do not have
    label: str = field(default="", compare=False)  #: name of the file that they were read from, without its suffix

    def __post_init__(self) -> None:
        """Check the entries."""
        if self.test not in STANDARDS:
            raise InvalidValueError("test", self.test, f"one of {', '.join(STANDARDS)}")
        if set(self.values) != set(self.uncertainties):
            raise InvalidValueError("uncertainties", sorted(self.uncertainties), f"those of {sorted(self.values)}")
        for name, value in self.values.items():
            if not is_finite_number(value):
                raise InvalidValueError(f"result {name}", value, "a finite number [m]")
        for name, spread in self.uncertainties.items():
            if spread is not None and not (is_finite_number(spread) and spread >= 0.0):
                expected = "a finite number of at least 0 [m], or null if it is not stated"
                raise InvalidValueError(f"uncertainty of {name}", spread, expected)
        if isinstance(self.readings, bool) or not isinstance(self.readings, int) or self.readings < 1:
            raise InvalidValueError("readings", self.readings, "their number")

    @classmethod
    def read(cls, path: Path | str) -> AcceptanceResult:
        """Read results that were written as JSON; raise DescriptionError for anything else."""
        try:
            data = json.loads(read_text(path))
            values, uncertainties = dict(data["results_m"]), dict(data["test_uncertainties_k2_m"])
            notes = tuple(map(str, data.get("notes", ())))
            return cls(data["test"], values, uncertainties, data["readings"], notes, Path(path).stem)
        except InvalidValueError as error:
            raise DescriptionError(path, "contents", str(error)) from error
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            raise DescriptionError(path, "contents", f"expected results of an acceptance test ({error!r})") from error

    @property
    def standard(self) -> str:
        """The standard, or what the test is made after, if the readings do not have all that the standard asks for."""
        name = STANDARDS[self.test]
        return f"after {name}" if self.notes and not name.startswith("after") else name

    def as_data(self) -> dict[str, Any]:
        """Return everything as plain data; keys end in their unit."""
        return {
            "test": self.test,
            "standard": self.standard,
            "notes": list(self.notes),
            "readings": self.readings,
            "results_m": dict(self.values),
            "test_uncertainties_k2_m": dict(self.uncertainties),
        }


def is_finite_number(value: object) -> bool:
    """Return whether a value read from a file is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < np.inf


def planned_targets(
    test: AcceptanceTest, place: tuple[float, ...], *, targets: int = _MIN_TARGETS, runs: int = 5
) -> tuple[Array, dict[str, Array]]:
    """Return the points of a test in their order, shape=(n, 3) [m], and the columns that describe each.

    Args:
        test: which.
        place: base axes [m]: both ends of a line, or two opposite corners of a box, shape=(6,); or centre and radius of
            a circle in the plane of x and y, or of a sphere, shape=(4,).
        targets: on a line or diagonal; on a circle 36 times runs.
        runs: from each side, or rounds in each direction.

    Raises:
        InvalidValueError: too few targets or runs, a place of another shape, or no extent.
    """
    if test not in get_args(AcceptanceTest):
        raise InvalidValueError("test", test, f"one of {', '.join(get_args(AcceptanceTest))}")
    if targets < _MIN_TARGETS or runs < _MIN_RUNS:
        raise InvalidValueError("targets, runs", (targets, runs), f"at least {_MIN_TARGETS} and {_MIN_RUNS}")
    numbers, expected = np.array(place, dtype=float), 4 if test in ("circular", "probing") else 6
    if numbers.shape != (expected,) or not np.isfinite(numbers).all():
        raise InvalidValueError("place", place, f"{expected} finite numbers for {test}")
    extent = numbers[3] if expected == 4 else np.linalg.norm(numbers[3:] - numbers[:3])
    if not extent > 0.0:
        raise InvalidValueError("place", place, "a positive length or radius")
    if test == "probing":
        touches = [(tilt, start + 360.0 * k / count) for tilt, count, start in _RINGS for k in range(count)]
        tilt, turn = np.radians(touches).T
        normals = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
        return numbers[:3] + numbers[3] * normals, {"touch": np.arange(1.0, len(normals) + 1.0)}
    if test == "circular":
        once = 2.0 * np.pi * np.arange(36) / 36.0
        angles = np.concatenate([side * once % (2.0 * np.pi) for side in _SIDES for _ in range(runs)])
        sides = np.repeat(_SIDES, runs * len(once))
        points = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        return numbers[:3] + numbers[3] * points, {"angle_rad": angles, "direction": sides}
    low, high = numbers[:3], numbers[3:]
    lines = [(low, high)]
    if test == "diagonals":
        # the four that start at the lower face
        corners = [np.array(c, dtype=bool) for c in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0))]
        lines = [(np.where(c, high, low), np.where(c, low, high)) for c in corners]
    shares = np.linspace(0.0, 1.0, targets)
    order = np.concatenate([np.concatenate([shares, shares[::-1]]) for _ in range(runs)])
    sides = np.tile(np.repeat(_SIDES, targets), runs)
    points = np.concatenate([a + order[:, None] * (b - a) for a, b in lines])
    columns = {"target_m": np.concatenate([order * np.linalg.norm(b - a) for a, b in lines])}
    columns |= {"direction": np.tile(sides, len(lines))}
    if test == "diagonals":
        columns = {"diagonal": np.repeat(np.arange(1.0, len(lines) + 1.0), len(order)), **columns}
    return points, columns


def write_acceptance_plan(
    robot: Robot,
    points: Array,
    columns: Mapping[str, Array],
    path: Path | str,
    compensation: Compensation | None = None,
    conditions: Conditions | None = None,
) -> Path:
    """Write the commands of a test, corrected if a calibration is given, under conditions by name.

    A tool that can, as one with six degrees of freedom, keeps its orientation at home.

    Raises:
        UnreachablePoseError: a point is out of reach, or breaks a limit of a joint.
        SingularConfigurationError: the drives do not determine the pose anywhere.
        InvalidValueError: the calibration depends on a condition that is not given.
        OutputError: the file cannot be written.
    """
    robot.require_regular_drives(from_home=False)
    transforms = np.tile(robot.configuration(robot.home.q).tool_placement.homogeneous, (len(points), 1, 1))
    transforms[:, :3, 3] = points
    whole = len(robot.tool_motions) == len(TOOL_COMPONENTS)
    may_turn = whole and instantaneous_mobility(robot.home).tool_mobility < len(TOOL_COMPONENTS)
    nominal = robot.reach(transforms if whole else points, on_failure="nan" if may_turn else "raise")
    if not nominal.solved.all():
        nominal = robot.reach(points)
    commands = nominal.commands
    if compensation is not None:
        commands = compensation.compensate(nominal, conditions).commands
    driven = nominal if compensation is None else robot.forward(commands, guess=nominal.q)
    if beyond := np.flatnonzero(~driven.within_limits).tolist():
        first, place = beyond[0], ", ".join(f"{value:.6g}" for value in points[beyond[0]])
        limits = broken_limits(robot, driven[first].configuration())
        others = f" and {len(limits) - 1} more" if len(limits) > 1 else ""
        raise UnreachablePoseError(
            f"{len(beyond)} of {len(points)} points break a limit, first point {first + 1} at ({place}) m: "
            f"{limits[0]}{others}: expected a test within the limits"
        )
    named = dict(zip(command_columns(robot), commands.T, strict=True)) | dict(columns)
    named |= zip(("nominal_x_m", "nominal_y_m", "nominal_z_m"), points.T, strict=True)
    return write_text_atomically(path, csv_text([list(named), *np.column_stack(list(named.values())).tolist()]))


def evaluate_acceptance(
    test: AcceptanceTest,
    path: Path | str,
    *,
    instrument: InstrumentErrors | None = None,
    radius: float | None = None,
    columns: ColumnMap | None = None,
    seed: int = 0,
) -> AcceptanceResult:
    """Evaluate a test from a file.

    Columns: `target_m,direction,deviation_m` (1 approached upwards, -1 downwards), for diagonals also `diagonal`;
    `angle_rad,direction,radius_m` (1 counter-clockwise); or `x_m,y_m,z_m` of touches of a sphere. Units are those of
    the headings.

    Args:
        test: which.
        path: the file.
        instrument: what the instrument adds; without it, or if all of it is 0, no uncertainty is stated.
        radius: nominal radius of a circle, or of a sphere with the stylus added [m].
        columns: what the file does not say of itself.
        seed: of the random numbers of the uncertainty.

    Raises:
        MeasurementError: the file cannot be read, is of another test, has too few targets, runs, diagonals or angles,
            or an arc that is too short, other than 25 touches, or touches of less than a hemisphere, or is of a circle
            or sphere of another radius.
        InvalidValueError: an unknown test.
    """
    if test not in get_args(AcceptanceTest):
        raise InvalidValueError("test", test, f"one of {', '.join(get_args(AcceptanceTest))}")
    needed, errors, generator = _COLUMNS[test], instrument or InstrumentErrors(), np.random.default_rng(seed)
    table = _table(Path(path), test, columns or ColumnMap())
    table.keep(np.asarray(np.isfinite(table.matrix(needed)).all(axis=1)))
    data = {name: table[name] for name in needed}
    if "direction" in data and (wrong := ~np.isin(data["direction"], _SIDES)).any():
        raise MeasurementError(table.path, "direction is neither 1 nor -1", table.lines_where(wrong))
    evaluate: dict[AcceptanceTest, Callable[[dict[str, Array]], dict[str, float]]] = {
        "positioning": _positioning,
        "diagonals": _diagonals,
        "circular": lambda each: _circular(each, radius),
        "probing": lambda each: _probing(each, radius),
    }
    try:
        values = evaluate[test](data)
    except InvalidValueError as error:
        raise MeasurementError(table.path, str(error)) from error
    off = max(
        (value for name, value in values.items() if name == "size" or name.startswith("F_")), key=abs, default=0.0
    )
    if radius is not None and abs(off) > _RADIUS_OFF * radius:
        problem = f"{test} has a radius of {radius + off:.6g} m as measured, nominally {radius:.6g} m: expected "
        raise MeasurementError(table.path, f"{problem}radii that differ by {100.0 * _RADIUS_OFF:.0f} % at most")
    notes = tuple(_notes(test, data))
    if not any(vars(errors).values()):
        return AcceptanceResult(test, values, dict.fromkeys(values), len(table), notes)
    read = needed[-1:] if test != "probing" else needed
    time = np.linspace(0.0, 1.0, len(table))
    drawn: dict[str, list[float]] = {name: [] for name in values}
    for _ in range(_DRAWS):
        scale, drift = errors.per_length * generator.standard_normal(), errors.drift * generator.standard_normal()
        other = dict(data)
        for name in read:
            length = data["target_m"] if "target_m" in data else data[name]
            noise = errors.noise * generator.standard_normal(len(table))
            other[name] = data[name] + scale * length + drift * time + noise
        for name, value in evaluate[test](other).items():
            drawn[name].append(value)
    # about the result itself: noise also makes every range too large, which counts as uncertainty
    spread = {name: 2.0 * float(np.sqrt(np.mean((np.array(drawn[name]) - values[name]) ** 2))) for name in values}
    return AcceptanceResult(test, values, dict(spread), len(table), notes)


def _notes(test: AcceptanceTest, data: Mapping[str, Array]) -> Iterator[str]:
    """Say what the standard asks for and the readings of a test do not have."""
    if test == "positioning":
        places = np.column_stack([np.round(data["target_m"] / _SAME), data["direction"]])
        runs = int(np.unique(places, axis=0, return_counts=True)[1].min())
        if runs < _RUNS:
            yield f"as few as {runs} runs to a target from one side, where {STANDARDS[test]} has {_RUNS}"
    if test == "circular":
        arcs = [_arc(data["angle_rad"][data["direction"] == side]) for side in np.unique(data["direction"])]
        if min(arcs) < 2.0 * np.pi:
            yield f"an arc of {np.degrees(min(arcs)):.0f} degrees, where {STANDARDS[test]} has the whole circle"


def _arc(angles: Array) -> float:
    """Return the angle that samples of a circle cover [rad]: all but the largest gap, or 2 pi if no gap is large."""
    around = 2.0 * np.pi
    places = np.sort(np.mod(angles, around))
    gap = float(np.diff(places, append=places[0] + around).max())
    return around if gap <= _FULL_GAP else around - gap


def _table(path: Path, test: AcceptanceTest, columns: ColumnMap) -> CsvTable:
    """Read a file as it comes, whose headings are the needed columns in any unit.

    Raises:
        MeasurementError: it cannot be read, a heading of a length or an angle has no unit, or it is of diagonals and
            the test is another.
    """
    needed = _COLUMNS[test]
    given = {heading.casefold() for heading in columns.columns}
    stems = {name.rpartition("_")[0] or name: name for name in needed}
    own = {stem: name for stem, name in stems.items() if stem not in given}
    export = Export.read(path, needed, replace(columns, columns=own | dict(columns.columns)))
    if "diagonal" not in needed and "diagonal" in map(str.casefold, export.headings):
        raise MeasurementError(path, f"has a column diagonal: expected a file of {test}, or the test diagonals")
    headings = {name: export.headings.get(name, "").strip() for name in needed}
    if bare := [headings[name] for stem, name in own.items() if stem != name and headings[name].casefold() == stem]:
        unit = "deg" if own[bare[0].casefold()].endswith("_rad") else "mm"
        problem = f"{', '.join(bare)} without a unit: expected headings such as {bare[0]} [{unit}], or --columns"
        raise MeasurementError(path, problem, [max(export.header_line, 1)])
    return export.table(needed)


def _positioning(data: dict[str, Array]) -> dict[str, float]:
    places = np.round(data["target_m"] / _SAME)
    targets = np.unique(places)
    if len(targets) < _MIN_TARGETS:
        raise InvalidValueError(
            "positioning", problem=f"has {len(targets)} targets", expected=f"{_MIN_TARGETS} or more"
        )
    means, spreads = np.empty((2, len(targets), 2))
    for i, target in enumerate(targets):
        for j, side in enumerate(_SIDES):
            values = data["deviation_m"][(places == target) & (data["direction"] == side)]
            if len(values) < _MIN_RUNS:
                problem = f"has {len(values)} runs in direction {side:g} at target {_SAME * target:.6g} m"
                raise InvalidValueError("positioning", problem=problem, expected=f"{_MIN_RUNS} or more")
            means[i, j], spreads[i, j] = values.mean(), values.std(ddof=1)
    reversal = means[:, 0] - means[:, 1]
    both = 2.0 * spreads.sum(axis=1) + np.abs(reversal)
    return {
        "A": float((means + 2.0 * spreads).max() - (means - 2.0 * spreads).min()),
        "E": float(np.ptp(means)),
        "M": float(np.ptp(means.mean(axis=1))),
        "R": float(np.maximum(both, 4.0 * spreads.max(axis=1)).max()),
        "B": float(np.abs(reversal).max()),
    }


def _diagonals(data: dict[str, Array]) -> dict[str, float]:
    parts, numbers = [], np.unique(data["diagonal"])
    if len(numbers) != _DIAGONALS:
        problem = f"has diagonals {', '.join(f'{number:g}' for number in numbers)}"
        raise InvalidValueError("diagonals", problem=problem, expected=f"the {_DIAGONALS} body diagonals of a box")
    for number in numbers:
        own = data["diagonal"] == number
        parts.append(_positioning({name: values[own] for name, values in data.items()}))
    return {name: max(part[name] for part in parts) for name in parts[0]}


def _circular(data: dict[str, Array], radius: float | None) -> dict[str, float]:
    found, paths = {}, {}
    for side, word in zip(_SIDES, ("ccw", "cw"), strict=True):
        own = data["direction"] == side
        if not own.any():
            continue
        angles, radii = data["angle_rad"][own], data["radius_m"][own]
        places = np.round(np.mod(angles, 2.0 * np.pi) / _SAME)
        if len(np.unique(places)) < _MIN_ANGLES:
            raise InvalidValueError("circular", problem=f"has fewer than {_MIN_ANGLES} angles {word}", expected="more")
        if (arc := _arc(angles)) < _MIN_ARC:
            problem, least = f"has an arc of {np.degrees(arc):.0f} degrees {word}", np.degrees(_MIN_ARC)
            raise InvalidValueError("circular", problem=problem, expected=f"the whole circle, or {least:.0f} at least")
        # centred by least squares: eccentricity is of the instrument's set-up
        terms = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
        centre = np.linalg.lstsq(terms, radii, rcond=None)[0]
        about = radii - terms[:, 1:] @ centre[1:]
        found[f"G_{word}"] = float(np.ptp(about))
        if radius is not None:
            found[f"F_max_{word}"], found[f"F_min_{word}"] = float(about.max() - radius), float(about.min() - radius)
        turns, numbers = np.unique(places, return_inverse=True)
        paths[word] = turns * _SAME, np.bincount(numbers, radii) / np.bincount(numbers)
    if len(paths) == 2:
        apart = _between(*paths["cw"], paths["ccw"][0]) - paths["ccw"][1]
        if np.isfinite(apart).any():
            found["H"] = float(np.nanmax(np.abs(apart)))
    return found


def _between(angles: Array, radii: Array, at: Array) -> Array:
    """Return a path's radii at other angles, shape=(n,); NaN where its own are too far apart."""
    around = 2.0 * np.pi
    known = np.concatenate([angles[-1:] - around, angles, angles[:1] + around])
    after = np.searchsorted(known, at - _SAME).clip(1, len(known) - 1)
    # both ends of the gap that an angle is in, unless the angle is one of them
    far = (known[after] - known[after - 1] > _FAR_APART) & (np.abs(known[after] - at) > _SAME)
    radius = np.interp(at, known, np.concatenate([radii[-1:], radii, radii[:1]]))
    return np.asarray(np.where(far, np.nan, radius))


def _probing(data: dict[str, Array], radius: float | None) -> dict[str, float]:
    points = np.column_stack([data[name] for name in _COLUMNS["probing"]])
    count, places = sum(ring for _, ring, _ in _RINGS), len(np.unique(np.round(points / _SAME), axis=0))
    if len(points) != count or places < count:
        problem = f"has {len(points)} touches, {places} of them distinct"
        raise InvalidValueError("probing", problem=problem, expected=f"{count} distinct ones, as ISO 10360-5 has")
    centre = points.mean(axis=0)
    extents = np.linalg.svd(points - centre, compute_uv=False)
    if not extents[2] > _MIN_HEIGHT * extents[0]:
        problem = f"has touches whose height is {100.0 * extents[2] / extents[0]:.0f} % of their width"
        expected = f"touches all over a hemisphere, {100.0 * _MIN_HEIGHT:.0f} % or more"
        raise InvalidValueError("probing", problem=problem, expected=expected)
    size = float(np.linalg.norm(points - centre, axis=1).mean())
    for _ in range(_ROUNDS):
        spans = points - centre
        distances = np.linalg.norm(spans, axis=1)
        rows = np.column_stack([spans / distances[:, None], np.ones(len(points))])
        step = np.linalg.lstsq(rows, distances - size, rcond=None)[0]
        centre, size = centre + step[:3], size + float(step[3])
    distances = np.linalg.norm(points - centre, axis=1)
    found = {"P": float(np.ptp(distances))}
    return found if radius is None else found | {"size": float(distances.mean() - radius)}
