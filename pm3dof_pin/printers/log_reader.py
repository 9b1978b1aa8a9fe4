"""Reading what RepRapFirmware and Marlin print, line by line: numbers of a printer, and heights probed with them.

Marlin writes "Bed X: 10.0 Y: 20.0 Z: 0.12"; for RepRapFirmware the G30 P... X... Y... lines of bed.g are paired with
its answer "bed probe heights: 0.12 -0.03 ...", without the mean and deviation at its end. P is the number of a point;
P0 begins anew. These points are the probe's, from which the nozzle is away by the X and Y of G31, or of M851 in Marlin.
Those of Marlin's G33 are the nozzle's (:mod:`~pm3dof_pin.printers.g33`). Letters may be small. What stands before a
command or an answer, such as a time or "Recv:", is passed over, and so are colours of a terminal.

M665 begins anew. Heights that were probed after M666, G31, M851 or the settings of G33 changed a number replace those
before, so all that are kept belong to the same numbers. What may have changed numbers, and does not print them, leaves
them in doubt until M665 or the settings of G33 follow; heights that were probed in doubt are refused.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.printers.g33 import G33Reports, radius_of_g33

_NUMBER = r"[-+]?[0-9]+(?:\.[0-9]*)?|[-+]?\.[0-9]+"
_ENDED = r"(?=[\s,\"'\\]|$)"  # after a number of an answer: else it is another one, as 1 is of 1e3 and of 1:30
_WORD = re.compile(rf"([A-Z])\s*({_NUMBER})")
_ARMS = re.compile(rf"L\s*((?:{_NUMBER})(?:\s*:\s*(?:{_NUMBER}))*)")
_WORDS = re.compile(rf"(?:\s*(?:{_ARMS.pattern}|[A-DF-Z]\s*(?:{_NUMBER})))+\s*(?:\*\d+)?\s*")
_MARLIN = re.compile(rf"Bed X:\s*({_NUMBER})\s*Y:\s*({_NUMBER})\s*Z:\s*({_NUMBER})(?!,){_ENDED}")
_FAILED = "probing failed|not set"
_HEIGHTS = re.compile(rf"bed probe heights:\s*((?:(?:{_NUMBER}|{_FAILED}){_ENDED}[\s,]*)*)([-+.\d]?)", re.IGNORECASE)
_DIAGNOSTICS = re.compile(r"Bed compensation in use|Error status")  # M122 prints heights of some points after these
_POINT = re.compile(r"\bG30(?!\d)[^;]*P\s*\d+[^;]*")
_COLOUR = re.compile(r"\x1b\[[\d;?]*[A-Za-z]|\0")
_DIAGONALS = re.compile(
    rf"Diagonals? ([\d.:]+), delta radius ({_NUMBER}), homed height ({_NUMBER}), bed radius ({_NUMBER}), "
    rf"X ({_NUMBER})[^,]*, Y ({_NUMBER})[^,]*, Z ({_NUMBER}).*"
)
_ENDSTOPS = re.compile(
    rf"Endstop adjustments (X(?:{_NUMBER}) Y(?:{_NUMBER}) Z(?:{_NUMBER})), tilt X({_NUMBER})% Y({_NUMBER})%.*"
)
"""Answers of RepRapFirmware to M665 and M666 without words."""
_CHANGED = r"CALIBRATED \d+ FACTORS|ITERATION ?: ?\d|\bM50[12]\b|(?:^|RECV: *)START\s*$"
_M665, _M666, _G28, _G21 = "M665 with L, R and H", "M666", "G28", "G21"
_DOUBTS = {
    _M665: re.compile(_CHANGED),
    _M666: re.compile(rf"{_CHANGED}|M666 OFFSETS MUST"),
    _G28: re.compile(r"\bG92\b.*Z|\bG30\s*(?:\*\d+\s*)?$"),
    _G21: re.compile(r"\bG20\b"),
}
"""What leaves numbers, the height of 0 or the unit in doubt, by what settles it."""
_SETTLED = {_G28: re.compile(r"\bG(?:28|33)\b"), _G21: re.compile(r"\bG21\b")}
_Height = tuple[float, float, float, bool]  # place and height [mm], and whether the place is the nozzle's


class LogReader:
    """What was read up to some line."""

    def __init__(self, path: Path) -> None:
        self.firmware: Literal["RepRapFirmware", "Marlin"] = "RepRapFirmware"  #: whose the log is
        self.geometry: dict[str, float] = {}  #: words of M665 [mm, degrees]
        self.arms: tuple[float, ...] = ()  #: its L
        self.begins: tuple[int, ...] = ()  #: line of the last M665, if there is one
        self._path, self._reports = path, G33Reports(path)
        self._stops: dict[str, float] = {}
        self._probe: dict[str, float] = {}
        self._probed: list[_Height] = []
        self._probed_with: tuple[dict[str, float], ...] = ()  # settings of G33, stops and place of the probe
        self._points: dict[float, tuple[float, float]] = {}
        self._answer = ""  # the last heights of RepRapFirmware
        self._doubts: dict[str, tuple[int, str]] = {}  # line and text of what caused a doubt
        self._problem: MeasurementError | None = None

    @property
    def stops(self) -> dict[str, float]:
        """Words of M666 with which heights were probed, or of the last one [mm, %]."""
        return self._stops | (self._probed_with[1] if self._probed else {})

    @property
    def probe(self) -> dict[str, float]:
        """X and Y of the probe with which heights were probed, or the last ones [mm]."""
        known = self._probe | (self._probed_with[2] if self._probed else {})
        return {letter: known[letter] for letter in "XY" if letter in known}

    @property
    def probed(self) -> tuple[tuple[float, float, float], ...]:
        """Places of the probe and heights [mm]."""
        x, y = (self.probe.get(letter, 0.0) for letter in "XY")
        return tuple((a + x * own, b + y * own, height) for a, b, height, own in self._probed)

    def read(self, text: str) -> None:
        """Read a log.

        Raises:
            MeasurementError: a line is not understood, or heights were probed in doubt and M665 does not begin anew.
        """
        before = ""
        for number, raw in enumerate(text.splitlines(), start=1):
            line = _DIAGONALS.sub(r"M665 L\1 R\2 H\3 B\4 X\5 Y\6 Z\7", _COLOUR.sub("", raw))
            line = _ENDSTOPS.sub(r"M666 \1 A\2 B\3", line)
            self._read_line(line, number, is_of_diagnostics=bool(_DIAGNOSTICS.search(before)))
            before = line
        if self._problem is not None:
            raise self._problem

    def _read_line(self, line: str, number: int, *, is_of_diagnostics: bool) -> None:
        code = _code(line)
        words = {letter: float(value) for letter, value in _WORD.findall(code)}
        is_point = bool(_POINT.search(code))
        # two words, of which one is the command: prose that mentions it has one
        is_command = len(words) > 1
        if is_command and ("M665" in code or "M666" in code or is_point) and not _WORDS.fullmatch(code):
            problem = f"'{code.strip()}': expected letters, each with a number such as 105.5"
            raise MeasurementError(self._path, problem, [number])
        self._doubts |= {settled: (number, line.strip()) for settled, cause in _DOUBTS.items() if cause.search(code)}
        for settled, cause in _SETTLED.items():
            if cause.search(code):
                self._doubts.pop(settled, None)
        if is_command and "M665" in code:
            self._begin(code, words, number)
        elif is_command and "M666" in code:
            self._take_settings()
            self._stops = self._stops | words
            self._reports.settings.clear()
            self._doubts.pop(_M666, None)
        elif ("M851" in code and is_command) or ("G31" in code and not words.get("K")):  # of the first probe
            if re.search(rf"[XY](?!\s*(?:{_NUMBER})(?![0-9.:]))", code):
                raise MeasurementError(self._path, f"'{code.strip()}': expected numbers after X and Y", [number])
            self._probe = self._probe | {letter: words[letter] for letter in "XYZ" if letter in words}
        elif "Bed X:" in line:
            if not (found := _MARLIN.search(line)):
                problem = f"'{line.strip()}': expected numbers, as in Bed X: 10.0 Y: 20.0 Z: 0.12"
                raise MeasurementError(self._path, problem, [number])
            self._add([(float(found[1]), float(found[2]), float(found[3]), False)], number, "Marlin")
        elif reported := self._reports.heights(line, number, radius_of_g33(self.geometry)):
            self._add([(*row, True) for row in reported], number, "Marlin")
        elif (found := _HEIGHTS.search(line)) and any(found.groups()) and not is_of_diagnostics:
            if found[2]:
                problem = f"'{line.strip()}': expected numbers, as in bed probe heights: 0.12 -0.03"
                raise MeasurementError(self._path, problem, [number])
            self._answer_of_points(found[1], number)
        elif is_point and {"X", "Y"} <= set(words):
            self._points = {} if words["P"] == 0.0 else self._points
            self._points[words["P"]] = words["X"], words["Y"]
            self._answer = ""
        if self._reports.are_complete(line):
            self._doubts = {key: cause for key, cause in self._doubts.items() if key not in (_M665, _M666)}

    def _begin(self, code: str, words: dict[str, float], number: int) -> None:
        """Take the numbers of M665; heights before were probed with others."""
        self._take_settings()
        self.geometry |= words
        if lengths := _ARMS.search(code):
            self.arms = tuple(float(length) for length in lengths[1].split(":"))
            if len(self.arms) == 2:  # more than three belong to towers that do not carry the nozzle
                raise MeasurementError(self._path, "M665 L has 2 lengths; expected one, or one a tower", [number])
        if words.keys() == {"M", "B"} and radius_of_g33(self.geometry) is not None:
            return  # the radius of G33 in Marlin 1, no number of the printer
        self._probed, self._problem, self._answer, self.begins = [], None, "", (number,)
        self._reports.settings.clear()
        if {"L", "R", "H"} <= words.keys():
            self._doubts.pop(_M665, None)

    def _take_settings(self) -> None:
        """Take the settings that G33 reported last."""
        if self._reports.settings:
            self.geometry |= self._reports.geometry
            self._stops = self._stops | self._reports.stops

    def _answer_of_points(self, answer: str, number: int) -> None:
        """Pair an answer with the points; one that is printed twice counts once, and failed points do not."""
        words = re.findall(rf"{_NUMBER}|{_FAILED}", answer, re.IGNORECASE)
        if len(words) != len(self._points):
            problem = f"{len(words)} bed probe heights for {len(self._points)} points (G30 P... X... Y...)"
            raise MeasurementError(self._path, problem, [number])
        places = [self._points[point] for point in sorted(self._points)]
        rows = [(x, y, float(w), False) for (x, y), w in zip(places, words, strict=True) if not w[-1].isalpha()]
        if answer != self._answer:
            self._add(rows, number, "RepRapFirmware")
        self._answer = answer

    def _add(self, rows: list[_Height], number: int, firmware: Literal["RepRapFirmware", "Marlin"]) -> None:
        """Add heights; those before are dropped if numbers changed in between."""
        self._take_settings()
        now = dict(self._reports.settings), self._stops, self._probe
        if self._probed_with != now:
            self._probed, self._problem = [], None
        self._probed += rows
        self._probed_with, self.firmware = now, firmware
        doubts: dict[str, Any] = dict(self._doubts)
        if firmware == "Marlin" and "G30" in doubts.get(_G28, (0, ""))[1].upper():
            del doubts[_G28]  # its G30 only probes
        if doubts and self._problem is None:
            expected, (line, cause) = next(iter(doubts.items()))
            problem = f"heights probed after line {line}, '{cause}', may belong to other numbers"
            problem += f": expected {expected} after it"
            self._problem = MeasurementError(self._path, problem, [number])


def _code(line: str) -> str:
    """Return a line in capitals from the command that is read on, without comments; else all of it."""
    words = re.sub(r"\([^)]*\)", "", line.split(";", 1)[0]).upper()
    found = re.search(r"M665|M666|M851|\bG3[01](?!\d)", words)
    return words[found.start() :] if found else words
