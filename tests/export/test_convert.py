"""Robots from one dialect to another and back: the same mechanism, and every loss listed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.robots import robot_names
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.export.convert import convert_robot
from pm3dof_pin.kinematics.robot import Robot

MACHINES = Path(__file__).parents[1] / "machines"
_SUFFIX = {"urdf": ".urdf", "mjcf": ".xml", "sdf": ".sdf", "drake": ".urdf"}
_ROBOTS = [*robot_names(), *(str(MACHINES / name) for name in ("agile_eye", "delta", "five_bar", "four_rrr"))]


@pytest.mark.parametrize("dialect", _SUFFIX)
@pytest.mark.parametrize("name", _ROBOTS, ids=lambda name: Path(name).name)
def test_another_dialect_describes_the_same_mechanism(tmp_path: Path, name: str, dialect: str) -> None:
    robot = Robot.load(name)
    done = convert_robot(name, tmp_path / f"robot{_SUFFIX[dialect]}", dialect=dialect, meshes=False)
    again = Robot.load(tmp_path / f"robot{_SUFFIX[dialect]}")
    assert again.home.closure_residual < 1e-12
    assert pm.instantaneous_mobility(again.home).count == pm.instantaneous_mobility(robot.home).count
    assert again.actuated_joints == robot.actuated_joints
    assert [c.name for c in again.coordinates] == [c.name for c in robot.coordinates]
    assert again.tool_frame == robot.tool_frame
    assert len(again.springs) == len(robot.springs) or [c.type for c in again.closures] != [
        c.type for c in robot.closures
    ]
    home = again.home.tool_placement.homogeneous
    np.testing.assert_allclose(home, robot.home.tool_placement.homogeneous, atol=1e-12)
    np.testing.assert_allclose(again.home.commands, robot.home.commands, atol=1e-12)
    if robot.springs and "the stiffness at home is another" not in done.losses:
        both = [pm.compliance(which, which.at([which.home.q])) for which in (robot, again)]
        np.testing.assert_allclose(both[0], both[1], atol=1e-9 * np.abs(both[0]).max())


def test_stiffness_is_kept_where_springs_are(tmp_path: Path) -> None:
    """All but three_rps in MJCF, whose beams carry more than the closures, and in what has other closures."""
    for name in ("pm3dof", "hexapod", "linear_delta"):
        for dialect, suffix in _SUFFIX.items():
            done = convert_robot(name, tmp_path / f"{name}_{dialect}{suffix}", dialect=dialect, meshes=False)
            assert not [loss for loss in done.losses if "stiffness at home" in loss or "springs" in loss], name


@pytest.mark.parametrize("dialect", ["mjcf", "sdf", "drake"])
def test_there_and_back_again(tmp_path: Path, dialect: str) -> None:
    robot, middle = Robot.load("hexapod"), tmp_path / f"middle{_SUFFIX[dialect]}"
    convert_robot("hexapod", middle, dialect=dialect, meshes=False)
    convert_robot(middle, tmp_path / "back.urdf", dialect="urdf", meshes=False)
    again = Robot.load(tmp_path / "back.urdf")
    assert len(again.closures) == len(robot.closures)
    assert {loop.type for loop in again.closures} == {"3d"}
    np.testing.assert_allclose(again.home.tool_placement.homogeneous, robot.home.tool_placement.homogeneous, atol=1e-12)
    both = [pm.compliance(which, which.at([which.home.q])) for which in (robot, again)]
    np.testing.assert_allclose(both[0], both[1], atol=1e-8 * np.abs(both[0]).max())


def test_losses_are_listed_and_may_be_errors(tmp_path: Path) -> None:
    done = convert_robot("hexapod", tmp_path / "hexapod.xml")
    assert "swing limits of closures" in done.losses
    assert any(loss.startswith("limits in the group strut_tip-B: strut1_tip-B1, strut2") for loss in done.losses)
    assert any(loss.startswith("velocity of strut1_joint") for loss in done.losses), "MJCF has no greatest speeds"
    with pytest.raises(DescriptionError, match="swing limits of closures"):
        convert_robot("hexapod", tmp_path / "strict" / "hexapod.xml", strict=True)
    assert not (tmp_path / "strict").exists()
    assert convert_robot("hexapod", tmp_path / "hexapod.urdf", strict=True).losses == ()


def test_springs_at_massless_frames_keep_their_places_in_mjcf(tmp_path: Path) -> None:
    """The tubes of a leg of three_rps are springs at its tip frames, which carry the ends of the closures."""
    done = convert_robot("three_rps", tmp_path / "robot.xml")
    robot, again = pm.load("three_rps"), pm.load(tmp_path / "robot.xml")
    expected = pm.compliance(robot, robot.home)
    np.testing.assert_allclose(pm.compliance(again, again.home), expected, atol=1e-9 * np.abs(expected).max())
    assert not [loss for loss in done.losses if "stiffness" in loss or "spring" in loss]


def test_a_suffix_says_the_dialect(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match="urdf, mjcf, sdf or drake"):
        convert_robot("pm3dof", tmp_path / "pm3dof.step")
    drake = convert_robot("pm3dof", tmp_path / "pm3dof.urdf", dialect="drake").files[0]
    assert "ball_constraint" in drake.read_text()


def test_armature_and_gains_pass_from_mjcf_to_mjcf(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        """<mujoco model="arm"><compiler angle="radian" autolimits="true"/><worldbody><body name="a">
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <joint name="j" type="hinge" axis="0 0 1" armature="0.02" damping="0.3" frictionloss="0.1" range="-1 2"/>
        <body name="b" pos="0.2 0 0"><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <joint name="k" type="hinge" axis="0 1 0"/></body></body></worldbody>
        <equality><joint joint1="k" joint2="j" polycoef="0.1 2 0.3 0 0"/></equality>
        <actuator><position name="servo" joint="j" gear="30" kp="200" kv="4" ctrlrange="-1 1" forcerange="-5 5"/>
        </actuator></mujoco>"""
    )
    done = convert_robot(tmp_path / "arm.xml", tmp_path / "out.xml")
    first, second = Robot.load(tmp_path / "arm.xml"), Robot.load(tmp_path / "out.xml")
    assert first.couplings == second.couplings
    assert pm.instantaneous_mobility(second.replace(tool_frame="b").home).count == 1
    assert [loss for loss in done.losses if "drive" in loss or "armature" in loss] == []
    assert second.description.drives[0].gear == 30.0
    assert second.description.drives[0].proportional_gain == 200.0


def test_the_command_lists_what_is_lost(answer: Callable[..., Any], tmp_path: Path) -> None:
    assert "swing limits of closures" in answer("convert", "three_rps", str(tmp_path / "out.sdf"))["losses"]
    assert answer("convert", "three_rps", str(tmp_path / "out.urdf"))["losses"] == []


NAMESAKES = """<mujoco model="leg"><compiler angle="radian"/><worldbody><body name="hip"><joint name="hip" axis="0 1 0"
stiffness="7"/><geom size="0.1"/><body name="shin" pos="0.3 0 0"><joint name="shin" axis="0 1 0" stiffness="50"
springref="0.1"/><geom size="0.1"/><site name="toe" pos="0.4 0 0"/><body name="foot" pos="0.4 0 0"><joint name="toe"
axis="0 1 0"/><geom size="0.05"/></body></body></body></worldbody><equality><joint joint1="toe" joint2="shin"
polycoef="0 0.5 0 0 0"/></equality><actuator><motor name="m" joint="hip"/></actuator></mujoco>"""
"""Joints with the names of bodies and of a site, as is usual in MJCF, two of them with springs."""


@pytest.mark.parametrize("dialect", ["mjcf", "sdf", "urdf", "drake"])
def test_joints_may_have_the_names_of_links_and_springs(tmp_path: Path, dialect: str) -> None:
    source = tmp_path / "leg.xml"
    source.write_text(NAMESAKES, encoding="utf-8")
    target = tmp_path / "out" / {"mjcf": "leg.xml", "sdf": "leg.sdf"}.get(dialect, "leg.urdf")
    target.parent.mkdir()
    losses = convert_robot(source, target, dialect=dialect, tool_frame="foot").losses
    assert sum("is called" in loss for loss in losses) == (3 if dialect == "sdf" else 0)
    before, after = pm.load(source, tool_frame="foot"), pm.load(target, tool_frame="foot")
    assert [spring["name"] for spring in after.springs] == [spring["name"] for spring in before.springs]
    assert len(after.couplings) == len(before.couplings) == 1
    found, expected = (np.asarray(pm.compliance(robot, robot.home)) for robot in (after, before))
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    if dialect == "sdf":
        assert after.actuated_joints == ("hip_joint",)
        assert after.description.joint("shin_joint").stiffness == 50.0
        if shutil.which("ign"):
            done = subprocess.run(["ign", "sdf", "--check", target], capture_output=True, text=True, check=False)
            assert "Valid" in done.stdout, done.stdout + done.stderr
