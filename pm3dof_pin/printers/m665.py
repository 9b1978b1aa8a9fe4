"""Logs of RepRapFirmware and Marlin: M665 and M666, and heights of the bed that were probed with G30.

Both place the towers X, Y, Z at 210, 330 and 90 degrees, corrected by the X, Y, Z of M665 (Marlin also trims
each arm by A, B, C, which are refused unless they are 0). The nozzle is at the height H when homed, corrected by M666
in RepRapFirmware; Marlin's M666 says how far each carriage moves back from its end stop, which is higher by as much.

A probed height h at (x, y) means that the printer, as it was, took the nozzle to be at (x, y, h) when it touched the
bed. Marlin writes "Bed X: 10.0 Y: 20.0 Z: 0.12"; for RepRapFirmware the G30 P... X... Y... lines of bed.g are paired
with the numbers of its answer "bed probe heights: 0.12 -0.03 ...", without the mean and deviation at its end.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.printers.delta_printer import DeltaPrinter
from pm3dof_pin.printers.touches import Touches

_NUMBER = r"-?\d+(?:\.\d*)?|-?\.\d+"
_WORD = re.compile(rf"([A-Z])\s*({_NUMBER})")
_MARLIN = re.compile(rf"Bed X:\s*({_NUMBER})\s*Y:\s*({_NUMBER})\s*Z:\s*({_NUMBER})")
_HEIGHTS = re.compile(rf"bed probe heights:\s*((?:(?:{_NUMBER})[\s,]*)+)", re.IGNORECASE)
_POINT = re.compile(r"\bG30\b[^;]*\bP\s*\d+[^;]*")
_TOWERS = (210.0, 330.0, 90.0)
_LETTERS = "XYZ"


@dataclass(frozen=True)
class GCodeLog:
    """A log, or pieces of one pasted together."""

    path: Path  #: the file
    firmware: Literal["RepRapFirmware", "Marlin"]  #: whose it is
    geometry: dict[str, float]  #: the last M665 [mm, degrees]
    stops: dict[str, float]  #: the last M666 [mm]
    probed: tuple[tuple[float, float, float], ...]  #: points and heights [mm]

    @property
    def most_parameters(self) -> int:
        """One arm length only."""
        return 7

    @classmethod
    def parse(cls, path: Path, text: str) -> GCodeLog:
        """Read the last M665 and M666, and all heights after them.

        Raises:
            MeasurementError: the heights and the points of RepRapFirmware are not as many.
        """
        geometry: dict[str, float] = {}
        stops: dict[str, float] = {}
        points: list[tuple[float, float]] = []
        probed: list[tuple[float, float, float]] = []
        firmware: Literal["RepRapFirmware", "Marlin"] = "RepRapFirmware"
        for line in text.splitlines():
            code = line.split(";", 1)[0]
            words = {letter: float(value) for letter, value in _WORD.findall(code.upper())}
            if "M665" in code:
                if re.search(r"L[^A-Z]*:", code.upper()):
                    raise MeasurementError(
                        path, "M665 L with a length for each tower: not supported, arms must be equal"
                    )
                geometry |= words
                probed = []
            elif "M666" in code:
                stops |= words
            elif found := _MARLIN.search(line):
                firmware = "Marlin"
                probed.append((float(found[1]), float(found[2]), float(found[3])))
            elif found := _HEIGHTS.search(line):
                heights = [float(word) for word in re.findall(_NUMBER, found[1])]
                if len(heights) != len(points):
                    problem = f"{len(heights)} bed probe heights for {len(points)} points (G30 P... X... Y...)"
                    raise MeasurementError(path, problem)
                probed += [(x, y, height) for (x, y), height in zip(points, heights, strict=True)]
            elif _POINT.search(code) and {"X", "Y"} <= set(words):
                points.append((words["X"], words["Y"]))
        return cls(path, firmware, geometry, stops, tuple(probed))

    def printer(self) -> DeltaPrinter:
        """Return the printer.

        Raises:
            MeasurementError: a number is missing, or the arms have trims of their own.
        """
        if missing := [letter for letter in "LRH" if letter not in self.geometry]:
            raise MeasurementError(self.path, f"M665 without {', '.join(missing)}")
        if self.firmware == "Marlin" and any(self.geometry.get(letter, 0.0) for letter in "ABC"):
            raise MeasurementError(self.path, "M665 A, B, C: arms with trims of their own are not supported")
        angles = [math.radians(tower + self.geometry.get(a, 0.0)) for tower, a in zip(_TOWERS, _LETTERS, strict=True)]
        stops = [1e-3 * (self.geometry["H"] + self._sign * self.stops.get(letter, 0.0)) for letter in _LETTERS]
        arm = 1e-3 * self.geometry["L"]
        (a, b, c), (x, y, z) = angles, stops
        return DeltaPrinter(1e-3 * self.geometry["R"], (a, b, c), (arm, arm, arm), (x, y, z))

    def touches(self, printer: DeltaPrinter) -> Touches:
        """Return the touches of the bed: where the printer's drives were, at a height of 0.

        Raises:
            MeasurementError: there are none.
        """
        if not self.probed:
            raise MeasurementError(
                self.path, "no heights of the bed after M665: Bed X: .. Y: .. Z: .., or bed probe heights"
            )
        travels = printer.drives(1e-3 * np.array(self.probed)) - printer.at_end_stops
        return Touches.of(travels, np.zeros(len(travels)))

    def with_printer(self, printer: DeltaPrinter) -> str:
        """Return M665 and M666 with another printer's numbers."""
        stops = 1e3 * np.array(printer.end_stops)
        height = float(stops.mean() if self._sign > 0.0 else stops.min())
        angles = [math.degrees(angle) - tower for angle, tower in zip(printer.angles, _TOWERS, strict=True)]
        turned = " ".join(f"{letter}{angle:.4f}" for letter, angle in zip(_LETTERS, angles, strict=True))
        bed = f" B{self.geometry['B']:g}" if "B" in self.geometry else ""
        size = f"L{1e3 * printer.arms[0]:.4f} R{1e3 * printer.radius:.4f} H{height:.4f}"
        own = " ".join(
            f"{letter}{self._sign * (stop - height):.4f}" for letter, stop in zip(_LETTERS, stops.tolist(), strict=True)
        )
        return f"M665 {size}{bed} {turned}\nM666 {own}\n"

    @property
    def _sign(self) -> float:
        return 1.0 if self.firmware == "RepRapFirmware" else -1.0
