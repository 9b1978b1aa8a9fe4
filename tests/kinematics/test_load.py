"""What `pm.load` takes, and the springs of drives that a description does not give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

import pm3dof_pin as pm
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError

pytest.importorskip("example_robot_data")

XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.2"/>
  <link name="base"/>
  <link name="arm"/>
  <joint name="turn" type="revolute">
    <parent link="base"/> <child link="arm"/> <axis xyz="0 0 1"/>
    <origin xyz="$(arg length) 0 0"/> <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


@pytest.fixture(scope="module")
def model() -> pin.Model:
    return pin.buildModelFromUrdf(str(find_robot("ur5").urdf))


def test_models_of_other_libraries_are_the_robot_of_the_file(model: pin.Model) -> None:
    document = yourdfpy.URDF.load(str(find_robot("ur5").urdf), load_meshes=False, build_scene_graph=False)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6))
    expected = pm.load("ur5", tool_frame="ee_link").at(q).transforms
    for source in (model, document):
        robot = pm.load(source, tool_frame="ee_link")
        np.testing.assert_allclose(robot.at(q).transforms, expected, rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(robot.lower_limits, pm.load("ur5").lower_limits)


def test_a_model_is_not_changed(model: pin.Model) -> None:
    fixed = model.copy()
    fixed.lowerPositionLimit[:] = fixed.upperPositionLimit[:] = 0.0
    assert np.isinf(pm.load(fixed).lower_limits).all()  # 0 .. 0 of every joint means that none are given
    assert not fixed.lowerPositionLimit.any()


def test_a_model_without_a_name_is_a_robot() -> None:
    robot = pm.load(pin.buildSampleModelManipulator())
    assert str(robot) == repr(robot)
    assert repr(robot).startswith("Robot(robot: 6 joints")
    assert str(robot.home) == f"q = [0., 0., 0., 0., 0., 0.] of {robot.name}"  # as messages name it


@pytest.mark.parametrize("source", [3, None, ["ur5"], {"robot": "ur5"}])
def test_what_cannot_be_loaded(source: Any) -> None:
    with pytest.raises(InvalidValueError, match=f"{type(source).__name__}.*the path of its description"):
        pm.load(source)


def test_arguments_of_a_xacro_file(tmp_path: Path, model: pin.Model) -> None:
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(XACRO.replace("<xacro:arg", "<!--").replace("/>", "-->", 1))
    with pytest.raises(DescriptionError, match="--xacro-arg NAME:=VALUE"):
        pm.load(path)
    assert pm.load(path, xacro_args={"length": "0.7"}).model.jointPlacements[1].translation[0] == 0.7
    path.write_text(XACRO)
    assert pm.load(path).model.jointPlacements[1].translation[0] == 0.2
    assert pm.load(path, xacro_args={"length": "0.3"}).model.jointPlacements[1].translation[0] == 0.3
    with pytest.raises(DescriptionError, match="has no argument 'lenght'"):
        pm.load(path, xacro_args={"lenght": "0.3"})
    with pytest.raises(DescriptionError, match="not a xacro file"):
        pm.load("ur5", xacro_args={"length": "0.7"})
    with pytest.raises(InvalidValueError, match="for descriptions in files"):
        pm.load(model, xacro_args={"length": "0.7"})


@pytest.mark.parametrize("stiffness", [2e4, dict.fromkeys(("elbow_joint", "wrist_1_joint"), 5e3)])
def test_drive_stiffness_of_an_arm(stiffness: float | dict[str, float], model: pin.Model) -> None:
    """C = J k^-1 J^T over the drives with a spring, with the Jacobian of Pinocchio's own model."""
    robot = pm.load("ur5", tool_frame="ee_link", drive_stiffness=stiffness)
    names = list(model.names)[1:]
    numbers = stiffness if isinstance(stiffness, dict) else dict.fromkeys(names, stiffness)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, 6)
    frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J = pin.computeFrameJacobian(model, model.createData(), q, model.getFrameId("ee_link"), frame)
    columns = [names.index(name) for name in numbers]
    expected = J[:, columns] @ np.diag([1.0 / k for k in numbers.values()]) @ J[:, columns].T
    np.testing.assert_allclose(pm.compliance(robot, q), expected, atol=1e-12 * np.abs(expected).max())


def test_drive_stiffness_of_closed_chains() -> None:
    """The struts of the hexapod have springs of 2e7 N/m in its file: the drive stiffness replaces them."""
    hexapod, delta = pm.load("hexapod"), pm.load("linear_delta")
    expected = pm.compliance(hexapod, hexapod.home)
    softer = hexapod.with_drive_stiffness(1e7)
    assert len(softer.springs) == len(hexapod.springs)
    np.testing.assert_allclose(pm.compliance(softer, softer.home), 2.0 * expected, rtol=1e-9, atol=1e-18)
    # the springs of other parts stay: with rigid drives the delta is stiffer, and compliances of springs add up
    soft, stiff = (pm.compliance(delta.with_drive_stiffness(k), delta.home) for k in (1e7, 1e18))
    half = pm.compliance(delta.with_drive_stiffness(2e7), delta.home)
    np.testing.assert_allclose(soft - stiff, 2.0 * (half - stiff), rtol=1e-6, atol=1e-16)


@pytest.mark.parametrize("stiffness", [0.0, -1e7, np.nan, np.inf, 1e30, "1e7", {"elbow": 1e7}, {"elbow_joint": -1.0}])
def test_a_drive_stiffness_that_is_none(stiffness: Any) -> None:
    with pytest.raises(InvalidValueError, match="drive"):
        pm.load("ur5", drive_stiffness=stiffness)


def test_without_springs_the_message_names_the_ways_out() -> None:
    with pytest.raises(DescriptionError, match="--drive-stiffness K"):
        pm.compliance(pm.load("ur5"), np.zeros(6))
    with pytest.raises(DescriptionError, match="none to give a drive stiffness to"):
        pm.load(pin.Model(), drive_stiffness=1e7)


def test_lenient_reads_over_what_is_not_understood(tmp_path: Path, run: Any) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text('<robot name="arm"><link name="base"/><jonit/></robot>')
    with pytest.raises(DescriptionError, match=r"line 1: <jonit>.*--lenient"):
        pm.load(path)
    assert pm.load(path, lenient=True).model.nq == 0
    assert run("info", "--robot", str(path)).returncode == 1
    assert run("info", "--robot", str(path), "--lenient").returncode == 0
