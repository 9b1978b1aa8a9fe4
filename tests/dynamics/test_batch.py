"""Programs of holding forces, inertia and frequencies: against closed forms, finite differences, and Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices, natural_frequencies
from pm3dof_pin.dynamics.inverse_dynamics import _loop_motion, inverse_dynamics
from pm3dof_pin.dynamics.mass_matrix import drive_mass_matrix, mass_matrix
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

MACHINES = Path(__file__).parents[1] / "machines"
MANY = 1000  # poses from which programs are used


def repeated(q: np.ndarray) -> np.ndarray:
    """The same configurations repeated, as many as programs are used for."""
    return np.tile(q, (-(-MANY // len(q)), 1))


@pytest.fixture
def counted(caplog: pytest.LogCaptureFixture) -> Callable[[], int]:
    """Number of poses computed by the Pinocchio engine."""
    caplog.set_level("INFO", logger="pm3dof_pin.kinematics.pose_values")
    return lambda: sum(int(record.args[2]) for record in caplog.records if "computed by" in record.msg)  # type: ignore


def test_a_four_bar_is_held_and_moved_as_its_closed_form_says(
    make_four_bar: Callable[..., Robot],
    place_four_bar: Callable[..., Configuration],
    four_bar: Any,
    counted: Callable[[], int],
) -> None:
    robot, cranks = make_four_bar(), np.linspace(0.0, 2.0 * np.pi, 15)
    q = repeated(np.array([place_four_bar(robot, crank).q for crank in cranks]))
    slopes = [four_bar.potential_slope(crank) for crank in cranks]
    np.testing.assert_allclose(actuator_forces(robot, q)[: len(cranks), 0], slopes, atol=1e-12)
    inertia = [four_bar.inertia(crank) for crank in cranks]
    np.testing.assert_allclose(drive_mass_matrices(robot, q)[: len(cranks), 0, 0], inertia, rtol=1e-12)
    assert not counted()


def test_towards_a_singular_pose_forces_are_right_and_there_they_are_refused(
    make_four_bar: Callable[..., Robot],
    place_four_bar: Callable[..., Configuration],
    four_bar: Any,
    counted: Callable[[], int],
) -> None:
    robot = make_four_bar("rocker_joint")
    dead_point = np.arccos((0.7**2 + 0.6**2 - 0.4**2) / (2.0 * 0.7 * 0.6))
    cranks = dead_point + np.array([0.1, 1e-2, 1e-4, 4e-6, 0.0])
    q = repeated(np.array([place_four_bar(robot, crank).q for crank in cranks]))
    found = actuator_forces(robot, q, on_failure="nan")[: len(cranks), 0]
    for force, crank in zip(found[:-1], cranks, strict=False):
        expected = four_bar.potential_slope(crank) / four_bar.speeds(crank)[1][2]
        assert force == pytest.approx(expected, rel=1e-8)
    assert np.isnan(found[-1])
    assert counted() == len(q) // len(cranks)
    assert np.isnan(drive_mass_matrices(robot, q, on_failure="nan")[4]).all()
    with pytest.raises(SingularConfigurationError):
        actuator_forces(robot, q)


def test_more_actuators_than_degrees_of_freedom_share_load_and_motion(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration], four_bar: Any
) -> None:
    robot = make_four_bar("crank_joint", "rocker_joint")
    q = repeated(np.array([place_four_bar(robot, crank).q for crank in (0.4, 1.1)]))
    ratio = four_bar.speeds(1.1)[1][2]
    along = np.array([1.0, ratio])
    expected = along * four_bar.potential_slope(1.1) / (along @ along)
    np.testing.assert_allclose(actuator_forces(robot, q)[1], expected, atol=1e-12)
    assert along @ drive_mass_matrices(robot, q)[1] @ along == pytest.approx(four_bar.inertia(1.1), rel=1e-12)


@pytest.mark.parametrize(
    "name", ["pm3dof", "three_rps", MACHINES / "delta" / "delta.urdf"], ids=["tripod", "3-RPS", "delta"]
)
def test_engines_agree_on_forces_and_inertia(name: str | Path, counted: Callable[[], int]) -> None:
    robot = Robot.load(name)
    q = reachable_poses(robot, 8, np.random.default_rng(1)).q
    payloads = {robot.tool_frame: pin.Inertia(2.0, np.array([0.02, 0.01, -0.03]), np.diag([0.02, 0.03, 0.04]))}
    for compute in (actuator_forces, drive_mass_matrices):
        found = compute(robot, repeated(q), payloads=payloads)[: len(q)]
        careful = compute(robot, q, payloads=payloads, engine="pinocchio")
        np.testing.assert_allclose(found, careful, rtol=0.0, atol=1e-12 * np.abs(careful).max())
    assert counted() == 2 * len(q)


def test_forces_and_inertia_of_the_hexapod_are_derivatives_of_its_energies() -> None:
    robot = Robot.load("hexapod")
    poses = reachable_poses(robot, 2, np.random.default_rng(2))
    model, data, step = robot.model, robot.model.createData(), 1e-5
    forces, masses = (compute(robot, repeated(poses.q)) for compute in (actuator_forces, drive_mass_matrices))
    rates = np.random.default_rng(3).uniform(-1.0, 1.0, 6)
    for pose in range(len(poses)):
        ends = robot.forward(poses.commands[pose] + step * np.stack([-rates, rates]), guess=poses.q[[pose, pose]]).q
        slope = np.ptp([pin.computePotentialEnergy(model, data, q) for q in ends]) / (2.0 * step)
        assert abs(forces[pose] @ rates) == pytest.approx(slope, rel=1e-6)
        velocity = pin.difference(model, *ends) / (2.0 * step)
        energy = pin.computeKineticEnergy(model, data, poses.q[pose], velocity)
        assert 0.5 * rates @ masses[pose] @ rates == pytest.approx(energy, rel=1e-6)


def test_engines_agree_on_frequencies(counted: Callable[[], int]) -> None:
    elastic = ElasticModel.load("linear_delta")
    q = reachable_poses(elastic.rigid, 6, np.random.default_rng(1)).q
    payloads = {elastic.rigid.tool_frame: 3.0}
    found = natural_frequencies(elastic, repeated(q), count=12, payloads=payloads)[: len(q)]
    assert not counted()
    careful = natural_frequencies(elastic, q, count=12, payloads=payloads, engine="pinocchio")
    np.testing.assert_allclose(found, careful, rtol=1e-10)


def test_a_robot_that_its_actuators_do_not_hold_has_no_forces(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration]
) -> None:
    driven = make_four_bar()
    undriven = Robot(driven.model, driven.closures, tool_frame=driven.tool_frame)
    q = repeated(place_four_bar(undriven, 0.3).q[None])
    for compute in (actuator_forces, drive_mass_matrices):
        with pytest.raises(SingularConfigurationError):
            compute(undriven, q)


@pytest.mark.parametrize("wrong", ["pm3dof", None, 3.0, np.zeros(12), {}])
def test_objects_of_a_wrong_kind_are_refused(wrong: object) -> None:
    of_robots = (actuator_forces, drive_mass_matrices)
    of_configurations = (holding_forces, mass_matrix, drive_mass_matrix)
    calls: list[Callable[[Any], object]] = [
        *(lambda value, f=f: f(value, np.zeros((1, 12))) for f in of_robots),
        *of_configurations,
        *(lambda value, f=f: f(value, [0.0] * 3, [0.0] * 3) for f in (inverse_dynamics, _loop_motion)),
        lambda value: natural_modes(value, np.zeros(12)),
        lambda value: natural_frequencies(value, np.zeros((1, 12)), count=1),
    ]
    for call in calls:
        with pytest.raises(InvalidValueError, match=r"expected an? (Robot|Configuration|ElasticModel), as"):
            call(wrong)
