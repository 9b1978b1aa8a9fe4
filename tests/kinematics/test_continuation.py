"""Closing loops by compiled programs against the Pinocchio engine, on machines of every kind."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import program_source
from pm3dof_pin.kinematics.continuation import Continuation
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.reference import assemble_at
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import llvm, walk

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import arm

MACHINES = Path(__file__).parents[1] / "machines"
ROBOTS = ("pm3dof", "hexapod", "three_rps", "delta", "five_bar", "four_bar", "walker", "ur5")


@cache
def load(name: str) -> Robot:
    if name == "ur5":
        loaded = pytest.importorskip("example_robot_data").load("ur5")
        model = loaded.model
        model.referenceConfigurations["home"] = np.array([0.3, -1.2, 1.4, -0.6, 0.9, 0.2])
        return Robot(model, tool_frame="tool0")
    files = [*(MACHINES / name).glob("*.urdf"), *(MACHINES / name).glob("*.xml")]
    return Robot.load(files[0] if files else name)


@cache
def continuation(name: str, given: str) -> Continuation:
    robot = load(name)
    return Continuation(robot, robot.coordinates if given == "coordinates" else robot.command_coordinates)


def random_values(name: str, given: str, count: int, share: float = 1.0) -> np.ndarray:
    robot, solver = load(name), continuation(name, given)
    coordinates = robot.coordinates if given == "coordinates" else robot.command_coordinates
    home = solver.read(robot.home.q[None])[0]
    width = np.array([0.3 * robot.characteristic_length if c.unit == "m" else 0.4 for c in coordinates]) * share
    ranges = np.array([robot.range_of(c) for c in coordinates])
    lower, upper = np.maximum(ranges[:, 0], home - width), np.minimum(ranges[:, 1], home + width)
    return np.random.default_rng(0).uniform(lower, upper, (count, len(home)))


@pytest.mark.parametrize("given", ["coordinates", "commands"])
@pytest.mark.parametrize("name", [*ROBOTS, "linear_delta", "agile_eye", "three_rpr"])
def test_walks_end_where_the_reference_does(name, given):
    robot = load(name)
    values = random_values(name, given, 25 if given == "coordinates" else 12)
    solve = robot.solve if given == "coordinates" else robot.forward
    found = solve(values, on_failure="nan")
    expected = solve(values, on_failure="nan", engine="pinocchio")
    np.testing.assert_array_equal(found.solved, expected.solved)
    np.testing.assert_array_equal(found.broken_limits, expected.broken_limits)
    if robot.tool_frame is not None:
        np.testing.assert_allclose(found.transforms[expected.solved], expected.transforms[expected.solved], atol=1e-9)
    poses = robot.at(found.q[expected.solved], engine="pinocchio")
    np.testing.assert_allclose(poses.commands, expected.commands[expected.solved], atol=1e-9)
    assert poses.residual.max() < 1e-12
    difference = (poses.coordinates if given == "coordinates" else poses.commands) - values[expected.solved]
    is_angle = [c.unit == "rad" for c in (robot.coordinates if given == "coordinates" else robot.command_coordinates)]
    difference[:, is_angle] = (difference[:, is_angle] + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps", "delta", "five_bar"])
def test_a_march_finds_what_walks_find(name):
    robot, solver = load(name), continuation(name, "coordinates")
    values = random_values(name, "coordinates", 200)
    axes = {
        coordinate.name: (values[:, k].min(), values[:, k].max(), count)
        for k, (coordinate, count) in enumerate(zip(robot.coordinates, (13, 11, 9), strict=False))
    }
    grid = robot.grid(**axes)
    marched = solver.march(grid)
    walked = solver.walk(grid.values.reshape(-1, len(robot.coordinates)))
    np.testing.assert_array_equal(marched.broken_limits, walked.broken_limits)
    assert np.isfinite(marched.residual).all()
    np.testing.assert_allclose(robot.at(marched.q).commands, robot.at(walked.q).commands, atol=1e-11)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps", "delta", "five_bar"])
def test_axes_may_be_uneven_and_come_back(name):
    robot = load(name)
    home = robot.home_coordinates
    steps = np.array([-1.0, -1.0, -0.9, 0.2, 0.2, 0.21, 1.0, -0.5])
    widths = [0.05 * robot.characteristic_length if c.unit == "m" else 0.1 for c in robot.coordinates]
    fixed = {c.name: float(value) for c, value in zip(robot.coordinates, home, strict=True)}
    axes = {c.name: fixed.pop(c.name) + widths[k] * steps for k, c in enumerate(robot.coordinates[:2])}
    grid = Grid(robot.coordinates, axes, fixed)
    marched, walked = robot.solve(grid), robot.solve(grid.values)
    np.testing.assert_allclose(marched.commands, walked.commands, atol=1e-12)
    np.testing.assert_allclose(marched.transforms, walked.transforms, atol=1e-12)
    np.testing.assert_allclose(marched.coordinates, grid.values, atol=1e-12)
    assert np.array_equal(marched.q, robot.solve(grid, threads=1).q)


def test_a_march_over_more_than_the_workspace():
    """The pen of a five-bar reaches less than the sum of its links: the grid is twice as wide."""
    robot, solver = load("five_bar"), continuation("five_bar", "coordinates")
    grid = robot.grid(x=(-0.7, 0.7, 5), y=(0.05, 0.95, 4))
    marched = solver.march(grid)
    values = grid.values.reshape(-1, 2)
    expected = robot.solve(values, on_failure="nan", engine="pinocchio")
    solved = np.isfinite(marched.residual)
    assert 0.2 < solved.mean() < 0.8
    assert not (expected.solved & ~solved).any()
    np.testing.assert_allclose(
        robot.at(marched.q[solved], engine="pinocchio").positions[:, :2], values[solved], atol=1e-12
    )


def elbow_area(robot: Robot, q: np.ndarray) -> float:
    """Return the signed area of the triangle of one arm: shoulder, elbow, pen; 0 where it is straight."""
    configuration = robot.configuration(q)
    joint = robot.command_coordinates[0].joint
    index = robot.model.getJointId(joint)
    elbow = next(k for k in range(robot.model.njoints) if robot.model.parents[k] == index and k != index)
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    shoulder, middle = data.oMi[index].translation, data.oMi[elbow].translation
    return float(np.cross(middle - shoulder, configuration.tool_placement.translation - middle)[2])


def test_a_walk_to_a_singular_pose_stays_in_the_mode_of_home_or_is_flagged():
    """With an arm straight the five-bar's pen is at the end of its reach: continuation stops there."""
    robot, solver = load("five_bar"), continuation("five_bar", "coordinates")
    q = robot.home.q
    home, sign = solver.read(q[None])[0], np.sign(elbow_area(robot, q))
    directions = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    way = 0.6 * np.column_stack([np.cos(directions), np.sin(directions)])
    for share in np.linspace(0.05, 1.0, 20):
        walked = solver._walked(np.tile(q, (48, 1)), home + share * way)
        arrived = walked.status == walk.REACHED
        for row in walked.q[arrived]:
            assert robot.configuration(row).closure_residual < 1e-12
            assert (
                sign * elbow_area(robot, row) > -1e-6
            )  # it may end at the singular pose: 1e-5 of that of a right angle
    assert not arrived.all()


