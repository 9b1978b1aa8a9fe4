"""Closing loops by traced Newton steps, and checks of closed configurations, against Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.checks import checks_program
from pm3dof_pin.programs.closing import Task, _determinant, closing_program
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.verification import verify

POSE = ("x", "y", "z", "rx", "ry", "rz")


def closed_samples(robot: Robot, count: int = 8, distance: float = 0.1) -> np.ndarray:
    generator, rows = np.random.default_rng(0), []
    while len(rows) < count:
        motion = robot.velocity_scale * generator.uniform(-distance, distance, robot.model.nv)
        result = assemble(robot, pin.integrate(robot.model, robot.home.q, motion))
        if result.converged:
            rows.append(result.configuration.q)
    return np.array(rows)


@pytest.fixture(scope="module", params=["pm3dof", "hexapod", "three_rps"])
def robot(request) -> Robot:
    return Robot.load(request.param)


def given_at(robot: Robot, q: np.ndarray, task: Task) -> np.ndarray:
    """Return the coordinates of the held joints and the targets of the tool at q."""
    joints = np.array([[robot.single_joint(name).coordinate(row) for name in task.joints] for row in q])
    if not task.tool:
        return joints
    components = tool_components([robot.configuration(row).tool_placement.homogeneous for row in q])
    return np.hstack([joints, components[:, [POSE.index(name) for name in task.tool]]])


def closed_by_steps(robot: Robot, task: Task, start: np.ndarray, targets: np.ndarray, samples, steps=6):
    program = closing_program(robot, task, samples)
    parameters = geometry.values(robot, program.parameters)
    q, residuals = start, []
    for _ in range(steps):
        inputs = np.hstack([q, np.tile([1.0, 0.0], (len(q), 1)), targets])
        result = program.split(program.evaluate(inputs, parameters))
        q = result["q"]
        residuals.append(result["residual"].max())
    return q, residuals, result["margin"]


@pytest.mark.parametrize("given", ["coordinates", "commands"])
def test_closes_quadratically_where_joints_are_given(robot, given):
    task = Task(robot.motion_coordinates if given == "coordinates" else robot.actuated_joints)
    samples = closed_samples(robot)
    free = np.setdiff1d(np.arange(robot.model.nv), robot.velocity_indices(task.joints))
    start = samples.copy()
    start[:, free] += (
        np.random.default_rng(1).uniform(-0.02, 0.02, (len(samples), len(free))) * robot.velocity_scale[free]
    )
    q, residuals, margin = closed_by_steps(robot, task, start, given_at(robot, samples, task), samples)
    assert (margin > 0.5).all()
    assert residuals[3] < 1e-12
    for row, sample in zip(q, samples, strict=True):
        assert robot.configuration(row).closure_residual < 1e-13
        np.testing.assert_allclose(row, sample, atol=1e-12)


@pytest.mark.parametrize("tool", [POSE, ("z", "rx", "ry"), ("x", "y", "rz")])
def test_brings_the_tool_to_its_target(tool):
    robot = Robot.load("hexapod")
    joints = () if len(tool) > 3 else ("platform_x_joint", "platform_y_joint", "platform_rz_joint")
    if tool == ("x", "y", "rz"):
        joints = ("platform_z_joint", "platform_rx_joint", "platform_ry_joint")
    task, samples = Task(joints, tool), closed_samples(robot)
    targets = given_at(robot, samples, task)
    free = np.setdiff1d(np.arange(robot.model.nv), robot.velocity_indices(joints))
    start = samples.copy()
    start[:, free] += (
        np.random.default_rng(1).uniform(-0.02, 0.02, (len(samples), len(free))) * robot.velocity_scale[free]
    )
    q, residuals, _ = closed_by_steps(robot, task, start, targets, samples)
    assert residuals[4] < 1e-13
    for row, sample in zip(q, samples, strict=True):
        np.testing.assert_allclose(row, sample, atol=1e-11)


def test_a_frame_turned_by_half_a_turn_is_not_closed():
    model = pin.Model()
    ends = [model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), name) for name in "ab"]
    for name, joint in zip("ab", ends, strict=True):
        model.addFrame(pin.Frame(f"{name}_tip", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, [LoopClosure("a_tip", "b_tip", "6d")], tool_frame="b_tip")
    samples = np.array([[0.1, 0.1], [0.2, 0.2], [-0.3, -0.3]])
    program = closing_program(robot, Task(("a",)), samples)
    parameters = geometry.values(robot, program.parameters)
    residual = program.split(program.evaluate([[0.0, np.pi, 1.0, 0.0, 0.0], [0.4, 0.4, 1.0, 0.0, 0.4]], parameters))[
        "residual"
    ]
    assert residual[0] > 0.9
    assert residual[1] < 1e-15


def test_nothing_moves_where_all_is_given():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "a")
    model.addFrame(pin.Frame("tip", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    program = closing_program(Robot(model, tool_frame="tip"), Task(("a",)), [[0.0], [0.1]])
    assert len(program) == 0


def test_checks_agree_with_pinocchio(robot):
    samples = closed_samples(robot)
    program = checks_program(robot, samples)
    generator = np.random.default_rng(5)
    q = np.vstack([samples, closed_samples(robot, 40, 0.8), samples[:1] + generator.uniform(-0.3, 0.3, samples.shape)])
    result = program.split(program.evaluate(q, geometry.values(robot, program.parameters)))
    poses = robot.at(q, engine="pinocchio")
    np.testing.assert_array_equal(result["broken"].astype(np.uint32), poses.broken_limits)
    assert len(set(poses.broken_limits)) > 1
    np.testing.assert_allclose(result["transform"], poses.transforms, atol=1e-14)
    assert (result["residual"][:48] < 1e-12).all()
    assert (result["residual"][48:] > 1e-3).all()


def test_verification(robot, monkeypatch):
    samples = closed_samples(robot)
    verify(robot, samples)
    verify(robot, samples, dense=True)
    placements = geometry.numbers(robot)
    name = next(name for name, value in placements.items() if name.endswith("p0") and abs(value) > 0.01)
    monkeypatch.setattr(geometry, "numbers", lambda *_: placements | {name: placements[name] + 1e-9})
    with pytest.raises(ProgramError, match="from Pinocchio's"):
        verify(robot, samples)


@pytest.mark.parametrize(
    ("size", "density"), [(1, 1.0), (3, 1.0), (6, 1.0), (10, 1.0), (7, 0.5), (12, 0.25), (16, 0.2)]
)
def test_determinants_of_sparse_matrices(size, density):
    generator = np.random.default_rng(size)
    pattern = (generator.random((size, size)) < density) | np.eye(size, dtype=bool)[generator.permutation(size)]
    values = generator.normal(size=(5, size, size)) * pattern
    graph = Graph()
    matrix = np.zeros((size, size), dtype=object)
    for i, j in np.argwhere(pattern):
        matrix[i, j] = graph.input(f"{i},{j}", values[:, i, j])
    found, expected = _determinant(matrix).samples, np.linalg.det(values)
    np.testing.assert_allclose(found * np.sign(found[0] * expected[0]), expected, rtol=1e-9)
