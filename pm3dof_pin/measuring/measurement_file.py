"""Files of measurements: reading them with every check, and writing them."""

from __future__ import annotations

import csv
import io
import itertools
import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.errors.pose_error import quaternion, rotation_of_quaternion, rotation_vector
from pm3dof_pin.exceptions import DescriptionError, MeasurementError, UnreachablePoseError, lines_in_words
from pm3dof_pin.files import read_text, write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.registration import register
from pm3dof_pin.typing import Array, Mask

logger = logging.getLogger(__name__)


POSITION_COLUMNS = ("x_m", "y_m", "z_m")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
NOMINAL_COLUMNS = tuple(f"nominal_{name}" for name in (*POSITION_COLUMNS, *QUATERNION_COLUMNS))
POINT_COLUMNS = ("px_m", "py_m", "pz_m")
DISTANCE_COLUMN, DISTANCE_SIGMA_COLUMN = "distance_m", "sigma_distance_m"
ORIGIN_COLUMNS = ("cx_m", "cy_m", "cz_m")
SIGMA_COLUMNS = ("sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad")

_TIME_COLUMN = "time_s"

_CONDITIONS = ("temperature_", "load_")
_UNIT_QUATERNION = 1e-2  # more than the rounding of a few printed digits
_SAME = 1e-9
_BEYOND_LIMITS = 0.2  # of a joint's range
_FAR_OFF = 0.05  # of the way from the base to the tool: no tolerance explains that
_TURNED = 0.1  # [rad], likewise
_THOUSANDFOLD = 300.0
_LARGE_SIGMA = {"m": 1e-3, "rad": 1e-2}


def command_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the commands: u1_m, u2_m ... for drives that slide, u1_rad ... for those that turn."""
    return tuple(f"u{k}_{unit}" for k, unit in enumerate((command.unit for command in robot.commands), start=1))


def _approach_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the directions from which drives came: approach_u1, approach_u2 ..."""
    return tuple(f"approach_u{k}" for k in range(1, len(robot.commands) + 1))


def _start_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the commands of the pose at which a distance begins: from_u1_m ..."""
    return tuple(f"from_{name}" for name in command_columns(robot))


def _measurements_as_text(measurements: Measurements, robot: Robot) -> str:
    """Return measurements as CSV, every digit kept; see :func:`read_measurements`."""
    columns: dict[str, Array] = dict(zip(command_columns(robot), measurements.commands.T, strict=True))
    columns |= zip(POSITION_COLUMNS, measurements.positions.T, strict=True)
    if measurements.rotations is not None:
        columns |= zip(QUATERNION_COLUMNS, quaternion(measurements.rotations).T, strict=True)
    if measurements.points.any():
        columns |= zip(POINT_COLUMNS, measurements.points.T, strict=True)
    columns |= zip(SIGMA_COLUMNS, measurements.sigmas.T, strict=False)
    if measurements.distances is not None and measurements.origins is not None and measurements.partners is not None:
        far = np.isfinite(measurements.distances)
        fixed = (far & (measurements.partners < 0))[:, None]
        begun = (far & (measurements.partners >= 0))[:, None]
        columns |= {DISTANCE_COLUMN: measurements.distances}
        columns |= {DISTANCE_SIGMA_COLUMN: np.where(far, measurements.sigmas[:, 0], np.nan)}
        columns |= {SIGMA_COLUMNS[0]: np.where(far, np.inf, measurements.sigmas[:, 0])}
        columns |= zip(ORIGIN_COLUMNS, np.where(fixed, measurements.origins, np.nan).T, strict=True)
        starts = np.where(begun, measurements.commands[measurements.partners], np.nan)
        columns |= zip(_start_columns(robot), starts.T, strict=True)
    return _columns_as_text(columns | measurements.conditions)


def _columns_as_text(columns: Mapping[str, Array]) -> str:
    """Return columns of numbers as CSV, every digit kept.

    Args:
        columns: by name, shape=(n,) each.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    rows = np.column_stack(list(columns.values())).tolist()
    writer.writerows(["" if number != number else repr(number) for number in row] for row in rows)
    return text.getvalue()


