"""Damaged inputs: files as changed by text editors, spreadsheets, bad disks or attackers, and the results.

As a script it runs hundreds of mutants of every input, each worker in a separate process, and reports those neither
refused by one of the package's errors nor read as a possible machine:

    python tests/fuzz/mutants.py --count 300 [--input urdf] [--seed 1] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import itertools
import json
import logging
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

SECONDS = 20
ROBOTS = Path(__file__).parents[2] / "robots"
MACHINES = Path(__file__).parents[1] / "machines"
DIALECTS = Path(__file__).parent / "dialects"

_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:[eE][+-]?\d+)?(?![\w.])")
_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9]{2,}")
_NASTY = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e999", "0", "-0", "-1", "0,1945", "1.2.3", "1_000", "0x10",
    "1e5", "-1e5", "1e20", "true", "null", "~", "''", "999999999999999999999", "\u0663", "1e", "5kg", ".5.",
    "yes", "off", "1:30", ".nan", "-.Inf", "NaN", "infinity", "1e400", "9" * 10_000, "\u22125", "\uff11", "5mm",
    "0.1 m", "5e-324", "+1", "1,000", "0b1", "0o17", "1j", "[1]", "{a: 1}", "!!float x", "2024-13-45", "0 0", "1e-9",
)  # fmt: skip
_NOISE = (
    "\x00",
    "\ufeff",
    "\u2028",
    "<",
    ">",
    "&",
    '"',
    "'",
    "]]>",
    "<!--",
    "{{",
    "*x",
    "!!python/object:os.system",
    "\t",
)


_NAMES = (
    "a/b", "../x", "/etc/passwd", "a b", "a\nb", "a\x07b", "\x1b[31m", "\u202eb", "\u2028", "<!--<script>", "</script>",
    "x" * 200_000, "%s{}$(pwd)", "-rf", "__class__", "CON", ".", "world", "universe",
)  # fmt: skip
_DOCTYPES = (
    '<!DOCTYPE r [<!ENTITY a0 "ha">'
    + "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12))
    + "]><r>&a12;</r>",
    '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
    '<!DOCTYPE robot PUBLIC "x" "http://127.0.0.1:9/x.dtd" [<!ENTITY % p SYSTEM "file:///dev/zero"> %p;]>',
)
_BLOCKS = (
    "a: &a [x, x]\n" + "".join(f"{c}: &{c} [{f'*{b}, ' * 9}*{b}]\n" for b, c in itertools.pairwise("abcdefghijkl")),
    "<<: {name: x, stiffness: 1}\n", "<<: [1]\n", "? [a, b]\n: 1\n", "1: 2\n", "null: 3\n", "&r x: *r\n", "--- \n",
    "%TAG ! tag:x,2000:\n", "x: !!binary aGVsbG8=\n", "x: !!python/name:os.system\n", "x: !!set {a, b}\n",
)  # fmt: skip


def mutate(text: str, generator: random.Random) -> str:
    """Damage a text in one to three places."""
    for _ in range(generator.choice((1, 1, 1, 2, 3))):
        text = generator.choice(_OPERATIONS)(text, generator)
    return text


def _number(text: str, generator: random.Random) -> str:
    return _replaced(text, _NUMBER, lambda number: generator.choice((*_NASTY, f"-{number}", f"{number}e3")), generator)


def _scaled(text: str, generator: random.Random) -> str:
    def scale(number: str) -> str:
        return repr(float(number) * 10.0 ** generator.choice((-30, -9, -3, 3, 9, 30)))

    return _replaced(text, _NUMBER, scale, generator)


def _word(text: str, generator: random.Random) -> str:
    words = _WORD.findall(text) or ["x"]
    return _replaced(
        text, _WORD, lambda _: generator.choice((*generator.sample(words, 1), "", "no_such", "\u00e9")), generator
    )


def _replaced(text: str, pattern: re.Pattern[str], change: Callable[[str], str], generator: random.Random) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    match = generator.choice(found)
    return text[: match.start()] + change(match[0]) + text[match.end() :]


def _line(text: str, generator: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    if len(lines) < 2:
        return text
    index, other = generator.randrange(len(lines)), generator.randrange(len(lines))
    match generator.randrange(3):
        case 0:
            del lines[index]
        case 1:
            lines.insert(other, lines[index])
        case _:
            lines[index], lines[other] = lines[other], lines[index]
    return "".join(lines)


def _cut(text: str, generator: random.Random) -> str:
    return text[: generator.randrange(len(text) + 1)]


def _noise(text: str, generator: random.Random) -> str:
    place = generator.randrange(len(text) + 1)
    return text[:place] + generator.choice(_NOISE) + text[place:]


def _deep(text: str, generator: random.Random) -> str:
    place = generator.randrange(len(text) + 1)
    return text[:place] + generator.choice(("<a>", "[", "{a: ", "(")) * 5_000 + text[place:]


def _swapped(text: str, generator: random.Random) -> str:
    """Swap two quoted values, two numbers or two words."""
    pattern = generator.choice((re.compile(r'(?<=")[^"\n]*(?=")'), _NUMBER, _WORD))
    found = list(pattern.finditer(text))
    if len(found) < 2:
        return text
    one, other = sorted(generator.sample(found, 2), key=lambda match: match.start())
    return text[: one.start()] + other[0] + text[one.end() : other.start()] + one[0] + text[other.end() :]


def _name(text: str, generator: random.Random) -> str:
    pattern = re.compile(r'(?<=")[^"\n]*(?=")|(?<=: )[A-Za-z_]\w+|^\w+(?=[:,])', re.MULTILINE)
    return _replaced(text, pattern, lambda _: generator.choice(_NAMES), generator)


def _block(text: str, generator: random.Random) -> str:
    """Copy an element or a run of lines to another place, or insert a hostile one there."""
    if text.lstrip().startswith("<"):
        if generator.random() < 0.3:
            return generator.choice(_DOCTYPES) + text.partition("?>")[2]
        pattern = re.compile(r"<(\w+)[^<>]*/>|<(\w+)[^<>]*>.*?</\2>", re.DOTALL)
        places = [match.end() for match in re.finditer(">", text)]
    else:
        pattern = re.compile(r"^(?:.*\n){1,6}", re.MULTILINE)
        places = [match.end() for match in re.finditer("\n", text)]
    found = list(pattern.finditer(text))
    if not found or not places:
        return text
    match, place = generator.choice(found), generator.choice(places)
    if not text.lstrip().startswith("<") and generator.random() < 0.3:
        return text[:place] + generator.choice(_BLOCKS) + text[place:]
    return text[:place] + match[0] + text[place:]


_OPERATIONS: tuple[Callable[[str, random.Random], str], ...] = (
    _number, _number, _number, _number, _scaled, _scaled, _word, _word, _line, _line, _cut, _noise, _deep,
    _swapped, _swapped, _name, _name, _block, _block, _block,
)  # fmt: skip


def _encoded(text: str, generator: random.Random) -> bytes:
    """Write a text in an unexpected encoding, or with bytes that are not text."""
    return generator.choice((
        text.encode(errors="replace")[:-3] + b"\xff\xfe",
        text.encode("utf-16", errors="replace"),
        text.encode("utf-8-sig", errors="replace"),
        text.encode("cp1252", errors="replace") + b"\xe9",
        text.replace("UTF-8", "utf-7").replace("utf-8", "no-such-code").encode(errors="replace"),
        text.replace("\n", "\r").encode(errors="replace"),
        bytes(len(text)),
    ))  # fmt: skip


def _replace_by_no_file(file: Path, generator: random.Random) -> None:
    """Replace a file by something that is not a file."""
    file.unlink()
    match generator.randrange(6):
        case 0:
            file.mkdir()
        case 1:
            os.mkfifo(file)
        case 2:
            file.symlink_to("/dev/zero")
        case 3:
            file.symlink_to(file)
        case 4:
            with file.open("wb") as hole:
                hole.truncate(5 << 30)
        case _:
            file.touch(mode=0)


_FIRMWARES = ("klipper", "reprapfirmware", "duet", "marlin", "g33")
_SAMPLES = ("export", "join", "ballbar", "rows", *_FIRMWARES, "acceptance", "history")


class Input:
    """A kind of input: folders of valid files, the file to damage, and its reader.

    Args:
        sources: folders, of which one is copied.
        pattern: the files, of which one is damaged.
        read: reads the folder's copy; raises if it accepts an impossible machine.
    """

    def __init__(self, sources: Sequence[Path], pattern: str, read: Callable[[Path], None]) -> None:
        self.sources = sources
        self.pattern = pattern
        self.read = read

    def mutant(self, above: Path, seed: int) -> Path:
        """Copy a folder with a file damaged, and return the copy."""
        generator = random.Random(seed)
        source = generator.choice(self.sources)
        folder = above / source.name
        shutil.copytree(source, folder)
        file = generator.choice(sorted(path for path in folder.glob(self.pattern) if path.is_file()))
        damaged = mutate(file.read_text(encoding="utf-8"), generator)
        chance = generator.random()
        if chance < 0.05:
            file.write_bytes(_encoded(damaged, generator))
        elif chance < 0.1:
            _replace_by_no_file(file, generator)
        else:
            file.write_text(damaged, encoding="utf-8", errors="replace", newline="")
        return folder


def _require(holds: Any, what: str) -> None:
    if not holds:
        raise AssertionError(f"accepted nonsense: {what}")


def _read_robot(path: Path) -> Any:
    import numpy as np

    from pm3dof_pin.dynamics.statics import holding_forces
    from pm3dof_pin.elastic.elastic_model import ElasticModel
    from pm3dof_pin.kinematics.robot import Robot

    robot = Robot.load(path)
    for inertia in list(robot.model.inertias)[1:]:
        _require(0.0 <= inertia.mass <= 1e9, f"mass {inertia.mass}")
        _require(np.isfinite(np.array(inertia.inertia)).all(), "moments of inertia")
        _require(np.linalg.eigvalsh(inertia.inertia)[0] >= -0.5 * np.abs(inertia.inertia).max() - 1e-9, "moments")
    for placement in robot.model.jointPlacements:
        _require(np.abs(placement.translation).max() <= 1e5, f"length {placement.translation}")
    _require((robot.lower_limits <= robot.upper_limits).all(), "limits out of order")
    for spring in ElasticModel(robot).springs if robot.springs else ():
        for number in (getattr(spring, "stiffness", 1.0), getattr(spring, "bending_stiffness", 1.0)):
            _require(1e-12 <= number <= 1e18, f"stiffness {number}")
    if robot.actuated_joints and robot.home.closure_residual < 1e-6:
        home = robot.at([robot.home.q])
        _require(home.solved.all() and np.isfinite(home.coordinates).all() and home.broken_limits.size, "home")
        forces = holding_forces(robot.home).actuator_forces
        _require(np.isfinite(forces).all() and np.abs(forces).max() < 1e12, f"forces {forces}")
    return robot


def _read_errors(folder: Path) -> None:
    from pm3dof_pin.errors.error_parameters import GeometricErrors

    errors = GeometricErrors.load(next(folder.glob("*.urdf")))
    _require((errors.tolerances > 0.0).all() and (errors.tolerances <= 1.0).all(), "tolerances")


def _read_parameters(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.chapter import Tripod

    if folder.name == "pm3dof_description":
        tripod = Tripod.load(folder / "config" / "pm3dof.yaml")
        _require(np.isfinite(tripod.bounds).all(), "bounds")
    else:
        _read_robot(next(folder.glob("xacro/*.urdf.xacro")))


def _read_measurements(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.measurement_file import read_measurements

    measurements = read_measurements(folder / "measurements.csv", load(folder.name))
    _require(np.isfinite(measurements.commands).all(), "commands")


def _read_plan(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.plan_file import read_plan

    _require(np.isfinite(read_plan(folder / "plan.csv", load(folder.name))[0]).all(), "commands")


def _read_calibration(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.calibration.folder import read_compensation
    from pm3dof_pin.kinematics.robot import load

    compensation, robot = read_compensation(folder / "calibration"), load(folder.name)
    answer = compensation.compensate(robot.solve(robot.home_coordinates), compensation.with_usual_conditions({}))
    _require(np.isfinite(answer.commands).all(), "commands")
    _require((answer.predicted_error < 1.0).all(), f"predicted error {answer.predicted_error}")


def _read_export(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.export_file import ColumnMap
    from pm3dof_pin.measuring.file_check import FileCheck
    from pm3dof_pin.measuring.measurement_file import read_measurements

    robot, file = load("pm3dof"), next(folder.glob("*.csv"))
    columns = ColumnMap.load(folder / "columns.yaml")
    found = read_measurements(file, robot, columns=columns)
    _require(np.isfinite(found.commands).all() and np.isfinite(found.positions).all(), "measurements")
    FileCheck.read(file, robot, columns=columns).as_data()


def _read_join(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.joining import join

    joined = join(folder / "log.csv", folder / "tracker.csv", load("pm3dof"))
    rows = np.column_stack(list(joined.columns.values()))
    _require(np.isfinite(rows[:, :3]).all() and joined.greatest_gap <= 0.05, "joined rows")


def _read_ballbar(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.ballbar import Circle, ballbar_columns

    robot = load("hexapod")
    x, y, z = map(float, robot.home.tool_placement.translation)
    for trace in sorted(folder.glob("*.csv")):
        rows = ballbar_columns(trace, robot, Circle((x, y, z), 0.008, feed=0.02), samples=8)
        _require(np.isfinite(list(rows.values())).all(), "distances")


def _read_rows(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.measurement_file import read_measurements

    robot = load("hexapod")
    for file in sorted(folder.glob("*.csv")):
        found = read_measurements(file, robot)
        residuals = found.residuals(robot.forward(found.commands))
        _require(np.isfinite(residuals[found.seen]).all(), "residuals")


def _read_printer(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.files import read_text
    from pm3dof_pin.printers.firmware import read_firmware

    path = next(folder.glob("printer.*"), folder / "heightmap.csv")
    file = read_firmware(path, read_text(path))
    printer = file.printer()
    touches = file.touches(printer)
    _require(np.isfinite(touches.travels).all() and np.isfinite(touches.heights).all(), "touches")
    text = file.with_printer(printer) + ("Bed X:0 Y:0 Z:0" * (file.firmware == "Marlin"))
    file.path.write_text(text, encoding="utf-8", newline="")
    again = read_firmware(path, read_text(path))
    _require(np.allclose(again.printer().end_stops, printer.end_stops, atol=1e-6), "a file that reads otherwise")


def _read_about(folder: Path) -> None:
    from pm3dof_pin.calibration.certificate import Certificate

    data = Certificate.make(folder / "calibration", folder / "about.yaml").data
    json.dumps(data, allow_nan=False)


def _read_acceptance(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.calibration.acceptance import AcceptanceResult, evaluate_acceptance

    result = evaluate_acceptance("positioning", folder / "positioning.csv")
    _require(np.isfinite(list(result.values.values())).all(), f"results {result.values}")
    AcceptanceResult.read(folder / "acceptance.json")


def _read_history(folder: Path) -> None:
    from pm3dof_pin.calibration.recheck import read_history

    _require(all(isinstance(entry, dict) for entry in read_history(folder)), "history")


def write_samples(above: Path) -> Path:
    """Write small valid files of kinds that the repository has none of, a folder for each, and return the folder."""
    import numpy as np

    from pm3dof_pin.kinematics.reachable_poses import reachable_poses
    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.instruments.table import placed_instrument
    from pm3dof_pin.measuring.measurement_file import write_measurements
    from pm3dof_pin.measuring.observation import planned_measurements

    texts: dict[str, str] = {}
    robot = load("pm3dof")
    poses = robot.solve(robot.grid(z_e=(0.46, 0.54, 12)).values)
    rows = np.column_stack([poses.commands, 1e3 * poses.positions])
    lines = [";".join(f"{number:.6f}".replace(".", ",") for number in row) for row in rows]
    texts["export/export.csv"] = "Tracker;SN 7\nAxis 1;Axis 2;Axis 3;X [mm];Y [mm];Z [mm];Time\n" + "".join(
        f"{line};2026-03-29T23:59:{48 + k}Z\n" for k, line in enumerate(lines)
    )
    texts["export/columns.yaml"] = (
        "profile: spatialanalyzer\ncolumns: {Axis 1: u1_m, Axis 2: u2_m, Axis 3: u3_m, Time: time_s}\n"
        "skip: 1\nseparator: ';'\ndecimal: ','\nencoding: utf-8\nangles: fixed xyz\n"
    )
    texts["join/log.csv"] = "time_s,u1_m,u2_m,u3_m\n" + "".join(
        f"{k},{','.join(map(repr, row))}\n" for k, row in enumerate(poses.commands.tolist())
    )
    texts["join/tracker.csv"] = "Time [s],X [mm],Y [mm],Z [mm]\n" + "".join(
        f"{k}.01,{','.join(map(repr, row))}\n" for k, row in enumerate((1e3 * poses.positions).tolist())
    )
    stepper = "[stepper_{}]\nmicrosteps: 16\nrotation_distance: 40\ngear_ratio: 2:1\n"
    config = stepper.format("a") + "position_endstop: 245\narm_length: 270\nangle: 210\n" + stepper.format("b")
    config += stepper.format("c") + "[printer]\nkinematics: delta\ndelta_radius: 130\n\n"
    config += "#*# <---------------------- SAVE_CONFIG ---------------------->\n#*# [delta_calibrate]\n"
    for k, steps in enumerate(np.random.default_rng(0).integers(30000, 40000, (8, 3)).tolist()):
        config += f"#*# height{k} = 0.0\n#*# height{k}_pos = {','.join(map(str, steps))}.000\n"
    config += "#*# [bed_mesh default]\n#*# version = 1\n#*# points =\n#*# \t  0.1, 0.2\n#*# \t  0.3, 0.4\n"
    texts["klipper/printer.cfg"] = config
    points = [(60.0 * np.cos(angle), 60.0 * np.sin(angle)) for angle in np.arange(8)]
    bed = "".join(f"G30 P{k} X{x:.3f} Y{y:.3f} Z-99999\n" for k, (x, y) in enumerate(points))
    texts["reprapfirmware/printer.g"] = (
        f"M665 L215:215.2:214.9 R105 B85 H240 X0.1 Y0 Z0\nM666 X0.1 Y-0.2 Z0 A0.1 B0\n{bed}"
        "G32 bed probe heights: 0.1 0.2 0.05 -0.1 0.0 0.1 0.02 0.3, mean 0.1, deviation from mean 0.1\n"
    )
    texts["duet/config.g"] = "M665 L215.5 R105 B85 H240 X0.1\nM666 X0.1 Y-0.2 Z0\nG31 P25 X5 Y-18.5 Z2.1\nM501\n"
    texts["duet/config-override.g"] = "M665 L215:215.2:214.9:200 R105.2 H240.1 X0.1 Y0 Z0\nM666 X0.1 Y-0.2 Z0.1 U0\n"
    heights = np.random.default_rng(1).normal(0.0, 0.05, (4, 5)).tolist()
    texts["duet/heightmap.csv"] = (
        "RepRapFirmware height map file v2 generated at 2026-01-16 23:12, min error -0.108, max error 0.095\n"
        "xmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum\n-60.00,60.10,-50.00,50.10,85.00,30.00,33.30,5,4\n"
        + "".join(", ".join(["      0", *(f"{height:7.3f}" for height in row[1:])]) + "\n" for row in heights)
    )
    texts["marlin/printer.log"] = "M665 L215 R105 H240 X0.1 Y0 Z0 A0.1 B0 C-0.1\nM666 X-0.1 Y0 Z-0.3\n" + "".join(
        f"Bed X: {x:.2f} Y: {y:.2f} Z: {0.01 * k:.2f}\n" for k, (x, y) in enumerate(points)
    )
    texts["g33/printer.log"] = (
        "M665 L215 R105 H240 B85 X0.1 Y0 Z0\nM666 X-0.1 Y0 Z-0.3\n>>> G33 P3 V0\nChecking... AC (DRY-RUN)\n"
        ".Height:240.00    Ex:-0.10  Ey:+0.00  Ez:-0.30    Radius:105.00\n"
        ".Tower angle :    Tx:+0.10  Ty:+0.00  Tz:+0.00\n"
        ".      c:+0.03     x:+0.32   y:+0.34   z:+0.41\n.                 yz:+0.37  zx:+0.32  xy:+0.17\n"
    )
    texts["acceptance/positioning.csv"] = "target_m,direction,deviation_m\n" + "".join(
        f"{0.1 * target:.2f},{side},{1e-6 * (3 * target + side + run):.7f}\n"
        for run in range(3)
        for side in (1, -1)
        for target in range(5)
    )
    numbers = {"A": 1e-5, "B": 2e-6}
    result = {"test": "positioning", "readings": 30, "results_m": numbers, "test_uncertainties_k2_m": numbers}
    texts["acceptance/acceptance.json"] = json.dumps(result)
    texts["history/history.jsonl"] = '{"verdict": "unchanged", "risk": 0.01}\n{"verdict": "re-zero", "risk": 0.2}\n'
    angles = np.linspace(0.0, 2.0 * np.pi, 20)
    texts["ballbar/angles.csv"] = "Angle [deg];Reading [um]\n" + "".join(
        f"{np.degrees(angle):.3f};{40.0 * np.cos(angle):.3f}\n" for angle in angles
    )
    texts["ballbar/times.csv"] = "# socket 1\ntime_s,reading_m\n" + "".join(
        f"{0.4 * angle:.4f},{4e-5 * np.sin(angle):.8f}\n" for angle in angles
    )
    for name, text in texts.items():
        (above / name).parent.mkdir(parents=True, exist_ok=True)
        (above / name).write_text(text, encoding="utf-8")
    hexapod = load("hexapod")
    seen = reachable_poses(hexapod, 12, np.random.default_rng(0), margin=0.2)
    (above / "rows").mkdir(exist_ok=True)
    for name in ("ballbar", "gauge", "camera", "socket"):
        given = planned_measurements(seen, placed_instrument(name, seen, point=(0.02, -0.03, 0.04)))
        write_measurements(given, hexapod, above / "rows" / f"{name}.csv")
    return above


def inputs(calibrations: Sequence[Path] = (), samples: Path | None = None) -> dict[str, Input]:
    """Return the kinds of input, by name.

    Args:
        calibrations: folders, each named as its robot, with plan.csv, measurements.csv, about.yaml and a folder
            `calibration`; without any, these kinds are omitted.
        samples: what :func:`write_samples` wrote; without it, these kinds are omitted.
    """
    of = {name: [] if samples is None else [samples / name] for name in _SAMPLES}
    robots, machines = sorted(ROBOTS.glob("*_description")), sorted(MACHINES.iterdir())
    closed = [*(robot / "urdf" for robot in robots), *(machine for machine in machines if any(machine.glob("*.urdf")))]
    tripod = ROBOTS / "pm3dof_description"

    def read_urdf(folder: Path) -> None:
        _read_robot(next(folder.glob("*.urdf")))

    kinds = {
        "urdf": Input(closed, "*.urdf", read_urdf),
        "closures": Input(closed, "*.closures.yaml", read_urdf),
        "springs": Input([tripod / "urdf"], "*.closures.yaml", read_urdf),
        "srdf": Input(robots, "srdf/*.srdf", lambda folder: read_urdf(folder / "urdf")),
        "errors": Input([robot / "urdf" for robot in robots], "*.errors.yaml", _read_errors),
        "parameters": Input([tripod, tripod, *robots], "config/[hlpt]*[!3].yaml", _read_parameters),
        "mjcf": Input(
            [MACHINES / "walker", *(robot / "mjcf" for robot in robots)],
            "*.xml",
            lambda folder: _read_robot(next(folder.glob("*.xml"))),
        ),
        "sdf": Input(
            [robot / "sdf" for robot in robots], "*.sdf", lambda folder: _read_robot(next(folder.glob("*.sdf")))
        ),
        "loops": Input([robot / "drake" for robot in robots], "*.urdf", read_urdf),
        "urdf_plus": Input([DIALECTS / "urdf_plus"], "*.urdf", read_urdf),
        "robot_yaml": Input([DIALECTS / "robot_yaml"], "robot.*", lambda folder: _read_robot(folder / "robot.yaml")),
        "loop_closures": Input([DIALECTS / "loop_closures"], "loop_closures.yaml", read_urdf),
        "xacro": Input(robots, "xacro/**/*", lambda folder: _read_robot(next(folder.glob("xacro/*.urdf.xacro")))),
        "measurements": Input(calibrations, "measurements.csv", _read_measurements),
        "plan": Input(calibrations, "plan.csv", _read_plan),
        "calibration": Input(calibrations, "calibration/[cn]*/*", _read_calibration),
        "compensation": Input(calibrations, "calibration/*.json", _read_calibration),
        "certificate": Input(calibrations, "about.yaml", _read_about),
        "export": Input(of["export"], "*.csv", _read_export),
        "columns": Input(of["export"], "*.yaml", _read_export),
        "join": Input(of["join"], "*.csv", _read_join),
        "ballbar": Input(of["ballbar"], "*.csv", _read_ballbar),
        "rows": Input(of["rows"], "*.csv", _read_rows),
        "klipper": Input(of["klipper"], "printer.*", _read_printer),
        "duet": Input(of["duet"], "*", _read_printer),
        "gcode": Input([*of["reprapfirmware"], *of["marlin"], *of["g33"]], "printer.*", _read_printer),
        "acceptance": Input(of["acceptance"], "*", _read_acceptance),
        "history": Input(of["history"], "*", _read_history),
    }
    return {name: kind for name, kind in kinds.items() if kind.sources}


class _HangError(BaseException):
    """A mutant took too long; ordinary error handlers do not catch this."""


def outcome(kind: Input, seed: int, above: Path) -> str:
    """Return "refused", "accepted", or what failed with a mutant."""
    from pm3dof_pin.exceptions import PM3DofError

    try:
        kind.read(kind.mutant(above, seed))
    except PM3DofError as error:
        return "refused" if "\n" not in str(error) else f"message of several lines: {error}"
    except _HangError:
        return "hang"
    except Exception:
        return traceback.format_exc(limit=-4)
    return "accepted"


def _work(name: str, seeds: range, calibrations: list[Path], keep: Path | None, seconds: int) -> None:
    """Run mutants in this process, a line of JSON on standard output for each."""

    def ring(*_: object) -> None:
        raise _HangError

    signal.signal(signal.SIGALRM, ring)
    logging.disable(logging.CRITICAL)
    samples = write_samples(Path(tempfile.mkdtemp(prefix="samples_")))
    kind = inputs(calibrations, samples)[name]
    kind.read(kind.sources[0])  # undamaged it is accepted, and what is imported does not count as a hang
    for seed in seeds:
        print(json.dumps({"begins": seed}), flush=True)
        with tempfile.TemporaryDirectory(prefix="mutant_") as above:
            signal.alarm(seconds)
            said = outcome(kind, seed, Path(above))
            signal.alarm(0)
            if keep is not None and said not in ("refused", "accepted"):
                kind.mutant(keep / f"{name}_{seed}", seed)
        print(json.dumps({"seed": seed, "said": said}), flush=True)
    shutil.rmtree(samples)


def run(
    name: str, seeds: range, calibrations: list[Path], keep: Path | None, seconds: int = SECONDS
) -> Iterator[tuple[int, str]]:
    """Run mutants in separate processes; one that dies is a finding, and the next process continues after it."""
    first = seeds.start
    while first < seeds.stop:
        command = [sys.executable, __file__, "--work", name, "--seed", str(first), "--count", str(seeds.stop - first)]
        command += [part for folder in calibrations for part in ("--calibration", str(folder))]
        command += ["--keep", str(keep)] if keep else []
        command += ["--seconds", str(seconds)]
        last = first - 1
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as worker:
            assert worker.stdout is not None
            for line in worker.stdout:
                entry = json.loads(line) if line.startswith("{") else {}
                if "begins" in entry:
                    last = entry["begins"]
                elif "seed" in entry:
                    yield entry["seed"], entry["said"]
                    first = entry["seed"] + 1
        if worker.returncode:
            yield last, f"the process ended with {worker.returncode}"
            first = last + 1


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--input", action="append")
    parser.add_argument(
        "--calibration",
        type=Path,
        action="append",
        default=[],
        help="folder named as its robot, with plan.csv, measurements.csv, calibration/",
    )
    parser.add_argument("--keep", type=Path, help="folder for what went wrong")
    parser.add_argument("--seconds", type=int, default=SECONDS, help="what is a hang, of this machine")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.count)
    if options.work:
        _work(options.work, seeds, options.calibration, options.keep, options.seconds)
        return
    failed = False
    for name in options.input or inputs(options.calibration, Path()):
        counts: Counter[str] = Counter()
        for seed, said in run(name, seeds, options.calibration, options.keep, options.seconds):
            counts[said if said in ("refused", "accepted") else "wrong"] += 1
            if said not in ("refused", "accepted"):
                print(f"--- {name} {seed}: {said}", flush=True)
        failed |= counts["wrong"] > 0
        print(f"{name}: {dict(counts)}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
