"""Inertia and weight felt by any description of motion, against kinetic and potential energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices
from pm3dof_pin.dynamics.motion_dynamics import motion_dynamics

_MACHINES = Path(__file__).parents[1] / "machines"


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "linear_delta", "five_bar"])
def test_energy_at_unit_rates_and_over_the_height(name: str) -> None:
    """Half x^T H x is the kinetic energy of solved poses in motion; the weight is the potential's derivative."""
    robot = pm.load(_MACHINES / name if (_MACHINES / name).exists() else name)
    poses = pm.reachable_poses(robot, 210, np.random.default_rng(0), margin=0.2)
    found = motion_dynamics(robot, poses, by="coordinates")
    reference = motion_dynamics(robot, poses[:3], by="coordinates", engine="pinocchio")
    np.testing.assert_allclose(found.inertia[:3], reference.inertia, atol=1e-12 * np.abs(reference.inertia).max())
    np.testing.assert_allclose(
        found.weight[:3], reference.weight, atol=1e-12 * np.abs(reference.weight).max(initial=1.0)
    )
    step = 1e-5 * robot.characteristic_length
    model, data = robot.model, robot.model.createData()
    at, q = poses.coordinates[0], poses.q[0]
    for k, change in enumerate(step * np.eye(at.size)):
        ahead, behind = (robot.solve(at + sign * change, guess=q).q for sign in (1.0, -1.0))
        v = pin.difference(model, behind, ahead) / (2.0 * step)
        energy = pin.computeKineticEnergy(model, data, q, v)
        np.testing.assert_allclose(0.5 * found.inertia[0, k, k], energy, rtol=1e-6)
        height = [pin.computePotentialEnergy(model, data, end) for end in (ahead, behind)]
        np.testing.assert_allclose(
            found.weight[0, k], (height[0] - height[1]) / (2.0 * step), atol=1e-6 * (1.0 + np.abs(found.weight).max())
        )


def test_weight_by_commands_is_what_the_drives_hold() -> None:
    robot = pm.load("pm3dof")
    poses = pm.reachable_poses(robot, 20, np.random.default_rng(0))
    np.testing.assert_allclose(
        motion_dynamics(robot, poses, by="commands").weight, actuator_forces(robot, poses), atol=1e-10
    )


def test_rotors_count_on_both_engines() -> None:
    """The armature of a joint adds to the mass matrix what it adds to the energy: half of it times the rate squared."""
    ankle = pm.load(_MACHINES / "ankle" / "ankle.xml", tool_frame="sole")
    q = np.tile(ankle.solve([0.1, 0.05]).q, (1100, 1))
    assert ankle.model.armature.max() == 0.004
    single, many = drive_mass_matrices(ankle, q[:1])[0], drive_mass_matrices(ankle, q)[0]
    np.testing.assert_allclose(single, many, rtol=1e-10)
    without = ankle.replace(model=_without_rotors(ankle.model))
    np.testing.assert_allclose(many - drive_mass_matrices(without, q)[0], 0.004 * np.eye(2), atol=1e-12)
    found, reference = (motion_dynamics(ankle, poses, by="commands").inertia[0] for poses in (q, q[:1]))
    np.testing.assert_allclose(found, reference, rtol=1e-10)
    np.testing.assert_allclose(found, many, rtol=1e-10)


def _without_rotors(model: pin.Model) -> pin.Model:
    bare = model.copy()
    bare.armature = np.zeros(model.nv)
    return bare


@pytest.mark.parametrize("name", ["ankle_rus", "ankle_spu", "hexapod", "linear_delta", "pm3dof", "three_rps"])
def test_inertia_and_weight_at_the_drives_are_those_of_mujoco(name: str) -> None:
    """MuJoCo's mass matrix and gravity, projected on the null space of its equality constraints."""
    mujoco = pytest.importorskip("mujoco")
    robot = pm.load(name)
    assert robot.files is not None
    model = mujoco.MjModel.from_xml_path(str(robot.files.urdf.parents[1] / "mjcf" / f"{name}.xml"))
    data = mujoco.MjData(model)
    poses = pm.reachable_poses(robot, 20, np.random.default_rng(1))
    found = motion_dynamics(robot, poses, by=robot.actuated_joints)
    joints = [robot.single_joint(joint).q_index for joint in list(robot.model.names)[1:]]
    places = [model.joint(joint).qposadr[0] for joint in list(robot.model.names)[1:]]
    drives = [model.joint(joint).dofadr[0] for joint in robot.actuated_joints]
    for q, inertia, weight in zip(poses.q, found.inertia, found.weight, strict=True):
        data.qpos[places] = q[joints]
        mujoco.mj_forward(model, data)
        rows = np.zeros((data.nefc, model.nv))
        if mujoco.mj_isSparse(model):
            mujoco.mju_sparse2dense(rows, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        else:
            rows[:] = data.efc_J.reshape(rows.shape)
        _, sizes, directions = np.linalg.svd(rows[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY])
        null = directions[(sizes > 1e-8 * sizes[0]).sum() :].T
        motions = null @ np.linalg.inv(null[drives])
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        np.testing.assert_allclose(inertia, motions.T @ mass @ motions, atol=1e-12 * np.abs(inertia).max())
        mujoco.mj_rne(model, data, 0, held := np.zeros(model.nv))
        np.testing.assert_allclose(weight, motions.T @ held, atol=1e-12 * np.abs(weight).max())
