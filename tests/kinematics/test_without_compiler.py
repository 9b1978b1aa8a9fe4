"""Robots in a process without llvmlite, whose import is a bare ImportError."""

from __future__ import annotations

import subprocess
import sys

_SCRIPT = """
import sys
sys.modules["llvmlite"] = None  # an import of it fails
import numpy as np
import pm3dof_pin as pm
from pm3dof_pin.exceptions import ProgramError
robot = pm.load("hexapod")
for compiled in (False, True):
    assert "pip install llvmlite" in robot.reason_without_programs(compiled=compiled)
values = robot.home_coordinates + np.linspace(0.0, 0.01, 40)[:, None]
poses = robot.solve(values)
np.testing.assert_allclose(poses.coordinates, values, atol=1e-9)
np.testing.assert_allclose(robot.forward(poses[:3].commands).coordinates, values[:3], atol=1e-9)
q = np.tile(robot.home.q, (300, 1))
assert robot.at(q).within_limits.all() and np.isfinite(pm.compliance(robot, q)).all()
"""


def test_poses_are_found_by_pinocchio_and_the_reason_says_what_to_install() -> None:
    done = subprocess.run([sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
