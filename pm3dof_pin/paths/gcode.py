"""Interpreter of a stated subset of G-code, with the meaning that LinuxCNC 2.9 gives its words.

G0 G1 G2 G3 G4 G17 G18 G19 G20 G21 G28 G43 G53 G54 .. G59 G61 G64 G90 G91 G91.1 G93 G94, and G40 G49 G80, which cancel
what the subset does not have; X Y Z A B C, I J K R, F P S; N, T and H numbers; M0 .. M9 and M30. Anything else is
refused with its line. X, Y, Z place the tool point and A, B, C turn the tool, R = Rx(A) Ry(B) Rz(C), in a coordinate
system that is placed in the base of the robot. A letter that a program does not use keeps its value at home.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pm3dof_pin.exceptions import GCodeError
from pm3dof_pin.mechanism.tool_components import rotation_of_angles, tool_components
from pm3dof_pin.typing import Array, Matrix, Vector

MACHINE = 53
"""Number of the coordinate system of the machine: the base of the robot."""

_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))", re.ASCII)
_COMMENT = re.compile(r"\([^()]*\)")
_AXES = "XYZABC"
_LINEAR = 3  # of these, the rest are angles
_PLANES = {17: (0, 1), 18: (2, 0), 19: (1, 2)}
_GROUPS: dict[str, tuple[float, ...]] = {
    "motion": (0, 1, 2, 3, 80),
    "without mode": (4, 28, 53),
    "plane": (17, 18, 19),
    "units": (20, 21),
    "radius compensation": (40,),
    "tool length": (43, 49),
    "coordinate system": (54, 55, 56, 57, 58, 59),
    "path control": (61, 64),
    "distance": (90, 91),
    "arc distance": (91.1,),
    "feed": (93, 94),
}
_GROUP_OF = {number: group for group, numbers in _GROUPS.items() for number in numbers}
_M_GROUP = {0: "stop", 1: "stop", 2: "stop", 30: "stop", 3: "spindle", 4: "spindle", 5: "spindle", 6: "tool"}
_M_GROUP |= {7: "coolant", 8: "coolant", 9: "coolant"}
_ENDS = (2, 30)
_INCH, _MILLIMETRE = 0.0254, 0.001
_RADIUS_ERROR = 1.27e-6  # of an arc: always permitted [m]
_SPIRAL, _SPIRAL_SHARE = 5e-4, 1e-3  # permitted below both, absolute [m] and relative to the radius
_FULL_TURN = 1e-10  # an arc that ends closer to its start makes a whole turn [rad]


class Arc(NamedTuple):
    """The part of a move in the plane of an arc: axes, centre [m], and the signed angle swept [rad]."""

    axes: tuple[int, int]
    centre: tuple[float, float]
    sweep: float


@dataclass(frozen=True, slots=True)
class Move:
    """One move of the tool, in one coordinate system; or a dwell, which ends where it starts."""

    line: int  #: the line of the program
    start: tuple[float, ...]  #: X, Y, Z [m], A, B, C [rad]
    end: tuple[float, ...]
    system: int  #: number of the coordinate system: 54 .. 59, or :data:`MACHINE`
    feed: float | None = None  #: along the path of X, Y, Z [m/s]; None for rapids
    turning_feed: float | None = None  #: of moves that only turn the tool [rad/s]
    duration: float | None = None  #: of a move in inverse time, or a dwell [s]
    arc: Arc | None = None
    blend: float | None = None  #: tolerance of the corner at its end: 0 for G61, P of G64 [m]; None if not given
    #: whether the program has said where X, Y, Z, A, B, C are in a coordinate system; else they follow from home
    named: tuple[bool, ...] = (True,) * len(_AXES)


class GCodeProgram(NamedTuple):
    """The moves of a program, and the letters of axes that it uses."""

    moves: Iterator[Move]  #: interpreted as they are taken, so that long programs need no memory
    letters: frozenset[str]


Systems = Mapping[int, Matrix]
"""Placements of coordinate systems in the base of the robot, by number, shape=(4, 4)."""


def in_machine(placement: Matrix, values: Array, *, turns: bool) -> Array:
    """Return X Y Z A B C of a placed coordinate system in the base, shape=(..., 6); A, B, C only if it `turns`."""
    found = np.array(values, dtype=float)
    rotation, shift = placement[:3, :3], placement[:3, 3]
    found[..., :3] = found[..., :3] @ rotation.T + shift
    if turns and not np.array_equal(rotation, np.eye(3)):
        whole = np.zeros((*found.shape[:-1], 4, 4))
        whole[..., :3, :3] = rotation @ rotation_of_angles(found[..., 3:])
        found[..., 3:] = tool_components(whole)[..., 3:]
    return found


def from_machine(placement: Matrix, values: Array, *, turns: bool) -> Array:
    """Return X Y Z A B C in a placed coordinate system, from those in the base, as :func:`in_machine`."""
    return in_machine(np.asarray(np.linalg.inv(placement), dtype=np.float64), values, turns=turns)


def read_program(
    path: Path | str, text: str, systems: Systems, home: Vector, *, has_tool: bool = False
) -> GCodeProgram:
    """Interpret a program.

    Args:
        path: the file, for messages.
        text: its text.
        systems: the coordinate systems that are placed; a program that uses another is refused. G54 is in the base
            unless placed.
        home: X, Y, Z [m], A, B, C [rad] of the tool point in the base, where the program starts and G28 goes.
        has_tool: whether a tool length is known, which G43 requires.

    Raises:
        GCodeError: a word is not one; when moves are taken, a line is not understood.
    """
    file = Path(path)
    letters = frozenset(letter for _, words in _words(file, text) for letter, _ in words if letter in _AXES)
    known = {54: np.eye(4), **systems, MACHINE: np.eye(4)}
    interpreter = _Interpreter(file, known, home, letters, has_tool=has_tool)
    return GCodeProgram(interpreter.run(_words(file, text)), letters)


def _lines(text: str) -> Iterator[str]:
    """Yield the lines, one at a time."""
    first = 0
    while first < len(text):
        end = text.find("\n", first)
        end = len(text) if end < 0 else end
        yield text[first:end]
        first = end + 1


def _words(path: Path, text: str) -> Iterator[tuple[int, list[tuple[str, float]]]]:
    """Yield the number and the words of each line that has some; a program that begins with % ends at the next."""
    percents, is_begun = 0, False
    for number, raw in enumerate(_lines(text), start=1):
        code = _COMMENT.sub("", raw).partition(";")[0].upper()
        code = "".join(code.split())
        if not code:
            continue
        if code == "%":
            percents += 1
            if percents == 1 and is_begun:
                raise GCodeError(path, number, "a % after other lines: expected it in the first, or none")
            if percents == 2:
                return
            continue
        is_begun = True
        words, place = [], 0
        while match := _WORD.match(code, place):
            words.append((match[1], float(match[2])))
            place = match.end()
        if place < len(code):
            what = "an unclosed comment" if "(" in code[place:] else f"'{code[place:][:16]}'"
            raise GCodeError(path, number, f"{what} is not understood; expected words such as G1, X10.5 or F600")
        yield number, words


class _Interpreter:
    """The state of a program between its lines."""

    def __init__(self, path: Path, systems: Systems, home: Vector, letters: frozenset[str], *, has_tool: bool) -> None:
        self._moves: list[Move] = []
        self._path, self._systems, self._home, self._has_tool = path, systems, home, has_tool
        self._turns = bool(letters & {*_AXES[_LINEAR:]})
        self._line = 0
        self._motion: int | None = None
        self._plane, self._unit, self._relative = 17, _MILLIMETRE, False
        self._inverse_time, self._feed, self._feed_unit = False, 0.0, _MILLIMETRE
        self._blend: float | None = None
        self._system = 54
        self._tool: int | None = None
        self._long = False
        self._named = np.zeros(len(_AXES), dtype=bool)
        self._position = self._seen_from(self._system, np.array(home, dtype=np.float64))

    def run(self, lines: Iterable[tuple[int, list[tuple[str, float]]]]) -> Iterator[Move]:
        """Yield the moves of lines, up to the end of the program."""
        for line, words in lines:
            goes_on = self._execute(line, words)
            yield from self._moves
            self._moves.clear()
            if not goes_on:
                return

    def _execute(self, line: int, words: list[tuple[str, float]]) -> bool:
        """Execute a line; return whether the program goes on."""
        self._line = line
        if len(words) == 1 and words[0][0] == "N":
            return True
        g, m, given = self._sorted(words)
        self._set_modes(g, given)
        if 6 in m.values() and "T" not in given and self._tool is None:
            raise self._error("M6 without the number of a tool, T")
        axes = [letter for letter in _AXES if letter in given]
        special = g.get("without mode")
        if special == 4:
            self._dwell(given, axes)
        elif special == 28:
            if g.get("motion") is not None:
                raise self._error(f"G28 and G{g['motion']:g} on one line")
            self._go_home(given, axes)
        else:
            self._move(g, given, axes, machine=special == 53)
        return not any(number in _ENDS for number in m.values())

    def _sorted(self, words: list[tuple[str, float]]) -> tuple[dict[str, float], dict[str, int], dict[str, float]]:
        """Return G words and M words by group, and the other words by letter."""
        g: dict[str, float] = {}
        m: dict[str, int] = {}
        given: dict[str, float] = {}
        for letter, number in words:
            if letter == "G":
                group = _GROUP_OF.get(number)
                if group is None:
                    raise self._error(f"G{number:g} is not understood")
                if group in g:
                    raise self._error(f"G{g[group]:g} and G{number:g} on one line exclude each other")
                g[group] = number
            elif letter == "M":
                kind = _M_GROUP.get(int(number)) if number == int(number) else None
                if kind is None:
                    raise self._error(f"M{number:g} is not understood")
                if kind in m:
                    raise self._error(f"M{m[kind]} and M{number:g} on one line exclude each other")
                m[kind] = int(number)
            elif letter not in "XYZABCIJKRFPSNTH":
                raise self._error(f"the word {letter}{number:g} is not understood")
            elif letter in given:
                raise self._error(f"two words {letter} on one line")
            else:
                given[letter] = number
        return g, m, given

    def _set_modes(self, g: dict[str, float], given: dict[str, float]) -> None:
        unit = {20: _INCH, 21: _MILLIMETRE}.get(int(g.get("units", 0)), self._unit)
        if "F" in given and unit != self._unit:
            raise self._error(f"F on the line of G{g['units']:g}, which changes its unit: expected it on a later line")
        self._unit = unit
        if "feed" in g:  # the word alone takes the feed back, as in LinuxCNC
            self._inverse_time, self._feed = g["feed"] == 93, 0.0
        for letter, what in (("F", "feed"), ("S", "spindle speed"), ("T", "tool number"), ("H", "tool number")):
            if given.get(letter, 0.0) < 0.0:
                raise self._error(f"the {what} {letter}{given[letter]:g} is negative")
        if self._inverse_time:
            self._feed = given.get("F", 0.0)
        elif "F" in given:
            self._feed = given["F"]
            self._feed_unit = self._unit
        if "T" in given:
            if self._tool is not None and given["T"] != self._tool:
                raise self._error(f"T{given['T']:g} is a second tool, after T{self._tool}: expected one for each file")
            self._tool = int(given["T"])
        self._plane = int(g.get("plane", self._plane))
        self._set_tool_length(g, given)
        if "coordinate system" in g:
            self._change_system(int(g["coordinate system"]))
        self._set_path_control(g, given)
        self._relative = bool(g.get("distance", 91 if self._relative else 90) == 91)

    def _set_tool_length(self, g: dict[str, float], given: dict[str, float]) -> None:
        match g.get("tool length"):
            case 43:
                if not self._has_tool:
                    raise self._error("G43 needs the length of the tool, which is not given")
                self._long = True
            case 49 if self._long:
                raise self._error("G49 is not understood after G43: X, Y, Z are those of the tool point throughout")
        if "H" in given and g.get("tool length") != 43:
            raise self._error("the word H is not understood without G43")

    def _set_path_control(self, g: dict[str, float], given: dict[str, float]) -> None:
        match g.get("path control"):
            case 61:
                self._blend = 0.0
            case 64:
                tolerance = given.get("P")
                if tolerance is not None and tolerance < 0.0:
                    raise self._error(f"the tolerance P{tolerance:g} of G64 is negative")
                self._blend = None if tolerance is None else tolerance * self._unit

    def _change_system(self, number: int) -> None:
        if number not in self._systems:
            raise self._error(f"G{number} is used, and where its zero lies is not given")
        before = in_machine(self._systems[self._system], self._position, turns=self._turns)
        self._system, self._position = number, self._seen_from(number, before)

    def _seen_from(self, system: int, machine: Array) -> Array:
        """Return X Y Z A B C in a coordinate system, from those in the base."""
        return from_machine(self._systems[system], machine, turns=self._turns)

    def _dwell(self, given: dict[str, float], axes: list[str]) -> None:
        if axes or given.get("P", -1.0) < 0.0:
            raise self._error("expected G4 P with a time in seconds, and no axes")
        place = tuple(self._position.tolist())
        named = tuple(self._named.tolist())
        self._moves.append(Move(self._line, place, place, self._system, duration=given["P"], named=named))

    def _go_home(self, given: dict[str, float], axes: list[str]) -> None:
        if axes:
            self._add(self._target(given, axes), None)
        place = in_machine(self._systems[self._system], self._position, turns=self._turns)
        target = place.copy()
        chosen = [_AXES.index(letter) for letter in axes] or list(range(len(_AXES)))
        target[chosen] = np.asarray(self._home)[chosen]
        self._add_in_machine(place, target, None)

    def _move(self, g: dict[str, float], given: dict[str, float], axes: list[str], *, machine: bool) -> None:
        if "motion" in g:
            self._motion = None if g["motion"] == 80 else int(g["motion"])
        motion, is_arc = self._motion, self._motion in (2, 3)
        others = [letter for letter in "IJKR" if letter in given]
        if others and not ((is_arc and axes) or (is_arc and "R" not in others)):
            raise self._error(f"the word {others[0]} is not understood without an arc, G2 or G3")
        if "P" in given and g.get("path control") != 64 and not (is_arc and (axes or others)):
            raise self._error("the word P is not understood here")
        if not axes and not others:
            if machine:
                raise self._error("G53 without axes")
            if g.get("motion") in (2, 3):
                raise self._error(f"an arc, G{motion}, without axes and centre")
            return
        if motion is None:
            raise self._error(f"{(axes or others)[0]} without a motion, G0, G1, G2 or G3")
        feed = self._required_feed() if motion else None
        if machine:
            if is_arc:
                raise self._error("G53 with an arc: expected G0 or G1")
            if self._relative:
                raise self._error("G53 in incremental distances, G91: expected G90 before")
            place = in_machine(self._systems[self._system], self._position, turns=self._turns)
            target = place.copy()
            for letter in axes:
                target[_AXES.index(letter)] = self._number(letter, given[letter])
            self._add_in_machine(place, target, feed)
            return
        target = self._target(given, axes)
        self._add(target, feed, self._arc(target, given, others) if is_arc else None)

    def _required_feed(self) -> float:
        if self._feed <= 0.0:
            each = "on every line in inverse time, G93" if self._inverse_time else "before or with this line"
            raise self._error(f"a feed is missing: expected F with a positive number, {each}")
        return self._feed

    def _number(self, letter: str, number: float) -> float:
        return number * self._unit if _AXES.index(letter) < _LINEAR else math.radians(number)

    def _target(self, given: dict[str, float], axes: list[str]) -> Array:
        target = self._position.copy()
        for letter in axes:
            index, number = _AXES.index(letter), self._number(letter, given[letter])
            target[index] = target[index] + number if self._relative else number
            self._named[index] |= not self._relative
        return target

    def _arc(self, target: Array, given: dict[str, float], others: list[str]) -> Arc:
        first, second = _PLANES[self._plane]
        start, end = self._position[[first, second]], target[[first, second]]
        allowed = ("IJK"[first], "IJK"[second])
        if wrong := [letter for letter in others if letter not in (*allowed, "R")]:
            raise self._error(f"the word {wrong[0]} is not in the plane of the arc, G{self._plane}")
        turns = given.get("P", 1.0)
        if turns < 1.0 or turns != int(turns):
            raise self._error(f"P{turns:g} turns of an arc: expected a whole number of at least 1")
        clockwise = self._motion == 2
        if "R" in others:
            if len(others) > 1:
                raise self._error("an arc with both R and a centre")
            centre = self._centre(start, end, given["R"] * self._unit, clockwise=clockwise)
        elif others:
            centre = start + np.array([given.get(letter, 0.0) for letter in allowed]) * self._unit
        else:
            raise self._error(f"an arc needs its radius R, or its centre {' and '.join(allowed)}")
        radii = np.linalg.norm([start - centre, end - centre], axis=1)
        off = abs(radii[1] - radii[0])
        if radii[0] == 0.0 or off > max(_RADIUS_ERROR, min(_SPIRAL, _SPIRAL_SHARE * radii[0])):
            words = " and ".join(f"{1e3 * radius:.4f}" for radius in radii)
            raise self._error(f"the ends of the arc are at different distances from its centre: {words} mm")
        angles = [math.atan2(*(point - centre)[::-1]) for point in (start, end)]
        sweep = (angles[1] - angles[0]) % (2.0 * math.pi)
        if sweep < _FULL_TURN or 2.0 * math.pi - sweep < _FULL_TURN:
            sweep = 0.0
        if clockwise:
            sweep = sweep - 2.0 * math.pi
        elif sweep == 0.0:
            sweep = 2.0 * math.pi
        sweep += math.copysign(2.0 * math.pi * (turns - 1.0), sweep)
        return Arc((first, second), (float(centre[0]), float(centre[1])), sweep)

    def _centre(self, start: Array, end: Array, radius: float, *, clockwise: bool) -> Array:
        """Return the centre of an arc by its radius; a negative one is that of the longer arc."""
        chord = end - start
        half = 0.5 * float(np.hypot(*chord))
        if half == 0.0:
            raise self._error("an arc with R that ends where it starts: expected its centre")
        square = radius**2 - half**2
        if square < -2.0 * abs(radius) * _RADIUS_ERROR:
            raise self._error(f"the radius R{abs(radius) / self._unit:g} of the arc is too small for its ends")
        left = np.array([-chord[1], chord[0]]) / (2.0 * half)
        side = -1.0 if clockwise == (radius > 0.0) else 1.0
        return np.asarray(start + 0.5 * chord + side * math.sqrt(max(square, 0.0)) * left)

    def _add_in_machine(self, place: Array, target: Array, feed: float | None) -> None:
        """Add a straight move in the base of the robot."""
        system, self._system, self._position = self._system, MACHINE, place
        self._add(target, feed)
        self._system, self._position = system, self._seen_from(system, target)

    def _add(self, target: Array, feed: float | None, arc: Arc | None = None) -> None:
        start, self._position = self._position, target
        speeds: dict[str, Any] = {}
        if feed is not None and self._inverse_time:
            speeds = {"duration": 60.0 / feed}
        elif feed is not None:
            speeds = {"feed": feed * self._feed_unit / 60.0, "turning_feed": math.radians(feed) / 60.0}
        ends, named = (tuple(start.tolist()), tuple(target.tolist())), tuple(self._named.tolist())
        self._moves.append(Move(self._line, *ends, self._system, arc=arc, blend=self._blend, named=named, **speeds))

    def _error(self, problem: str) -> GCodeError:
        return GCodeError(self._path, self._line, problem)
