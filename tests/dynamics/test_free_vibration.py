"""Natural modes against a time simulation of small free vibration in MuJoCo, which does not use modes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import joint_positions
from pm3dof_pin.dynamics.modes import Modes, natural_modes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import AxialSpring, CantileverSpring, JointSpring
from pm3dof_pin.kinematics.robot import Robot

mujoco = pytest.importorskip("mujoco")

SOFTENING = 1e-3  # of the springs, so that a time step resolves every mode
STEP = 4e-5
PERIODS = 6
AMPLITUDE = 1e-5  # of the joint that moves most [m, rad]
TIPS = {f"link{leg}_tip": pin.Inertia(0.05, np.zeros(3), 1e-5 * np.eye(3)) for leg in (1, 2, 3)}
ARMATURE = 1e-3  # at the tip of the passive leg, whose slope carries no mass: MuJoCo moves nothing without mass
POSE = np.array([np.radians(12.0), np.radians(-20.0), 0.5])


@pytest.fixture(scope="module")
def elastic(mechanism: Robot) -> ElasticModel:
    """The tripod with soft springs."""
    soft = [
        JointSpring(s.name, s.joint, SOFTENING * s.stiffness, s.unit)
        if isinstance(s, JointSpring)
        else AxialSpring(s.name, s.at, s.axis, SOFTENING * s.stiffness)
        if isinstance(s, AxialSpring)
        else CantileverSpring(
            s.name, s.at, s.axis, SOFTENING * s.bending_stiffness, SOFTENING * s.torsional_stiffness, s.length
        )
        for s in ElasticModel(mechanism).springs
    ]
    model = ElasticModel(mechanism, soft)
    armature = np.zeros(model.mechanism.model.nv)
    names = [name for name in model.mechanism.model.names if name.startswith("passive_leg.")]
    armature[model.mechanism.velocity_indices(names)] = ARMATURE
    model.mechanism.model.armature = armature
    return model


@pytest.fixture(scope="module")
def modes(elastic: ElasticModel, tripod: Tripod) -> Modes:
    q, _ = elastic.rigid.place_joints(elastic.rigid.home.q, joint_positions(tripod, POSE))
    return natural_modes(elastic, q, payloads=TIPS)


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _place(placement: pin.SE3) -> dict[str, str]:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    return {"pos": _text(placement.translation), "quat": _text([w, x, y, z])}


def _mjcf(mechanism: Robot) -> str:
    """Write a tree with virtual joints, without gravity. Joints without a body go to the next body on their chain."""
    model, data = mechanism.model, mechanism.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false")
    option = {"timestep": repr(STEP), "gravity": "0 0 0", "integrator": "Euler", "tolerance": "1e-14"}
    ElementTree.SubElement(root, "option", option)
    bodies = [ElementTree.SubElement(root, "worldbody")]
    inertias = list(model.inertias)
    for frame, payload in TIPS.items():
        carrier = model.frames[mechanism.frame_id(frame)]
        inertias[carrier.parentJoint] = inertias[carrier.parentJoint] + carrier.placement.act(payload)
    for joint in range(1, model.njoints):
        name, parent, place = model.names[joint], model.parents[joint], model.jointPlacements[joint]
        body = bodies[parent]
        if parent == 0 or inertias[parent].mass > 0.0:
            body = ElementTree.SubElement(body, "body", {"name": name, **_place(place)})
        else:
            assert place.isIdentity(1e-12)
        bodies.append(body)
        index = mechanism.single_joint(name).v_index
        column = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, index]
        kind, axis = ("hinge", column[3:]) if column[3:].any() else ("slide", column[:3])
        moving = {"name": name, "type": kind, "axis": _text(axis), "armature": repr(float(model.armature[index]))}
        ElementTree.SubElement(body, "joint", moving)
        if inertias[joint].mass > 0.0:
            i = np.array(inertias[joint].inertia)
            moments = _text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
            mass = {"mass": repr(float(inertias[joint].mass)), "pos": _text(inertias[joint].lever)}
            ElementTree.SubElement(body, "inertial", {**mass, "fullinertia": moments})
    equality = ElementTree.SubElement(root, "equality")
    for loop in mechanism.closures:
        for frame in (model.frames[mechanism.frame_id(name)] for name in (loop.frame_a, loop.frame_b)):
            ElementTree.SubElement(bodies[frame.parentJoint], "site", name=frame.name, **_place(frame.placement))
        hard = {"solref": "0.001 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
        ElementTree.SubElement(equality, "connect", {"site1": loop.frame_a, "site2": loop.frame_b, **hard})
    return ElementTree.tostring(root, encoding="unicode")


@pytest.fixture(scope="module")
def simulation(elastic: ElasticModel) -> Any:
    return mujoco.MjModel.from_xml_string(_mjcf(elastic.mechanism))


def _deflections(simulation: Any, elastic: ElasticModel, modes: Modes, mode: int) -> np.ndarray:
    """Release with the velocities of a mode; return the deflections of all joints per step, shape=(steps, nv)."""
    where, frequency, shape = modes.configuration, modes.frequencies[mode], modes.shapes[:, mode]
    model = elastic.mechanism.model
    assert model.nq == model.nv
    names = list(model.names)[1:]
    ours = elastic.mechanism.velocity_indices(names)
    theirs = np.array([simulation.joint(name).qposadr[0] for name in names])
    start, speed = np.empty(model.nv), np.empty(model.nv)
    stiffness = np.empty((model.nv, model.nv))
    start[theirs], speed[theirs] = where.q[ours], shape[ours]
    stiffness[np.ix_(theirs, theirs)] = elastic.joint_stiffness(where)[np.ix_(ours, ours)]
    data = mujoco.MjData(simulation)
    data.qpos[:] = start
    data.qvel[:] = speed * AMPLITUDE * 2.0 * np.pi * frequency / np.abs(shape).max()
    deflections = np.empty((int(PERIODS / frequency / STEP), model.nv))
    for step in range(len(deflections)):
        deflections[step] = data.qpos - start
        data.qfrc_applied[:] = -stiffness @ deflections[step]
        mujoco.mj_step(simulation, data)
    in_our_order = np.empty_like(deflections)
    in_our_order[:, ours] = deflections[:, theirs]
    return in_our_order


def _frequency(signal: np.ndarray) -> float:
    """Frequency of a vibration from the first to the last upward crossing of zero [Hz]."""
    before = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    times = (before + signal[before] / (signal[before] - signal[before + 1])) * STEP
    return float((len(times) - 1) / (times[-1] - times[0]))


def test_the_masses_are_the_same(simulation: Any, modes: Modes) -> None:
    inertias = modes.configuration.mechanism.model.inertias
    expected = sum(inertia.mass for inertia in list(inertias)[1:]) + sum(payload.mass for payload in TIPS.values())
    assert simulation.body_mass.sum() == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("mode", range(6))
def test_a_mode_let_go_vibrates_at_its_frequency_and_keeps_its_shape(
    simulation: Any, elastic: ElasticModel, modes: Modes, mode: int
) -> None:
    deflections = _deflections(simulation, elastic, modes, mode)
    direction = modes.shapes[:, mode] / np.linalg.norm(modes.shapes[:, mode])
    along = deflections @ direction
    assert _frequency(along) == pytest.approx(modes.frequencies[mode], rel=1e-4)
    rest = deflections - np.outer(along, direction)
    assert np.linalg.norm(rest) < 1e-3 * np.linalg.norm(deflections)
