"""Damaged inputs are refused in one line or read as a possible machine: a few of the script's mutants."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.folder import read_summary

SCRIPT = Path(__file__).with_name("mutants.py")
OF_SAMPLES = ("export", "columns", "join", "ballbar", "rows", "klipper", "gcode", "duet", "acceptance", "history")
KINDS = ("urdf", "xacro", "closures", "springs", "srdf", "errors", "parameters", "mjcf", "sdf", "loops")
DIALECTS = ("urdf_plus", "robot_yaml", "loop_closures")


@pytest.fixture(scope="module")
def mutants() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mutants", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = script  # where its data classes look for their names
    spec.loader.exec_module(script)
    return script


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", [*KINDS, *DIALECTS])
def test_mutants_are_refused_or_sound(kind: str, mutants: ModuleType, tmp_path: Path) -> None:
    damaged = mutants.inputs()[kind]
    for seed in range(1000, 1004):
        said = mutants.outcome(damaged, seed, tmp_path / str(seed))
        assert said in ("refused", "accepted"), f"{kind} {seed}: {said}"


@pytest.fixture(scope="module")
def samples(mutants: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return mutants.write_samples(tmp_path_factory.mktemp("samples"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", OF_SAMPLES)
def test_samples(kind: str, mutants: ModuleType, samples: Path, tmp_path: Path) -> None:
    input_of = mutants.inputs((), samples)[kind]
    for source in input_of.sources:
        input_of.read(source)  # as they are, they are accepted
    for seed in range(1000, 1008):
        said = mutants.outcome(input_of, seed, tmp_path / str(seed))
        assert said in ("refused", "accepted"), f"{kind} {seed}: {said}"


@pytest.mark.filterwarnings("ignore")
def test_a_damaged_calibration_is_refused_or_gives_the_same_numbers(
    mutants: ModuleType, calibration_folder: Path, tmp_path: Path
) -> None:
    expected = _numbers(calibration_folder)

    def read(folder: Path) -> None:
        assert _numbers(folder) == expected

    damaged = mutants.Input([calibration_folder], "**/*", read)
    said = [mutants.outcome(damaged, seed, tmp_path / str(seed)) for seed in range(1000, 1040)]
    assert set(said) <= {"refused", "accepted"}, said
    assert said.count("refused") > 0.8 * len(said)


def _numbers(folder: Path) -> tuple[bytes, str]:
    """Commands of three poses, and the summary."""
    compensation, summary = pm.read_compensation(folder), read_summary(folder)
    poses = pm.reachable_poses(compensation.errors.robot, 3, np.random.default_rng(0))
    return compensation.compensate(poses).commands.tobytes(), str(summary)


def test_the_script_runs_them_in_processes_of_their_own() -> None:
    words = ["--input", "closures", "--count", "2", "--seed", "1000"]
    done = subprocess.run([sys.executable, str(SCRIPT), *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "closures: " in done.stdout