def write_measurements(measurements: Measurements, robot: Robot, path: Path | str) -> Path:
    """Write measurements as CSV, whole or not at all.

    Args:
        measurements: what to write.
        robot: the robot, for the names of the columns.
        path: file to write.

    Raises:
        OutputError: the file cannot be written.
    """
    return write_text_atomically(path, _measurements_as_text(measurements, robot))


def write_plan(poses: Poses, path: Path | str, loads: Mapping[str, Array] | None = None) -> Path:
    """Write a plan of measurements as CSV, every digit kept: commands to drive to, and where the tool should then be.

    The nominal pose is that of the robot as described; its columns are no measurement, and named so.

    Args:
        poses: poses of the robot as described.
        path: file to write.
        loads: loads to measure under, by the name of their column, shape=(n,) each.

    Raises:
        OutputError: the file cannot be written; nothing is left of it.
    """
    columns: dict[str, Array] = dict(zip(command_columns(poses.robot), poses.commands.T, strict=True))
    seen = np.concatenate([poses.positions, quaternion(poses.rotations)], axis=1)
    columns |= dict(zip(NOMINAL_COLUMNS, seen.T, strict=True)) | dict(loads or {})
    return write_text_atomically(path, _columns_as_text(columns))


def read_measurements(
    path: Path | str,
    robot: Robot,
    instrument: Instrument | None = None,
    *,
    own_frame: bool = False,
    target_sigma: float = 0.0,
    tool_point_sigma: float = 0.0,
) -> Measurements:
    """Read and check a CSV file of measurements.

    Columns: the commands (`u1_m,u2_m,u3_m`, or `u1_rad` for a drive that turns), `x_m,y_m,z_m`, and for full poses
    `qw,qx,qy,qz`. Optional: `px_m,py_m,pz_m`, the point seen, in the tool's axes; `sigma_x_m ... sigma_rz_rad`;
    `temperature_*_K`, `load_*`; `time_s`, by which drift is told; `approach_u1` ..., the direction (1, -1, 0 for
    unknown) from which each drive came: with times alone, that from the pose before. Rows with missing numbers are left
    out with a warning that names them.

    Example:
        Measurements of a simulated machine, written and read:

        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.measuring.measurement_file import write_measurements
        >>> machine = pm.SimulatedMachine(pm.load("pm3dof"))
        >>> commands = [[0.24, 0.24, 0.24], [0.25, 0.24, 0.23]]
        >>> seen = machine.measure(commands, np.random.default_rng(0))
        >>> path = write_measurements(pm.Measurements.of_poses(np.array(commands), seen), machine.nominal, "seen.csv")
        >>> len(pm.read_measurements(path, machine.nominal))
        2

    Args:
        path: the file.
        robot: the robot as described.
        instrument: its noise is taken where the file has no sigmas.
        own_frame: whether the instrument measured in a frame of its own, from which the base has to be found first; see
            :mod:`pm3dof_pin.measuring.registration`.
        target_sigma: how well the points seen are known, standard deviation of each coordinate [m]; 0 for exactly.
        tool_point_sigma: likewise the tool point, where that is what was seen [m].

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is no number, a quaternion is no rotation,
            numbers are most likely in another unit, or no row is left.
        InvalidValueError: the base cannot be found: positions alone, on one line.
    """
    read = _Reader(Path(path), robot).measurements(instrument or Instrument(), own_frame)
    return replace(read, target_sigma=target_sigma, tool_point_sigma=tool_point_sigma)


def read_commands(path: Path | str, robot: Robot) -> Array:
    """Read the commands of a CSV file, such as a plan of measurements; its other columns are ignored.

    Args:
        path: the file, with the columns `u1_m,u2_m,u3_m` or what the robot's drives need.
        robot: the robot.

    Returns:
        shape=(n, number of commands) [m, rad].

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is no number, or no row is left.
    """
    return _Reader(Path(path), robot, commands_only=True).commands()


def read_plan(path: Path | str, robot: Robot) -> tuple[Array, dict[str, Array]]:
    """Read a plan of measurements: the commands, and the temperatures and loads at which to measure if there are such.

    Args:
        path: the file.
        robot: the robot.

    Returns:
        Commands, shape=(n, number of commands) [m, rad]; conditions by the name of their column, shape=(n,) each.

    Raises:
        MeasurementError: see :func:`read_commands`; or a temperature or load is missing in a row.
    """
    reader = _Reader(Path(path), robot, commands_only=True)
    return reader.commands(), reader.conditions()


