"""The interpreter of G-code against LinuxCNC's own, and against arithmetic by hand; damaged programs."""

from __future__ import annotations

import itertools
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from pm3dof_pin.exceptions import GCodeError
from pm3dof_pin.paths.gcode import Move, read_program
from pm3dof_pin.paths.tool_path import from_moves

RS274 = shutil.which("rs274")
POCKET = """%
(pocket)
N10 G21 G90 G17 G40 G80 G54 G64 P0.02
T1 M6
S8000 M3
G0 X10 Y0 Z5 ; above
G1 Z-2 F300
X20.5 F600
G3 X0 Y20.5 I-20.5 J0
G3 X20.5 Y0 R-20.5
G2 X22.5 I1 J0 Z-3
G91 G1 X-1.5 Y.5 A10 C-5
G90 X0 Y0 A0 C0
G4 P0.25
G18 G2 X4 Z-3 I2 K0
G19 G3 Y3 Z0 J0 K3
G17
G93 G1 X1 Y1 F2
X2 F3
G94
G20
G1 X1 Y.5 F10
X.5
G21 G61
G3 X12.7 Y12.7 I2 J2 P2
G53 G0 Z3
G28 Z8
M5
M2
"""


class Interpreted(NamedTuple):
    moves: list[Move]
    letters: frozenset[str]


def interpreted(text: str, *, has_tool: bool = False) -> Interpreted:
    program = read_program("part.ngc", text, {55: np.eye(4)}, np.zeros(6), has_tool=has_tool)
    return Interpreted(list(program.moves), program.letters)


def by_linuxcnc(text: str, folder: Path) -> list[tuple[str, list[float]]]:
    """Return the canonical moves that LinuxCNC makes of a program, in its millimetres and degrees."""
    assert RS274 is not None
    file = folder / "part.ngc"
    file.write_text(text, encoding="utf-8")
    tools = folder / "tool.tbl"
    tools.write_text("T1 P1 Z0\n", encoding="utf-8")
    command = [RS274, "-g", "-t", str(tools), str(file)]
    lines = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, stdin=subprocess.DEVNULL, timeout=60, check=False
    )
    found = []
    for line in lines.stdout.splitlines():
        if match := re.search(r"(STRAIGHT_TRAVERSE|STRAIGHT_FEED|ARC_FEED|DWELL|USE_LENGTH_UNITS)\((.*)\)", line):
            words = match[2].replace("CANON_UNITS_", "").split(", ")
            numbers = [{"INCHES": 25.4, "MM": 1.0}.get(word) or float(word) for word in words]
            found.append((match[1], numbers))
    return found


@pytest.mark.skipif(RS274 is None, reason="LinuxCNC is not installed")
def test_every_word_moves_as_in_linuxcnc(tmp_path: Path) -> None:
    program = interpreted(POCKET)
    path = from_moves(program.moves, program.letters, {})
    unit, checked = 1.0, 0
    ours = iter(zip(program.moves, path.end, strict=True))
    for name, numbers in by_linuxcnc(POCKET, tmp_path):
        if name == "USE_LENGTH_UNITS":
            unit = numbers[0]
            continue
        move, end = next(ours)
        place = [*(1e3 * end[:3]), *np.degrees(end[3:])]
        if name == "DWELL":
            assert move.duration == pytest.approx(numbers[0])
        elif name == "ARC_FEED":
            assert move.arc is not None
            first, second = move.arc.axes
            plane = [place[first], place[second], *(1e3 * np.array(move.arc.centre))]
            np.testing.assert_allclose(np.array(numbers[:4]) * unit, plane, atol=2e-3)
            turns = numbers[4]
            assert math.copysign(1.0, move.arc.sweep) == math.copysign(1.0, turns)
            assert math.ceil(abs(move.arc.sweep) / (2.0 * math.pi) - 1e-9) == abs(turns)
            third = ({0, 1, 2} - {first, second}).pop()
            assert numbers[5] * unit == pytest.approx(place[third], abs=2e-3)
        else:
            np.testing.assert_allclose(np.array(numbers[:3]) * unit, place[:3], atol=2e-3)
            np.testing.assert_allclose(numbers[3:6], place[3:], atol=1e-4)
            assert (move.feed is None and move.duration is None) == (name == "STRAIGHT_TRAVERSE")
        checked += 1
    assert next(ours, None) is None
    assert checked == len(program.moves) == 19


