"""Heat of single bodies in budget, simulation and calibration; rods that are closures; groups of bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.source_numbers import SourceNumbers, Thermal
from pm3dof_pin.errors.body_temperatures import BodyTemperatures
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.simulation.simulated_machine import Conditions, SimulatedMachine

EXPANSION = 11.5e-6
ROD = 0.3


@pytest.fixture(scope="module")
def on_rods() -> Robot:
    """A carriage that moves up and down on a column, held by a rod of 300 mm to a slide on the ground."""
    model = pin.Model()
    model.name = "lift"
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    for name, joint in (("foot", slide), ("head", lift)):
        carrier = model.addJointFrame(joint)
        model.addFrame(pin.Frame(name, joint, carrier, pin.SE3.Identity(), pin.FrameType.BODY))
    home = np.array([0.18, 0.24])
    model.referenceConfigurations["home"] = home
    rod = LoopClosure("foot", "head", "distance", length=ROD)
    return Robot(model, [rod], actuated_joints=["slide"], tool_frame="head")


def test_a_rod_expands_with_its_own_temperature(on_rods: Robot) -> None:
    """z = sqrt(l^2 - x^2): only the rod 10 K warmer; and all 10 K warmer, which scales."""
    heat = BodyTemperatures(on_rods, np.zeros(1))
    poses = on_rods.forward([[0.18]])
    rod = on_rods.closures[0].name
    assert rod in heat.names
    warm = heat.poses(poses, {rod: 10.0})[0, 2, 3]
    assert warm == pytest.approx(np.sqrt((ROD * (1.0 + 10.0 * EXPANSION)) ** 2 - 0.18**2), abs=1e-12)
    scaled = heat.poses(poses, {"all": 10.0})[0, 2, 3]
    assert scaled == pytest.approx(0.24 * (1.0 + 10.0 * EXPANSION), abs=1e-12)


def test_groups_name_their_members() -> None:
    errors = pm.GeometricErrors.load("pm3dof")
    heat = BodyTemperatures.from_errors(errors)
    poses = pm.reachable_poses(errors.robot, 5, np.random.default_rng(0))
    single = dict.fromkeys(errors.robot.actuated_joints, 6.0)
    np.testing.assert_array_equal(heat.motions(poses, {"screws": 6.0}), heat.motions(poses, single))
    np.testing.assert_array_equal(heat.motions(poses, {"spindle": 4.0}), heat.motions(poses, {"platform": 4.0}))
    assert np.abs(heat.motions(poses, {"drives": 4.0})).max() > 1e-6


def test_the_budget_of_single_bodies() -> None:
    """Uniform between plus and minus 5 K: the motion of one warm platform over sqrt 3, from the warmed robot."""
    errors = pm.GeometricErrors.load("hexapod")
    thermal = Thermal(bodies_K={"platform": 5.0, "screws": 2.0})
    sources = ErrorSources(errors, SourceNumbers(thermal=thermal))
    poses = pm.reachable_poses(errors.robot, 4, np.random.default_rng(2))
    (found,) = (source for source in sources.at(poses, ["thermal"]) if source.name == "thermal_bodies")
    motion = BodyTemperatures.from_errors(errors).motions(poses, {"platform": 5.0})
    np.testing.assert_allclose(found.effects[:, :, 0] * np.sqrt(3.0), motion, rtol=1e-3, atol=1e-11)


def test_a_warm_machine_is_calibrated_as_if_cold() -> None:
    """The same machine measured cold and at known temperatures: the same parameters, to what heat does to errors."""
    errors, generator = pm.GeometricErrors.load("hexapod"), np.random.default_rng(3)
    machine = SimulatedMachine.random(errors, generator, everything=False)
    commands = pm.reachable_poses(errors.robot, 40, generator).commands
    rises = {"platform": np.linspace(0.0, 9.0, 40), "screws": np.linspace(8.0, -3.0, 40)}
    cold = machine.poses(commands)
    warm = machine.poses(commands, Conditions(body_rises=rises))
    assert np.abs(warm - cold).max() > 1e-5
    measured = [pm.Measurements.from_poses(commands, poses) for poses in (cold, warm)]
    columns = {f"rise_{name}_K": values for name, values in rises.items()}
    measured[1] = replace(measured[1], conditions=columns)
    found = [pm.calibrate(each, errors, "lm", on_refusal="keep") for each in measured]
    wanted = pm.reachable_poses(errors.robot, 5, generator)
    (first, second) = (calibration.compensate(wanted).commands for calibration in found)
    np.testing.assert_allclose(first, second, atol=2e-7)
    blind = pm.calibrate(replace(measured[1], conditions={}), errors, "lm", on_refusal="keep")
    assert np.abs(blind.compensate(wanted).commands - first).max() > 2e-6
