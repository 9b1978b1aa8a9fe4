"""Bodies whose weight bends springs more than geometric errors move the tool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.measurement_plan import plan_measurements
from pm3dof_pin.calibration.sag import sag_in_words
from pm3dof_pin.errors.error_parameters import all_parameters
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


def test_a_calibration_that_sag_disturbs_says_so(tmp_path: Path) -> None:
    """A boom of length L pitched by q sags by m g L cos(q) / k, of which the zero of its drive describes the mean."""
    path = tmp_path / "boom.urdf"
    path.write_text(
        f"""<robot name="boom"><link name="base"/><link name="tip"/><link name="boom"><inertial><origin xyz="1 0 0"/>
        <mass value="{_MASS}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
        <joint name="pitch" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
        <joint name="end" type="fixed"><parent link="boom"/><child link="tip"/><origin xyz="1 0 0"/></joint></robot>"""
    )
    stiffness = 2e3  # [N m/rad]
    (tmp_path / "boom.closures.yaml").write_text(
        "name_mot: [pitch]\ntool_frame: tip\n"
        f"springs:\n  - {{name: spring, type: joint, joint: pitch, stiffness: {stiffness}, unit: N m/rad}}\n"
    )
    robot = pm.Robot.load(path)
    (zero,) = (each for each in all_parameters(robot) if each.name == "pitch.ry")
    errors = pm.GeometricErrors(robot, [replace(zero, tolerance=4e-3)])
    angles = np.linspace(-0.9, 0.9, 20)
    true = robot.forward((angles + _MASS * _GRAVITY * np.cos(angles) / stiffness)[:, None])
    measurements = pm.Measurements.from_poses(angles[:, None], true.transforms)
    calibration = pm.calibrate(measurements, errors, "lm")
    assert calibration.held_out is not None
    assert calibration.held_out.after.mean() < 0.5 * calibration.held_out.before.mean()
    assert any("times the noise: by the springs of the description the weight" in each for each in calibration.warnings)
