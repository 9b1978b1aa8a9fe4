"""Jacobians between descriptions of motion, against differences of solved poses."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, tool_coordinates
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics import jacobian_programs
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.jacobian_programs import jacobian_program
from pm3dof_pin.kinematics.jacobians import jacobian, motion_rates
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import legs

_MACHINES = Path(__file__).parents[1] / "machines"
_ROBOTS = {
    "pm3dof": [0.05, -0.1, 0.5],
    "hexapod": [0.002, -0.003, 0.136, 0.05, -0.04, 0.06],
    "three_rps": None,
    "linear_delta": None,
    "five_bar": None,
}


@pytest.fixture(scope="module", params=_ROBOTS)
def robot(request: pytest.FixtureRequest) -> Robot:
    name = request.param
    return pm.load(_MACHINES / name if (_MACHINES / name).exists() else name)


@pytest.fixture(scope="module")
def pose(robot: Robot) -> np.ndarray:
    generator = np.random.default_rng(3)
    return np.array(pm.reachable_poses(robot, 1, generator, margin=0.2).coordinates[0])


def _differences(robot: Robot, pose: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return first and second derivatives of the commands by the coordinates, by central differences."""
    size = len(pose)
    steps = step * np.eye(size)

    def commands(values: np.ndarray) -> np.ndarray:
        return np.array(robot.solve(values, guess=robot.solve(pose).q).commands)

    first = np.stack([(commands(pose + e) - commands(pose - e)) / (2.0 * step) for e in steps], axis=1)
    second = np.empty((len(first), size, size))
    for i, a in enumerate(steps):
        for j, b in enumerate(steps):
            corners = commands(pose + a + b) - commands(pose + a - b) - commands(pose - a + b) + commands(pose - a - b)
            second[:, i, j] = corners / (4.0 * step**2)
    return first, second


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_commands_by_coordinates_are_the_derivatives_of_solve(robot: Robot, pose: np.ndarray, engine: str) -> None:
    poses = robot.solve(np.tile(pose, (250 if engine == "program" else 8, 1)))
    found = jacobian(robot, poses, of="commands", by="coordinates", with_derivatives=True, engine=engine)
    first, second = _differences(robot, pose, 1e-4 * robot.characteristic_length)
    assert found.columns == tuple(c.name for c in robot.coordinates)
    np.testing.assert_allclose(found.values[7], first, atol=1e-7 * np.abs(first).max())
    assert found.derivatives is not None
    np.testing.assert_allclose(found.derivatives[7], second, atol=2e-5 * np.abs(second).max())


def test_both_engines_agree(robot: Robot) -> None:
    poses = pm.reachable_poses(robot, 250, np.random.default_rng(0), margin=0.1)
    for of, by in (("tool", "commands"), ("commands", "coordinates"), ("joints", "commands")):
        program = jacobian(robot, poses, of=of, by=by, with_derivatives=True)
        reference = jacobian(robot, poses[:3], of=of, by=by, with_derivatives=True, engine="pinocchio")
        for one, other in ((program.values, reference.values), (program.derivatives, reference.derivatives)):
            assert one is not None
            assert other is not None
            np.testing.assert_allclose(one[:3], other, rtol=0.0, atol=1e-9 * np.abs(other).max())


def test_power_is_the_same_in_every_description(robot: Robot) -> None:
    """Forces map by the transposed Jacobian: the drives' power is that of the coordinates."""
    generator = np.random.default_rng(1)
    poses = pm.reachable_poses(robot, 300, generator)
    J = jacobian(robot, poses, of="commands", by="coordinates").values
    rates, forces = generator.normal(size=(300, J.shape[2])), generator.normal(size=(300, J.shape[1]))
    drives = np.einsum("nk,nkm,nm->n", forces, J, rates)
    coordinates = np.einsum("nm,nm->n", np.einsum("nkm,nk->nm", J, forces), rates)
    np.testing.assert_allclose(drives, coordinates, atol=1e-12 * np.abs(drives).max())


def test_inverse_descriptions_are_inverse_matrices(robot: Robot, pose: np.ndarray) -> None:
    configuration = robot.solve(pose).configuration()
    there = jacobian(robot, configuration, of="commands", by="coordinates").values
    back = jacobian(robot, configuration, of="coordinates", by="commands").values
    np.testing.assert_allclose(there @ back, np.eye(len(there)), atol=1e-10)


