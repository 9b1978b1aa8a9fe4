"""Measurement files: reading them with checks, and writing them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from pm3dof_pin.csv_table import CsvTable, columns_as_text, is_condition
from pm3dof_pin.errors.pose_error import quaternion, rotation_of_quaternion
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.pose_file import UNIT_QUATERNION
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.command_columns import (
    approach_columns,
    command_columns,
    commands_of,
    start_columns,
)
from pm3dof_pin.measuring.encoders import encoder_column, encoder_joints, readings_of
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.plausibility import (
    POINT_COLUMNS,
    POSITION_COLUMNS,
    QUATERNION_COLUMNS,
    check_extent,
    check_points,
    check_positions,
    check_rotations,
    warn_of_copies,
)
from pm3dof_pin.measuring.registration import AT_THE_BASE, Registration, fitted_sphere, register
from pm3dof_pin.typing import Array, Mask

TARGET_POINT_SIGMA = 1e-3
"""Default prior standard deviation of a file's target positions, per coordinate [m]."""

DISTANCE_COLUMN, DISTANCE_SIGMA_COLUMN = "distance_m", "sigma_distance_m"
_ORIGIN_COLUMNS = ("cx_m", "cy_m", "cz_m")
_SPHERE_COLUMN = "sphere"
_SIGMA_COLUMNS = ("sigma_x_m", "sigma_y_m", "sigma_z_m", "sigma_rx_rad", "sigma_ry_rad", "sigma_rz_rad")

_TIME_COLUMN = "time_s"
_SAME = 1e-9
_LARGE_SIGMA = {"m": 1e-3, "rad": 1e-2}
_LEAST_SIGMA = 1e-12  # [m, rad]
_FAR_LESS = 1e-3  # relative to the other sigmas of a column: such a row would outweigh all others
_LEAST_OF_A_SPHERE = 4  # rows


def write_measurements(measurements: Measurements, robot: Robot, path: Path | str) -> Path:
    """Write measurements as CSV, atomically and at full precision; raise OutputError on failure."""
    columns: dict[str, Array] = dict(zip(command_columns(robot), measurements.commands.T, strict=True))
    columns |= zip(POSITION_COLUMNS, measurements.positions.T, strict=True)
    if measurements.rotations is not None:
        columns |= zip(QUATERNION_COLUMNS, quaternion(measurements.rotations).T, strict=True)
    if measurements.points.any():
        columns |= zip(POINT_COLUMNS, measurements.points.T, strict=True)
    columns |= zip(_SIGMA_COLUMNS, measurements.sigmas.T[: measurements.tool_columns], strict=False)
    for k, joint in enumerate(measurements.joints):
        name, sigmas = encoder_column(robot, joint), measurements.sigmas[:, measurements.tool_columns + k]
        assert measurements.readings is not None
        columns |= {name: np.where(np.isfinite(sigmas), measurements.readings[:, k], np.nan), f"sigma_{name}": sigmas}
    if measurements.distances is not None and measurements.origins is not None and measurements.partners is not None:
        far, spheres = np.isfinite(measurements.distances), measurements.spheres
        on_sphere = np.zeros(len(far), dtype=bool) if spheres is None else spheres >= 0
        fixed = (far & (measurements.partners < 0) & ~on_sphere)[:, None]
        begun = (far & (measurements.partners >= 0))[:, None]
        columns |= {DISTANCE_COLUMN: measurements.distances}
        columns |= {DISTANCE_SIGMA_COLUMN: np.where(far, measurements.sigmas[:, 0], np.nan)}
        columns |= {_SIGMA_COLUMNS[0]: np.where(far, np.inf, measurements.sigmas[:, 0])}
        columns |= zip(_ORIGIN_COLUMNS, np.where(fixed, measurements.origins, np.nan).T, strict=True)
        starts = np.where(begun, measurements.commands[measurements.partners], np.nan)
        columns |= zip(start_columns(robot), starts.T, strict=True)
        if spheres is not None:
            columns |= {_SPHERE_COLUMN: np.where(on_sphere, spheres, np.nan)}
    if measurements.times is not None:
        columns |= {_TIME_COLUMN: measurements.times}
    if measurements.approaches is not None:
        columns |= zip(approach_columns(robot), measurements.approaches.T, strict=True)
    return write_text_atomically(path, columns_as_text(columns | measurements.conditions))


