"""Files of a judged path, one row for each point: CSV or NetCDF, written block by block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import csv_text, write_atomically
from pm3dof_pin.kinematics.poses import limit_names
from pm3dof_pin.maps.datasets import dataset_attributes
from pm3dof_pin.paths.evaluation import PathEvaluation
from pm3dof_pin.typing import Matrix

Progress = Callable[[int, int], None]
_WORDS = "broken_limits"
_DIGITS = 12  # of numbers in CSV


def write_path(found: PathEvaluation, path: Path | str, *, progress: Progress | None = None) -> Path:
    """Write all points of a path: as NetCDF in SI units (.nc), else as CSV with coordinates and commands in degrees.

    Raises:
        OutputError: the file cannot be written; no partial file is left.
    """
    file, tell = Path(path), progress or (lambda done, total: None)
    if file.suffix.lower() == ".nc":
        _write_netcdf(found, file, tell)
    else:
        _write_csv(found, file, tell)
    return file


def _write_csv(found: PathEvaluation, path: Path, tell: Progress) -> None:
    robot, names = found.robot, limit_names(found.robot)
    turned = {f"{c.name}_rad" for c in robot.coordinates if c.unit == "rad"}
    turned |= {
        f"{prefix}u{k}_rad"
        for prefix in ("", "calibrated_", "compensated_")
        for k, command in enumerate(robot.commands, start=1)
        if command.unit == "rad"
    }
    whole, done = {"line", "within_limits", "branch"}, 0
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        for columns in found.blocks():
            if not done:
                headings = [name.removesuffix("rad") + "deg" if name in turned else name for name in columns]
                file.write(csv_text([headings]).encode())
            words = {
                flags: "+".join(name for bit, name in enumerate(names) if int(flags) & (1 << bit))
                for flags in np.unique(columns[_WORDS]).tolist()
            }
            cells = _rounded(np.stack([np.degrees(columns[n]) if n in turned else columns[n] for n in columns]))
            rows: list[list[Any]] = cells.T.tolist()
            for k, name in enumerate(columns):
                if name == _WORDS:
                    for row, flags in zip(rows, columns[name].tolist(), strict=True):
                        row[k] = words[flags]
                elif name in whole or not np.isfinite(cells[k]).all():
                    form = "%.0f" if name in whole else "%.12g"
                    for row in rows:
                        row[k] = form % row[k]
            file.write(_lines(rows))
            done += len(columns["line"])
            tell(done, len(found))


def _rounded(values: Matrix) -> Matrix:
    """Return numbers rounded to twelve digits, so that their shortest forms have no more."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        power = 10.0 ** (_DIGITS - 1 - np.floor(np.log10(np.abs(values))))
        rounded = np.rint(values * power) / power
    return np.where(np.isfinite(rounded), rounded, values)


def _lines(rows: Sequence[Sequence[Any]]) -> bytes:
    """Return rows of numbers, and of words without commas and quotes, as CSV: JSON without its brackets is faster."""
    return msgspec.json.encode(rows)[2:-2].replace(b"],[", b"\n").replace(b'"', b"") + b"\n"


def _write_netcdf(found: PathEvaluation, path: Path, tell: Progress) -> None:
    import netCDF4

    done, names = 0, limit_names(found.robot)
    with write_atomically(path) as temporary:
        try:
            with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
                file.setncatts(dataset_attributes("tool path", found.robot.name))
                file.createDimension("point", len(found))
                for columns in found.blocks():
                    rows = slice(done, done + len(columns["line"]))
                    for name, values in columns.items():
                        if not done:
                            kind = np.int32 if name in ("line", _WORDS) else np.float64
                            file.createVariable(name, kind, ("point",))
                        file[name][rows] = values
                    done = rows.stop
                    tell(done, len(found))
                masks = np.array([1 << bit for bit in range(len(names))], dtype=np.int32)
                file[_WORDS].setncatts({"flag_masks": masks, "flag_meanings": " ".join(names)})
        except RuntimeError as error:  # raised by the NetCDF library for a full disk
            raise OutputError(path, str(error)) from error