def five_bar_by_triangles(pens: np.ndarray) -> np.ndarray:
    """Return the motors' travels from home, elbows outward, at pens, shape=(n, 2); NaN where an arm does not reach.

    The arms, of 0.25 m and 0.35 m, are 0.1 m left and right of the origin.
    """
    travels = []
    for side in (-1.0, 1.0):
        x, y = (pens - [0.1 * side, 0.0]).T
        reach = np.hypot(x, y)
        with np.errstate(invalid="ignore"):
            between = np.arccos((0.25**2 + reach**2 - 0.35**2) / (0.5 * reach))
        travels.append(np.arctan2(y, x) - side * between)
    return np.stack(travels, axis=-1)


def test_the_reachable_set_up_to_singular_reach_is_that_of_homes_assembly_mode():
    """All over the five-bar's plane, and within a micrometre of the reach of both arms, against triangles."""
    robot = load("five_bar")
    generator = np.random.default_rng(4)
    angle = generator.uniform(1.3, 2.6, 300)
    reach = (0.6 + generator.uniform(-1e-6, 1e-6, 300))[:, None]
    edge = reach * np.stack([np.cos(angle), np.sin(angle)], axis=-1) + [0.1, 0.0]
    pens = np.vstack([generator.uniform([-0.5, 0.15], [0.5, 0.65], (2000, 2)), edge, edge * [-1.0, 1.0]])
    poses = robot.solve(pens, on_failure="nan")
    expected = five_bar_by_triangles(pens)
    np.testing.assert_array_equal(poses.solved, np.isfinite(expected).all(axis=1))
    home = five_bar_by_triangles(robot.home_coordinates[None])
    np.testing.assert_allclose(poses.commands[poses.solved], (expected - home)[poses.solved], atol=1e-5)


