"""Thermal growth against closed forms: screws, members, bent members, and a machine that is warm all over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.source_numbers import SourceNumbers, Thermal
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.errors.thermal_growth import Bending, ThermalGrowth
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.simulation.simulated_machine import Conditions, SimulatedMachine

SCREWS = ("pm3dof", "linear_delta", "hexapod")  # sliding drives: at a fixed reading they grow with the machine
ROBOTS = (*SCREWS, "three_rps")

BRANCH = """<robot name="arm">
  <link name="base"/><link name="beam"/><link name="flange"/><link name="tool"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="beam"/><origin xyz="0 0 0.4" rpy="0.3 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="bolts" type="fixed"><parent link="beam"/><child link="flange"/>
    <origin xyz="0.3 0 0.1" rpy="0 0.5 0"/></joint>
  <joint name="chuck" type="fixed"><parent link="flange"/><child link="tool"/><origin xyz="0.05 0 0.2"/></joint>
</robot>"""


def test_ten_kelvin_lengthen_a_screw_of_240_mm_by_28_um(tripod_errors: GeometricErrors) -> None:
    growth = ThermalGrowth(tripod_errors.fixed_bearings)
    np.testing.assert_allclose(growth.travel_errors(np.zeros((1, 3)), np.full((1, 3), 10.0)), 11.5e-5 * 0.240272)


@pytest.mark.parametrize("bearing", [0.0, 0.15, 0.5, -0.1])
def test_the_growth_is_the_integral_of_the_temperature(bearing: float) -> None:
    """Against a fine sum over the piecewise linear profile."""
    profile = ((0.05, 1.0), (0.1, 2.0), (0.3, 0.5))
    growth = ThermalGrowth(np.array([bearing]), profile, expansion=1.0)
    for travel in (-0.2, 0.0, 0.07, 0.2, 0.6):
        distances = np.linspace(0.0, travel - bearing, 200_001)
        shares = np.interp(distances, *np.transpose(profile))
        expected = np.sum(0.5 * (shares[1:] + shares[:-1]) * np.diff(distances))
        computed = growth.travel_errors(np.array([[travel]]), np.array([[1.0]]))
        assert computed[0, 0] == pytest.approx(expected, abs=1e-8)


def test_members_grow_with_their_length(mechanism: Robot) -> None:
    growth = ThermalGrowth(np.zeros(3), members={"link1_tip": 0.5, "E2": 1.0})
    grown = growth.grown(mechanism, 20.0)
    link = grown.home.frame_placement("universal1_second_joint").actInv(grown.home.frame_placement("link1_tip"))
    assert np.linalg.norm(link.translation) == pytest.approx(0.353 * (1.0 + 0.5 * 20.0 * 11.5e-6), rel=1e-15)
    joint = grown.home.frame_placement("platform").actInv(grown.home.frame_placement("E2"))
    assert np.linalg.norm(joint.translation) == pytest.approx(np.hypot(0.075, 0.013) * (1.0 + 20.0 * 11.5e-6))


def test_a_bent_member_ends_on_its_arc(mechanism: Robot) -> None:
    """Two fibres 30 mm apart, one 5 K warmer: concentric arcs over the length of the link, towards the colder one."""
    expansion, depth, across = 11.5e-6, 0.03, 5.0
    growth = ThermalGrowth(np.zeros(3), bending={"link1_tip": Bending((across / depth, 0.0))})
    before, after = (
        robot.home.frame_placement("universal1_second_joint").actInv(robot.home.frame_placement("link1_tip"))
        for robot in (mechanism, growth.grown(mechanism, 1.0))
    )
    along = before.translation / 0.353
    radius = depth / (expansion * across)
    angle = 0.353 / radius
    aside = after.translation - before.translation
    assert np.linalg.norm(aside) == pytest.approx(radius * (1.0 - np.cos(angle)), rel=1e-6)
    assert aside @ along == pytest.approx(0.0, abs=1e-12)
    turn = pin.log3(before.rotation.T @ after.rotation)
    assert np.linalg.norm(turn) == pytest.approx(angle, rel=1e-9)
    # the end points the way it has moved
    np.testing.assert_allclose(np.cross(before.rotation @ turn, along), 2.0 * aside / 0.353, atol=1e-12)
    straight = ThermalGrowth(np.zeros(3), bending={"passive_cross": Bending((1.0, 0.0))})
    with pytest.raises(InvalidValueError, match="along_m"):
        straight.growth(mechanism)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_machine_that_is_warm_all_over_scales(name: str) -> None:
    """Eight kelvin everywhere, screws included: the tool moves by alpha dT r, without a tilt."""
    errors = GeometricErrors.load(name)
    poses = pm.reachable_poses(errors.robot, 10, np.random.default_rng(0))
    members = {p.place: 1.0 for p in all_parameters(errors.robot) if p.motion == "translation"}
    machine = SimulatedMachine(errors.robot, thermal=ThermalGrowth(errors.fixed_bearings, members=members))
    expected = np.array(poses.transforms)
    expected[:, :3, 3] *= 1.0 + 8.0 * 11.5e-6
    np.testing.assert_allclose(machine.poses(poses.commands, Conditions(8.0)), expected, atol=1e-12)
    numbers = SourceNumbers(thermal=Thermal(members=1.0, between_drives_K=0.0))
    (source,) = ErrorSources(errors, numbers).at(poses, ["thermal"])
    per_strain = source.effects[:, :, 0] * np.sqrt(3.0) / (8.0 * 11.5e-6)
    np.testing.assert_allclose(per_strain[:, :3], poses.positions, atol=1e-7)
    np.testing.assert_allclose(per_strain[:, 3:], 0.0, atol=1e-6)


def test_a_member_that_another_carries_grows_from_there(tmp_path: Path) -> None:
    """Flange and tool on one body: with both as members the tool's offset from the joint grows once."""
    (tmp_path / "arm.urdf").write_text(BRANCH, encoding="utf-8")
    robot = Robot.load(tmp_path / "arm.urdf", tool_frame="tool")
    place = robot.configuration([0.4]).tool_placement.translation
    for names in (("turn", "flange", "tool"), ("turn", "tool")):
        grown = ThermalGrowth(np.zeros(1), members=dict.fromkeys(names, 1.0), expansion=1e-5).grown(robot, 10.0)
        after = grown.configuration([0.4]).tool_placement.translation
        np.testing.assert_allclose(after, (1.0 + 1e-4) * place, rtol=1e-14)
    rigid_tool = ThermalGrowth(np.zeros(1), members={"flange": 1.0, "tool": 0.0}, expansion=1e-5).grown(robot, 10.0)
    at_joint = robot.configuration([0.4]).frame_placement("turn").translation
    flange = robot.configuration([0.4]).frame_placement("flange").translation - at_joint
    after = rigid_tool.configuration([0.4]).tool_placement.translation
    np.testing.assert_allclose(after, place + 1e-4 * flange, rtol=1e-14)
