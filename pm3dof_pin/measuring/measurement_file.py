"""Files of measurements: reading them with checks, and writing them."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pm3dof_pin.csv_table import csv_of_columns, is_condition
from pm3dof_pin.errors.pose_error import quaternion, rotation_of_quaternion, rotation_vector
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.pose_file import PLACEMENT, UNIT_QUATERNION
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.angles import (
    angle_columns,
    orders_of,
    other_orders,
    quaternions_of_angles,
    replace_angles,
)
from pm3dof_pin.measuring.datum import Datum, DatumKind
from pm3dof_pin.measuring.export_file import ColumnMap
from pm3dof_pin.measuring.instrument import ENCODER_ZERO, Instrument
from pm3dof_pin.measuring.instruments.table import datum_kinds
from pm3dof_pin.measuring.joint_columns import (
    ENCODER,
    approach_columns,
    checked_commands,
    command_columns,
    commands_table,
    encoder_column,
    start_columns,
)
from pm3dof_pin.measuring.measurements import Measurements, joint_coordinates
from pm3dof_pin.measuring.registration import AT_THE_BASE, Registration, register
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Indices, Mask

TARGET_POINT_SIGMA = 1e-3
"""Default prior standard deviation of a file's target positions, per coordinate [m]."""

_POSITION, _QUATERNION = PLACEMENT[:3], PLACEMENT[3:]
_POINT = ("px_m", "py_m", "pz_m")
_SIGMAS = ("sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad")
_DISTANCE, _DISTANCE_SIGMA = "distance_m", "sigma_distance_m"
_ORIGIN = ("cx_m", "cy_m", "cz_m")
_TIME, _STATION, _HOMING = "time_s", "station", "homing"

_LARGE_SIGMA = {"m": 1e-3, "rad": 1e-2}
_MIN_SIGMA = 1e-12  # [m, rad]
_FAR_LESS = 1e-3  # relative to the other sigmas of a column: such a row would outweigh all others
_FAR_OFF = 0.05  # of the distance from the base to the tool: more than any tolerance explains
_FAR_POINTS = 30.0  # times the machine's size
_CLEARLY = 3.0  # times nearer than other orders of angles
_TURNED = 0.1  # [rad]: more than any tolerance explains
_THOUSANDFOLD = 300.0
_FAR_READING = 6.0  # times the standard deviation of an encoder's zero
_OWN_FRAME = "use --own-frame for an instrument with its own frame"


def write_measurements(measurements: Measurements, robot: Robot, path: Path | str) -> Path:
    """Write measurements as CSV, atomically and at full precision; raise OutputError on failure."""
    columns: dict[str, Array] = dict(zip(command_columns(robot), measurements.commands.T, strict=True))
    columns |= zip(_POSITION, measurements.positions.T, strict=True)
    if measurements.rotations is not None:
        columns |= zip(_QUATERNION, quaternion(measurements.rotations).T, strict=True)
    if measurements.points.any():
        columns |= zip(_POINT, measurements.points.T, strict=True)
    columns |= zip(_SIGMAS, measurements.sigmas.T[: measurements.tool_columns], strict=False)
    for k, joint in enumerate(measurements.joints):
        name, sigmas = encoder_column(robot, joint), measurements.sigmas[:, measurements.tool_columns + k]
        assert measurements.readings is not None
        columns |= {name: np.where(np.isfinite(sigmas), measurements.readings[:, k], np.nan), f"sigma_{name}": sigmas}
    if measurements.distances is not None and measurements.origins is not None and measurements.partners is not None:
        far = np.isfinite(measurements.distances)
        fixed = (far & (measurements.partners < 0))[:, None]
        begun = (far & (measurements.partners >= 0))[:, None]
        columns |= {_DISTANCE: measurements.distances}
        columns |= {_DISTANCE_SIGMA: np.where(far, measurements.sigmas[:, 0], np.nan)}
        columns |= {_SIGMAS[0]: np.where(far, np.inf, measurements.sigmas[:, 0])}
        columns |= zip(_ORIGIN, np.where(fixed, measurements.origins, np.nan).T, strict=True)
        starts = np.where(begun, measurements.commands[measurements.partners], np.nan)
        columns |= zip(start_columns(robot), starts.T, strict=True)
    columns |= _datum_columns(measurements, columns)
    if measurements.times is not None:
        columns |= {_TIME: measurements.times}
    for name, numbers in {_STATION: measurements.stations, _HOMING: measurements.homings}.items():
        if numbers is not None:
            columns |= {name: np.where(numbers > 0, numbers, np.nan)}
    if measurements.approaches is not None:
        columns |= zip(approach_columns(len(robot.commands)), measurements.approaches.T, strict=True)
    return write_text_atomically(path, csv_of_columns(columns | measurements.conditions))


