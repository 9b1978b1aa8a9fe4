"""Logs of RepRapFirmware and Marlin: M665 and M666, and heights of the bed that were probed with G30 or G33.

Both place the towers X, Y, Z at 210, 330 and 90 degrees, corrected by the X, Y, Z of M665. Arms of several lengths are
L100:101:102 in RepRapFirmware, and L with the trims A, B, C in Marlin 2; in Marlin 1, B alone is the radius of G33. The
nozzle is at the height H when homed, corrected by M666 in RepRapFirmware; the M666 of Marlin says how far each carriage
moves back from its end stop, which is higher by as much. The A and B of M666 in RepRapFirmware are slopes of the bed
along x and y [%], which are kept, as are the arms and end stops U, V, W of more towers.

A probed height h at (x, y) means that the printer, as it was, took the nozzle to be at (x, y, h) when it touched the
bed. :mod:`~pm3dof_pin.printers.log_reader` says which heights those are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.printers.bed_mesh import BedMesh
from pm3dof_pin.printers.delta_printer import DeltaPrinter
from pm3dof_pin.printers.g33 import radius_of_g33
from pm3dof_pin.printers.log_reader import LogReader
from pm3dof_pin.printers.touches import Touches

_TOWERS = (210.0, 330.0, 90.0)
_LETTERS, _TRIMS = "XYZ", "ABC"
_SAME = 5e-5  # [mm], of what is written


@dataclass(frozen=True)
class GCodeLog:
    """A log, or pieces of one pasted together."""

    path: Path  #: the file
    firmware: Literal["RepRapFirmware", "Marlin"]  #: whose it is
    geometry: dict[str, float]  #: the last M665 [mm, degrees]
    arms: tuple[float, ...]  #: its L, one length or that of each tower [mm]
    stops: dict[str, float]  #: the last M666 [mm, %]
    probed: tuple[tuple[float, float, float], ...]  #: points and heights [mm]
    probe: dict[str, float]  #: X and Y of G31 or M851: the probe's place, seen from the nozzle [mm]
    begins: tuple[int, ...]  #: line of the last M665, if there is one

    takes_mesh = False
    notes = ()

    @property
    def meshes(self) -> tuple[str, ...]:
        """There are none."""
        return ()

    @property
    def most_parameters(self) -> int:
        """Each tower's arms have a length of their own, but in Marlin 1."""
        return 9 if self._takes_trims else 7

    @classmethod
    def parse(cls, path: Path, text: str) -> GCodeLog:
        """Read the last M665 and M666, or settings of G33, and all heights that were probed with them.

        Raises:
            MeasurementError: a line is not understood, or heights were probed with numbers or at places that the log
                does not tell.
        """
        log = LogReader(path)
        log.read(text)
        return cls(path, log.firmware, log.geometry, log.arms, log.stops, log.probed, log.probe, log.begins)

    def then(self, later: GCodeLog) -> GCodeLog:
        """Return what holds after the settings of another log too, with the heights of both."""
        geometry, stops = self.geometry | later.geometry, self.stops | later.stops
        arms, probed = later.arms or self.arms, self.probed + later.probed
        return replace(self, geometry=geometry, arms=arms, stops=stops, probed=probed, probe=self.probe | later.probe)

    def printer(self) -> DeltaPrinter:
        """Return the printer.

        Raises:
            MeasurementError: a number is missing.
        """
        if missing := [letter for letter in "LRH" if letter not in self.geometry]:
            raise MeasurementError(self.path, f"M665 without {', '.join(missing)}")
        angles = [math.radians(tower + self.geometry.get(a, 0.0)) for tower, a in zip(_TOWERS, _LETTERS, strict=True)]
        stops = [1e-3 * (self.geometry["H"] + self._sign * self.stops.get(letter, 0.0)) for letter in _LETTERS]
        has_trims = self.firmware == "Marlin" and self._takes_trims
        trims = [self.geometry.get(letter, 0.0) if has_trims else 0.0 for letter in _TRIMS]
        arms = [1e-3 * (self.arms[k % len(self.arms)] + trim) for k, trim in enumerate(trims)]
        (a, b, c), (x, y, z), (one, two, three) = angles, stops, arms
        return DeltaPrinter(1e-3 * self.geometry["R"], (a, b, c), (one, two, three), (x, y, z))

    def touches(self, printer: DeltaPrinter) -> Touches:
        """Return the touches of the bed: where the printer's drives were, at a height of 0.

        Raises:
            MeasurementError: there are none.
        """
        if not self.probed:
            ways = "Bed X: .. Y: .. Z: .., G33, bed probe heights, or heightmap.csv beside it"
            raise MeasurementError(self.path, f"no heights of the bed after M665: {ways}", self.begins)
        points = 1e-3 * (np.array(self.probed) - [*(self.probe.get(letter, 0.0) for letter in "XY"), 0.0])
        slope = [0.01 * self.stops.get(letter, 0.0) if self._sign > 0.0 else 0.0 for letter in "AB"]
        bed = points[:, :2] @ slope  # its height where the drives' frame is level
        travels = printer.drives(points + bed[:, None] * [0.0, 0.0, 1.0]) - printer.at_end_stops
        return Touches.of(travels, bed)

    def with_printer(self, printer: DeltaPrinter, mesh: BedMesh | None = None) -> str:
        """Return M665 and M666 with another printer's numbers."""
        stops = 1e3 * np.array(printer.end_stops)
        height = float(stops.mean() if self._sign > 0.0 else stops.min())
        angles = [math.degrees(angle) - tower for angle, tower in zip(printer.angles, _TOWERS, strict=True)]
        turned = " ".join(f"{letter}{angle:.4f}" for letter, angle in zip(_LETTERS, angles, strict=True))
        arms, trims, kept = 1e3 * np.array(printer.arms), "", ""
        own_lengths = np.ptp(arms) > _SAME or len(self.arms) > len(arms)
        lengths = [f"{arm:.4f}" for arm in (arms if own_lengths else arms[:1])]
        length = ":".join([*lengths, *(f"{arm:g}" for arm in self.arms[len(arms) :])])
        if self.firmware == "Marlin" and self._takes_trims:
            length = f"{arms.mean():.4f}"
            trims = "".join(f" {a}{arm - arms.mean():.4f}" for a, arm in zip(_TRIMS, arms, strict=True))
        else:
            trims = f" B{self.geometry['B']:g}" if "B" in self.geometry else ""
            kept = "".join(f" {letter}{self.stops[letter]:g}" for letter in "ABUVW" if letter in self.stops)
        own = " ".join(
            f"{letter}{self._sign * (stop - height):.4f}" for letter, stop in zip(_LETTERS, stops.tolist(), strict=True)
        )
        return f"M665 L{length} R{1e3 * printer.radius:.4f} H{height:.4f}{trims} {turned}\nM666 {own}{kept}\n"

    @property
    def _takes_trims(self) -> bool:
        """Whether arms may differ: in Marlin 1, whose M665 has B alone, they may not."""
        return self.firmware != "Marlin" or radius_of_g33(self.geometry) is None

    @property
    def _sign(self) -> float:
        return 1.0 if self.firmware == "RepRapFirmware" else -1.0