def test_damped_steps_find_what_the_damped_solver_finds_from_far():
    """Directly from home to poses all over the five-bar's plane, most of them out of reach."""
    robot, solver = load("five_bar"), continuation("five_bar", "coordinates")
    values = np.random.default_rng(1).uniform([-0.6, 0.1], [0.6, 1.0], (150, 2))
    ends, moving = solver._damped_ends(np.tile(robot.home.q, (150, 1)), values)
    expected = np.array([assemble_at(robot, robot.coordinates, row, robot.home.q).converged for row in values])
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal((solver._residuals(ends, values) < 1e-12) & ~moving, expected)
    np.testing.assert_allclose(
        robot.at(ends[expected], engine="pinocchio").positions[:, :2], values[expected], atol=1e-12
    )


def test_a_variant_is_solved_by_the_programs_of_its_prototype():
    """Small errors in every joint placement: no separate tracing, and the same poses as Pinocchio."""
    robot = load("hexapod")
    generator = np.random.default_rng(2)
    for _ in range(2):
        model = robot.model.copy()
        for joint in range(1, model.njoints):
            model.jointPlacements[joint] *= pin.exp6(pin.Motion(generator.normal(0.0, 1e-3, 6)))
        variant = robot.replace(model=model)
        assert variant.prototype is robot
        commands = random_values("hexapod", "commands", 20, 0.5)
        found = variant.forward(commands)
        expected = variant.forward(commands, engine="pinocchio")
        assert program_source(variant) is program_source(robot)
        np.testing.assert_allclose(found.transforms, expected.transforms, atol=1e-10)
        assert found.residual.max() < 1e-12


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "delta", "five_bar"])
@pytest.mark.parametrize("given", ["coordinates", "commands"])
def test_legs_twenty_times_shorter_end_in_the_same_poses(name, given, monkeypatch):
    """Far out, where continuation often meets a singular pose."""
    robot, solver = load(name), continuation(name, given)
    coordinates = robot.coordinates if given == "coordinates" else robot.command_coordinates
    units = np.array([1.0 if c.unit == "rad" else robot.characteristic_length for c in coordinates])
    home = solver.read(robot.home.q[None])
    values = home + np.random.default_rng(3).uniform(-1.0, 1.0, (200, home.shape[1])) * units
    starts = np.tile(robot.home.q, (200, 1))
    walked = solver._walked(starts, values)
    monkeypatch.setattr(walk, "WALK", walk._Limits(jump=0.05, regularity=walk.WALK.regularity))
    compiled, parameters = solver._step
    samples = program_source(robot).samples
    start = walk.start_program(robot, solver._task, samples, leg=0.05 * walk.LEG)
    control = walk.control_program(robot, start, solver._task, samples)
    program = walk.Walk.from_programs(compiled.program, start, control)
    slowly = llvm.compile(program).walk(starts, solver._given_numbers(values), parameters)
    arrived, arrived_slowly = walked.status == walk.REACHED, slowly.status == walk.REACHED
    assert not (arrived & ~arrived_slowly).any()
    assert arrived.sum() >= 0.98 * arrived_slowly.sum()
    np.testing.assert_allclose(
        robot.at(walked.q[arrived]).transforms, robot.at(slowly.q[arrived]).transforms, atol=1e-8
    )