class _Reader:
    """One file on its way to Measurements."""

    def __init__(self, path: Path, robot: Robot, *, commands_only: bool = False) -> None:
        self._path, self._robot = path, robot
        self._own = command_columns(robot)
        self._commands_only = commands_only
        self._warnings: list[str] = []
        self._lines, self._table = self._numbers()
        self._leave_out_incomplete_rows()

    def commands(self) -> Array:
        commands = self._columns(self._own)
        self._check_commands(commands)
        return commands

    def conditions(self) -> dict[str, Array]:
        found = {name: values for name, values in self._table.items() if name.startswith(_CONDITIONS)}
        for name, values in found.items():
            if not np.isfinite(values).all():
                raise MeasurementError(self._path, f"{name} is missing", self._lines_where(~np.isfinite(values)))
        return found

    def measurements(self, instrument: Instrument, own_frame: bool) -> Measurements:
        table = self._table
        self._warn_of_copies()
        commands = self.commands()
        rotations = self._rotations()
        points = self._columns(POINT_COLUMNS) if POINT_COLUMNS[0] in table else np.zeros((len(commands), 3))
        sigmas = self._sigmas(instrument, rotations is not None)
        nominal = self._nominal_poses(commands)
        expected = nominal.positions + np.einsum("nij,nj->ni", nominal.rotations, points)
        seen = self._seen[:, : sigmas.shape[1]]
        # what was not measured is where the machine is by its description, and has no weight
        positions = np.column_stack(
            [np.where(seen[:, k], table.get(name, 0.0), expected[:, k]) for k, name in enumerate(POSITION_COLUMNS)]
        )
        if rotations is not None:
            seen_at_all = np.asarray(seen[:, 3:].any(axis=1))
            rotations = np.where(seen_at_all[:, None, None], rotations, nominal.rotations)
        sigmas = np.where(seen, sigmas, np.inf)
        registration = None
        if own_frame and not self._seen[:, : sigmas.shape[1]].all():
            raise MeasurementError(self._path, "an instrument with its own frame has to see positions or whole poses")
        if own_frame:
            self._check_extent(expected, positions)
            registration = register(positions, expected, rotations, nominal.rotations)
            positions, sigmas = registration.positions(positions), registration.sigmas(sigmas)
            rotations = None if rotations is None else registration.rotations(rotations)
        self._check_positions(expected, positions)
        if rotations is not None:
            self._check_rotations(nominal, rotations)
        conditions = self.conditions()
        found = Measurements(
            commands,
            positions,
            rotations,
            sigmas,
            points,
            conditions,
            tuple(self._lines),
            tuple(self._warnings),
            registration,
            times=self._table.get(_TIME_COLUMN),
            approaches=self._approaches(commands),
        )
        return self._with_distances(found, instrument) if self._seen[:, 6].any() else found

    def _with_distances(self, found: Measurements, instrument: Instrument) -> Measurements:
        """Return measurements with their distances; poses at which some begin are rows where nothing was seen."""
        count, table, far = len(found), self._table, self._seen[:, 6]
        both = far & self._seen[:, :6].any(axis=1)
        if both.any():
            problem = f"a row has {DISTANCE_COLUMN} and other measurements, expected a row for each"
            raise MeasurementError(self._path, problem, self._lines_where(both))
        nothing = np.full((count, 3), np.nan)
        origins = self._columns(ORIGIN_COLUMNS) if ORIGIN_COLUMNS[0] in table else nothing
        columns = _start_columns(self._robot)
        starts = self._columns(columns) if columns[0] in table else np.full(found.commands.shape, np.nan)
        fixed, begun = (np.isfinite(values).all(axis=1) for values in (origins, starts))
        unclear = far & (fixed == begun)
        if unclear.any():
            problem = f"from where is {DISTANCE_COLUMN}? Expected {','.join(ORIGIN_COLUMNS)} or {','.join(columns)}"
            raise MeasurementError(self._path, problem, self._lines_where(unclear))
        sigmas = found.sigmas.copy()
        given = table.get(DISTANCE_SIGMA_COLUMN, np.full(count, instrument.position_sigma))
        sigmas[far] = np.inf
        sigmas[far, 0] = given[far]
        if not (given[far] > 0.0).all():
            raise MeasurementError(self._path, f"{DISTANCE_SIGMA_COLUMN} is not positive", self._lines_where(far))
        begins = np.flatnonzero(far & begun)
        rows = np.concatenate([np.arange(count), begins])
        whole = replace(found, sigmas=sigmas)[rows]
        partners = np.full(len(rows), -1)
        partners[begins] = count + np.arange(len(begins))
        commands, unseen = whole.commands.copy(), whole.sigmas.copy()
        commands[count:] = starts[begins]
        unseen[count:] = np.inf
        distances = np.where(far, table[DISTANCE_COLUMN], np.nan)
        return replace(
            whole,
            commands=commands,
            sigmas=unseen,
            distances=np.concatenate([distances, np.full(len(begins), np.nan)]),
            origins=np.nan_to_num(origins[rows]),
            partners=partners,
        )

    def _approaches(self, commands: Array) -> Array | None:
        names = _approach_columns(self._robot)
        if names[0] in self._table:
            approaches = self._columns(names)
            wrong = ~np.isin(approaches, (-1.0, 0.0, 1.0)).all(axis=1)
            if wrong.any():
                problem = f"{','.join(names)} are directions: expected 1, -1, or 0 for unknown"
                raise MeasurementError(self._path, problem, self._lines_where(wrong))
            return approaches
        if _TIME_COLUMN not in self._table:
            return None
        order = np.argsort(self._table[_TIME_COLUMN], kind="stable")
        approaches, last = np.zeros_like(commands), np.zeros(commands.shape[1])
        for before, row in itertools.pairwise(order):
            moved = commands[row] - commands[before]
            last = np.where(np.abs(moved) > _SAME, np.sign(moved), last)
            approaches[row] = last
        return approaches

    def _numbers(self) -> tuple[list[int], dict[str, Array]]:
        """Return the lines of the rows and the columns by name; an empty cell is NaN."""
        try:
            text = read_text(self._path)
        except DescriptionError as error:
            raise MeasurementError(self._path, error.expected) from error
        reader = csv.reader(io.StringIO(text, newline=""))
        try:
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
        except csv.Error as error:
            raise MeasurementError(self._path, f"expected CSV ({error})", [reader.line_num]) from error
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
            measured = self._measured_columns(header)
            wanted += measured
            positions = tuple(f"sigma_{name}" for name in POSITION_COLUMNS if name in measured)
            optional: tuple[tuple[str, ...], ...] = (
                ORIGIN_COLUMNS,
                _start_columns(self._robot),
                (DISTANCE_SIGMA_COLUMN,),
            )
            optional += (QUATERNION_COLUMNS, POINT_COLUMNS, positions, SIGMA_COLUMNS[3:], (_TIME_COLUMN,))
            for group in (*optional, _approach_columns(self._robot)):
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

    def _measured_columns(self, header: Sequence[str]) -> tuple[str, ...]:
        """Return which columns of what was measured the file has to have: of positions alone, some will do."""
        positions = tuple(name for name in POSITION_COLUMNS if name in header)
        if DISTANCE_COLUMN in header:
            return (*positions, DISTANCE_COLUMN)
        used = {
            *self._own,
            *positions,
            *POINT_COLUMNS,
            *SIGMA_COLUMNS[:3],
            _TIME_COLUMN,
            *_approach_columns(self._robot),
        }
        alone = positions and all(name in used or name.startswith(_CONDITIONS) for name in header)
        return positions if alone else POSITION_COLUMNS

    def _settle_what_was_measured(self) -> None:
        """Make whole columns of what was measured, and say which of it was: the flags of x, y, z, angles, distance.

        Not measured is a coordinate without a column or with an infinite sigma, and a position, an orientation or a
        distance of which every cell of a row is empty.
        """
        count = len(self._lines)
        groups = (POSITION_COLUMNS, QUATERNION_COLUMNS, (DISTANCE_COLUMN,))
        infinite = np.column_stack([np.isposinf(self._table.get(name, np.zeros(count))) for name in SIGMA_COLUMNS])
        self._seen = np.zeros((count, 7), dtype=bool)
        self._broken = np.zeros(count, dtype=bool)
        for group, places in zip(groups, ((0, 1, 2), (3, 4, 5), (6,)), strict=True):
            present = [name for name in group if name in self._table]
            if not present:
                continue
            cells = self._columns(present)
            there: Mask = np.asarray(~np.isnan(cells).all(axis=1))
            if group is POSITION_COLUMNS:
                for name, place in zip(group, places, strict=True):
                    column = self._table.get(name)
                    needed = there & ~infinite[:, place]
                    if column is not None:
                        self._broken |= needed & ~np.isfinite(column)
                        self._seen[:, place] = needed
            elif group is QUATERNION_COLUMNS:
                self._broken |= there & ~np.isfinite(cells).all(axis=1)
                self._seen[:, 3:6] = there[:, None] & ~infinite[:, 3:]
                self._table |= dict(zip(group, np.where(there[:, None], cells, [1.0, 0.0, 0.0, 0.0]).T, strict=True))
            else:
                self._broken |= there & ~np.isfinite(cells).all(axis=1)
                self._seen[:, 6] = there
        self._broken |= ~self._seen.any(axis=1)

    def _leave_out_incomplete_rows(self) -> None:
        read = self._own if self._commands_only else [name for name in self._table if name not in self._may_be_empty()]
        whole = np.isfinite(self._columns(read)).all(axis=1)
        if not self._commands_only:
            self._settle_what_was_measured()
            whole &= ~self._broken
            self._seen = self._seen[whole]
        if not whole.all():
            self._warn("numbers are missing or not finite; left out", self._lines_where(~whole))
        if not whole.any():
            raise MeasurementError(self._path, "no complete row of numbers, expected one for each pose")
        self._table = {name: values[whole] for name, values in self._table.items()}
        self._lines = self._lines_where(whole)

    def _may_be_empty(self) -> set[str]:
        measured = {*POSITION_COLUMNS, *QUATERNION_COLUMNS, *SIGMA_COLUMNS, DISTANCE_COLUMN, DISTANCE_SIGMA_COLUMN}
        return measured | {*ORIGIN_COLUMNS, *_start_columns(self._robot)}

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
        robot = self._robot
        lower, upper = np.array([robot.range_of(command) for command in robot.command_coordinates]).T
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
            return self._robot.forward(commands)
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
                "other axes, another zero of the commands or another tool point? --own-frame finds the base of an "
                "instrument with a frame of its own"
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
        scalar_last = rotation_of_quaternion(np.roll(self._columns(QUATERNION_COLUMNS), 1, axis=1))
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
            "other axes of the base or of the tool? --own-frame finds the base of an instrument with a frame of its own"
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
        return rotation_of_quaternion(quaternions)

    def _sigmas(self, instrument: Instrument, poses: bool) -> Array:
        count = 6 if poses else 3
        names = SIGMA_COLUMNS[:count]
        usual = np.repeat([instrument.position_sigma, instrument.angle_sigma], 3)
        sigmas = np.tile(usual[:count], (len(self._lines), 1))
        for k, name in enumerate(names):
            if name in self._table:
                sigmas[:, k] = self._table[name]
        sigmas = np.where(np.isnan(sigmas), usual[:count], sigmas)
        bad = ~(sigmas > 0.0).all(axis=1)
        if bad.any():
            lines = self._lines_where(bad)
            raise MeasurementError(self._path, "a sigma is not positive", lines)
        for k, name in enumerate(names):
            unit = name.rsplit("_", 1)[1]
            finite = sigmas[np.isfinite(sigmas[:, k]), k]
            if finite.size and np.median(finite) > _LARGE_SIGMA[unit]:
                other = "millimetres" if unit == "m" else "degrees"
                self._warn(f"{name} is {np.median(finite):.3g} {unit} (median), a great deal: {other}?")
        return sigmas

    def _lines_where(self, flags: Any) -> list[int]:
        return [self._lines[row] for row in np.flatnonzero(flags)]

    def _columns(self, names: Sequence[str]) -> Array:
        return np.column_stack([self._table[name] for name in names])

    def _warn(self, text: str, lines: Sequence[int] = ()) -> None:
        self._warnings.append(f"{lines_in_words(lines)}{text}")
        logger.warning("%s: %s", self._path, self._warnings[-1])