def read_measurements(
    path: Path | str,
    robot: Robot,
    instrument: Instrument | None = None,
    *,
    own_frame: bool = False,
    target_sigma: float = TARGET_POINT_SIGMA,
    tool_point_sigma: float = 0.0,
) -> Measurements:
    """Read and check a CSV file of measurements.

    Columns: the commands (`u1_m,u2_m,u3_m`, or `u1_rad` for a rotary drive), `x_m,y_m,z_m`, and for full poses
    `qw,qx,qy,qz`. Optional: `px_m,py_m,pz_m`, the point seen, in tool axes; `sigma_x_m ... sigma_rz_rad`;
    `temperature_*_K`, `load_*`; `time_s`, to identify drift; `approach_u1` ..., the direction (1, -1, 0 for unknown)
    from which each drive came, by default inferred from the order in time; `encoder_<joint>_rad` or `_m`, readings of
    passive joints, and `sigma_encoder_...`. Columns may be in mm, um, deg, mrad or urad if their names say so (`x_mm`,
    `u1_deg`). Rows with missing numbers are left out with a warning that names them.

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
        instrument: its noise is used if the file has no sigmas.
        own_frame: whether the instrument measured in its own frame, in which the base must be located first; see
            :mod:`pm3dof_pin.measuring.registration`. With single coordinates, its axes must be near those of the base.
        target_sigma: prior standard deviation of the points seen, per coordinate [m]; 0 if known exactly.
        tool_point_sigma: the same for the tool point, if that is the point seen [m].

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is not a number, a quaternion is not a
            rotation, numbers are probably in another unit, or no row is left.
        InvalidValueError: the base cannot be located: positions only, on one line.
    """
    read = _Reader(Path(path), robot).measurements(instrument or Instrument(), own_frame)
    return replace(read, target_sigma=target_sigma, tool_point_sigma=tool_point_sigma)


