"""Transmissions against MuJoCo's mass matrix, linear programs, and lever arms that can be read off a drawing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

import pm3dof_pin as pm
from pm3dof_pin.capability.serial_model import serial_model
from pm3dof_pin.capability.transmission import Transmission, held_outside, joint_driven, transmission
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot

_ANKLE = Path(__file__).parents[1] / "machines" / "ankle" / "ankle.xml"


@pytest.fixture(scope="module")
def ankle() -> Robot:
    return joint_driven(pm.load(_ANKLE), ["pitch", "roll"])


@pytest.fixture(scope="module")
def box(ankle: Robot) -> Transmission:
    grid = ankle.grid(pitch=(-0.35, 0.35, 21), roll=(-0.17, 0.17, 21))
    poses = ankle.solve(grid, on_failure="nan")
    return transmission(ankle, poses, effort=40.0, speed=[12.0, 10.0], on_failure="nan")


def test_lever_arms_at_the_neutral_pose(ankle: Robot) -> None:
    """Rods are vertical, cranks 35 mm long, and the heel's balls 55 mm behind and 45 mm beside the axes."""
    at = transmission(ankle, [0.0, 0.0])
    pitch, roll = 55.0 / 35.0, 45.0 / 35.0
    np.testing.assert_allclose(at.jacobian, [[pitch, roll], [pitch, -roll]], atol=1e-12)
    np.testing.assert_allclose(at.rotor_inertia, 0.004 * np.diag([2.0 * pitch**2, 2.0 * roll**2]), atol=1e-15)
    np.testing.assert_allclose(at.unit_pure_torques, [2.0 * pitch, 2.0 * roll], rtol=1e-12)