def _datum_columns(measurements: Measurements, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns of rows measured against datums, in which the tool's own columns are not measured."""
    found: dict[str, Array] = {}
    if not measurements.datums:
        return found
    on, nothing = measurements.on_datums, np.full(len(measurements), np.nan)
    found |= {name: np.where(on, np.inf, columns[name]) for name in _SIGMAS[:3]}
    for datum in measurements.datums:
        kind, sigmas = datum.kind, measurements.sigmas[:, 0] / datum.scales
        cells = [np.full(len(on), float(datum.number)), *kind.written(datum.numbers).T, sigmas]
        for name, cell in zip((kind.name, *kind.columns, kind.sigma_column), cells, strict=True):
            found[name] = np.where(datum.rows, cell, found.get(name, columns.get(name, nothing)))
    return found


def read_measurements(
    path: Path | str,
    robot: Robot,
    instrument: Instrument | None = None,
    *,
    own_frame: bool = False,
    target_sigma: float = TARGET_POINT_SIGMA,
    tool_point_sigma: float = 0.0,
    columns: ColumnMap | Path | str | None = None,
) -> Measurements:
    """Read and check a CSV file of measurements.

    Columns: the commands (`u1_m,u2_m,u3_m`, or `u1_rad` for a rotary drive, or named after the drives, `slider1_m`),
    `x_m,y_m,z_m`, and for full poses `qw,qx,qy,qz`. Optional: `px_m,py_m,pz_m`, the point seen, in tool axes;
    `sigma_x_m ... sigma_rz_rad`;
    `temperature_*_K`, `load_*`; `time_s`, to identify drift; `approach_u1` ..., the direction (1, -1, 0 for unknown)
    from which each drive came, by default inferred from the order in time; `encoder_<joint>_rad` or `_m`, readings of
    passive joints, and `sigma_encoder_...`. Columns may be in mm, um, deg, mrad or urad if their names say so (`x_mm`,
    `u1_deg`). Rows with missing numbers are left out with a warning that names them. Exports of instruments are
    understood as :mod:`pm3dof_pin.measuring.export_file` says.

    Example:
        Measurements of a simulated machine, written and read:

        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.measuring.measurement_file import write_measurements
        >>> machine = pm.SimulatedMachine(pm.load("pm3dof"))
        >>> commands = [[0.24, 0.24, 0.24], [0.25, 0.24, 0.23]]
        >>> seen = machine.measure(commands, np.random.default_rng(0))
        >>> path = write_measurements(pm.Measurements.from_poses(np.array(commands), seen), machine.nominal, "seen.csv")
        >>> len(pm.read_measurements(path, machine.nominal))
        2

    Args:
        path: the file.
        robot: the robot as described.
        instrument: its noise is used if the file has no sigmas.
        own_frame: whether the instrument measured in its own frame, in which the base must be located first; see
            :mod:`pm3dof_pin.measuring.registration`. With single coordinates, its axes must be near those of the base.
        target_sigma: prior standard deviation of the points seen, per coordinate [m]; 0 if known exactly.
        tool_point_sigma: the same for the tool point, if that is the point seen [m].
        columns: what the file does not say of itself: a column map, the YAML file of one, or the name of a profile.

    Raises:
        DescriptionError: the column map cannot be read.
        MeasurementError: the file is unreadable, a column is missing, a cell is not a number, a quaternion is not a
            rotation, numbers are probably in another unit, or no row is left.
        InvalidValueError: the base cannot be located: positions only, on one line.
    """
    given = ColumnMap.load(columns) if isinstance(columns, (str, Path)) else columns
    read = _Reader(Path(path), robot, given, own_frame=own_frame).measurements(instrument or Instrument())
    return replace(read, target_sigma=target_sigma, tool_point_sigma=tool_point_sigma)


class _Reader:
    """Reader of one file."""

    def __init__(self, path: Path, robot: Robot, columns: ColumnMap | None, *, own_frame: bool) -> None:
        self._robot, self._own_frame, self._unused = robot, own_frame, set[str]()
        self._command_columns, self._start_columns = command_columns(robot), start_columns(robot)
        self._kinds = tuple(datum_kinds().values())
        self._table = commands_table(path, robot, columns)
        if columns is not None and columns.angles:
            replace_angles(self._table, columns.angles)
        self._refuse_unknown_angles(own_frame)
        self._joints = self._encoder_joints()
        self._encoders = [encoder_column(robot, joint) for joint in self._joints]
        self._check_header()
        self._seen, whole = self._flags_of_measured()
        distances = (_DISTANCE, _DISTANCE_SIGMA, *_ORIGIN, *self._start_columns)
        datums = [name for kind in self._kinds for name in (kind.name, *kind.columns, kind.sigma_column)]
        encoders = (f"{sigma}{name}" for sigma in ("", "sigma_") for name in self._encoders)
        numbers = (_STATION, _HOMING)
        may_be_empty = {*numbers, *_POSITION, *_QUATERNION, *_SIGMAS, *distances, *datums, *encoders, *self._unused}
        needed = [name for name in self._table.columns if name not in may_be_empty]
        whole &= np.isfinite(self._table.matrix(needed)).all(axis=1)
        self._table.keep(whole)
        for name in (each for each in self._table.columns if each.startswith("sigma_")):
            if (negative := self._table[name] < 0.0).any():
                self._refuse(f"{name} is not positive", negative)
        self._seen, self._on_datum = self._seen[whole], np.any(self._flags_of_datums(), axis=0)

    def measurements(self, instrument: Instrument) -> Measurements:
        own_frame, table = self._own_frame, self._table
        points = table.matrix(_POINT, missing=0.0)
        self._warn_of_copies(points)
        commands = checked_commands(table, self._robot)
        rotations = self._rotations()
        size, off = self._robot.characteristic_length, np.median(np.linalg.norm(points, axis=1))
        if off > _FAR_POINTS * size:
            self._refuse(f"{','.join(_POINT)} are {off:.3g} m (median) from the tool point: millimetres?")
        sigmas = self._sigmas(instrument, rotations is not None)
        nominal = self._nominal_poses(commands)
        expected = nominal.positions + np.einsum("nij,nj->ni", nominal.rotations, points)
        seen = self._seen[:, : sigmas.shape[1]]
        # coordinates that were not measured take the description's values, with zero weight
        positions = np.column_stack(
            [np.where(seen[:, k], table.get(name, 0.0), expected[:, k]) for k, name in enumerate(_POSITION)]
        )
        if rotations is not None:
            rotations = np.where(np.any(seen[:, 3:], axis=1)[:, None, None], rotations, nominal.rotations)
        sigmas = np.where(seen, sigmas, np.inf)
        stations, registration = self._stations(), None
        places = np.unique(stations) if stations is not None else np.zeros(1)
        for number in places:
            if number == 0 and not own_frame:
                continue
            own = np.ones(len(table), dtype=bool) if stations is None else stations == number
            found_at = self._registration(expected, positions, nominal, rotations, own)
            registration = found_at if number == 0 else registration
            if found_at is None:
                continue
            # rows without positions or orientations already have those of the description
            placed, turned = (own & np.isfinite(part).all(axis=1) for part in (sigmas[:, :3], sigmas[:, 3:]))
            positions[placed] = found_at.positions(positions[placed])
            sigmas[placed, :3] = found_at.sigmas(sigmas[placed, :3])
            if rotations is not None:
                rotations[turned] = found_at.rotations(rotations[turned])
                sigmas[turned, 3:] = found_at.sigmas(sigmas[turned, 3:])
        placed_well = self._check_positions(expected, positions)
        if rotations is not None:
            self._check_rotations(nominal, rotations, refuse=placed_well)
        found = Measurements(
            commands,
            positions,
            rotations,
            sigmas,
            points,
            table.conditions(),
            tuple(table.lines),
            tuple(table.warnings),
            registration,
            times=table.columns.get(_TIME),
            stations=stations,
            homings=self._numbers(_HOMING, "homings"),
            approaches=self._approaches(commands),
        )
        if self._joints:
            found = found.with_encoders(self._joints, *self._readings(nominal, instrument))
        if self._on_datum.any():
            found = self._with_datums(found, expected, instrument)
        return self._with_distances(found, expected, instrument) if self._seen[:, 6].any() else found

    def _refuse(self, problem: str, flags: Any = None) -> NoReturn:
        raise MeasurementError(self._table.path, problem, () if flags is None else self._table.lines_where(flags))

    def _refuse_unknown_angles(self, own_frame: bool) -> None:
        """Refuse angles of unknown order, if there are any, naming the orders nearest to the described orientations."""
        if not (names := angle_columns(self._table)):
            return
        commands, angles = self._table.matrix(self._command_columns), self._table.matrix(names)
        usable = np.isfinite(commands).all(axis=1) & np.isfinite(angles).all(axis=1)
        poses, turned = self._robot.forward(commands[usable], on_failure="nan"), {}
        for order in orders_of(names) if poses.solved.any() and not own_frame else ():
            seen = rotation_of_quaternion(quaternions_of_angles(angles[usable], order, names))[poses.solved]
            off = np.swapaxes(poses.rotations[poses.solved], 1, 2) @ seen
            turned[order] = float(np.median(np.linalg.norm(rotation_vector(off), axis=1)))
        best = [order for order, off in turned.items() if off < 1.01 * min(turned.values()) and off < _TURNED]
        others = [off for order, off in turned.items() if order not in best]
        clear = best and others and _CLEARLY * turned[best[0]] < min(others)
        near = " or ".join(f"`{order}`" for order in best)
        said = f"; {near} is nearest to the described orientations" if clear else ""
        problem = f"{','.join(names)} are angles of unknown order: expected `angles:` in --columns{said}"
        raise MeasurementError(self._table.path, problem, [self._table.header_line])

    def _encoder_joints(self) -> dict[str, str]:
        """Return the joints with readings, and their units, in the order of the columns."""
        robot, header, columns = self._robot, self._table.header, {}
        for joint in robot.passive_joints:
            with contextlib.suppress(InvalidValueError):  # several degrees of freedom
                columns[encoder_column(robot, joint)] = joint
        self._passive = tuple(columns.values())
        names = [name for name in header if name.removeprefix("sigma_").startswith(ENCODER)]
        if wrong := [name for name in names if name.removeprefix("sigma_") not in columns]:
            expected = ", ".join(columns) or f"none: {robot.name} has no passive joint"
            self._refuse(f"line 1: {', '.join(wrong)}: expected columns of passive joints, {expected}")
        return {columns[name]: robot.single_joint(columns[name]).unit for name in names if name in columns}

    def _check_header(self) -> None:
        """Require the columns that belong together, and warn of others.

        Some positions alone, or orientations alone, are enough if no other column could hold the rest.
        """
        header, approaches = self._table.header, approach_columns(len(self._robot.commands))
        positions = tuple(name for name in _POSITION if name in header)
        beside = (*_POINT, *_SIGMAS[:3]) if positions else (*_QUATERNION, *_SIGMAS[3:])
        known = {*self._command_columns, *positions, *beside, _TIME, *approaches}
        alone = all(name in known or is_condition(name) for name in header)
        if not (
            {_DISTANCE, *(kind.name for kind in self._kinds)} & {*header}
            or self._encoders
            or (alone and (positions or _QUATERNION[0] in header))
        ):
            positions = _POSITION
        expected = [*self._command_columns, *positions]
        for group in (
            (_DISTANCE,),
            (_DISTANCE_SIGMA,),
            *((name,) for kind in self._kinds for name in (kind.name, kind.sigma_column)),
            *((name,) for kind in self._kinds for name in kind.columns if name != _DISTANCE),
            (_TIME,),
            (_STATION,),
            (_HOMING,),
            _ORIGIN,
            _QUATERNION,
            _POINT,
            self._start_columns,
            tuple(f"sigma_{name}" for name in positions),
            _SIGMAS[3:],
            approaches,
            *((f"{sigma}{encoder}",) for encoder in self._encoders for sigma in ("", "sigma_")),
        ):
            if set(group) & set(header):
                expected += group
        expected += [name for kind in self._kinds if kind.needed and kind.name in header for name in kind.columns]
        self._table.require(list(dict.fromkeys(expected)))
        unknown = [name for name in header if name not in expected and not is_condition(name)]
        self._unused = {*unknown}
        if unknown:
            self._table.warn(f"columns {', '.join(unknown)} are not used")

    def _flags_of_measured(self) -> tuple[Mask, Mask]:
        """Complete the measured columns, and return flags of what was measured: x, y, z, angles, distance, encoders.

        A coordinate was not measured if it has no column or an infinite sigma; a position, orientation or distance was
        not measured in a row in which all its cells are empty.

        Returns:
            The flags, shape=(n, 7 + encoders); and whether a row has any measurement, and no incomplete one.
        """
        table = self._table
        seen = np.zeros((len(table), 7 + len(self._encoders)), dtype=bool)
        broken = np.zeros(len(table), dtype=bool)
        infinite = np.column_stack([np.isposinf(table.get(name, 0.0)) for name in _SIGMAS])
        if present := [name for name in _POSITION if name in table]:
            given = np.asarray(~np.isnan(table.matrix(present)).all(axis=1))
            for name in present:
                place = _POSITION.index(name)
                seen[:, place] = given & ~infinite[:, place]
                broken |= seen[:, place] & ~np.isfinite(table[name])
        if _QUATERNION[0] in table:
            cells = table.matrix(_QUATERNION)
            given = np.asarray(~np.isnan(cells).all(axis=1))
            broken |= given & ~np.isfinite(cells).all(axis=1)
            seen[:, 3:6] = given[:, None] & ~infinite[:, 3:]
            table.columns |= zip(_QUATERNION, np.where(given[:, None], cells, [1.0, 0.0, 0.0, 0.0]).T, strict=True)
        for place, name in enumerate([_DISTANCE, *self._encoders], start=6):
            if name in table:
                seen[:, place] = ~np.isnan(table[name]) & ~np.isposinf(table.get(f"sigma_{name}", 0.0))
                broken |= seen[:, place] & ~np.isfinite(table[name])
        datums = np.any(self._flags_of_datums(), axis=0)
        for kind in self._kinds:
            if _DISTANCE in kind.columns:
                seen[:, 6] &= ~np.isfinite(table.get(kind.name, np.nan))
        return seen, (seen.any(axis=1) | datums) & ~broken

    def _flags_of_datums(self) -> Mask:
        """Tell which rows are measured against a datum of each kind, shape=(kinds, n)."""
        table, flags = self._table, []
        for kind in self._kinds:
            missing = np.isposinf(table.get(kind.sigma_column, 0.0))
            if kind.needed and kind.name in table:
                missing = missing | np.isnan(table.matrix(kind.columns, missing=np.nan)).all(axis=1)
            flags.append(np.isfinite(table.get(kind.name, np.nan)) & ~missing)
        return np.array(flags)

    def _warn_of_copies(self, points: Array) -> None:
        """Warn of rows that repeat others, entirely or in everything measured at other commands."""
        table = self._table
        rows = table.matrix(list(table.columns))
        first: dict[bytes, int] = {}
        copies = [n for n, row in zip(table.lines, rows, strict=True) if first.setdefault(row.tobytes(), n) != n]
        if copies:
            table.warn("copies of earlier lines; each copy counts", copies)
        against = table.matrix([kind.name for kind in self._kinds if kind.name in table])
        places = np.hstack([table.matrix(self._command_columns), points, self._seen, np.nan_to_num(against)])
        if {*_POSITION} <= {*table.columns}:
            measured = table.matrix([name for name in (*_POSITION, *_QUATERNION) if name in table])
            _, origin, again = np.unique(np.round(measured / SAME), axis=0, return_index=True, return_inverse=True)
            elsewhere = np.any(places != places[origin[again.reshape(-1)]], axis=1)
            if elsewhere.any():
                problem = "measurements repeat those of other lines to the last digit, at other commands"
                table.warn(f"{problem}: stale or copied?", table.lines_where(elsewhere))
        distinct = len(np.unique(np.round(places / SAME), axis=0))
        if distinct < len(rows) - len(copies):
            table.warn(f"{len(rows)} rows at {distinct} different commands: the others repeat one")

    def _rotations(self) -> Array | None:
        if _QUATERNION[0] not in self._table:
            return None
        quaternions = self._table.matrix(_QUATERNION)
        norms = np.linalg.norm(quaternions, axis=1)
        bad = np.abs(norms - 1.0) > UNIT_QUATERNION
        if bad.any():
            problem = f"is not a rotation: its length is {norms[bad][0]:.6g}, expected 1"
            self._refuse(f"{','.join(_QUATERNION)} {problem}", bad)
        return rotation_of_quaternion(quaternions)

    def _sigmas(self, instrument: Instrument, poses: bool) -> Array:
        count = 6 if poses else 3
        usual = np.repeat([instrument.position_sigma, instrument.angle_sigma], 3)[:count]
        sigmas = np.column_stack([self._table.get(name, usual[k]) for k, name in enumerate(_SIGMAS[:count])])
        sigmas = np.where(np.isnan(sigmas), usual, sigmas)
        bad = ~(sigmas > 0.0).all(axis=1)
        if bad.any():
            self._refuse("a sigma is not positive", bad)
        for name, column in zip(_SIGMAS, sigmas.T, strict=False):
            finite = column[np.isfinite(column)]
            middle, unit = float(np.median(finite)) if finite.size else 0.0, name.rsplit("_", 1)[1]
            tiny = column < max(_MIN_SIGMA, _FAR_LESS * middle)
            if tiny.any():
                problem = f"{name} is {column[tiny][0]:.3g} {unit}, nearly zero: no instrument is that accurate"
                self._refuse(problem, tiny)
            if middle > _LARGE_SIGMA[unit]:
                other = "millimetres" if unit == "m" else "degrees"
                self._table.warn(f"{name} is {middle:.3g} {unit} (median), which is very large: {other}?")
        return sigmas

    def _nominal_poses(self, commands: Array) -> Poses:
        poses = self._robot.forward(commands, on_failure="nan")
        if poses.solved.all():
            return poses
        problem = f"{self._robot.name} cannot reach these commands"
        # of several drives that could count the other way, the one that brings the tool nearest to its measured place
        mirrored = 2.0 * self._robot.home.commands - commands
        turned = {"all drives": mirrored}
        drives = np.eye(commands.shape[1], dtype=bool)
        turned |= {f"u{k + 1}": np.where(one, mirrored, commands) for k, one in enumerate(drives)}
        found = {name: self._robot.forward(other, on_failure="nan") for name, other in turned.items()}
        found = {name: other for name, other in found.items() if other.solved.all()}
        if found and {*_POSITION} <= {*self._table.columns}:
            seen = self._table.matrix(_POSITION)
            off = {name: np.nanmedian(np.linalg.norm(each.positions - seen, axis=1)) for name, each in found.items()}
            found = {(nearest := min(off, key=lambda name: off[name])): found[nearest]}
        if found:
            problem += f", but could if {' or '.join(found)} counted the other way"
        self._refuse(problem, ~poses.solved)

    def _stations(self) -> Indices | None:
        """Return the number of the place from which each row was seen, 0 for none, shape=(n,)."""
        stations = self._numbers(_STATION, "places")
        # in a frame of its own, that of the first station is the frame
        if stations is None or not self._own_frame:
            return stations
        return stations - stations.min() if np.ptp(stations) else None

    def _numbers(self, name: str, what: str) -> Indices | None:
        """Return the numbers in a column, 0 for empty cells, shape=(n,); None if all are 0."""
        numbers = np.nan_to_num(self._table.get(name, 0.0))
        if (bad := (numbers < 0.0) | (numbers != np.round(numbers))).any():
            self._refuse(f"{name} is a number of {what}, expected 1, 2 ...", bad)
        return numbers.astype(np.intp) if numbers.any() else None

    def _registration(
        self, expected: Array, positions: Array, nominal: Poses, rotations: Array | None, own: Mask
    ) -> Registration | None:
        """Locate the base in an instrument's frame by its own rows; None if all are distances, which have no frame."""
        count = 3 if rotations is None else 6
        seen = self._seen[:, :count] & own[:, None]
        whole, some = seen.all(axis=1), seen.any(axis=1)
        if not some.any():
            return None
        if (some & ~whole & ~seen[:, :3].all(axis=1)).any() or not whole.any():
            # single coordinates, such as heights above a bed, are along axes close to the base's
            return AT_THE_BASE
        spreads = [
            np.median(np.linalg.norm(points[whole] - np.median(points[whole], axis=0), axis=1))
            for points in (positions, expected)
        ]
        if spreads[0] > _THOUSANDFOLD * spreads[1]:
            problem = "look like millimetres: they spread a thousand times as far as the machine moves"
            self._refuse(f"{','.join(_POSITION)} {problem}")
        turned = (None, None) if rotations is None else (rotations[whole], nominal.rotations[whole])
        return register(positions[whole], expected[whole], *turned)

    def _check_positions(self, expected: Array, positions: Array) -> bool:
        """Refuse positions in millimetres, warn of those out of reach, and tell whether most are within it."""
        size = float(np.median(np.linalg.norm(expected, axis=1)))
        if np.median(np.linalg.norm(1e-3 * positions - expected, axis=1)) < _FAR_OFF * size:
            problem = "look like millimetres: a thousandth of them is where the machine is"
            self._refuse(f"{','.join(_POSITION)} {problem}")
        distances, size = np.linalg.norm(positions - expected, axis=1), max(size, self._robot.characteristic_length)
        far = distances > _FAR_OFF * size
        if far.mean() > 0.5:
            self._table.warn(
                f"positions are {np.median(distances):.3g} m (median) from where the description has the machine: "
                f"other axes, another zero of the commands or another tool point? {_OWN_FRAME}"
            )
        elif far.any():
            lines = self._table.lines_where(far)
            self._table.warn(f"positions are more than {_FAR_OFF * size:.2g} m from where the machine can be", lines)
        return bool(far.mean() <= 0.5)

    def _check_rotations(self, nominal: Poses, rotations: Array, *, refuse: bool) -> None:
        """Warn of orientations out of reach; if everything else fits, refuse another order of the quaternion."""

        def angles(seen: Array) -> Array:
            return np.asarray(np.linalg.norm(rotation_vector(np.swapaxes(nominal.rotations, 1, 2) @ seen), axis=1))

        turned = angles(rotations)
        middle = np.median(turned)
        if middle <= _TURNED:
            if (far := turned > _TURNED).any():
                problem = f"orientations are more than {_TURNED:g} rad from where the machine can be"
                self._table.warn(problem, self._table.lines_where(far))
            return
        inverse = "are inverse rotations, of the base in the tool's axes: expected those of the tool in the base"
        orders = other_orders(self._table.matrix(_QUATERNION))
        others = {f"are in the order {order}": seen for order, seen in orders.items()}
        others |= {inverse: np.swapaxes(rotations, 1, 2)}
        # where two are the same, the more usual one
        off = {problem: round(float(np.median(angles(seen))), 3) for problem, seen in others.items()}
        nearest = min(off, key=lambda problem: off[problem])
        if refuse and off[nearest] < min(_TURNED, 0.1 * middle):
            self._refuse(f"{','.join(_QUATERNION)} {nearest}")
        self._table.warn(
            f"orientations are {middle:.3g} rad (median) from where the description has the machine: other axes of the "
            f"base or of the tool? {_OWN_FRAME}"
        )

    def _readings(self, nominal: Poses, instrument: Instrument) -> tuple[Array, Array]:
        """Return encoder readings and their noise, infinite for empty cells, shape=(n, joints) each [m, rad]."""
        passive = dict(zip(self._passive, joint_coordinates(nominal.robot, nominal.q, self._passive).T, strict=True))
        expected = np.column_stack([passive[joint] for joint in self._joints])
        readings, sigmas = expected.copy(), np.full_like(expected, np.inf)
        for k, (column, unit) in enumerate(zip(self._encoders, self._joints.values(), strict=True)):
            seen = np.isfinite(self._table[column])
            usual = instrument.position_sigma if unit == "m" else instrument.angle_sigma
            given = self._table.get(f"sigma_{column}", usual)
            if (bad := seen & ~(given > 0.0)).any():
                self._refuse(f"sigma_{column} is not positive", bad)
            readings[seen, k], sigmas[seen, k] = self._table[column][seen], given[seen]
            if seen.any():
                self._refuse_other_joint(column, readings[seen, k], {name: q[seen] for name, q in passive.items()})
            far = np.abs(readings[seen, k] - expected[seen, k])
            if seen.any() and np.median(far) > _FAR_READING * ENCODER_ZERO[unit]:
                self._refuse(
                    f"{column} is {np.median(far):.3g} {unit} (median) from the described position of the joint: "
                    "another unit, zero, direction or joint?"
                )
        return readings, sigmas

    def _refuse_other_joint(self, column: str, readings: Array, passive: Mapping[str, Array]) -> None:
        """Refuse an encoder that follows another passive joint, or its own one backwards, clearly better than it.

        And clearly better than none at all, as that of a locked joint does.
        """
        signs = (("", 1.0), ("minus ", -1.0))
        found = {f"{words}{joint}": readings - sign * q for joint, q in passive.items() for words, sign in signs}
        found |= {"": readings}
        spreads = {name: float(np.median(np.abs(off - np.median(off)))) for name, off in found.items()}
        nearest = min(spreads, key=lambda name: spreads[name])
        own = column.removeprefix(ENCODER).rpartition("_")[0]
        if _CLEARLY**2 * spreads[nearest] < min(spreads[own], spreads[""]):
            self._refuse(f"{column} follows {nearest}, not {own}: counted the other way, or columns exchanged?")

    def _with_datums(self, found: Measurements, expected: Array, instrument: Instrument) -> Measurements:
        """Return measurements with planes, lines, sockets and cameras, placed by the machine as described."""
        table, datums, sigmas = self._table, [], found.sigmas.copy()
        both = self._on_datum & self._seen.any(axis=1)
        if both.any():
            self._refuse("a row has a datum and other measurements, expected a row for each", both)
        for kind, of_kind in zip(self._kinds, self._flags_of_datums(), strict=True):
            if not of_kind.any():
                continue
            numbers, (observed, noise) = table[kind.name], self._observed(kind, of_kind, instrument)
            if (bad := of_kind & ((numbers < 0.0) | (numbers != np.round(numbers)))).any():
                self._refuse(f"{kind.name} is a number of datums, expected 1, 2 ...", bad)
            for number in np.unique(numbers[of_kind]):
                own = of_kind & (numbers == number)
                try:
                    datum = Datum.fitted(kind, int(number), expected, np.where(own[:, None], observed, np.nan))
                except InvalidValueError as error:
                    raise MeasurementError(table.path, str(error), table.lines_where(own)) from error
                datums.append(datum)
                sigmas[own] = np.inf
                sigmas[own, : kind.dimension] = (noise * datum.scales)[own, None]
                off = np.linalg.norm(datum.residuals(expected), axis=1)[own]
                if np.median(off) > (limit := _FAR_OFF * float(np.median(np.linalg.norm(expected, axis=1)))):
                    which = f"{kind.name} {int(number)}"
                    table.warn(f"{which} is {np.median(off):.3g} m (median), more than {limit:.2g} m, off")
        return replace(found, sigmas=sigmas, datums=tuple(datums))

    def _observed(self, kind: DatumKind, of_kind: Mask, instrument: Instrument) -> tuple[Array, Array]:
        """Return what is measured against data of a kind, shape=(n, dimension), and its noise, shape=(n,) [m, 1]."""
        table = self._table
        numbers, unit = kind.read(table.matrix(kind.columns, missing=np.nan))
        observed = numbers[:, : kind.dimension]
        if (bad := of_kind & ~np.isfinite(observed).all(axis=1)).any():
            self._refuse(f"{','.join(kind.columns)} are incomplete", bad)
        usual = instrument.position_sigma if kind.usual_sigma is None else kind.usual_sigma
        noise = table.get(kind.sigma_column, usual) * unit
        if (bad := of_kind & ~(noise > 0.0)).any():
            self._refuse(f"{kind.sigma_column} is not positive", bad)
        return observed, noise

    def _with_distances(self, found: Measurements, expected: Array, instrument: Instrument) -> Measurements:
        """Return measurements with their distances; the poses where some start become rows without measurements."""
        count, table, far = len(found), self._table, self._seen[:, 6]
        both = far & np.delete(self._seen, 6, axis=1).any(axis=1)
        if both.any():
            self._refuse(f"a row has {_DISTANCE} and other measurements, expected a row for each", both)
        origins = table.matrix(_ORIGIN, missing=np.nan)
        starts = found.commands * np.nan
        if self._start_columns[0] in table:
            starts = table.matrix(self._start_columns)
        fixed, begun = np.isfinite(origins).all(axis=1), np.isfinite(starts).all(axis=1)
        unclear = (far & (fixed == begun)) | (self._on_datum & (fixed | begun))
        if unclear.any():
            choices = f"{','.join(_ORIGIN)} or {','.join(self._start_columns)} or the number of a sphere"
            self._refuse(f"{_DISTANCE} needs one starting point: expected {choices}", unclear)
        if found.registration is not None and fixed.any():
            origins[fixed] = found.registration.positions(origins[fixed])
        sigmas, given = found.sigmas.copy(), table.get(_DISTANCE_SIGMA, instrument.position_sigma)
        if not (given[far] > 0.0).all():
            self._refuse(f"{_DISTANCE_SIGMA} is not positive", far)
        sigmas[far] = np.inf
        sigmas[far, 0] = given[far]
        begins = np.flatnonzero(far & begun)
        rows = np.concatenate([np.arange(count), begins])
        whole = replace(found, sigmas=sigmas)[rows]
        partners = np.full(len(rows), -1)
        partners[begins] = count + np.arange(len(begins))
        commands, unseen = whole.commands.copy(), whole.sigmas.copy()
        commands[count:] = starts[begins]
        unseen[count:] = np.inf
        distances = np.where(far, table[_DISTANCE], np.nan)
        return replace(
            whole,
            commands=commands,
            sigmas=unseen,
            distances=np.concatenate([distances, np.full(len(begins), np.nan)]),
            origins=np.nan_to_num(origins[rows]),
            partners=partners,
        )

    def _approaches(self, commands: Array) -> Array | None:
        names = approach_columns(len(self._robot.commands))
        if names[0] in self._table:
            approaches = self._table.matrix(names)
            wrong = ~np.isin(approaches, (-1.0, 0.0, 1.0)).all(axis=1)
            if wrong.any():
                self._refuse(f"{','.join(names)} are not directions: expected 1, -1, or 0 for unknown", wrong)
            return approaches
        if _TIME not in self._table:
            return None
        order = np.argsort(self._table[_TIME], kind="stable")
        approaches, last = np.zeros_like(commands), np.zeros(commands.shape[1])
        for before, row in itertools.pairwise(order):
            moved = commands[row] - commands[before]
            last = np.where(np.abs(moved) > SAME, np.sign(moved), last)
            approaches[row] = last
        return approaches
