"""Reports of Marlin's G33: the settings of a delta printer, and heights of the bed at up to seven places.

The places are the centre, c, and on a circle those before the towers, x, y and z, and opposite to them, yz, zx and xy.
Heights belong to the settings that were reported before them: at the end of a calibration G33 reports others. With four
points a side or more (P4 and above) each height is an average over a part of the circle, which hides the errors that
are sought; P3 reports single touches, but for the centre: there it is the mean of three, a tenth of the circle away.

The radius of the circle is what the report says, "at radius:"; R in the command then made the circle smaller by as
much. Where the report says none, R is the radius itself, and without R it is the B of M665. Reports with the words
"Tower angle" are of versions that had no R and ignored it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pm3dof_pin.exceptions import MeasurementError

_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)"
_COMMAND = re.compile(r"\bG33(?![\d.])(?!\s*AUTO)([^;]*)")
_WORD = re.compile(rf"([A-Z])\s*({_NUMBER})")
_RADIUS = re.compile(rf"Checking\.\.\. AC at radius:\s*({_NUMBER})")
_WITHOUT_R = re.compile(r"\.Tower angle")
_SETTINGS = re.compile(r"\.(?:Height:|Tower angle\s*:|\s+Tx:)")
_SETTING = re.compile(rf"\b(Height|Radius|[ET][xyz]):\s*({_NUMBER})(?![\w.])")
_RESULTS = re.compile(r"\.\s+(?:c|yz):")
_ROW = re.compile(rf"\.\s+((?:(?:c|[xyz]|yz|zx|xy):\s*{_NUMBER}\s*)+)$")
_RESULT = re.compile(rf"(c|yz|zx|xy|[xyz]):\s*({_NUMBER})")
_DIRECTIONS = {"x": 210.0, "xy": 270.0, "y": 330.0, "yz": 30.0, "z": 90.0, "zx": 150.0}
_SINGLE = 3.0  # points a side that are not averaged


@dataclass
class G33Reports:
    """What was reported up to some line."""

    path: Path  #: the log
    settings: dict[str, float] = field(default_factory=dict)  #: Height, Ex ... Ez, Radius, Tx ... Tz [mm, degrees]
    _points: float | None = None  # P of the last command
    _given: float | None = None  # its R [mm]
    _radius: float | None = None  # that was reported [mm]

    @property
    def geometry(self) -> dict[str, float]:
        """The settings in the words of M665."""
        words = {"H": "Height", "R": "Radius", "X": "Tx", "Y": "Ty", "Z": "Tz"}
        return {word: self.settings[name] for word, name in words.items() if name in self.settings}

    @property
    def stops(self) -> dict[str, float]:
        """The settings in the words of M666."""
        words = {"X": "Ex", "Y": "Ey", "Z": "Ez"}
        return {word: self.settings[name] for word, name in words.items() if name in self.settings}

    def heights(self, line: str, number: int, radius: float | None) -> list[tuple[float, float, float]]:
        """Read a line; return the places and heights that it reports [mm].

        Args:
            line: the line.
            number: which one it is.
            radius: of the circle if neither a report nor R says it [mm].

        Raises:
            MeasurementError: a height is not a number, may be an average, or was probed at an unknown radius.
        """
        if command := _COMMAND.search(line.upper()):
            words = {letter: float(value) for letter, value in _WORD.findall(command[1])}
            self._points, self._given, self._radius = words.get("P"), words.get("R"), None
        elif found := _RADIUS.search(line):
            self._radius = float(found[1])
        elif _SETTINGS.search(line):
            self.settings |= {name: float(value) for name, value in _SETTING.findall(line)}
            self._given = None if _WITHOUT_R.search(line) else self._given
        if not _RESULTS.search(line):
            return []
        if not (row := _ROW.search(line.rstrip())):
            raise MeasurementError(self.path, f"'{line.strip()}': expected numbers, as in c:+0.03 x:-0.12", [number])
        if self._points is None or self._points > _SINGLE:
            what = "G33 without P" if self._points is None else f"G33 P{self._points:g}"
            problem = f"{what}: heights that may be averages over a part of the circle; expected those of G33 P3 V0"
            raise MeasurementError(self.path, problem, [number])
        around = next((known for known in (self._radius, self._given, radius) if known is not None), None)
        if around is None:
            problem = (
                "heights of G33 at an unknown radius: expected 'at radius:' in its report, R in the command, or the B "
                "(DELTA_CALIBRATION_RADIUS) of M665 without A and C"
            )
            raise MeasurementError(self.path, problem, [number])
        places = {name: np.radians(angle) for name, angle in _DIRECTIONS.items()}
        return [
            (around * np.cos(places[name]), around * np.sin(places[name]), float(height))
            if name in places
            else (0.0, 0.0, float(height))
            for name, height in _RESULT.findall(row[1])
        ]

    @staticmethod
    def are_complete(line: str) -> bool:
        """Tell whether a line reports settings with the radius: others may be those of a calibration of the height."""
        return bool(_SETTINGS.search(line)) and "Radius:" in line


def radius_of_g33(geometry: dict[str, float]) -> float | None:
    """Return the B of Marlin 1's M665, which stands alone; beside A or C it is a trim of Marlin 2."""
    return None if "A" in geometry or "C" in geometry else geometry.get("B")
