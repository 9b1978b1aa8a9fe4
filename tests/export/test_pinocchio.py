"""The MJCF read by Pinocchio: bodies, frames, closures and named configurations of the URDF, from one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.kinematics.robot import Robot


def _same_joints(one: pin.Model, other: pin.Model, q: np.ndarray) -> np.ndarray:
    """The configuration of `other` with its joints where those of `one` are at q."""
    moved = pin.neutral(other)
    for name in list(one.names)[1:]:
        a, b = one.joints[one.getJointId(name)], other.joints[other.getJointId(name)]
        moved[b.idx_q : b.idx_q + b.nq] = q[a.idx_q : a.idx_q + a.nq]
    return moved


def _placed(model: pin.Model, q: np.ndarray) -> pin.Data:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data


def _assert_same(path: Path, mechanism: Robot) -> None:
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(path))
    assert set(model.names) == set(mechanism.model.names)
    assert len(points) == sum(loop.type == "3d" for loop in mechanism.closures)
    assert len(frames) == sum(loop.type == "6d" for loop in mechanism.closures)
    v = np.random.default_rng(5).uniform(-0.3, 0.3, mechanism.model.nv)
    ours = pin.integrate(mechanism.model, pin.neutral(mechanism.model), v)
    data, other = _placed(mechanism.model, ours), _placed(model, _same_joints(mechanism.model, model, ours))
    for frame in mechanism.model.frames:
        if frame.type == pin.FrameType.BODY and frame.name != "world":
            placement = other.oMf[model.getFrameId(frame.name, frame.type)]
            expected = data.oMf[mechanism.model.getFrameId(frame.name, frame.type)]
            np.testing.assert_allclose(placement.homogeneous, expected.homogeneous, rtol=0, atol=1e-14)
    _assert_same_closures(model, other, [*points, *frames], mechanism, data)
    masses = [sum(inertia.mass for inertia in list(m.inertias)[1:]) for m in (model, mechanism.model)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-14)
    order = [model.joints[model.getJointId(name)].idx_v for name in list(mechanism.model.names)[1:]]
    mass = pin.crba(model, model.createData(), _same_joints(mechanism.model, model, ours))
    expected = pin.crba(mechanism.model, mechanism.model.createData(), ours)
    np.testing.assert_allclose(mass[np.ix_(order, order)], expected, rtol=0, atol=1e-13)


def _assert_same_closures(
    model: pin.Model, data: pin.Data, constraints: list[Any], mechanism: Robot, ours: pin.Data
) -> None:
    loops = [loop for kind in ("3d", "6d") for loop in mechanism.closures if loop.type == kind]
    for constraint, loop in zip(constraints, loops, strict=True):
        ends = [
            (constraint.joint1_id, constraint.joint1_placement, loop.frame_a),
            (constraint.joint2_id, constraint.joint2_placement, loop.frame_b),
        ]
        for joint, placement, frame in ends:
            expected = ours.oMf[mechanism.frame_id(frame)]
            np.testing.assert_allclose((data.oMi[joint] * placement).translation, expected.translation, atol=1e-14)
            if loop.type == "6d":
                np.testing.assert_allclose((data.oMi[joint] * placement).rotation, expected.rotation, atol=1e-14)


def test_the_mjcf_is_the_urdf(file_of: Callable[[str, str], Path], robot: str, load: Callable[[str], Robot]) -> None:
    _assert_same(file_of(robot, "mjcf"), load(robot))


def test_a_robot_of_ones_own(four_bar: Path, tmp_path: Path) -> None:
    """With a root called world, closures on bodies with mass, and rotated products of inertia."""
    path = export_robot(four_bar, "mjcf", tmp_path / "out")[0]
    mechanism = Robot.load(four_bar)
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(path))
    assert (len(points), len(frames)) == ((1, 0) if mechanism.closures[0].type == "3d" else (0, 1))
    # Pinocchio represents a hinge without limits by an angle, and a continuous joint of a URDF by cosine and sine
    q = np.random.default_rng(5).uniform(-0.3, 0.3, model.nq)
    positions = {name: q[model.joints[model.getJointId(name)].idx_q] for name in list(model.names)[1:]}
    ours = mechanism.configuration(mechanism.place_joints(mechanism.home.q, positions)[0])
    data = _placed(model, q)
    for name in ("base", "crank", "coupler", "rocker", "tip", "rocker_tip", "tool"):
        placement = data.oMf[model.getFrameId(name, pin.FrameType.BODY)]
        np.testing.assert_allclose(placement.homogeneous, ours.frame_placement(name).homogeneous, rtol=0, atol=1e-14)
    mass = pin.crba(model, model.createData(), q)
    expected = pin.crba(mechanism.model, mechanism.model.createData(), np.array(ours.q))
    order = mechanism.velocity_indices(positions)
    np.testing.assert_allclose(mass, expected[np.ix_(order, order)], rtol=0, atol=1e-13)


def test_closed_at_ten_poses_with_the_forces_of_the_closed_form(
    file_of: Callable[[str, str], Path],
    mechanism: Robot,
    ten_positions: list[dict[str, float]],
    positions_at: Callable[..., dict[str, float]],
) -> None:
    model = pin.buildModelAndConstraintsFromMJCF(str(file_of("pm3dof", "mjcf")))[0]
    from_mjcf = Robot(model, mechanism.closures, actuated_joints=mechanism.actuated_joints)
    assert set(from_mjcf.named_configurations) == {*mechanism.named_configurations, "qpos0"}
    zero = pin.neutral(model)
    for positions in ten_positions:
        configuration = from_mjcf.configuration(from_mjcf.place_joints(zero, positions)[0])
        assert configuration.closure_residual < 1e-14
    tilted = positions_at((np.radians(10.0), np.radians(-15.0), 0.5))
    configuration = from_mjcf.configuration(from_mjcf.place_joints(zero, tilted)[0])
    expected = (5.868999588679, 5.836388512736, 6.334937172705)
    np.testing.assert_allclose(holding_forces(configuration).actuator_forces, expected, rtol=0, atol=1e-9)