class _Reader:
    """Reader of one file."""

    def __init__(self, path: Path, robot: Robot) -> None:
        self._path, self._robot = path, robot
        self._command_columns = command_columns(robot)
        self._table = CsvTable(path, self._command_columns)
        self._joints = encoder_joints(self._table, robot)
        self._encoders = [encoder_column(robot, joint) for joint in self._joints]
        self._check_header()
        self._seen, whole = self._flags_of_measured()
        whole &= np.isfinite(self._table.matrix(self._needed())).all(axis=1)
        self._table.keep(whole)
        self._seen = self._seen[whole]

    def measurements(self, instrument: Instrument, own_frame: bool) -> Measurements:
        table = self._table
        points = table.matrix(POINT_COLUMNS, missing=0.0)
        whole = POSITION_COLUMNS if {*POSITION_COLUMNS} <= {*table.columns} else ()
        measured = [name for name in (*whole, *QUATERNION_COLUMNS) if whole and name in table]
        warn_of_copies(
            table, np.hstack([table.matrix(self._command_columns), points, self._seen]), table.matrix(measured)
        )
        commands = commands_of(table, self._robot)
        rotations = self._rotations()
        check_points(table, points, self._robot.characteristic_length)
        sigmas = self._sigmas(instrument, rotations is not None)
        nominal = self._nominal_poses(commands)
        expected = nominal.positions + np.einsum("nij,nj->ni", nominal.rotations, points)
        seen = self._seen[:, : sigmas.shape[1]]
        # coordinates that were not measured take the description's values, with zero weight
        positions = np.column_stack(
            [np.where(seen[:, k], table.get(name, 0.0), expected[:, k]) for k, name in enumerate(POSITION_COLUMNS)]
        )
        if rotations is not None:
            seen_at_all = np.asarray(seen[:, 3:].any(axis=1))
            rotations = np.where(seen_at_all[:, None, None], rotations, nominal.rotations)
        sigmas = np.where(seen, sigmas, np.inf)
        registration = self._registration(expected, positions, nominal, rotations) if own_frame else None
        if registration is not None:
            # rows without positions or orientations already have those of the description
            placed, turned = np.isfinite(sigmas[:, :3]).all(axis=1), np.isfinite(sigmas[:, 3:]).all(axis=1)
            positions[placed] = registration.positions(positions[placed])
            sigmas[placed, :3] = registration.sigmas(sigmas[placed, :3])
            if rotations is not None:
                rotations[turned] = registration.rotations(rotations[turned])
                sigmas[turned, 3:] = registration.sigmas(sigmas[turned, 3:])
        fits = check_positions(table, expected, positions)
        if rotations is not None:
            check_rotations(table, nominal, rotations, refuse=fits)
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
            times=table.columns.get(_TIME_COLUMN),
            approaches=self._approaches(commands),
        )
        if self._joints:
            found = found.with_encoders(self._joints, *readings_of(table, self._joints, nominal, instrument))
        return self._with_distances(found, expected, instrument) if self._seen[:, 6].any() else found

    def _registration(
        self, expected: Array, positions: Array, nominal: Poses, rotations: Array | None
    ) -> Registration | None:
        """Locate the base in the instrument's frame; None if all rows are distances, which have no frame."""
        count = 3 if rotations is None else 6
        seen = self._seen[:, :count]
        whole, some = seen.all(axis=1), seen.any(axis=1)
        if not some.any():
            return None
        if (some & ~whole & ~seen[:, :3].all(axis=1)).any() or not whole.any():
            # single coordinates, such as heights above a bed, are along axes close to the base's
            return AT_THE_BASE
        check_extent(self._table, expected[whole], positions[whole])
        turned = (None, None) if rotations is None else (rotations[whole], nominal.rotations[whole])
        return register(positions[whole], expected[whole], *turned)

    def _with_distances(self, found: Measurements, expected: Array, instrument: Instrument) -> Measurements:
        """Return measurements with their distances; the poses where some start become rows without measurements."""
        count, table, far = len(found), self._table, self._seen[:, 6]
        both = far & np.delete(self._seen, 6, axis=1).any(axis=1)
        if both.any():
            problem = f"a row has {DISTANCE_COLUMN} and other measurements, expected a row for each"
            raise MeasurementError(self._path, problem, table.lines_where(both))
        origins = table.matrix(_ORIGIN_COLUMNS, missing=np.nan)
        starts = found.commands * np.nan
        if (columns := start_columns(self._robot))[0] in table:
            starts = table.matrix(columns)
        spheres = np.nan_to_num(table.get(_SPHERE_COLUMN, np.nan), nan=-1.0).astype(np.intp)
        fixed, begun, on_sphere = np.isfinite(origins).all(axis=1), np.isfinite(starts).all(axis=1), spheres >= 0
        unclear = far & (fixed.astype(int) + begun + on_sphere != 1)
        if unclear.any():
            origins_in_words = f"{','.join(_ORIGIN_COLUMNS)} or {','.join(columns)} or the number of a {_SPHERE_COLUMN}"
            problem = f"{DISTANCE_COLUMN} needs one starting point: expected {origins_in_words}"
            raise MeasurementError(self._path, problem, table.lines_where(unclear))
        if found.registration is not None and fixed.any():
            origins[fixed] = found.registration.positions(origins[fixed])
        for number in np.unique(spheres[far & on_sphere]):
            rows = np.flatnonzero(far & (spheres == number))
            if len(rows) < _LEAST_OF_A_SPHERE:
                problem = f"{_SPHERE_COLUMN} {number} has {len(rows)} rows, expected {_LEAST_OF_A_SPHERE} or more"
                raise MeasurementError(self._path, problem, table.lines_where(far & (spheres == number)))
            origins[rows] = fitted_sphere(expected[rows], table[DISTANCE_COLUMN][rows])
        sigmas = found.sigmas.copy()
        given = table.get(DISTANCE_SIGMA_COLUMN, instrument.position_sigma)
        sigmas[far] = np.inf
        sigmas[far, 0] = given[far]
        if not (given[far] > 0.0).all():
            raise MeasurementError(self._path, f"{DISTANCE_SIGMA_COLUMN} is not positive", table.lines_where(far))
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
            spheres=np.where(far, spheres, -1)[rows] if on_sphere.any() else None,
        )

    def _approaches(self, commands: Array) -> Array | None:
        names = approach_columns(self._robot)
        if names[0] in self._table:
            approaches = self._table.matrix(names)
            wrong = ~np.isin(approaches, (-1.0, 0.0, 1.0)).all(axis=1)
            if wrong.any():
                problem = f"{','.join(names)} are not directions: expected 1, -1, or 0 for unknown"
                raise MeasurementError(self._path, problem, self._table.lines_where(wrong))
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

    def _check_header(self) -> None:
        header = self._table.header
        measured = self._measured_columns(header)
        expected = [*self._command_columns, *measured]
        for group in (
            _ORIGIN_COLUMNS,
            start_columns(self._robot),
            (DISTANCE_SIGMA_COLUMN,),
            (_SPHERE_COLUMN,),
            QUATERNION_COLUMNS,
            POINT_COLUMNS,
            tuple(f"sigma_{name}" for name in POSITION_COLUMNS if name in measured),
            _SIGMA_COLUMNS[3:],
            (_TIME_COLUMN,),
            approach_columns(self._robot),
            *((name,) for encoder in self._encoders for name in (encoder, f"sigma_{encoder}")),
        ):
            if set(group) & set(header):
                expected += group
        self._table.require(expected)
        unknown = [name for name in header if name not in expected and not is_condition(name)]
        if unknown:
            angles = QUATERNION_COLUMNS[0] not in header and any(name.endswith("_rad") for name in unknown)
            hint = f"; an orientation is expected in {','.join(QUATERNION_COLUMNS)}" if angles else ""
            self._table.warn(f"columns {', '.join(unknown)} are not used{hint}")

    def _measured_columns(self, header: list[str]) -> tuple[str, ...]:
        """Return the measured columns that the file must have.

        Some positions alone, or orientations alone, are enough if no other column could hold the rest.
        """
        positions = tuple(name for name in POSITION_COLUMNS if name in header)
        if DISTANCE_COLUMN in header:
            return (*positions, DISTANCE_COLUMN)
        if self._encoders:
            return positions
        beside = (*POINT_COLUMNS, *_SIGMA_COLUMNS[:3]) if positions else (*QUATERNION_COLUMNS, *_SIGMA_COLUMNS[3:])
        known = {*self._command_columns, *positions, *beside, _TIME_COLUMN, *approach_columns(self._robot)}
        some = positions or QUATERNION_COLUMNS[0] in header
        alone = some and all(name in known or is_condition(name) for name in header)
        return positions if alone else POSITION_COLUMNS

    def _flags_of_measured(self) -> tuple[Mask, Mask]:
        """Complete the measured columns, and return flags of what was measured: x, y, z, angles, distance, encoders.

        A coordinate was not measured if it has no column or an infinite sigma; a position, orientation or distance was
        not measured in a row in which all its cells are empty.

        Returns:
            The flags, shape=(n, 7 + encoders); and whether a row has any measurement, and no incomplete one.
        """
        table = self._table
        count = len(table)
        infinite = np.column_stack([np.isposinf(table.get(name, 0.0)) for name in _SIGMA_COLUMNS])
        seen, broken = np.zeros((count, 7 + len(self._encoders)), dtype=bool), np.zeros(count, dtype=bool)
        if present := [name for name in POSITION_COLUMNS if name in table]:
            given = np.asarray(~np.isnan(table.matrix(present)).all(axis=1))
            for name in present:
                place = POSITION_COLUMNS.index(name)
                seen[:, place] = given & ~infinite[:, place]
                broken |= seen[:, place] & ~np.isfinite(table[name])
        if QUATERNION_COLUMNS[0] in table:
            cells = table.matrix(QUATERNION_COLUMNS)
            given = np.asarray(~np.isnan(cells).all(axis=1))
            broken |= given & ~np.isfinite(cells).all(axis=1)
            seen[:, 3:6] = given[:, None] & ~infinite[:, 3:]
            whole = np.where(given[:, None], cells, [1.0, 0.0, 0.0, 0.0])
            table.columns |= dict(zip(QUATERNION_COLUMNS, whole.T, strict=True))
        if DISTANCE_COLUMN in table:
            seen[:, 6] = ~np.isnan(table[DISTANCE_COLUMN])
            broken |= seen[:, 6] & ~np.isfinite(table[DISTANCE_COLUMN])
        for place, name in enumerate(self._encoders, start=7):
            seen[:, place] = ~np.isnan(table[name]) & ~np.isposinf(table.get(f"sigma_{name}", 0.0))
            broken |= seen[:, place] & ~np.isfinite(table[name])
        return seen, seen.any(axis=1) & ~broken

    def _needed(self) -> list[str]:
        """Return the columns that must not have empty cells."""
        distances = {
            DISTANCE_COLUMN,
            DISTANCE_SIGMA_COLUMN,
            _SPHERE_COLUMN,
            *_ORIGIN_COLUMNS,
            *start_columns(self._robot),
        }
        encoders = {f"{sigma}{name}" for sigma in ("", "sigma_") for name in self._encoders}
        may_be_empty = {*POSITION_COLUMNS, *QUATERNION_COLUMNS, *_SIGMA_COLUMNS, *distances, *encoders}
        return [name for name in self._table.columns if name not in may_be_empty]

    def _nominal_poses(self, commands: Array) -> Poses:
        poses = self._robot.forward(commands, on_failure="nan")
        if poses.solved.all():
            return poses
        problem = f"{self._robot.name} cannot reach these commands"
        if turned := self._drives_that_count_backwards(commands):
            problem += f", but could if {turned} counted the other way"
        raise MeasurementError(self._path, problem, self._table.lines_where(~poses.solved))

    def _drives_that_count_backwards(self, commands: Array) -> str:
        """Return the drives that would make the commands reachable by counting the other way; "" if none would.

        Of several choices, the one that brings the tool nearest to its measured position, or all if it has none.
        """
        mirrored, every = 2.0 * self._robot.home.commands - commands, np.ones(commands.shape[1], dtype=bool)
        turned = {"all drives": mirrored}
        turned |= {f"u{k + 1}": np.where(one, mirrored, commands) for k, one in enumerate(np.diag(every))}
        found = {name: self._robot.forward(other, on_failure="nan") for name, other in turned.items()}
        found = {name: poses for name, poses in found.items() if poses.solved.all()}
        if not {*POSITION_COLUMNS} <= {*self._table.columns}:
            return " or ".join(found)
        seen = self._table.matrix(POSITION_COLUMNS)
        off = {name: np.nanmedian(np.linalg.norm(poses.positions - seen, axis=1)) for name, poses in found.items()}
        return min(off, key=lambda name: off[name], default="")

    def _rotations(self) -> Array | None:
        if QUATERNION_COLUMNS[0] not in self._table:
            return None
        quaternions = self._table.matrix(QUATERNION_COLUMNS)
        norms = np.linalg.norm(quaternions, axis=1)
        bad = np.abs(norms - 1.0) > UNIT_QUATERNION
        if bad.any():
            problem = f"is not a rotation: its length is {norms[bad][0]:.6g}, expected 1"
            lines = self._table.lines_where(bad)
            raise MeasurementError(self._path, f"{','.join(QUATERNION_COLUMNS)} {problem}", lines)
        return rotation_of_quaternion(quaternions)

    def _sigmas(self, instrument: Instrument, poses: bool) -> Array:
        count = 6 if poses else 3
        names = _SIGMA_COLUMNS[:count]
        usual = np.repeat([instrument.position_sigma, instrument.angle_sigma], 3)[:count]
        sigmas = np.column_stack([self._table.get(name, usual[k]) for k, name in enumerate(names)])
        sigmas = np.where(np.isnan(sigmas), usual, sigmas)
        bad = ~(sigmas > 0.0).all(axis=1)
        if bad.any():
            raise MeasurementError(self._path, "a sigma is not positive", self._table.lines_where(bad))
        for k, name in enumerate(names):
            unit = name.rsplit("_", 1)[1]
            finite = sigmas[np.isfinite(sigmas[:, k]), k]
            tiny = sigmas[:, k] < max(_LEAST_SIGMA, _FAR_LESS * float(np.median(finite)) if finite.size else 0.0)
            if tiny.any():
                problem = f"{name} is {sigmas[tiny, k][0]:.3g} {unit}, nearly zero: no instrument is that accurate"
                raise MeasurementError(self._path, problem, self._table.lines_where(tiny))
            if finite.size and np.median(finite) > _LARGE_SIGMA[unit]:
                other = "millimetres" if unit == "m" else "degrees"
                self._table.warn(f"{name} is {np.median(finite):.3g} {unit} (median), which is very large: {other}?")
        return sigmas
