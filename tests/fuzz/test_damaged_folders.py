"""A calibration's folder with one damaged file is refused by the package's own error, or gives the same numbers."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.folder import read_summary
from pm3dof_pin.exceptions import PM3DofError

COUNT = 40


def _flip(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(content))
    return content[:place] + bytes([content[place] ^ (1 << chance.randrange(8))]) + content[place + 1 :]


def _digit(content: bytes, chance: random.Random) -> bytes:
    place = chance.choice([k for k, byte in enumerate(content) if chr(byte).isdigit()])
    return content[:place] + str(chance.randrange(10)).encode() + content[place + 1 :]


DAMAGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "a bit": _flip,
    "a digit": _digit,
    "cut": lambda content, chance: content[: chance.randrange(len(content))],
    "empty": lambda content, chance: b"",
    "twice": lambda content, chance: content + content,
    "UTF-16": lambda content, chance: content.decode().encode("utf-16"),
    "zeros": lambda content, chance: bytes(len(content)),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1)
    machine = pm.SimulatedMachine.random(errors, generator, everything=False)
    commands = pm.reachable_poses(errors.robot, 30, generator).commands
    measurements = pm.Measurements.from_poses(commands, machine.measure(commands, generator))
    return pm.calibrate(measurements, errors, "lm").save(tmp_path_factory.mktemp("calibrated") / "folder")


def _numbers(folder: Path) -> tuple[bytes, str]:
    compensation, summary = pm.read_compensation(folder), read_summary(folder)
    poses = pm.reachable_poses(compensation.errors.robot, 3, np.random.default_rng(0))
    return compensation.compensate(poses).commands.tobytes(), str(summary)


@pytest.mark.filterwarnings("ignore")
def test_damaged_folders_are_refused_or_give_the_same_numbers(folder: Path, tmp_path: Path) -> None:
    expected, chance, refused = _numbers(folder), random.Random(0), 0
    for number in range(COUNT):
        damaged = Path(shutil.copytree(folder, tmp_path / str(number)))
        path = chance.choice(sorted(file for file in damaged.rglob("*") if file.is_file()))
        kind = chance.choice([*DAMAGES, "missing", "a folder", "another's"])
        if kind in DAMAGES:
            path.write_bytes(DAMAGES[kind](path.read_bytes(), chance))
        elif kind == "another's":
            path.write_bytes((folder / "report.html").read_bytes())
        else:
            path.unlink()
            if kind == "a folder":
                path.mkdir()
        try:
            found = _numbers(damaged)
        except PM3DofError:
            refused += 1
        else:
            assert found == expected, (kind, path)
    assert refused > 0.8 * COUNT
