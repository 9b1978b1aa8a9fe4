"""Heat of single bodies in budget, simulation and calibration; rods that are closures; groups of bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.source_numbers import SourceNumbers, Thermal
from pm3dof_pin.errors.body_temperatures import BodyTemperatures
from pm3dof_pin.errors.expansion_field import ExpansionField
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError
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


def test_a_linear_field_strains_no_body() -> None:
    """The motion has the strain e + h r in all directions and no other, and its curl is twice the rotation."""
    field = ExpansionField(3e-4, np.array([2e-4, -1e-4, 5e-4]))
    place, step = np.array([0.3, -0.2, 0.5]), 1e-4
    slopes = np.column_stack(
        [
            (field.motion(place + offset).translation - field.motion(place - offset).translation) / (2.0 * step)
            for offset in step * np.eye(3)
        ]
    )
    np.testing.assert_allclose(0.5 * (slopes + slopes.T), (3e-4 + field.gradient @ place) * np.eye(3), atol=1e-11)
    turn = pin.log3(field.motion(place).rotation)
    np.testing.assert_allclose(pin.skew(turn), 0.5 * (slopes - slopes.T), atol=1e-11)


def column() -> Robot:
    """A column of 400 mm on a table that slides, with a sensor at its foot and one at each side of its head."""
    model = pin.Model()
    model.name = "column"
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "table")
    carrier = model.addJointFrame(joint)
    for name, place in {
        "foot": (0, 0, 0),
        "head": (0, 0, 0.4),
        "left": (-0.05, 0, 0.4),
        "right": (0.05, 0, 0.4),
    }.items():
        model.addFrame(pin.Frame(name, joint, carrier, pin.SE3(np.eye(3), np.array(place)), pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = np.zeros(1)
    return Robot(model, [], actuated_joints=["table"], tool_frame="head")


def test_gradients_bend_and_sensors_tell_them() -> None:
    """A column 2 K warmer on one side leans to the other; one warmer at its head has its mean rise along it."""
    robot = column()
    heat, poses = BodyTemperatures(robot, np.zeros(1)), robot.forward([[0.0]])
    bent = EXPANSION * 20.0 * np.array([-0.5 * 0.4**2, 0.0, 0.0, 0.0, -0.4, 0.0])
    np.testing.assert_allclose(heat.motions(poses, {"foot:x": 20.0})[0], bent, atol=1e-9)
    np.testing.assert_allclose(heat.motions(poses, {"left": -1.0, "right": 1.0})[0], bent, atol=1e-9)
    longer = heat.motions(poses, {"foot": 0.0, "head": 6.0})[0]
    np.testing.assert_allclose(longer, [0.0, 0.0, EXPANSION * 3.0 * 0.4, 0.0, 0.0, 0.0], atol=1e-9)
    with pytest.raises(InvalidValueError, match="foot:w"):
        heat.warmed({"foot:w": 1.0})


def test_materials_differ() -> None:
    """Aluminium grows by its own coefficient; the default is that of the error file, steel."""
    heat = BodyTemperatures(column(), np.zeros(1), Thermal(expansions_per_K={"head": 23e-6}))
    poses = heat.robot.forward([[0.0]])
    assert heat.poses(poses, {"all": 5.0})[0, 2, 3] == pytest.approx(0.4 * (1.0 + 5.0 * 23e-6), abs=1e-15)
    errors = pm.GeometricErrors.load("hexapod")
    sources = ErrorSources(errors, SourceNumbers(thermal=Thermal(expansions_per_K={"platform": 2.0 * EXPANSION})))
    poses = pm.reachable_poses(errors.robot, 3, np.random.default_rng(4))
    found = {source.name: source for source in sources.at(poses, ["thermal"])}["thermal_growth"]
    heat = BodyTemperatures.from_errors(errors)
    twice = heat.motions(poses, {"all": 8.0, "platform": 16.0})
    np.testing.assert_allclose(found.effects[:, :, 0] * np.sqrt(3.0), twice, rtol=2e-3, atol=1e-10)


@pytest.mark.parametrize("leader", ["turn", "slide"])
def test_racks_and_telescopes_expand(leader: str) -> None:
    """A head that follows a pinion, or another slide, of a machine that is warm all over, which scales."""
    model = pin.Model()
    model.name = leader
    first = {"turn": pin.JointModelRY(), "slide": pin.JointModelPX()}[leader]
    start, step = (pin.SE3(np.eye(3), np.array(at)) for at in ((0.1, 0.2, 0.05), (0.1, 0.0, 0.05)))
    one = model.addJoint(0, first, start, leader)
    two = model.addJoint(0 if leader == "turn" else one, pin.JointModelPX(), step, "head_joint")
    model.addFrame(pin.Frame("head", two, model.addJointFrame(two), pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = np.array([0.0, 0.03])
    coupling = Coupling("head_joint", (leader,), ((0.02, 0.7),), 0.03)
    robot = Robot(model, couplings=[coupling], actuated_joints=[leader], tool_frame="head")
    poses = robot.forward([[0.1]])
    expected = np.array(poses.transforms)
    expected[:, :3, 3] *= 1.0 + 8.0 * EXPANSION
    heat = BodyTemperatures(robot, np.array([0.04]))
    np.testing.assert_allclose(heat.poses(poses, {"all": 8.0}), expected, atol=1e-12)


def test_a_budget_has_gradients() -> None:
    errors = pm.GeometricErrors.load("hexapod")
    sources = ErrorSources(errors, SourceNumbers(thermal=Thermal(gradients_K_per_m={"platform": 10.0})))
    poses = pm.reachable_poses(errors.robot, 3, np.random.default_rng(2))
    (found,) = (source for source in sources.at(poses, ["thermal"]) if source.name == "thermal_fields")
    heat = BodyTemperatures.from_errors(errors)
    motions = [heat.motions(poses, {f"platform:{axis}": 10.0}) for axis in "xyz"]
    np.testing.assert_allclose(found.effects * np.sqrt(3.0), np.stack(motions, axis=2), rtol=5e-3, atol=2e-10)
