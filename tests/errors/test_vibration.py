"""Vibration by modal superposition against Lyapunov's equation, quadrature, one oscillator, and a shaken base."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg

import pm3dof_pin as pm
from pm3dof_pin.description.source_numbers import Spectrum, VibrationNumbers
from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import vibrating_system
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.errors.normal_vectors import covariance_root
from pm3dof_pin.errors.vibration import CAUSES, Vibration
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot


def quiet(**spectra: Spectrum | None) -> VibrationNumbers:
    return VibrationNumbers(**{cause: None for cause in CAUSES} | spectra)


@pytest.mark.parametrize("omega", [50.0, 700.0])
def test_one_oscillator_under_white_noise(omega: float) -> None:
    """G / (8 zeta omega^3), S. Crandall and W. Mark, Random Vibration in Mechanical Systems, 1963."""
    model = pin.Model()
    model.name = "cart"
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    robot = Robot(model, [], actuated_joints=["slide"])
    elastic = ElasticModel(robot, [JointSpring("k", "slide", omega**2, "N/m")])
    system = vibrating_system(elastic, np.zeros(1), damping=Damping(ratio=0.02))
    row = system.rows(["slide"])
    found = system.covariance((0.0, 1e9), (3.0,), row, row)
    assert found.item() == pytest.approx(3.0 / (8.0 * 0.02 * omega**3), rel=1e-9)


def state_space(robot: Robot, q: np.ndarray, damping: float) -> tuple[np.ndarray, ...]:
    """Return A, the basis of the moving coordinates, the same by state, and the tool's Jacobian, from Pinocchio alone.

    Coordinates of the motions that close the loops; damping of every mode, C = 2 zeta M sqrt(M^-1 K).
    """
    model = ElasticModel(robot)
    there = model.configuration(q)
    mass = pin.crba(there.mechanism.model, there.mechanism.model.createData(), np.array(there.q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    basis = scipy.linalg.null_space(there.constraint_jacobian, rcond=1e-10)
    stiffness = basis.T @ model.joint_stiffness(there) @ basis
    strained, axes = np.linalg.eigh(stiffness)
    held = strained > 1e-12 * strained.max()
    free, basis = basis @ axes[:, ~held], basis @ (axes[:, held] / np.sqrt(strained[held]))  # unit stiffness
    assert np.abs(there.tool_jacobian @ free).max(initial=0.0) < 1e-9  # such as the spin of a rod, which follows
    basis = basis - free @ np.linalg.pinv(free.T @ mass @ free) @ free.T @ mass @ basis
    inverse_squares, shapes = np.linalg.eigh(basis.T @ mass @ basis)
    moving = inverse_squares > 1e-13 * inverse_squares.max()
    omegas = 1.0 / np.sqrt(inverse_squares[moving])
    basis = basis @ shapes[:, moving] * omegas  # unit mass
    n = len(omegas)
    turn, damped = np.diag(omegas), np.diag(2.0 * damping * omegas)
    system = np.block([[np.zeros((n, n)), turn], [-turn, -damped]])  # of omega q and the rate of q
    return system, basis, basis / omegas, there.tool_jacobian


@pytest.mark.parametrize("name", ["pm3dof", "hexapod"])
def test_white_forces_shake_the_tool_as_lyapunov_says(name: str, rigid_in_shear: Callable[..., Robot]) -> None:
    """A P + P A^T + B (G / 2) B^T = 0: a white force of one-sided density G has the two-sided density G / 2."""
    robot = rigid_in_shear(Robot.load(name), mass_model="lumped")  # with bodies that Pinocchio knows
    poses = reachable_poses(robot, 2, np.random.default_rng(0))
    level, damping = 2.0, 0.05
    white = Spectrum(edges_Hz=(0.0, 1e12), levels=(level,))
    numbers = VibrationNumbers(damping=damping, tool=white, motors=white, axes=white)
    found = Vibration(spectra=numbers).covariances_by_cause(poses)
    for row, q in enumerate(poses.q):
        system, basis, from_state, tool = state_space(robot, q, damping)
        model = ElasticModel(robot).mechanism
        base = np.empty((model.model.nv, 3))
        data = model.model.createData()
        there = ElasticModel(robot).configuration(q)
        pin.computeJointJacobians(model.model, data, np.array(there.q))
        for axis in range(3):  # a body of mass m in an accelerated frame: the force -m a at its centre
            base[:, axis] = 0.0
            for joint in range(1, model.model.njoints):
                inertia = model.model.inertias[joint]
                jacobian = pin.getJointJacobian(model.model, data, joint, pin.LOCAL_WORLD_ALIGNED)
                lever = data.oMi[joint].rotation @ inertia.lever
                centre = jacobian[:3] - pin.skew(lever) @ jacobian[3:]
                base[:, axis] -= inertia.mass * centre[axis]
        forces = {"tool": tool[:3].T, "motors": np.eye(model.model.nv)[:, model.actuated_indices], "axes": base}
        for cause, forcing in forces.items():
            n = basis.shape[1]
            inputs = np.vstack([np.zeros((n, forcing.shape[1])), basis.T @ forcing])
            spread = scipy.linalg.solve_continuous_lyapunov(system, -0.5 * level * inputs @ inputs.T)
            expected = tool @ from_state @ spread[:n, :n] @ from_state.T @ tool.T
            scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
            np.testing.assert_allclose(found[cause][row] / scale, expected / scale, atol=1e-5)


def test_a_low_band_moves_the_tool_as_the_compliance_says(tripod_nominal: Poses) -> None:
    """Far below the first natural frequency, a force of 1 N rms has the displacement C, up to (f / f1)^2."""
    poses = tripod_nominal[:2]
    low = Spectrum(edges_Hz=(0.5, 1.0), levels=(2.0,))
    found = Vibration(spectra=quiet(tool=low)).covariances_by_cause(poses)["tool"]
    for row, compliance in enumerate(pm.compliance(poses.robot, poses, engine="pinocchio")):
        expected = compliance[:, :3] @ compliance[:3]
        np.testing.assert_allclose(found[row].diagonal(), expected.diagonal(), rtol=1e-3)


def test_what_is_drawn_scatters_so(tripod_nominal: Poses) -> None:
    pose = tripod_nominal[[0] * 4000]
    spectra = quiet(tool=VibrationNumbers().tool)
    one = Vibration(spectra=spectra).covariances_by_cause(pose[:1])["tool"][0]

    class Once(Vibration):
        def covariances_by_cause(self, poses: Poses) -> dict[str, np.ndarray]:
            return {"tool": np.broadcast_to(one, (len(poses), 6, 6))}

    drawn = Once(spectra=spectra).tool_displacements(pose, np.random.default_rng(0))
    np.testing.assert_allclose(drawn.std(axis=0), np.sqrt(one.diagonal()), rtol=0.05)


def test_roots_of_covariances() -> None:
    generator = np.random.default_rng(0)
    factors = generator.normal(size=(3, 6, 2)) * np.repeat([1e-6, 1e-3], 3)[:, None]
    covariances = factors @ np.swapaxes(factors, 1, 2)
    roots = covariance_root(covariances)
    np.testing.assert_allclose(roots @ np.swapaxes(roots, 1, 2), covariances, rtol=1e-9)
    with pytest.raises(InvalidValueError, match="positive semidefinite"):
        covariance_root(np.diag([1.0, -1.0]))


def test_roundings_of_components_that_do_not_move_do_not_change_the_root() -> None:
    covariance = np.diag([4e-10, 0.0, 1e-10])
    covariance[0, 1] = covariance[1, 0] = 0.9 * 2e-5 * 1e-17  # a correlation of 0.9 with a rounding error
    covariance[1, 1] = 1e-34
    np.testing.assert_allclose(covariance_root(covariance), np.diag([2e-5, 0.0, 1e-5]), rtol=0.0, atol=1e-10)
