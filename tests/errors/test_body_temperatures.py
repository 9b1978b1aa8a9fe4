"""Temperatures of bodies: uniform warming scales the machine, single bodies move it as their lengths do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.errors.body_temperatures import BodyTemperatures
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference
from pm3dof_pin.exceptions import InvalidValueError

MACHINES = Path(__file__).parents[1] / "machines"
SHIPPED = ("pm3dof", "hexapod", "linear_delta", "three_rps", "ankle_rus", "ankle_spu")
OTHERS = ("agile_eye", "delta", "five_bar", "four_bar", "four_rrr", "three_rpr")
ROBOTS = (*SHIPPED, *(str(MACHINES / name) for name in OTHERS))
EXPANSION = 11.5e-6


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("rise", [8.0, -10.0])
def test_uniform_warming_scales(name: str, rise: float) -> None:
    errors = GeometricErrors.load(name)
    poses = pm.reachable_poses(errors.robot, 10, np.random.default_rng(0))
    expected = np.array(poses.transforms)
    expected[:, :3, 3] *= 1.0 + rise * EXPANSION
    found = BodyTemperatures.from_errors(errors).poses(poses, {"all": rise})
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "linear_delta"])
def test_corrections_take_the_warm_tool_back(name: str) -> None:
    """What is left is what commands cannot reach: nothing of the six components that a hexapod's drives move."""
    errors = GeometricErrors.load(name)
    robot = errors.robot
    poses = pm.reachable_poses(robot, 6, np.random.default_rng(1))
    heat = BodyTemperatures.from_errors(errors)
    rises = {"all": 4.0, heat.robot.actuated_joints[0]: 11.0}
    corrected = robot.forward(poses.commands + heat.corrections(poses, rises), guess=poses.q)
    before = pose_difference(poses.transforms, heat.poses(poses, rises))
    after = pose_difference(poses.transforms, heat.poses(corrected, rises))
    controlled = {"pm3dof": [2], "linear_delta": [0, 1, 2], "hexapod": [0, 1, 2, 3, 4, 5]}[name]
    assert np.abs(before[:, controlled]).max() > 1e-6
    scale = 1e-9 if name == "hexapod" else 2e-6
    assert np.abs(after[:, controlled]).max() < scale


def test_one_link_of_the_hexapod_lengthens() -> None:
    """With its platform 10 K warmer, joints there move apart: against a description with these lengths."""
    errors = GeometricErrors.load("hexapod")
    warm, screws = BodyTemperatures.from_errors(errors).warmed({"platform": 10.0})
    np.testing.assert_array_equal(screws, 0.0)
    for frame in ("B1", "B4"):
        before, after = (
            robot.model.frames[robot.frame_id(frame)].placement.translation for robot in (errors.robot, warm)
        )
        np.testing.assert_allclose(after, before * (1.0 + 10.0 * EXPANSION), rtol=1e-14)


@pytest.mark.parametrize("rise", [10.0, -10.0])
def test_a_warm_platform_moves_the_tool_as_other_lengths_do(rise: float) -> None:
    """Against a description with all lengths of the platform changed, and finite differences by these lengths."""
    errors = GeometricErrors.load("hexapod")
    poses = pm.reachable_poses(errors.robot, 5, np.random.default_rng(2))
    joint = errors.robot.model.frames[errors.robot.frame_id("O_e")].parentJoint

    def tools(strain: float) -> np.ndarray:
        model = errors.robot.model.copy()
        for frame in model.frames:
            if frame.parentJoint == joint and frame.name in ("O_e", *(f"B{k}" for k in range(1, 7))):
                frame.placement = pin.SE3(frame.placement.rotation, (1.0 + strain) * frame.placement.translation)
        described = errors.robot.replace(model=model)
        return np.array(described.forward(poses.commands, guess=poses.q).transforms)

    heat = BodyTemperatures.from_errors(errors)
    np.testing.assert_allclose(heat.poses(poses, {"platform": rise}), tools(rise * EXPANSION), atol=1e-11)
    step = 1e-6
    slopes = (tools(step) - tools(-step))[:, :3, 3] / (2.0 * step)
    moved = heat.motions(poses, {"platform": rise})[:, :3]
    np.testing.assert_allclose(moved, rise * EXPANSION * slopes, atol=2e-9)
    assert np.abs(moved).max() > 1e-6


def test_unknown_bodies_are_refused() -> None:
    heat = BodyTemperatures.from_errors(GeometricErrors.load("pm3dof"))
    with pytest.raises(InvalidValueError, match="turret"):
        heat.warmed({"turret": 3.0})
    assert {"all", "platform", "slider1_joint"} <= set(heat.names)