def test_units_and_names() -> None:
    robot = pm.load("pm3dof")
    found = jacobian(robot, robot.home, of="tool", by=["theta_x", "z_e", "theta_y"])
    assert found.columns == ("theta_x", "z_e", "theta_y")
    assert found.column_units == ("rad/s", "m/s", "rad/s")
    np.testing.assert_allclose(found.values[:, 1], [0, 0, 1, 0, 0, 0], atol=1e-12)
    with pytest.raises(InvalidValueError, match="theta_x"):
        jacobian(robot, robot.home, of="tool", by=["theta"])
    with pytest.raises(SingularConfigurationError, match="can move with theta_x"):
        jacobian(robot, robot.home, of="commands", by=["theta_x", "theta_y"])


def test_singular_poses_say_so() -> None:
    hexapod = pm.load("hexapod")
    turned = hexapod.solve([0.0, 0.0, 0.135, 0.0, 0.0, np.pi / 2])
    with pytest.raises(SingularConfigurationError, match="rest"):
        jacobian(hexapod, turned, of="tool", by="commands")
    assert np.isnan(jacobian(hexapod, turned, of="tool", by="commands", on_failure="nan").values).all()


@pytest.mark.usefixtures("programs_for_few_poses")
def test_counters_in_micrometres_determine_the_pose() -> None:
    """A counter of another unit makes no configuration singular: J of the coordinates by commands is the inverse."""
    robot = pm.load(_MACHINES / "three_rpr")
    assert robot.command_coordinates[0].scale == -1e6
    poses = pm.reachable_poses(robot, 20, np.random.default_rng(3))
    for engine in ("program", "pinocchio"):
        there = pm.jacobian(robot, poses, of="commands", by="coordinates", engine=engine).values
        back = pm.jacobian(robot, poses, of="coordinates", by="commands", engine=engine).values
        np.testing.assert_allclose(there @ back, np.broadcast_to(np.eye(3), there.shape), atol=1e-8)


def test_joints_follow_in_the_order_that_takes_fewer_operations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Legs of a hexapod, which come after its platform in the tree, follow it in fewer operations from the first on."""
    robot = pm.load("hexapod")
    ends = motion_rates(robot, "of", "commands"), motion_rates(robot, "by", "coordinates")
    of_two = jacobian_program(robot, *ends, samples_near_home(robot), with_derivatives=True)
    monkeypatch.setattr(jacobian_programs, "_MANY", 0)
    of_one = jacobian_program(robot, *ends, samples_near_home(robot), with_derivatives=True)
    assert len(of_two) < 0.7 * len(of_one)


def test_no_pose_of_many_legs_is_less_accurate(tmp_path: Path) -> None:
    """Motions are combined of the platform's, which legs follow at every pose, not of those of some legs' joints."""
    robot = Robot.load(legs(12).write(tmp_path))
    poses = pm.reachable_poses(robot, 500, np.random.default_rng(0))
    found = jacobian(robot, poses, of="coordinates", by="tool").values
    own = jacobian(robot, poses, of="coordinates", by="tool", engine="pinocchio").values
    assert np.abs(found - own).max() <= 1e-12 * np.abs(own).max()


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_derivatives_by_the_angles_of_a_turned_tool(engine: Engine) -> None:
    """Differences of the Jacobian along rx, ry and rz, whose axes turn with each other."""
    hexapod = pm.load("hexapod")
    robot = hexapod.replace(coordinates=tool_coordinates(TOOL_COMPONENTS))  # its own are joints
    at, step = np.array([0.004, -0.006, 0.135, 0.12, -0.2, 0.25]), 1e-5
    poses = robot.solve(at)
    found = pm.jacobian(robot, poses, of="commands", by="coordinates", with_derivatives=True, engine=engine)
    assert found.derivatives is not None
    for k in range(6):
        ends = [robot.solve(at + sign * step * np.eye(6)[k]) for sign in (1.0, -1.0)]
        ahead, back = (pm.jacobian(robot, end, of="commands", by="coordinates").values for end in ends)
        np.testing.assert_allclose(found.derivatives[:, :, k], (ahead - back) / (2.0 * step), atol=1e-6)