def test_results_do_not_depend_on_the_batch():
    solver = continuation("hexapod", "commands")
    values = random_values("hexapod", "commands", 37)
    together = solver.walk(values)
    for row in (0, 17, 36):
        np.testing.assert_array_equal(solver.walk(values[row : row + 1]).q[0], together.q[row])


def test_a_tool_angle_goes_the_shortest_way_round():
    robot, solver = load("ur5"), continuation("ur5", "coordinates")
    values = np.tile(solver.read(robot.home.q[None]), (3, 1))
    values[1, 5] += 2.0 * np.pi
    values[2, 5] -= 2.0 * np.pi
    found = solver.walk(values)
    np.testing.assert_allclose(found.q, np.tile(robot.home.q, (3, 1)), atol=1e-12)


def test_values_that_are_not_finite_are_not_solved():
    solver = continuation("pm3dof", "coordinates")
    values = random_values("pm3dof", "coordinates", 3)
    values[1, 1] = np.nan
    found = solver.walk(values)
    np.testing.assert_array_equal(found.broken_limits[[1]], [1])
    assert np.isfinite(found.residual[[0, 2]]).all()
    assert np.isnan(found.transforms[1]).all()


def test_poses_at_positions_are_those_of_pinocchio():
    robot = load("hexapod")
    q = random_values("hexapod", "coordinates", 60).repeat(2, axis=0)
    positions = np.array(robot.solve(q, engine="pinocchio").q)
    positions[1::2, 6:] += 1e-3  # loops open
    positions[5] = np.nan
    found = robot.at(positions.reshape(2, 60, -1))
    expected = robot.at(positions.reshape(2, 60, -1), engine="pinocchio")
    np.testing.assert_array_equal(found.broken_limits, expected.broken_limits)
    np.testing.assert_allclose(found.transforms, expected.transforms, atol=1e-13)
    np.testing.assert_array_equal(found.residual < 1e-12, expected.residual < 1e-12)


def test_samples_are_closed_and_differ_from_home():
    robot = load("hexapod")
    samples = samples_near_home(robot)
    assert len(samples) == 9
    assert all(robot.configuration(q).closure_residual < 1e-12 for q in samples)
    np.testing.assert_array_equal(samples[0], robot.home.q)
    assert (np.abs(samples[1:] - robot.home.q).max(axis=1) > 1e-3).all()


