"""Files of a judged path, one row for each point: CSV or NetCDF, written block by block."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import csv_text, write_atomically
from pm3dof_pin.maps.datasets import dataset_attributes, limit_names
from pm3dof_pin.paths.evaluation import PathEvaluation

Progress = Callable[[int, int], None]
_WORDS = "broken_limits"


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
    with write_atomically(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        for columns in found.blocks():
            if not done:
                headings = [name.removesuffix("rad") + "deg" if name in turned else name for name in columns]
                file.write(csv_text([headings]))
            words = {
                flags: "+".join(name for bit, name in enumerate(names) if int(flags) & (1 << bit))
                for flags in np.unique(columns[_WORDS]).tolist()
            }
            cells: list[list[Any]] = []
            forms: list[str] = []
            for name, values in columns.items():
                form = "%s" if name == _WORDS else "%.0f" if name in whole else "%.12g"
                shown = (np.degrees(values) if name in turned else values).tolist()
                if name == _WORDS:
                    shown = [words[flags] for flags in shown]
                if cells and (values == values[0]).all():  # as many columns are: formatting takes the time
                    forms.append((form % shown[0]).replace("%", "%%"))
                else:
                    forms.append(form)
                    cells.append(shown)
            line = ",".join(forms) + "\n"
            file.writelines(line % row for row in zip(*cells, strict=True))
            done += len(columns["line"])
            tell(done, len(found))


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