def test_inertia_and_weight_are_those_of_mujoco(ankle: Robot, box: Transmission) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(_ANKLE))
    data = mujoco.MjData(model)
    names = list(ankle.model.names)[1:]
    places = [model.joint(name).qposadr[0] for name in names]
    columns = [model.joint(name).dofadr[0] for name in ("pitch", "roll")]
    for index in ((0, 0), (3, 17), (20, 20)):
        data.qpos[places] = box.poses.q[index]
        mujoco.mj_forward(model, data)
        rows = np.zeros((data.nefc, model.nv))
        assert not mujoco.mj_isSparse(model)
        rows[:] = data.efc_J.reshape(rows.shape)
        closures = rows[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        null = np.linalg.svd(closures)[2][np.linalg.matrix_rank(closures) :].T
        motions = null @ np.linalg.inv(null[columns])
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        np.testing.assert_allclose(box.inertia[index], motions.T @ mass @ motions, rtol=1e-9, atol=1e-12)
        data.qvel[:] = 0.0
        mujoco.mj_rne(model, data, 0, weight := np.zeros(model.nv))
        np.testing.assert_allclose(box.weight[index], motions.T @ weight, rtol=1e-9, atol=1e-12)


def test_torques_and_speeds_against_linear_programs(box: Transmission) -> None:
    for index in ((2, 5), (10, 10), (19, 1)):
        G = box.jacobian[index]
        for direction in ([1.0, 0.0], [0.0, -1.0], [0.6, 0.8]):
            # the greatest s with G^T tau - weight = s d
            system = np.hstack([G.T, -np.array(direction)[:, None]])
            found = linprog([0, 0, -1], A_eq=system, b_eq=box.weight[index], bounds=[(-40, 40), (-40, 40), (0, None)])
            np.testing.assert_allclose(box.torques.extent(direction)[index], found.x[2], rtol=1e-9)
            limits = np.array([12.0, 10.0])
            greatest = 1.0 / np.max(np.abs(G @ direction) / limits)
            np.testing.assert_allclose(box.speeds.extent(direction)[index], greatest, rtol=1e-12)


def test_gains_go_to_the_joints_and_back(box: Transmission) -> None:
    joints = box.joint_gains([50.0, 70.0])
    at = (4, 9)
    back = Transmission.drive_gains(_at(box, at), joints[at])
    np.testing.assert_allclose(back, np.diag([50.0, 70.0]), atol=1e-9)


def _at(box: Transmission, index: tuple[int, int]) -> Transmission:
    return transmission(box.poses.robot, box.poses[index], effort=40.0)


def test_constants_of_a_serial_model(box: Transmission) -> None:
    model = serial_model(box, kp=50.0, kd=2.0)
    diagonal = np.einsum("...ii->...i", box.rotor_inertia).reshape(-1, 2)
    typed, error = model.armature.least_wrong, model.armature.error
    np.testing.assert_allclose(np.max(np.abs(typed - diagonal) / diagonal, axis=0), error, rtol=1e-12)
    for other in (0.97 * typed, 1.03 * typed):  # any other constant is more wrong somewhere
        assert (np.max(np.abs(other - diagonal) / diagonal, axis=0) > error).all()
    assert model.torque is not None
    assert (model.torque.chosen("worst") == np.nanmin(box.pure_torques.reshape(-1, 2), axis=0)).all()
    assert (model.armature.chosen("worst") == diagonal.max(axis=0)).all()
    np.testing.assert_allclose(model.gains["kp"].greatest / model.gains["kd"].greatest, 25.0)


def test_a_box_partly_out_of_reach(ankle: Robot) -> None:
    poses = ankle.solve(ankle.grid(pitch=(-1.0, 1.0, 41), roll=(-0.3, 0.3, 7)), on_failure="nan")
    found = serial_model(transmission(ankle, poses, on_failure="nan"))
    assert 0.0 < found.unreached == pytest.approx(1.0 - poses.within_limits.mean())
    assert found.torque is None
    inner = np.abs(np.linspace(-1.0, 1.0, 41)) <= found.reached_scale + 1e-9
    outer = np.abs(np.linspace(-1.0, 1.0, 7)) <= found.reached_scale + 1e-9
    assert poses.within_limits[np.ix_(inner, outer)].all()
    assert not poses.within_limits[inner].all() or not poses.within_limits.all()


def test_one_leg_of_a_walker_held_outside() -> None:
    """A part of a machine on a free base has the transmission that it has with the base held."""
    walker = pm.load(Path(__file__).parents[1] / "machines" / "walker" / "walker.xml")
    link = next(
        frame.name
        for frame in walker.model.frames
        if frame.parentJoint > 0 and 2 < sum(frame.parentJoint in s for s in walker.model.supports) < 8
    )
    part = held_outside(walker, link)
    assert 0 < part.model.njoints < walker.model.njoints
    assert part.home.closure_residual < 1e-9


def test_what_does_not_work_is_named(ankle: Robot) -> None:
    at = transmission(ankle, [0.0, 0.0], effort={"left_motor": 40.0, "right_motor": 0.0})
    with pytest.raises(InvalidValueError, match=r"right_motor.*zero"):
        at.torques  # noqa: B018
    with pytest.raises(InvalidValueError, match=r"left_motor"):
        transmission(ankle, [0.0, 0.0], effort={"middle": 1.0})
    with pytest.raises(InvalidValueError, match="negative"):
        transmission(ankle, [0.0, 0.0], speed=-1.0)
    with pytest.raises(SingularConfigurationError, match="do not determine"):
        transmission(joint_driven(ankle, ["pitch", "roll"], ["left_motor"]), [0.0, 0.0])


def test_the_command(answer: Callable[..., Any], tmp_path: Path) -> None:
    options = ["--robot", str(_ANKLE), "--joints", "pitch,roll", "--over", "pitch", "-20", "20", "9"]
    options += ["--over", "roll", "-10", "10", "5", "--effort", "40", "--speed", "10", "--out", str(tmp_path)]
    result = answer("transmission", "5", "-3", *options)
    robot = joint_driven(pm.load(_ANKLE), ["pitch", "roll"])
    expected = transmission(robot, np.radians([5.0, -3.0]), effort=40.0)
    np.testing.assert_allclose(result["jacobian"], expected.jacobian, rtol=1e-12)
    assert result["joints"] == ["pitch", "roll"]
    assert len(result["torque_polytope_N_m"]) == 4
    assert set(result["greatest_pure_torque_N_m"]) == {"pitch", "roll"}
    sheet = (tmp_path / "transmission.csv").read_text().splitlines()
    assert len(sheet) == 46
    assert (tmp_path / "transmission.nc").stat().st_size > 1000