def test_joints_of_any_kind_are_walked():
    """A spherical joint and a free body between two arms."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    ball = model.addJoint(first, pin.JointModelSpherical(), pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), "ball")
    last = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3(np.eye(3), np.array([0.0, 0.4, 0.0])), "last")
    free = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    shift = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
    for name, joint in (("ball_tip", ball), ("last_tip", last), ("ball_middle", ball)):
        model.addFrame(pin.Frame(name, joint, shift if "tip" in name else pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("body", free, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    from pm3dof_pin.description.closures import LoopClosure

    closures = [LoopClosure("ball_tip", "last_tip", "3d"), LoopClosure("ball_middle", "body", "6d")]
    robot = Robot(model, closures, actuated_joints=["first"], tool_frame="body")
    solver = Continuation(robot, robot.command_coordinates)
    values = np.linspace(-0.3, 0.3, 13)[:, None]
    found = solver.walk(values)
    for row in found.q:
        assert robot.configuration(row).closure_residual < 1e-12
    np.testing.assert_allclose(robot.at(found.q).commands, values, atol=1e-15)


def test_a_robot_without_programs_is_solved_all_the_same(caplog):
    """Programs do not support joints on ellipsoids: Pinocchio solves, and the log says why."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    last = model.addJoint(first, pin.JointModelEllipsoid(0.1, 0.2, 0.3), pin.SE3.Identity(), "last")
    model.addFrame(pin.Frame("tip", last, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, tool_frame="tip", actuated_joints=["first"])
    with caplog.at_level("INFO"):
        poses = robot.forward([[0.1], [0.2]])
    np.testing.assert_array_equal(poses.commands, [[0.1], [0.2]])
    assert "programs do not support joints of type Ellipsoid" in caplog.text


def test_a_robot_without_a_tool_is_solved():
    robot = load("walker")
    commands = np.random.default_rng(0).uniform(-0.05, 0.05, (40, len(robot.commands)))
    poses = robot.forward(commands)
    np.testing.assert_allclose(poses.commands, commands, atol=1e-15)
    assert poses[3:5].residual.max() < 1e-12


@pytest.mark.parametrize(("engine", "count"), [("program", 300), ("pinocchio", 6)])
def test_a_serial_arm_reaches_wherever_its_joints_lead(engine, count):
    robot = load("ur5")
    model, data = robot.model, robot.model.createData()
    wanted = []
    for q in np.random.default_rng(3).uniform(-np.pi, np.pi, (count, model.nq)):
        pin.framesForwardKinematics(model, data, q)
        wanted.append(data.oMf[model.getFrameId("tool0")].homogeneous)
    found = robot.reach(wanted, engine=engine)
    np.testing.assert_allclose(found.transforms, wanted, atol=1e-9)
    assert found.within_limits.all()  # every joint may make a full turn


def test_poses_out_of_an_arms_reach_are_given_up_by_programs(tmp_path, monkeypatch):
    """Seven joints as six: the solver on Pinocchio's Jacobians, a thousand times slower, decides few of many poses."""
    calls = []

    def counted(*arguments):
        calls.append(arguments)
        return assemble_at(*arguments)

    monkeypatch.setattr(f"{Continuation.__module__}.assemble_at", counted)
    robot = Robot.load(arm(7).write(tmp_path))
    generator = np.random.default_rng(3)
    radius = 0.95 * robot.arm_reach[1]
    away = generator.standard_normal((60, 3))
    positions = robot.arm_reach[0] + radius * away / np.linalg.norm(away, axis=1)[:, None]
    targets = np.hstack([positions, generator.uniform(-1.5, 1.5, (60, 3))])
    found = robot.continuation(robot.coordinates).walk(targets)
    assert np.isnan(found.q[:, 0]).mean() > 0.9
    assert len(calls) < 10


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
@pytest.mark.parametrize("count", [8, 20])
def test_arms_with_null_motions_keep_their_limits(count, engine, tmp_path):
    """Where some pose is within them: that from which the target was made."""
    robot = Robot.load(arm(count).write(tmp_path))
    ranges = np.array([robot.range_of(command) for command in robot.commands])
    commands = np.random.default_rng(0).uniform(*(0.6 * ranges.T), (40, count))
    targets = robot.forward(commands).coordinates
    poses = robot.solve(targets, engine=engine)
    np.testing.assert_allclose(poses.coordinates, targets, atol=1e-9)
    assert poses.within_limits.mean() > 0.85
    within = [not robot.configuration(q).violated_limits() for q in poses.q]
    np.testing.assert_array_equal(poses.within_limits, within)


def test_an_arm_with_null_motions_has_no_jumps_along_a_line(tmp_path):
    robot = Robot.load(arm(20).write(tmp_path))
    ranges = np.array([robot.range_of(command) for command in robot.commands])
    ends = robot.forward(np.random.default_rng(1).uniform(*(0.9 * ranges.T), (2, 20))).transforms
    line = np.tile(ends[0], (200, 1, 1))
    way = ends[1, :3, 3] - ends[0, :3, 3]
    line[:, :3, 3] += np.linspace(0.0, 0.3 * robot.characteristic_length / np.linalg.norm(way), 200)[:, None] * way
    poses = robot.reach(line)
    assert poses.within_limits.all()
    assert np.abs(np.diff(poses.q, axis=0)).max() < 0.01
