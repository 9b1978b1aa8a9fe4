"""Measurements of a real machine: which commands were given, and where the tool was seen."""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.calibration.registration import Registration, register
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion, rotation_vector
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError, UnreachablePoseError, lines_in_words
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.simulation.instrument import Instrument, Measured
from pm3dof_pin.typing import Array

logger = logging.getLogger(__name__)


POSITION_COLUMNS = ("x_m", "y_m", "z_m")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
POINT_COLUMNS = ("px_m", "py_m", "pz_m")
SIGMA_COLUMNS = ("sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad")

_CONDITIONS = ("temperature_", "load_")
_UNIT_QUATERNION = 1e-2  # more than the rounding of a few printed digits
_SAME = 1e-9
_BEYOND_LIMITS = 0.2  # of a joint's range
_FAR_OFF = 0.05  # of the way from the base to the tool: no tolerance explains that
_TURNED = 0.1  # [rad], likewise
_THOUSANDFOLD = 300.0
_LARGE_SIGMA = {"m": 1e-3, "rad": 1e-2}


@dataclass(frozen=True, eq=False)
class Measurements:
    """Commands and the poses, positions or points that were seen, row after row.

    Attributes:
        commands: coordinates of the actuated joints, 0 where the description has its zero, shape=(n, number of
            actuated joints) [m, rad].
        positions: what was seen of the tool point, or of `points`, in the world, shape=(n, 3) [m].
        rotations: orientation of the tool, shape=(n, 3, 3); None if positions only were measured.
        sigmas: noise of each measured coordinate (x, y, z, then about these axes), shape=(n, 6) or (n, 3) [m, rad].
        points: the points seen, in the tool's axes from the tool point, shape=(n, 3) [m]; zeros for the tool point.
        conditions: temperatures and loads by the name of their column, shape=(n,) each.
        lines: line of the file of each row, shape=(n,); counted from 2 where there is no file.
        warnings: what is odd about them.
        registration: how they came into the axes of the base; None if they were measured in them.
    """

    commands: Array
    positions: Array
    rotations: Array | None
    sigmas: Array
    points: Array
    conditions: dict[str, Array] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    registration: Registration | None = None

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            InvalidValueError: arrays that do not fit each other, numbers that are not finite, noise that is not
                positive.
        """
        n = len(self.commands)
        if not self.lines:
            object.__setattr__(self, "lines", tuple(range(2, n + 2)))
        shapes: dict[str, tuple[Array, tuple[int, ...]]] = {
            "commands": (self.commands, (n, self.commands.shape[-1])),
            "positions": (self.positions, (n, 3)),
            "sigmas": (self.sigmas, (n, 3 if self.rotations is None else 6)),
            "points": (self.points, (n, 3)),
        }
        if self.rotations is not None:
            shapes["rotations"] = (self.rotations, (n, 3, 3))
        shapes |= {name: (values, (n,)) for name, values in self.conditions.items()}
        for name, (array, shape) in shapes.items():
            if array.shape != shape or not np.isfinite(array).all():
                raise InvalidValueError(
                    name, f"an array of shape {array.shape}", f"finite numbers of shape {shape}, one row a measurement"
                )
        if not np.all(self.sigmas > 0.0):
            raise InvalidValueError("sigmas", float(self.sigmas.min()), "positive numbers")

    def __len__(self) -> int:
        return len(self.commands)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.intp] | Sequence[int] | slice) -> Measurements:
        """Return some of the rows."""
        chosen = np.arange(len(self))[rows]
        return replace(
            self,
            commands=self.commands[chosen],
            positions=self.positions[chosen],
            rotations=None if self.rotations is None else self.rotations[chosen],
            sigmas=self.sigmas[chosen],
            points=self.points[chosen],
            conditions={name: values[chosen] for name, values in self.conditions.items()},
            lines=tuple(self.lines[k] for k in chosen),
        )

    @property
    def measured(self) -> Measured:
        """What was seen: "pose" or "position"."""
        return "position" if self.rotations is None else "pose"

    @classmethod
    def of_poses(cls, commands: Array, transforms: Array, instrument: Instrument | None = None) -> Measurements:
        """Make measurements of whole poses, or of what an instrument sees of them.

        Args:
            commands: coordinates of the actuated joints, shape=(n, number of actuated joints) [m, rad].
            transforms: poses seen, shape=(n, 4, 4).
            instrument: whose noise they have.
        """
        seen_by = instrument or Instrument()
        poses = np.asarray(transforms, dtype=float)
        return cls(
            np.array(commands, dtype=float),
            poses[:, :3, 3],
            poses[:, :3, :3] if seen_by.measured == "pose" else None,
            np.tile(seen_by.sigmas, (len(poses), 1)),
            np.zeros((len(poses), 3)),
        )


def command_columns(mechanism: Robot) -> tuple[str, ...]:
    """Return the columns of the commands: u1_m, u2_m ... for drives that slide, u1_rad ... for those that turn."""
    return tuple(f"u{k}_{unit}" for k, unit in enumerate(command_units(mechanism), start=1))


def command_units(mechanism: Robot) -> tuple[str, ...]:
    """Return the unit of each actuated joint, "m" or "rad"."""
    return tuple(command.unit for command in mechanism.commands)


def measurements_as_text(measurements: Measurements, errors: GeometricErrors) -> str:
    """Return measurements as CSV, every digit kept; see :func:`read_measurements`."""
    n, columns = len(measurements), dict[str, Array]()
    columns |= dict(zip(command_columns(errors.mechanism), measurements.commands.T, strict=True))
    columns |= dict(zip(POSITION_COLUMNS, measurements.positions.T, strict=True))
    if measurements.rotations is not None:
        columns |= dict(zip(QUATERNION_COLUMNS, quaternion(measurements.rotations).T, strict=True))
    if measurements.points.any():
        columns |= dict(zip(POINT_COLUMNS, measurements.points.T, strict=True))
    columns |= dict(zip(SIGMA_COLUMNS, measurements.sigmas.T, strict=False))
    columns |= measurements.conditions
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([repr(float(column[row])) for column in columns.values()] for row in range(n))
    return text.getvalue()


def write_measurements(measurements: Measurements, errors: GeometricErrors, path: Path | str) -> Path:
    """Write measurements as CSV, whole or not at all.

    Args:
        measurements: what to write.
        errors: the robot, for the names of the columns and the zeros of its commands.
        path: file to write.

    Raises:
        OutputError: the file cannot be written.
    """
    return write_text_atomically(path, measurements_as_text(measurements, errors))


def read_measurements(
    path: Path | str,
    errors: GeometricErrors,
    instrument: Instrument | None = None,
    *,
    own_frame: bool = False,
) -> Measurements:
    """Read and check a CSV file of measurements.

    Columns: the commands (`u1_m,u2_m,u3_m`, or `u1_rad` for a drive that turns), `x_m,y_m,z_m`, and for full poses
    `qw,qx,qy,qz`. Optional: `px_m,py_m,pz_m`, the point seen, in the tool's axes; `sigma_x_m ... sigma_rz_rad`;
    `temperature_*_K`, `load_*`. Rows with missing numbers are left out with a warning that names them.

    Args:
        path: the file.
        errors: the robot; commands count from where its error file says.
        instrument: its noise is taken where the file has no sigmas.
        own_frame: whether the instrument measured in a frame of its own, from which the base has to be found first; see
            :mod:`pm3dof_pin.calibration.registration`.

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is no number, a quaternion is no rotation,
            numbers are most likely in another unit, or no row is left.
        InvalidValueError: the base cannot be found: positions alone, on one line.
    """
    return _Reader(Path(path), errors).measurements(instrument or Instrument(), own_frame)


def read_commands(path: Path | str, errors: GeometricErrors) -> Array:
    """Read the commands of a CSV file, such as a plan of measurements; its other columns are not looked at.

    Args:
        path: the file, with the columns `u1_m,u2_m,u3_m` or what the robot's drives need.
        errors: the robot.

    Returns:
        Coordinates of the actuated joints, shape=(n, number of actuated joints) [m, rad].

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is no number, or no row is left.
    """
    return _Reader(Path(path), errors, commands_only=True).commands()


class _Reader:
    """One file on its way to Measurements."""

    def __init__(self, path: Path, errors: GeometricErrors, *, commands_only: bool = False) -> None:
        self._path, self._errors = path, errors
        self._own = command_columns(errors.mechanism)
        self._commands_only = commands_only
        self._warnings: list[str] = []
        self._lines, self._table = self._numbers()
        self._leave_out_incomplete_rows()

    def commands(self) -> Array:
        commands = self._columns(self._own)
        self._check_commands(commands)
        return commands

    def measurements(self, instrument: Instrument, own_frame: bool) -> Measurements:
        table = self._table
        self._warn_of_copies()
        commands = self.commands()
        rotations = self._rotations()
        points = self._columns(POINT_COLUMNS) if POINT_COLUMNS[0] in table else np.zeros((len(commands), 3))
        positions = self._columns(POSITION_COLUMNS)
        sigmas = self._sigmas(instrument, rotations is not None)
        nominal = self._nominal_poses(commands)
        expected = nominal.positions + np.einsum("nij,nj->ni", nominal.rotations, points)
        registration = None
        if own_frame:
            self._check_extent(expected, positions)
            registration = register(positions, expected, rotations, nominal.rotations)
            positions, sigmas = registration.positions(positions), registration.sigmas(sigmas)
            rotations = None if rotations is None else registration.rotations(rotations)
        self._check_positions(expected, positions)
        if rotations is not None:
            self._check_rotations(nominal, rotations)
        conditions = {name: values for name, values in table.items() if name.startswith(_CONDITIONS)}
        return Measurements(
            commands,
            positions,
            rotations,
            sigmas,
            points,
            conditions,
            tuple(self._lines),
            tuple(self._warnings),
            registration,
        )

    def _numbers(self) -> tuple[list[int], dict[str, Array]]:
        """Return the lines of the rows and the columns by name; an empty cell is NaN."""
        try:
            text = self._path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise MeasurementError(self._path, f"expected a readable CSV file ({error})") from error
        reader = csv.reader(io.StringIO(text, newline=""))
        header = [name.strip() for name in next(reader, [])]
        self._check_header(header)
        lines, rows = [], []
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(header):
                raise MeasurementError(
                    self._path, f"{len(cells)} cells, expected {len(header)} as in the header", [reader.line_num]
                )
            lines.append(reader.line_num)
            rows.append([self._number(cell, name, lines[-1]) for cell, name in zip(cells, header, strict=True)])
        table = np.array(rows, dtype=float).reshape(len(rows), len(header))
        return lines, {name: table[:, k] for k, name in enumerate(header)}

    def _number(self, cell: str, column: str, line: int) -> float:
        word = cell.strip()
        try:
            return float(word) if word else np.nan
        except ValueError as error:
            raise MeasurementError(self._path, f"{column} is '{word}', expected a number", [line]) from error

    def _check_header(self, header: Sequence[str]) -> None:
        if len(header) == 1 and (found := next((mark for mark in ";\t|" if mark in header[0]), "")):
            raise MeasurementError(
                self._path, f"columns are separated by {found!r}, expected commas, and points in numbers", [1]
            )
        wanted = [*self._own]
        if not self._commands_only:
            wanted += POSITION_COLUMNS
            for group in (QUATERNION_COLUMNS, POINT_COLUMNS, SIGMA_COLUMNS[:3], SIGMA_COLUMNS[3:]):
                if set(group) & set(header):
                    wanted += group
        missing = [name for name in wanted if name not in header]
        if missing:
            raise MeasurementError(
                self._path,
                f"no column {', '.join(missing)}; expected {','.join(wanted)}, the file has {','.join(header)}",
                [1],
            )
        twice = sorted({name for name in header if header.count(name) > 1})
        if twice:
            raise MeasurementError(self._path, f"column {', '.join(twice)} stands there more than once", [1])
        unknown = [name for name in header if name not in wanted and not name.startswith(_CONDITIONS)]
        if unknown and not self._commands_only:
            self._warn(f"columns {', '.join(unknown)} are not used")

    def _leave_out_incomplete_rows(self) -> None:
        read = self._own if self._commands_only else list(self._table)
        whole = np.isfinite(self._columns(read)).all(axis=1)
        if not whole.all():
            self._warn("numbers are missing or not finite; left out", self._lines_where(~whole))
        if not whole.any():
            raise MeasurementError(self._path, "no complete row of numbers, expected one for each pose")
        self._table = {name: values[whole] for name, values in self._table.items()}
        self._lines = self._lines_where(whole)

    def _warn_of_copies(self) -> None:
        rows = np.column_stack(list(self._table.values()))
        first: dict[bytes, int] = {}
        copies = []
        for line, row in zip(self._lines, rows, strict=True):
            if first.setdefault(row.tobytes(), line) != line:
                copies.append(line)
        if copies:
            self._warn("copies of earlier lines; they count as often as they stand there", copies)
        names = [*self._own, *(POINT_COLUMNS if POINT_COLUMNS[0] in self._table else ())]
        places = np.round(self._columns(names) / _SAME)
        distinct = len(np.unique(places, axis=0))
        if distinct < len(rows) - len(copies):
            self._warn(f"{len(rows)} rows at {distinct} different commands: the others repeat one")

    def _check_commands(self, commands: Array) -> None:
        mechanism = self._errors.mechanism
        lower, upper = np.array([mechanism.range_of(command) for command in mechanism.command_coordinates]).T
        slack = np.where(np.isfinite(upper - lower), _BEYOND_LIMITS * (upper - lower), 0.0)
        for k, name in enumerate(self._own):
            unit = name.rsplit("_", 1)[1]

            def within(values: Array, k: int = k) -> NDArray[np.bool_]:
                inside: NDArray[np.bool_] = (values >= lower[k] - slack[k]) & (values <= upper[k] + slack[k])
                return inside

            bad = ~within(commands[:, k])
            if not bad.any():
                continue
            factor, other = (1e-3, "millimetres") if unit == "m" else (np.pi / 180.0, "degrees")
            scaled = within(factor * commands[:, k])
            lines = self._lines_where(bad)
            problem = f"{name} is far outside the joint's limits {lower[k]:.6g} .. {upper[k]:.6g} {unit}"
            if np.mean(scaled[bad]) > 0.5:
                problem += f": these look like {other}"
            raise MeasurementError(self._path, problem, lines)

    def _nominal_poses(self, commands: Array) -> Poses:
        try:
            return self._errors.mechanism.forward(commands)
        except UnreachablePoseError as error:
            raise MeasurementError(self._path, f"commands that the machine cannot take: {error}") from error

    def _check_extent(self, expected: Array, positions: Array) -> None:
        seen, wanted = (np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)) for p in (positions, expected))
        if seen > _THOUSANDFOLD * wanted:
            raise MeasurementError(
                self._path,
                f"{','.join(POSITION_COLUMNS)} look like millimetres: "
                "they spread a thousand times as far as the machine moves",
            )

    def _check_positions(self, expected: Array, positions: Array) -> None:
        size = max(float(np.median(np.linalg.norm(expected, axis=1))), 1e-3)
        distances = np.linalg.norm(positions - expected, axis=1)
        if np.median(np.linalg.norm(1e-3 * positions - expected, axis=1)) < _FAR_OFF * size:
            raise MeasurementError(
                self._path,
                f"{','.join(POSITION_COLUMNS)} look like millimetres: a thousandth of them is where the machine is",
            )
        far = distances > _FAR_OFF * size
        if far.mean() > 0.5:
            self._warn(
                f"positions are {np.median(distances):.3g} m (median) from where the machine is by its description: "
                "other axes, another zero of the commands or another tool point?"
            )
        elif far.any():
            lines = self._lines_where(far)
            self._warn(f"positions are more than {_FAR_OFF * size:.2g} m from where the machine can be", lines)

    def _check_rotations(self, nominal: Poses, rotations: Array) -> None:
        """Look for the usual mistakes: another order of a quaternion's numbers, the inverse rotation, other axes."""

        def angles(seen: Array) -> Array:
            return np.asarray(np.linalg.norm(rotation_vector(np.swapaxes(nominal.rotations, 1, 2) @ seen), axis=1))

        turned = angles(rotations)
        if np.median(turned) <= _TURNED:
            if (turned > _TURNED).any():
                lines = self._lines_where(turned > _TURNED)
                self._warn(f"orientations are more than {_TURNED:g} rad from where the machine can be", lines)
            return
        columns = ",".join(QUATERNION_COLUMNS)
        scalar_last = rotations_of(np.roll(self._columns(QUATERNION_COLUMNS), 1, axis=1))
        inverse = np.swapaxes(rotations, 1, 2)
        for seen, problem in (
            (scalar_last, "hold the numbers in the order x, y, z, w"),
            (
                inverse,
                "are the inverse rotations, of the base in the tool's axes: expected those of the tool in the base",
            ),
        ):
            if np.median(angles(seen)) < min(_TURNED, 0.1 * np.median(turned)):
                raise MeasurementError(self._path, f"{columns} {problem}")
        self._warn(
            f"orientations are {np.median(turned):.3g} rad (median) from where the machine is by its description: "
            "other axes of the base or of the tool?"
        )

    def _rotations(self) -> Array | None:
        if QUATERNION_COLUMNS[0] not in self._table:
            return None
        quaternions = self._columns(QUATERNION_COLUMNS)
        norms = np.linalg.norm(quaternions, axis=1)
        bad = np.abs(norms - 1.0) > _UNIT_QUATERNION
        if bad.any():
            lines = self._lines_where(bad)
            raise MeasurementError(
                self._path,
                f"{','.join(QUATERNION_COLUMNS)} is no rotation: its length is {norms[bad][0]:.6g}, expected 1",
                lines,
            )
        return rotations_of(quaternions)

    def _sigmas(self, instrument: Instrument, poses: bool) -> Array:
        count = 6 if poses else 3
        names = SIGMA_COLUMNS[:count]
        usual = np.repeat([instrument.position_sigma, instrument.angle_sigma], 3)
        sigmas = np.tile(usual[:count], (len(self._lines), 1))
        for k, name in enumerate(names):
            if name in self._table:
                sigmas[:, k] = self._table[name]
        bad = ~(sigmas > 0.0).all(axis=1)
        if bad.any():
            lines = self._lines_where(bad)
            raise MeasurementError(self._path, "a sigma is not positive", lines)
        for k, name in enumerate(names):
            unit = name.rsplit("_", 1)[1]
            if np.median(sigmas[:, k]) > _LARGE_SIGMA[unit]:
                other = "millimetres" if unit == "m" else "degrees"
                self._warn(f"{name} is {np.median(sigmas[:, k]):.3g} {unit} (median), a great deal: {other}?")
        return sigmas

    def _lines_where(self, flags: Any) -> list[int]:
        return [self._lines[row] for row in np.flatnonzero(flags)]

    def _columns(self, names: Sequence[str]) -> Array:
        return np.column_stack([self._table[name] for name in names])

    def _warn(self, text: str, lines: Sequence[int] = ()) -> None:
        self._warnings.append(f"{lines_in_words(lines)}{text}")
        logger.warning("%s: %s", self._path, self._warnings[-1])


def rotations_of(quaternions: Array) -> Array:
    """Return the rotation matrices of quaternions (w, x, y, z) of any length, shape=(..., 3, 3).

    Args:
        quaternions: shape=(..., 4).
    """
    w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
