"""A calibration with a few new rows merged into it, after the check that they are of the same machine.

Rows of the folder and new ones are fitted together, which is what the old calibration as prior would give, with every
row judged again: outliers, noise, what is held out. If drives' zeros moved, the old rows' commands are first counted
from the new zeros. These are known from few rows, so what the old rows are still off by is estimated with the machine
(`homing`), and the zeros are those of the new rows. Rows of a machine whose parts moved say nothing of the present one
and are not merged.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from pm3dof_pin.calibration.calibrate import Calibration, calibrate
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.fit import Options
from pm3dof_pin.calibration.folder import MEASUREMENTS, read_compensation, read_summary
from pm3dof_pin.calibration.recheck import Recheck, recheck
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import CalibrationRefusedError
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.measuring.instruments.table import datum_kinds
from pm3dof_pin.measuring.joint_columns import command_columns
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array

_POINT = ("px_m", "py_m", "pz_m")
_SESSION = ("time_s", "approach_u")


def updated(
    directory: Path | str, measurements: Measurements, checked: Recheck | None = None
) -> tuple[Calibration, Recheck]:
    """Calibrate again from the rows of a calibration's folder and new ones.

    Args:
        directory: the folder, whose checksums are compared first.
        measurements: new rows; those in an instrument's own frame are placed by the calibrated machine.
        checked: what :func:`~pm3dof_pin.calibration.recheck.recheck` says of them, if known.

    Raises:
        CalibrationRefusedError: parts moved, drift between the sessions is unknown, temperatures or loads are known in
            one of them only, or the result would be refused.
        DescriptionError: the folder is no calibration, or was changed.
        InvalidValueError: the calibration has no parameters.
    """
    known, summary = read_compensation(directory), read_summary(directory)
    found = checked or recheck(known, measurements)
    if found.verdict == "recalibrate":
        risk = f"with a risk of {100.0 * found.risk:.1f} %"
        cause = (
            f"parts moved since the calibration ({risk}): its rows are of another machine; measure a whole plan anew"
        )
        raise CalibrationRefusedError([cause])
    if summary.get("drift", {}).get("more_than_chance"):
        cause = (
            "the machine drifted during the calibration: rows of another session have an unknown place in that drift"
        )
        raise CalibrationRefusedError([cause])
    robot = known.errors.robot
    old = read_measurements(Path(directory) / MEASUREMENTS, robot, target_sigma=0.0)
    scales = np.abs([command.scale for command in robot.commands])
    if found.verdict == "re-zero":
        homings = np.zeros(len(old), dtype=np.intp) if old.homings is None else old.homings
        old = replace(old, commands=old.commands - scales * found.zeros, homings=homings + 1)
    if {*old.conditions} != {*measurements.conditions}:
        differing = ", ".join(sorted({*old.conditions} ^ {*measurements.conditions}))
        raise CalibrationRefusedError([f"{differing}: known in one session only; expected in both or in none"])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / MEASUREMENTS
        _write_union(old, _seen_from_a_station(known, measurements), known, path)
        errors = GeometricErrors.load(robot.source, tool_frame=robot.tool_frame)
        options = Options(summary["method"], summary["seed"], summary["eta_m_per_rad"])
        return calibrate(path, errors, options, own_frame="base_in_instrument_frame" in summary), found


def _seen_from_a_station(known: Compensation, measurements: Measurements) -> Measurements:
    """Return rows of an instrument's own frame, placed by the calibrated machine, as those of a station."""
    if measurements.registration is None:
        return measurements
    machine = known.poses(known.errors.robot.forward(measurements.commands), dict(measurements.conditions))
    placed = replace(measurements.in_axes(measurements.registered_at(machine)), registration=None)
    stations = np.zeros(len(placed), dtype=np.intp) if placed.stations is None else placed.stations
    return replace(placed, stations=stations + 1)


def _write_union(old: Measurements, new: Measurements, known: Compensation, path: Path) -> None:
    """Write rows of two sessions as one file; things of unknown place are numbered on."""
    robot, tables = known.errors.robot, []
    for k, measurements in enumerate((old, new)):
        own = path.with_name(f"session{k}.csv")
        write_measurements(measurements, robot, own)
        tables.append(_columns(own))
    counts = [len(table[command_columns(robot)[0]]) for table in tables]
    for name in ("station", *datum_kinds()):
        if all(name in table for table in tables):
            tables[1][name] = tables[1][name] + np.nanmax(tables[0][name])
    names = list(dict.fromkeys(name for table in tables for name in table if not name.startswith(_SESSION)))
    approaches = [f"approach_u{k}" for k in range(1, len(robot.commands) + 1)]
    if any(name in table for table in tables for name in approaches):
        names += approaches
    columns = []
    for name in names:
        empty = 0.0 if name in (*_POINT, *approaches) else np.nan
        columns.append(np.concatenate([t.get(name, np.full(n, empty)) for t, n in zip(tables, counts, strict=True)]))
    write_text_atomically(path, csv_text([names, *np.column_stack(columns).tolist()]))


def _columns(path: Path) -> dict[str, Array]:
    rows = np.genfromtxt(path, delimiter=",", names=True, deletechars="", replace_space=" ", encoding="utf-8")
    return {name: np.atleast_1d(rows[name]) for name in rows.dtype.names or ()}
