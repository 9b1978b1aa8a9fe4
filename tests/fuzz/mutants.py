"""Damaged inputs: what a text editor, a spreadsheet, a bad disk or a stranger makes of files, and what comes of them.

As a script it runs hundreds of mutants of every input, each worker in a process of its own, and says what was neither
refused by one of the package's errors nor read as a machine that can be:

    python tests/fuzz/mutants.py --count 300 [--input urdf] [--seed 1] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import json
import logging
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

SECONDS = 20
ROBOTS = Path(__file__).parents[2] / "robots"
MACHINES = Path(__file__).parents[1] / "machines"

_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:[eE][+-]?\d+)?(?![\w.])")
_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9]{2,}")
_NASTY = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e999", "0", "-0", "-1", "0,1945", "1.2.3", "1_000", "0x10",
    "1e5", "-1e5", "1e20", "true", "null", "~", "''", "999999999999999999999", "\u0663", "1e", "5kg", ".5.",
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


_OPERATIONS: tuple[Callable[[str, random.Random], str], ...] = (
    _number, _number, _number, _number, _scaled, _scaled, _word, _word, _line, _line, _cut, _noise, _deep,
)  # fmt: skip


class Input:
    """One kind of input: a folder of sound files, which of them is damaged, and what reads it.

    Args:
        source: folder that is copied.
        pattern: the files, of which one is damaged.
        read: reads the folder's copy; raises if what it accepts is no machine.
    """

    def __init__(self, source: Path, pattern: str, read: Callable[[Path], None]) -> None:
        self.source = source
        self.pattern = pattern
        self.read = read

    def mutant(self, folder: Path, seed: int) -> Path:
        """Copy the folder with a file damaged, and return that file."""
        generator = random.Random(seed)
        shutil.copytree(self.source, folder)
        file = generator.choice(sorted(path for path in folder.glob(self.pattern) if path.is_file()))
        damaged = mutate(file.read_text(encoding="utf-8"), generator)
        if generator.random() < 0.05:  # a byte that is no text
            file.write_bytes(damaged.encode(errors="replace")[:-3] + b"\xff\xfe")
        else:
            file.write_text(damaged, encoding="utf-8", errors="replace")
        return file


def _require(holds: Any, what: str) -> None:
    if not holds:
        raise AssertionError(f"accepted nonsense: {what}")


def _read_robot(path: Path) -> Any:
    import numpy as np

    from pm3dof_pin.dynamics import holding_forces
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
        forces = holding_forces(robot.home).actuator_forces
        _require(np.isfinite(forces).all() and np.abs(forces).max() < 1e12, f"forces {forces}")
    return robot


def _read_errors(folder: Path) -> None:
    from pm3dof_pin.errors.error_parameters import GeometricErrors

    errors = GeometricErrors.load(folder / "pm3dof.urdf")
    _require((errors.tolerances > 0.0).all() and (errors.tolerances <= 1.0).all(), "tolerances")


def _read_parameters(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.chapter import Tripod

    tripod = Tripod.load(folder / "pm3dof.yaml")
    _require(np.isfinite(tripod.bounds).all(), "bounds")


def _read_measurements(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.measurement_file import read_measurements

    measurements = read_measurements(folder / "measurements.csv", load("pm3dof"))
    _require(np.isfinite(measurements.commands).all(), "commands")


def _read_plan(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.kinematics.robot import load
    from pm3dof_pin.measuring.measurement_file import read_commands

    _require(np.isfinite(read_commands(folder / "plan.csv", load("pm3dof"))).all(), "commands")


def _read_calibration(folder: Path) -> None:
    import numpy as np

    from pm3dof_pin.calibration.results import read_compensation
    from pm3dof_pin.kinematics.robot import load

    compensation = read_compensation(folder)
    answer = compensation.compensate(load("pm3dof").solve([[0.1, -0.2, 0.5]]), compensation.with_usual_conditions({}))
    _require(np.isfinite(answer.commands).all(), "commands")
    _require((answer.predicted_error < 1.0).all(), f"predicted error {answer.predicted_error}")


def inputs(calibration: Path | None = None) -> dict[str, Input]:
    """Return the kinds of input, by name.

    Args:
        calibration: folder with plan.csv, measurements.csv and a folder `calibration`; without it these are left out.
    """
    tripod, hexapod = ROBOTS / "pm3dof_description", ROBOTS / "hexapod_description"
    kinds = {
        "urdf": Input(tripod / "urdf", "pm3dof.urdf", lambda folder: _read_robot(folder / "pm3dof.urdf")),
        "closures": Input(hexapod / "urdf", "*.closures.yaml", lambda folder: _read_robot(folder / "hexapod.urdf")),
        "springs": Input(tripod / "urdf", "*.closures.yaml", lambda folder: _read_robot(folder / "pm3dof.urdf")),
        "srdf": Input(tripod, "srdf/*.srdf", lambda folder: _read_robot(folder / "urdf" / "pm3dof.urdf")),
        "errors": Input(tripod / "urdf", "*.errors.yaml", _read_errors),
        "parameters": Input(tripod / "config", "pm3dof.yaml", _read_parameters),
        "mjcf": Input(MACHINES / "walker", "*.xml", lambda folder: _read_robot(folder / "walker.xml")),
        "xacro": Input(hexapod, "xacro/*", lambda folder: _read_robot(folder / "xacro" / "hexapod.urdf.xacro")),
    }
    if calibration is not None:
        kinds |= {
            "measurements": Input(calibration, "measurements.csv", _read_measurements),
            "plan": Input(calibration, "plan.csv", _read_plan),
            "calibration": Input(calibration / "calibration", "[cn]*/*[lf]", lambda folder: _read_calibration(folder)),
            "compensation": Input(calibration / "calibration", "*.json", _read_calibration),
        }
    return kinds


def outcome(kind: Input, seed: int, folder: Path) -> str:
    """Return "refused", "accepted", or what went wrong with a mutant."""
    from pm3dof_pin.exceptions import PM3DofError

    try:
        kind.mutant(folder, seed)
        kind.read(folder)
    except PM3DofError as error:
        return "refused" if "\n" not in str(error) else f"message of several lines: {error}"
    except TimeoutError:
        return "hang"
    except Exception:
        return traceback.format_exc(limit=-4)
    return "accepted"


def _work(name: str, seeds: range, calibration: Path | None, keep: Path | None, seconds: int) -> None:
    """Run mutants in this process, a line of JSON on standard output for each."""

    def ring(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, ring)
    logging.disable(logging.CRITICAL)
    kind = inputs(calibration)[name]
    for seed in seeds:
        print(json.dumps({"begins": seed}), flush=True)
        with tempfile.TemporaryDirectory(prefix="mutant_") as above:
            folder = Path(above) / kind.source.name
            signal.alarm(seconds)
            said = outcome(kind, seed, folder)
            signal.alarm(0)
            if keep is not None and said not in ("refused", "accepted"):
                shutil.copytree(folder, keep / f"{name}_{seed}", dirs_exist_ok=True)
        print(json.dumps({"seed": seed, "said": said}), flush=True)


def run(
    name: str, seeds: range, calibration: Path | None, keep: Path | None, seconds: int = SECONDS
) -> Iterator[tuple[int, str]]:
    """Run mutants in processes of their own; one that dies is a finding, and the next process goes on behind it."""
    first = seeds.start
    while first < seeds.stop:
        command = [sys.executable, __file__, "--work", name, "--seed", str(first), "--count", str(seeds.stop - first)]
        command += ["--calibration", str(calibration)] if calibration else []
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
    parser.add_argument("--calibration", type=Path, help="folder with plan.csv, measurements.csv, calibration/")
    parser.add_argument("--keep", type=Path, help="folder for what went wrong")
    parser.add_argument("--seconds", type=int, default=SECONDS, help="what is a hang, of this machine")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.count)
    if options.work:
        _work(options.work, seeds, options.calibration, options.keep, options.seconds)
        return
    failed = False
    for name in options.input or inputs(options.calibration):
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