@pytest.mark.skipif(RS274 is None, reason="LinuxCNC is not installed")
@pytest.mark.parametrize(
    ("text", "refused"),
    [
        ("%\nG21 G1 X1 F1\n%\nG1 X2\n", None),
        ("n5 G21 g 1 x 1 . 5 (half way) y-.5 f1 ; on\nG91 X+5\nM30\nX7\n", None),
        ("G20\nG18 G2 X1 Z1 I1 K0 P2 F1\n", None),
        ("G21 (half\nG0 X1\n", 1),
        ("G21\n%\nG0 X1\n", 2),
        ("G21 G0 X1 X2\n", 1),
        ("G21 G93 G1 X1 F2\nX2\n", 2),
        ("G21 G94 G1 X1 F2\nG94 X2\n", 2),
        ("G21 M7 M8 G0 X1\n", 1),
        ("G21 G91 G0 X1\nG53 G0 X1\n", 2),
        ("G21 G0 X1\nG2 F3\n", 2),
    ],
)
def test_forms_of_lines_are_taken_and_refused_as_by_linuxcnc(text: str, refused: int | None, tmp_path: Path) -> None:
    theirs = [numbers for name, numbers in by_linuxcnc(text, tmp_path) if name not in ("USE_LENGTH_UNITS", "DWELL")]
    if refused is not None:
        with pytest.raises(GCodeError) as caught:
            interpreted(text)
        assert caught.value.line == refused
        assert len(theirs) == refused - 1 - ("%" in text)  # it stops there too
        return
    moves = interpreted(text).moves
    assert len(moves) == len(theirs)
    for move, numbers in zip(moves, theirs, strict=True):
        unit = 25.4 if "G20" in text else 1.0
        place = [numbers[1], numbers[5], numbers[0]] if move.arc else numbers[:3]  # of an arc in G18: z, x and y
        np.testing.assert_allclose(1e3 * np.array(move.end[:3]), unit * np.array(place), atol=2e-3)


def test_arcs_lie_on_their_circles() -> None:
    program = interpreted("G21 F60\nG0 X10\nG3 X0 Y10 I-10 J0 Z2\nG2 X10 Y0 R10\nG2 I-10\n")
    path = from_moves(program.moves, program.letters, {})
    shares = np.linspace(0.0, 1.0, 9)
    quarter = path.values(np.full(9, 1), shares) * 1e3
    angles = 0.5 * np.pi * shares
    np.testing.assert_allclose(quarter[:, :2], 10.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1), atol=1e-12)
    np.testing.assert_allclose(quarter[:, 2], 2.0 * shares, atol=1e-12)
    back = path.values(np.full(9, 2), shares) * 1e3
    np.testing.assert_allclose(np.hypot(back[:, 0], back[:, 1]), 10.0, atol=1e-12)
    whole = path.values(np.full(9, 3), shares) * 1e3
    np.testing.assert_allclose(whole[:, 1], -10.0 * np.sin(2.0 * np.pi * shares), atol=1e-12)
    assert [move.feed for move in program.moves] == [None, *[pytest.approx(1e-3)] * 3]


def test_feeds_by_distance_angle_time_and_inch() -> None:
    moves = interpreted("G21 G1 X10 F600\nA90 F90\nG93 X20 F2\nG94 G20\nG1 X1 F6\n").moves
    assert moves[0].feed == pytest.approx(0.01)
    assert moves[1].turning_feed == pytest.approx(math.radians(1.5))
    assert moves[2].duration == pytest.approx(30.0)
    assert moves[3].feed == pytest.approx(0.1 * 0.0254)
    assert moves[3].end[0] == pytest.approx(0.0254)


