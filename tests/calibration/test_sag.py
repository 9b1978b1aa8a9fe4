"""Bodies whose weight bends springs more than geometric errors move the tool."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.measurement_plan import plan_measurements
from pm3dof_pin.calibration.sag import sag_in_words
from pm3dof_pin.errors.pose_error import TIP_LENGTH

_MASS, _GRAVITY = 2.0, 9.81


def _slide(folder: Path, stiffness: float) -> Path:
    """Write a vertical slide on a spring [N/m]: it sags by m g / k."""
    path = folder / "slide.urdf"
    path.write_text(
        f"""<robot name="slide"><link name="base"/><link name="slide"><inertial><mass value="{_MASS}"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
        <joint name="lift" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    (folder / "slide.closures.yaml").write_text(
        "name_mot: [lift]\ntool_frame: slide\n"
        f"springs:\n  - {{name: spring, type: joint, joint: lift, stiffness: {stiffness}, unit: N/m}}\n"
    )
    return path


@pytest.mark.parametrize(("stiffness", "sag"), [(1e3, _MASS * _GRAVITY), (1e8, None)])
def test_sag_is_named_where_it_is_larger_than_errors(tmp_path: Path, stiffness: float, sag: float | None) -> None:
    errors = pm.GeometricErrors.load(_slide(tmp_path, stiffness))
    poses = errors.robot.forward(np.linspace(-0.5, 0.5, 8)[:, None])
    planned = plan_measurements(errors, 6, candidates=40, machines=1)  # before anything is measured
    for words in (sag_in_words(errors, poses, TIP_LENGTH), planned.sag):
        assert words == "" if sag is None else f"moves the tool by {sag:.3g} mm" in words
