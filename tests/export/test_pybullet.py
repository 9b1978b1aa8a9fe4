"""`close_loops` in PyBullet: loops closed, forces those of the closed form, and a simulation that stays closed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.exceptions import FrameNotFoundError, UnknownRobotError
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.export.pybullet import close_loops
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

pybullet = pytest.importorskip("pybullet")

FileOf = Callable[[str, str], Path]
Positions = dict[str, float]
STEP = 1e-3
SINGLE = 6e-8  # single precision at half a metre or more


class Simulator:
    """A robot's URDF, loaded and closed."""

    def __init__(self, client: int, urdf: Path, mechanism: Robot, robot: str | Path) -> None:
        self.client = client
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        self.body = pybullet.loadURDF(str(urdf), useFixedBase=True, flags=flags, physicsClientId=client)
        self.constraints = close_loops(client, self.body, robot)
        count = pybullet.getNumJoints(self.body, physicsClientId=client)
        information = [pybullet.getJointInfo(self.body, joint, physicsClientId=client) for joint in range(count)]
        self.index = {entry[1].decode(): entry[0] for entry in information}
        self.links = {entry[12].decode(): entry[0] for entry in information}
        # the order of the rates in PyBullet's vectors
        self.joints = [entry[1].decode() for entry in sorted(information, key=lambda entry: entry[4]) if entry[4] >= 0]
        self.closures = mechanism.closures
        self.actuated = [self.index[name] for name in mechanism.actuated_joints]

    def place(self, positions: Mapping[str, float], rates: Mapping[str, float] | None = None) -> None:
        for name, position in positions.items():
            rate = rates[name] if rates else 0.0
            pybullet.resetJointState(self.body, self.index[name], position, rate, physicsClientId=self.client)

    def frames(self, loop: Any) -> list[tuple[np.ndarray, np.ndarray]]:
        states = [
            pybullet.getLinkState(
                self.body, self.links[name], computeForwardKinematics=True, physicsClientId=self.client
            )
            for name in (loop.frame_a, loop.frame_b)
        ]
        return [(np.array(state[4]), np.array(pybullet.getMatrixFromQuaternion(state[5]))) for state in states]

    def closure_error(self) -> float:
        error = 0.0
        for loop in self.closures:
            (one, axes), (other, other_axes) = self.frames(loop)
            error = max(error, np.linalg.norm(one - other))
            if loop.type == "6d":
                error = max(error, np.abs(axes - other_axes).max())
        return float(error)

    def state(self, make_terms: Any, positions: Mapping[str, float], rates: Mapping[str, float]) -> Any:
        q = np.array([positions[name] for name in self.joints])
        v = np.array([rates[name] for name in self.joints])
        self.place(positions, rates)
        mass = np.array(pybullet.calculateMassMatrix(self.body, q.tolist(), physicsClientId=self.client))
        bias = np.array(
            pybullet.calculateInverseDynamics(
                self.body, q.tolist(), v.tolist(), [0.0] * len(q), physicsClientId=self.client
            )
        )
        # PyBullet does not compute derivatives of a Jacobian: central differences
        step = 1e-6
        drift = (self._loops(q + step * v) - self._loops(q - step * v)) @ v / (2.0 * step)
        return make_terms(self.joints, mass, bias, self._loops(q), drift)

    def _loops(self, q: np.ndarray) -> np.ndarray:
        rows = []
        for loop in self.closures:
            one, other = (self._jacobian(self.links[name], q) for name in (loop.frame_a, loop.frame_b))
            rows.append((other - one)[: 3 if loop.type == "3d" else 6])
        return np.vstack(rows)

    def _jacobian(self, link: int, q: np.ndarray) -> np.ndarray:
        still = [0.0] * len(q)
        # the frames of closures here have their centre of mass at their origin
        parts = pybullet.calculateJacobian(
            self.body, link, [0.0, 0.0, 0.0], q.tolist(), still, still, physicsClientId=self.client
        )
        return np.vstack([np.array(part) for part in parts])

    def step(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pybullet.setJointMotorControlArray(
            self.body, self.actuated, pybullet.TORQUE_CONTROL, forces=forces.tolist(), physicsClientId=self.client
        )
        pybullet.stepSimulation(physicsClientId=self.client)
        states = pybullet.getJointStates(self.body, self.actuated, physicsClientId=self.client)
        q, v = np.array([state[0] for state in states]), np.array([state[1] for state in states])
        return q, v


@pytest.fixture
def client() -> Iterator[int]:
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
    pybullet.setTimeStep(STEP, physicsClientId=client)
    yield client
    pybullet.disconnect(client)


@pytest.fixture
def open_robot(client: int, file_of: FileOf, load: Callable[[str], Robot]) -> Callable[[str], Simulator]:
    return lambda robot: Simulator(client, file_of(robot, "urdf"), load(robot), robot)


def test_the_loops_close_at_ten_poses(open_robot: Callable[[str], Simulator], ten_positions: list[Positions]) -> None:
    tripod = open_robot("pm3dof")
    assert len(tripod.constraints) == 3
    for positions in ten_positions:
        tripod.place(positions)
        assert tripod.closure_error() < SINGLE


def test_forces_are_those_of_the_closed_form(
    open_robot: Callable[[str], Simulator], assert_forces_of_the_closed_form: Callable[..., None]
) -> None:
    assert_forces_of_the_closed_form(open_robot("pm3dof"))


def test_every_robot_is_closed_and_holds_itself_with_our_forces(
    open_robot: Callable[[str], Simulator], robot: str, assert_closed_and_held: Callable[..., None]
) -> None:
    assert_closed_and_held(robot, open_robot(robot), closed=SINGLE)


def test_positions_are_handed_out_in_single_precision(
    open_robot: Callable[[str], Simulator], robot: str, ten_poses: Callable[[str], list[Configuration]]
) -> None:
    simulator = open_robot(robot)
    for pose in ten_poses(robot):
        simulator.place({name: pose.joint_position(name) for name in simulator.joints})
        for loop in simulator.closures:
            for name, (position, _) in zip((loop.frame_a, loop.frame_b), simulator.frames(loop), strict=True):
                expected = pose.frame_placement(name).translation
                np.testing.assert_allclose(position, expected, rtol=0, atol=SINGLE)
                np.testing.assert_array_equal(position, position.astype(np.float32))


@pytest.mark.parametrize(
    ("robot", "gains", "open_by", "off_by"),
    [
        ("pm3dof", (4000.0, 20000.0, 80.0), 2e-6, 1e-5),
        ("hexapod", (20000.0, 100000.0, 400.0), 1e-6, 1e-5),
        ("three_rps", (100000.0, 500000.0, 4000.0), 1e-4, 2e-3),
    ],
)
def test_a_simulation_from_home_stays_closed_and_settles_near_our_forces(
    open_robot: Callable[[str], Simulator],
    load: Callable[[str], Robot],
    settle: Callable[..., dict[str, Any]],
    robot: str,
    gains: tuple[float, float, float],
    open_by: float,
    off_by: float,
) -> None:
    """PyBullet opens loops [m, rad] in proportion to their load, which is ten times greater for the last robot."""
    simulator, mechanism = open_robot(robot), load(robot)
    target = mechanism.configuration(mechanism.named_configurations["tilt_x"])
    end = settle(
        simulator,
        [target.joint_position(name) for name in mechanism.actuated_joints],
        time_step=STEP,
        duration=4.0,
        gains=gains,
    )
    assert end["position_error"] < 1e-9
    assert end["greatest_closure_error"] < open_by
    ours = holding_forces(target).actuator_forces
    np.testing.assert_allclose(end["forces"], ours, rtol=0, atol=off_by)


def test_a_robot_of_ones_own(client: int, four_bar: Path, tmp_path: Path) -> None:
    """The points of its closure are relative to centres of mass elsewhere, in rotated axes."""
    (path, *_) = export_robot(four_bar, "urdf", tmp_path / "out")
    mechanism = Robot.load(four_bar)
    linkage = Simulator(client, path, mechanism, four_bar)
    configuration = mechanism.assemble(mechanism.home)
    linkage.place({name: configuration.joint_position(name) for name in linkage.joints})
    assert linkage.closure_error() < 1e-6  # PyBullet keeps the axes of centres of mass in single precision
    for _ in range(100):
        _, rates = linkage.step(np.array(holding_forces(configuration).actuator_forces))
    assert linkage.closure_error() < 2e-5
    assert abs(rates).max() < 1e-3
    # when released, it falls and stays closed
    for _ in range(200):
        _, rates = linkage.step(np.zeros(1))
    assert abs(rates).max() > 0.1
    assert linkage.closure_error() < 1e-3


def test_another_body_or_robot_is_refused(client: int, file_of: FileOf) -> None:
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    body = pybullet.loadURDF(str(file_of("hexapod", "urdf")), flags=flags, physicsClientId=client)
    with pytest.raises(FrameNotFoundError, match="PyBullet's body: no frame 'link1_tip'"):
        close_loops(client, body, "pm3dof")
    with pytest.raises(UnknownRobotError, match="no robot 'nobody'"):
        close_loops(client, body, "nobody")
