"""Files of the firmware of delta printers: which kind a file is, and what every kind can do."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Protocol

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.printers.bed_mesh import BedMesh
from pm3dof_pin.printers.delta_printer import DeltaPrinter
from pm3dof_pin.printers.duet import CONFIG, HEIGHT_MAP, DuetBackup, is_height_map
from pm3dof_pin.printers.klipper import KlipperFile
from pm3dof_pin.printers.m665 import GCodeLog
from pm3dof_pin.printers.touches import Touches

_SUFFIXES = (".cfg", ".g", ".gcode", ".log")
_BEGINNING = 100  # bytes
_KLIPPER_LOG = re.compile(r"^=+ Config file =+\s*$", re.MULTILINE)


class FirmwareFile(Protocol):
    """A file of a printer's firmware."""

    @property
    def firmware(self) -> str:
        """Name of the firmware."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def most_parameters(self) -> int:
        """The greatest number of parameters that it can hold."""

    @property
    def takes_mesh(self) -> bool:
        """Whether it can hold a mesh of heights of the bed."""

    @property
    def meshes(self) -> tuple[str, ...]:
        """Names of the meshes that it holds."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of its touches: what they are, and what it does not tell of them."""

    def printer(self) -> DeltaPrinter:
        """Return the printer that it describes."""

    def touches(self, printer: DeltaPrinter) -> Touches:
        """Return the touches of the bed that it contains."""

    def with_printer(self, printer: DeltaPrinter, mesh: BedMesh | None = None) -> str:
        """Return the text of a file with another printer's numbers, and a mesh if it takes one."""


def is_of_firmware(path: Path) -> bool:
    """Tell whether a file is one of a printer's firmware, and not a table of measurements, in whatever encoding."""
    if path.suffix.lower() in _SUFFIXES or not path.is_file():
        return path.suffix.lower() in _SUFFIXES
    with path.open("rb") as file:
        return is_height_map(file.read(_BEGINNING).decode("utf-8", errors="replace"))


def read_firmware(path: Path, text: str) -> FirmwareFile:
    """Return what a file is.

    Raises:
        MeasurementError: it is of no firmware that is known, or a log of Klipper, which has the state of many days.
    """
    if found := _KLIPPER_LOG.search(text):
        lines = [text.count("\n", 0, found.start()) + 1]
        raise MeasurementError(path, "a configuration in a log of Klipper: expected the file printer.cfg", lines)
    if re.search(r"^\[(printer\]|include\s)", text, re.MULTILINE | re.IGNORECASE):
        return KlipperFile.parse(path, text)
    if is_height_map(text):
        return DuetBackup.of(path.with_name(CONFIG), path)
    if "M665" in text.upper():
        log = GCodeLog.parse(path, text)
        height_map = path.with_name(HEIGHT_MAP)
        return log if log.probed or not height_map.is_file() else DuetBackup.of(path, height_map)
    raise MeasurementError(
        path, "neither Klipper's section [printer] nor M665 of RepRapFirmware or Marlin: no delta printer"
    )