def test_placed_systems_turn_positions_and_the_tool() -> None:
    quarter = np.array([[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])
    program = read_program("p.ngc", "G21 G55 G0 X10 Y0 Z0 C10\nG54 G0 X0\n", {55: quarter}, np.zeros(6))
    path = from_moves(program.moves, program.letters, {55: quarter})
    ends = path.values(np.arange(2), np.ones(2))
    np.testing.assert_allclose(ends[0], [0.1, 0.21, 0.3, 0.0, 0.0, math.radians(100.0)], atol=1e-12)
    np.testing.assert_allclose(ends[1], [0.0, 0.21, 0.3, 0.0, 0.0, math.radians(100.0)], atol=1e-12)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("G1 X1", "a feed is missing"),
        ("G38.2 Z1 F1", "G38.2 is not understood"),
        ("G0 G1 X1 F1", "exclude each other"),
        ("X1", "without a motion"),
        ("G0 X1 X2", "two words X"),
        ("G0 X\u0661", "'X\u0661' is not understood"),
        ("G0 X#1", "'X#1' is not understood"),
        ("G0 X1 (half", "an unclosed comment"),
        ("G2 X1 Y1 R0.1 F1", "too small"),
        ("G2 X1 Y1 I5 J0 F1", "different distances"),
        ("G2 X1 Y1 K1 F1", "not in the plane"),
        ("G2 X1 Y1 F1", "needs its radius"),
        ("G4", "expected G4 P"),
        ("G43 H1", "G43 needs the length"),
        ("G0 U1", "the word U1 is not understood"),
        ("G56 G0 X1", "G56 is used"),
        ("M98 P1", "M98 is not understood"),
        ("T1 M6 T2", "two words T"),
        ("G53 G2 X1 I1 F1", "G53 with an arc"),
        ("G1 X1 F-5", "negative"),
        ("G20 F5", "which changes its unit"),
        ("O100 call", "is not understood"),
        ("/G0 X1", "'/G0X1' is not understood"),
        ("#1=5", "'#1=5' is not understood"),
        ("G41 D1", "G41 is not understood"),
        ("G92 X1", "G92 is not understood"),
        ("G10 L2 P1 X1", "G10 is not understood"),
        ("G81 Z-1 R1 F1", "G81 is not understood"),
        ("%", "a % after other lines"),
    ],
)
def test_what_is_not_understood_is_refused_by_line(line: str, words: str) -> None:
    with pytest.raises(GCodeError, match=r"part\.ngc: line 3: ") as caught:
        interpreted(f"G21\n(a comment)\n{line}\nM2\n")
    assert words in str(caught.value)
    assert caught.value.line == 3


def test_damaged_programs_end_in_one_error_with_its_line() -> None:
    generator = np.random.default_rng(0)
    letters = "XYZABCGMFIJKRPSTHNO#[]()%;-+.0123456789 \n"
    refused = 0
    for _ in range(300):
        text, caught = list(POCKET), None
        for _ in range(int(generator.integers(1, 6))):
            place = int(generator.integers(len(text)))
            match int(generator.integers(3)):
                case 0:
                    del text[place]
                case 1:
                    text.insert(place, letters[int(generator.integers(len(letters)))])
                case _:
                    text[place] = letters[int(generator.integers(len(letters)))]
        try:
            moves = interpreted("".join(text)).moves
        except GCodeError as error:
            caught, moves = error, []
        if caught is not None:
            refused += 1
            assert 1 <= caught.line <= "".join(text).count("\n") + 1
            assert str(caught).startswith(f"part.ngc: line {caught.line}: ")
        for one, other in itertools.pairwise(moves):  # what is left is a program, and its moves follow each other
            if one.system == other.system:
                np.testing.assert_allclose(one.end, other.start, atol=1e-12)
    assert refused > 100
