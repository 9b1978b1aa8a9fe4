"""Tolerances by how parts are made, against numbers of ISO 2768-1."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.errors.part_tolerances import with_process
from pm3dof_pin.errors.presets import nearly_free, with_free_zeros
from pm3dof_pin.exceptions import InvalidValueError

ARM = """<robot name="arm"><link name="base"/><link name="upper"/><link name="flange"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.45"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="flange"/><origin xyz="0.1 0 0"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def arm(tmp_path: Path) -> pm.GeometricErrors:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return pm.GeometricErrors.load(path, tool_frame="flange")


def test_half_the_permissible_deviation(arm: pm.GeometricErrors) -> None:
    """A column of 450 mm may be off by 0.8 mm and 5', a link of 100 mm by 0.3 mm and 20' (medium)."""
    found = {parameter.name: parameter for parameter in with_process(arm, "medium").parameters}
    assert found["shoulder.tz"].tolerance == pytest.approx(0.4e-3)
    assert found["shoulder.rx"].tolerance == pytest.approx(np.radians(5.0 / 60.0) / 2.0)
    assert found["elbow.tx"].tolerance == pytest.approx(0.15e-3)
    assert found["elbow.rz"].tolerance == pytest.approx(np.radians(20.0 / 60.0) / 2.0)
    assert found["shoulder.ry"] == next(p for p in arm.parameters if p.name == "shoulder.ry")  # a drive's zero
    with pytest.raises(InvalidValueError, match="fine, medium"):
        with_process(arm, "rough")  # type: ignore[arg-type]


def test_a_file_of_them(arm: pm.GeometricErrors, run: Callable[..., Any], tmp_path: Path) -> None:
    words = ("--robot", "arm.urdf", "--tool-frame", "flange", "--preset", "dh", "--out", "arm.errors.yaml")
    assert run("error-parameters", *words, "--process", "coarse", cwd=tmp_path).returncode == 0
    read = pm.GeometricErrors.load(tmp_path / "arm.urdf", tool_frame="flange")
    tolerances = dict(zip(read.names, read.tolerances, strict=True))
    assert tolerances["shoulder.ry"] == 50e-3  # not homed to an absolute mark
    # offsets along the parallel axes of column and link are one of the root of both squares
    assert {1e3 * size for name, size in tolerances.items() if ".t" in name} == {1.0, 0.4, 1.1}
    assert run("error-parameters", *words[:4], "--process", "coarse", cwd=tmp_path).returncode == 2


def test_zeros_that_are_nearly_free(arm: pm.GeometricErrors) -> None:
    """Turns about the drives' axes, y, once they are known to 50 mrad only; no others, and none as they come."""
    assert not nearly_free(arm).any()
    free = with_free_zeros(arm)
    named = [name for name, is_free in zip(free.names, nearly_free(free), strict=True) if is_free]
    assert named == ["shoulder.ry", "elbow.ry"]
