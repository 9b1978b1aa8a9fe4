"""Damaged inputs are refused in one line or read as a machine that can be: a few mutants of the script beside."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("mutants.py")
KINDS = ("urdf", "closures", "springs", "srdf", "errors", "parameters", "mjcf")


@pytest.mark.parametrize("kind", KINDS)
def test_mutants_are_refused_or_sound(kind: str) -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--input", kind, "--count", "4", "--seed", "1000"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{kind}: " in done.stdout
