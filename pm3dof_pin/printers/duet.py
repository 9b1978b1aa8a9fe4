"""Backups of RepRapFirmware: config.g, config-override.g, and the height map that G29 saved beside them.

M501 in config.g calls config-override.g, in which M500 saved numbers that replace those of config.g. A height map is a
grid of probed heights, 0 (not 0.000) where nothing was probed: after a comment, a line of labels, and their values.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.files import read_text
from pm3dof_pin.printers.bed_mesh import BedMesh
from pm3dof_pin.printers.delta_printer import DeltaPrinter
from pm3dof_pin.printers.m665 import GCodeLog

_TITLE = "RepRapFirmware height map file"
_LABELS = {
    "xmin": "min0",
    "ymin": "min1",
    "spacing": "spacing0",
    "xspacing": "spacing0",
    "yspacing": "spacing1",
    "xnum": "num0",
    "ynum": "num1",
}
"""Labels of older versions, and those of today."""
_NOT_PROBED = "0"
CONFIG, HEIGHT_MAP = "config.g", "heightmap.csv"
"""Names of the printer's numbers, and of the map that G29 saves."""
_OVERRIDE = "config-override.g"


@dataclass(frozen=True)
class DuetBackup(GCodeLog):
    """The file with the numbers that hold, and the heights of a map that were probed with them."""

    text: str  #: of the file
    height_map: str  #: name of the map

    @classmethod
    def of(cls, config: Path, height_map: Path) -> DuetBackup:
        """Read the numbers, also those of config-override.g if M501 calls it, and the heights.

        Raises:
            MeasurementError: a file is missing or not understood.
        """
        if not config.is_file():
            raise MeasurementError(height_map, f"no {config.name} beside it, with the M665 and M666 of the printer")
        text, override = read_text(config), config.with_name(_OVERRIDE)
        log = GCodeLog.parse(config, text)
        if re.search(r"^\s*M501\b", text, re.MULTILINE | re.IGNORECASE) and override.is_file():
            later = read_text(override)
            saved = GCodeLog.parse(override, later)
            log = log.then(saved)
            if saved.geometry or saved.stops:
                log, text = replace(log, path=override), later
        log = replace(log, probed=_read_height_map(height_map, read_text(height_map)))
        return cls(**vars(log), text=text, height_map=height_map.name)

    @property
    def meshes(self) -> tuple[str, ...]:
        """The height map, which was probed with the old numbers."""
        return (self.height_map,)

    def with_printer(self, printer: DeltaPrinter, mesh: BedMesh | None = None) -> str:
        """Return the file with another printer's M665 and M666 in place of the last ones."""
        lines = self.text.splitlines(keepends=True)
        for code in super().with_printer(printer, mesh).splitlines():
            places = [k for k, line in enumerate(lines) if re.match(rf"\s*{code[:4]}\b", line, re.IGNORECASE)]
            if places:
                old = lines[places[-1]]
                lines[places[-1]] = old.replace(old.partition(";")[0].strip(), code, 1)
            else:
                lines = ["".join(lines).rstrip("\r\n"), "\n", code, "\n"]
        return "".join(lines)


def is_height_map(text: str) -> bool:
    """Tell whether a text is a height map of RepRapFirmware."""
    return text.lstrip("\ufeff").startswith(_TITLE)


def _read_height_map(path: Path, text: str) -> tuple[tuple[float, float, float], ...]:
    """Return the points and heights of a height map [mm].

    Raises:
        MeasurementError: a label or a number is missing, the axes are not X and Y, or rows are.
    """
    rows = [[cell.strip() for cell in line.split(",")] for line in text.splitlines()[1:]]
    if len(rows) < 2:
        raise MeasurementError(path, "ends before the grid's values")
    grid = dict(zip((_LABELS.get(label, label) for label in rows[0]), rows[1], strict=False))
    if (axes := [grid.get("axis0", "X"), grid.get("axis1", "Y")]) != ["X", "Y"]:
        raise MeasurementError(path, f"a grid along {' and '.join(axes)}; expected X and Y", [3])
    grid.setdefault("spacing1", grid.get("spacing0", ""))

    def number(label: str) -> float:
        value = _number(grid.get(label, ""))
        if value is None:
            raise MeasurementError(path, f"{label} of the grid is '{grid.get(label, '')}': expected a number", [3])
        return value

    starts, steps = (number("min0"), number("min1")), (number("spacing0"), number("spacing1"))
    columns, count = number("num0"), number("num1")
    heights = [row for row in rows[2:] if any(row)]
    if len(heights) != count:
        raise MeasurementError(path, f"{len(heights)} rows of heights; expected {count:g}")
    found = []
    for i, row in enumerate(heights):
        cells = row[:-1] if row[-1] == "" else row
        if len(cells) != columns:
            raise MeasurementError(path, f"{len(cells)} heights; expected {columns:g}", [4 + i])
        for k, cell in enumerate(cells):
            height = _number(cell)
            if height is None:
                raise MeasurementError(path, f"'{cell}': expected a height such as -0.012", [4 + i])
            if cell != _NOT_PROBED:
                found.append((starts[0] + k * steps[0], starts[1] + i * steps[1], height))
    return tuple(found)


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
