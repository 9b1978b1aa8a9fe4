"""Branches: poses beyond serial and parallel singularities, against determinants derived by hand."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import (
    AmbiguousHomeError,
    ConvergenceError,
    InvalidValueError,
    PM3DofError,
    SingularConfigurationError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.branches import branches_of
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.limit_space import robot_space
from pm3dof_pin.programs.checks import checks_program
from pm3dof_pin.programs.closing import Task, closing_program

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import four_bars

MACHINES = Path(__file__).parents[1] / "machines"
BASE, PLATFORM = 0.5, 0.2  # radii [m]


def load(name: str) -> Robot:
    files = [*(MACHINES / name).glob("*.urdf"), *(MACHINES / name).glob("*.xml")]
    return Robot.load(files[0] if files else name)


@cache
def three_rpr(turn: float = np.radians(35.0)) -> Robot:
    """A planar 3-RPR: triangles of radii BASE and PLATFORM, the platform turned by `turn` where phi = 0."""
    model = pin.Model()
    model.name = "three_rpr"
    for leg, angle in enumerate(np.pi / 2 + np.arange(3) * 2 * np.pi / 3):
        foot = BASE * np.array([np.cos(angle), np.sin(angle), 0.0])
        head = PLATFORM * np.array([np.cos(angle + turn), np.sin(angle + turn), 0.0])
        way = head - foot
        direction = np.arctan2(way[1], way[0])
        placement = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, direction), foot)
        swing = model.addJoint(0, pin.JointModelRZ(), placement, f"swing{leg}")
        along = pin.SE3(np.eye(3), np.array([np.linalg.norm(way), 0.0, 0.0]))
        slide = model.addJoint(swing, pin.JointModelPX(), along, f"u{leg}")
        model.addFrame(pin.Frame(f"tip{leg}", slide, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        if leg == 0:
            level = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, -direction), np.zeros(3))
            platform, first = model.addJoint(slide, pin.JointModelRZ(), level, "pivot"), head
        else:
            at = pin.SE3(np.eye(3), head - first)
            model.addFrame(pin.Frame(f"head{leg}", platform, at, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tool", platform, pin.SE3(np.eye(3), -first), pin.FrameType.OP_FRAME))
    coordinates = [Coordinate("x", "m", tool="x"), Coordinate("y", "m", tool="y"), Coordinate("phi", "rad", tool="rz")]
    return Robot(
        model,
        [LoopClosure(f"tip{leg}", f"head{leg}", "3d") for leg in (1, 2)],
        actuated_joints=["u0", "u1", "u2"],
        tool_frame="tool",
        coordinates=coordinates,
    )


def three_rpr_determinant(values: np.ndarray, turn: float = np.radians(35.0)) -> np.ndarray:
    """Return the determinant of the 3-RPR's actuation, up to positive factors.

    With base points b e_i and platform points t + r R(theta) e_i, theta = phi + turn, the i-th row is [d_i, r R e_i x
    d_i] with the leg d_i = t + (r R - b) e_i. As the e_i add up to zero and their squares to 3/2 of unity, the
    determinant of the three rows is r b sin(theta) (r^2 + b^2 - 2 r b cos(theta) - |t|^2) times a constant: all poses
    at phi = -turn are singular.
    """
    x, y, phi = np.moveaxis(np.asarray(values), -1, 0)
    theta = phi + turn
    circle = PLATFORM**2 + BASE**2 - 2.0 * PLATFORM * BASE * np.cos(theta) - x**2 - y**2
    return np.asarray(np.sin(theta) * circle)


@pytest.mark.parametrize(("engine", "count"), [("program", 400), ("pinocchio", 40)])
def test_a_turned_three_rpr_ends_at_its_parallel_singularity(engine, count):
    robot = three_rpr()
    values = np.random.default_rng(0).uniform([-0.1, -0.1, -1.4], [0.1, 0.1, 1.4], (count, 3))
    poses = robot.solve(values, on_failure="nan", engine=engine)
    same = three_rpr_determinant(values) > 0.0
    assert 0.2 < same.mean() < 0.8
    np.testing.assert_array_equal(poses.solved, same)
    np.testing.assert_array_equal(poses.branch, 0)
    found = robot.solve(values, branches="all", engine=engine)
    np.testing.assert_array_equal(found.branch == 0, same)
    back = robot.forward(poses.commands[same], engine=engine)
    np.testing.assert_allclose(back.commands, poses.commands[same], atol=1e-10)


def test_grids_random_poses_and_placements_end_there_too():
    robot = three_rpr()
    grid = robot.grid(x=(-0.1, 0.1, 5), y=(-0.1, 0.1, 5), phi=(-1.4, 0.5, 39))
    poses = robot.solve(grid, on_failure="nan")
    np.testing.assert_array_equal(poses.solved, three_rpr_determinant(grid.values) > 0.0)
    everything = robot.solve(grid, on_failure="nan", branches="all")
    np.testing.assert_array_equal(everything.branch == 0, three_rpr_determinant(grid.values) > 0.0)
    placements = everything.transforms.reshape(-1, 4, 4)
    found = robot.reach(placements, on_failure="nan")
    np.testing.assert_array_equal(found.solved, poses.solved.ravel())


def test_the_message_names_the_singularity_and_the_way_beyond():
    robot = three_rpr()
    with pytest.raises(UnreachablePoseError, match=r"parallel singularity.*phi = -3[45](\.\d+)? deg.*'home'"):
        robot.solve([0.0, 0.01, np.radians(-50.0)])
    beyond = robot.solve([0.0, 0.01, np.radians(-50.0)], branches="all")
    assert beyond.branch != 0
    there = robot.solve([0.02, 0.0, np.radians(-60.0)], guess=beyond.q)  # on purpose
    assert there.branch == beyond.branch
    model = robot.model.copy()
    model.referenceConfigurations["home"] = np.array(beyond.q)
    other = robot.replace(model=model)
    assert other.solve([0.02, 0.0, np.radians(-60.0)]).branch == 0
    with pytest.raises(UnreachablePoseError, match="parallel"):
        other.solve([0.0, 0.01, 0.0])


def test_a_five_bar_stays_on_the_side_of_its_distal_links():
    """The distal links of 0.35 m from the elbows to the pen: their cross product is zero at a parallel singularity."""
    robot = load("five_bar")
    grid = robot.grid(x=(-0.5, 0.5, 81), y=(-0.45, 0.65, 81))
    everything = robot.solve(grid, on_failure="nan", branches="all")
    left, right = everything.commands[..., 0], everything.commands[..., 1]
    # counter zeros at home, where the travels are those of the triangles of test_continuation.py
    pen, angles = grid.values, []
    home = robot.home_coordinates
    for side, travel in ((-1.0, left), (1.0, right)):
        x, y = home - [0.1 * side, 0.0]
        reach = np.hypot(x, y)
        between = np.arccos((0.25**2 + reach**2 - 0.35**2) / (0.5 * reach))
        angles.append(np.arctan2(y, x) - side * between + travel)
    elbows = [
        np.stack([0.1 * side + 0.25 * np.cos(a), 0.25 * np.sin(a)], axis=-1)
        for side, a in zip((-1.0, 1.0), angles, strict=True)
    ]
    first, second = (pen - elbow for elbow in elbows)
    np.testing.assert_allclose(np.hypot(*np.moveaxis(first, -1, 0))[everything.solved], 0.35, atol=1e-9)
    cross = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    solved = everything.solved & (np.abs(cross) > 1e-9)
    same = cross * (0.35**2) > 0.0  # at home the left link turns into the right one counter-clockwise
    np.testing.assert_array_equal((everything.branch == 0)[solved], same[solved])
    assert np.mean(~same[solved]) > 0.005
    reached = robot.solve(grid, on_failure="nan")
    assert not (reached.solved & solved & ~same).any()


@pytest.mark.parametrize("name", ["pm3dof", "three_rps", "linear_delta", "agile_eye", "four_bar"])
def test_both_engines_number_closed_configurations_far_from_home_alike(name):
    robot = load(name)
    generator, rows = np.random.default_rng(5), []
    for _ in range(80):
        motion = robot.velocity_scale * generator.uniform(-1.6, 1.6, robot.model.nv)
        result = assemble(robot, pin.integrate(robot.model, robot.home.q, motion))
        if result.converged:
            rows.append(result.q)
    by_pinocchio = [branches_of(robot).number(row) for row in rows]
    assert len(set(by_pinocchio)) > 1
    np.testing.assert_array_equal(robot.at(np.array(rows)).branch, by_pinocchio)


def test_numbers_of_branches_take_few_operations():
    for name in ("pm3dof", "three_rps", "linear_delta"):
        robot = load(name)
        task, samples = Task.from_coordinates(robot.coordinates), branches_of(robot).samples
        step = closing_program(robot, task, samples)
        more = len(checks_program(robot, samples, task)) - len(checks_program(robot, samples))
        assert more < 0.7 * len(step)  # a pose of a map takes at least one Newton step


@pytest.mark.parametrize(
    "name",
    ["pm3dof", "hexapod", "three_rps", "linear_delta", "delta", "five_bar", "three_rpr", "four_rrr", "agile_eye"],
)
def test_both_engines_number_branches_alike_and_poses_return(name):
    robot = load(name)
    poses = reachable_poses(robot, 150, np.random.default_rng(2))
    wide = robot.home_coordinates + np.random.default_rng(3).normal(0.0, 0.3, (60, len(robot.coordinates))) * [
        1.0 if c.unit == "rad" else robot.characteristic_length for c in robot.coordinates
    ]
    far = robot.solve(wide, on_failure="nan", branches="all")
    for batch in (poses, far[far.solved]):
        q = batch.q
        by_program = robot.at(q).branch
        by_pinocchio = [branches_of(robot).number(row) for row in q]
        np.testing.assert_array_equal(by_program, by_pinocchio)
    np.testing.assert_array_equal(poses.branch, 0)
    commands = robot.solve(poses.coordinates).commands
    if len(robot.commands) == len(robot.coordinates):  # some of redundant drives have singularities of their own
        back = robot.forward(commands)
        np.testing.assert_allclose(back.commands, commands, atol=1e-9)
        np.testing.assert_allclose(robot.solve(back.coordinates).commands, commands, atol=1e-9)


def test_a_chain_with_more_drives_than_the_tool_has_motions_has_no_sign_of_the_drives(tmp_path):
    """Six rates of its tool do not determine eight drives, so no determinant of some of these bounds a branch.

    No crank passes a dead point: each loop closes for all its angles here, so every command is within reach.
    """
    robot = Robot.load(four_bars(8).write(tmp_path))
    commands = robot.home.commands + np.random.default_rng(0).uniform(-0.3, 0.3, (60, 8))
    poses = robot.forward(commands, on_failure="nan")
    assert poses.solved.all()
    expected = robot.with_engine("pinocchio").forward(commands)
    assert np.abs(poses.transforms - expected.transforms).max() < 1e-12


@pytest.mark.parametrize("count", [7, 8, 12])
def test_more_drives_than_the_tool_has_motions(count, tmp_path):
    """Poses that some commands reach are found from home, the chain's straight pose with five motions of the tool."""
    robot = Robot.load(four_bars(count).write(tmp_path))
    assert len(robot.coordinates) == 6 < len(robot.commands)
    commands = np.random.default_rng(0).uniform(-0.2, 0.2, (12, count))
    targets = np.vstack([robot.home_coordinates, robot.forward(commands).coordinates])
    for which in (robot, robot.with_engine("pinocchio")):
        poses = which.solve(targets)
        assert poses.solved.all()
        np.testing.assert_allclose(poses.coordinates, targets, atol=1e-9)
        for q in poses.q:
            assert robot.configuration(q).closure_residual < 1e-9
    with pytest.raises(InvalidValueError, match="drives can move while the tool rests"):
        robot_space(robot)


@pytest.mark.parametrize("count", [7, 12])
def test_many_poses_of_more_drives_than_the_tool_has_motions(count, tmp_path):
    """What commands reach is found in large batches, from other poses, and on a grid around a regular pose."""
    robot = Robot.load(four_bars(count).write(tmp_path))
    made = robot.forward(np.random.default_rng(1).uniform(-0.4, 0.4, (300, count)))
    for guess in (None, np.roll(made.q, 1, axis=0)):
        poses = robot.solve(made.coordinates, guess=guess, on_failure="nan")
        assert poses.solved.mean() > (0.98 if guess is None else 0.8)
        found = poses.solved
        np.testing.assert_allclose(poses.transforms[found], made.transforms[found], atol=1e-9)
        assert not poses.branch[found].any()
    x, y, z, *angles = made.coordinates[0]
    size = 0.01 * robot.characteristic_length
    grid = robot.grid(
        x=(x - size, x + size, 5),
        y=(y - size, y + size, 5),
        z=z,
        **dict(zip(("rx", "ry", "rz"), map(float, angles), strict=True)),
    )
    alone = robot.solve(grid.values.reshape(-1, 6), on_failure="nan").solved
    marched = robot.solve(grid, on_failure="nan").solved.ravel()
    assert alone.mean() > 0.9
    assert (marched | ~alone).mean() > 0.85


def test_the_reference_finds_the_same_poses_without_any_compiled_code(tmp_path):
    robot = load("linear_delta")
    ranges = np.array([robot.range_of(command) for command in robot.commands])
    commands = np.random.default_rng(5).uniform(*ranges.T, (8, 3))
    expected = robot.forward(commands, on_failure="nan")
    assert 0.2 < expected.solved.mean() < 0.95
    script = """
import json, sys
sys.modules["llvmlite"] = sys.modules["pm3dof_pin.programs"] = sys.modules["pm3dof_pin.kinematics.continuation"] = None
import numpy as np
import pm3dof_pin as pm
poses = pm.load("linear_delta", engine="pinocchio").forward(json.load(sys.stdin), on_failure="nan")
print(json.dumps(poses.transforms[:, :3, 3].tolist()))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], input=json.dumps(commands.tolist()), capture_output=True, text=True, check=True
    )
    np.testing.assert_allclose(json.loads(done.stdout), expected.positions, atol=1e-9)


URDF_JOINT = (
    '<link name="{0}"/><joint name="{0}_joint" type="revolute"><parent link="{1}"/><child link="{0}"/>'
    '<origin xyz="{2} {3} 0" rpy="{4}"/><axis xyz="0 0 1"/>'
    '<limit lower="{5}" upper="{6}" effort="1" velocity="1"/></joint>'
)
URDF_FRAME = (
    '<link name="{0}"/><joint name="{0}_fixed" type="fixed"><parent link="{1}"/><child link="{0}"/>'
    '<origin xyz="{2} 0 0"/></joint>'
)


def four_bar_files(folder: Path, links: list[float], *, tilt: str = "0 0 0", crank=(-3.2, 3.2), rocker=(-3.2, 3.2)):
    """Write a four-bar whose zero pose is collinear: crank, coupler, rocker and ground, in a plane tilted by rpy."""
    crank_length, coupler, rocker_length, ground = links
    text = '<robot name="fb"><link name="world"/>'
    text += '<link name="base"/><joint name="tilt" type="fixed"><parent link="world"/><child link="base"/>'
    text += f'<origin xyz="0 0 0" rpy="{tilt}"/></joint>'
    text += URDF_JOINT.format("crank", "base", 0, 0, "0 0 0", *crank)
    text += URDF_JOINT.format("coupler", "crank", crank_length, 0, "0 0 0", -3.2, 3.2)
    text += URDF_JOINT.format("rocker", "base", ground, 0, "0 0 0", *rocker)
    text += URDF_FRAME.format("tip", "coupler", coupler) + URDF_FRAME.format("end", "rocker", rocker_length)
    (folder / "fb.urdf").write_text(text + "</robot>")
    closures = "closed_loop: [[tip, end]]\ntype: [3d]\nname_mot: [crank_joint]\ntool_frame: tip\n"
    (folder / "fb.closures.yaml").write_text(closures)
    return folder / "fb.urdf"


def test_a_home_from_which_the_loops_close_in_several_ways_is_refused(tmp_path, run):
    """A ten-thousandth of a radian off the line the coupler's side is anybody's guess."""
    path = four_bar_files(tmp_path, [0.08, 0.22, 0.18, 0.24])
    state = '<group_state name="home" group="all"><joint name="coupler_joint" value="1e-4"/></group_state>'
    (tmp_path / "fb.srdf").write_text(f'<robot name="fb">{state}</robot>')
    robot = Robot.load(path, drive_stiffness=100.0)
    for action in (robot.assemble, lambda: robot.forward([1.0]), robot.with_engine("pinocchio").assemble):
        with pytest.raises(AmbiguousHomeError, match=r"open by 0\.12 m or rad and close in several ways.*--assemble"):
            action()
    for command in (["stiffness", "--drive-stiffness", "100"], ["fk", "--configuration", "home"]):
        done = run(command[0], "--robot", str(path), *command[1:])
        assert done.returncode == 1
        assert "close in several ways" in done.stderr


def rocker_angles(links: list[float], crank: float) -> np.ndarray:
    """Return the two angles of the rocker of a four-bar at a crank angle, by the triangle of its diagonal."""
    a, b, c, d = links
    x, y = a * np.cos(crank) - d, a * np.sin(crank)
    diagonal = np.hypot(x, y)
    between = np.arccos((c**2 + diagonal**2 - b**2) / (2.0 * c * diagonal))
    return np.arctan2(y, x) + between * np.array([1.0, -1.0])


@pytest.mark.parametrize("tilt", ["0 0 0", "0.3 -0.7 1.1"])
def test_a_collinear_home_is_refused_by_both_engines_and_assembled_on_request(tmp_path, run, answer, tilt):
    links = [0.08, 0.22, 0.18, 0.24]
    path = four_bar_files(tmp_path, links, tilt=tilt)
    for engine in ("program", "pinocchio"):
        with pytest.raises(ConvergenceError, match=r"closing the loops at home.*--assemble"):
            Robot.load(path, engine=engine).forward([1.0])
    for command in (["ik", "60"], ["fk", "60"], ["workspace"], ["stiffness", "--drive-stiffness", "100"]):
        done = run(command[0], "--robot", str(path), *command[1:])
        assert done.returncode == 1
        assert "--assemble" in done.stderr
    listed = answer("info", str(path), "--assemble", status=1)
    assert (len(listed["assemblies"]), listed["written"]) == (2, None)
    for branch in (1, 2):
        answer("info", str(path), "--assemble", "--branch", str(branch))
        robot = Robot.load(path)
        expected = rocker_angles(links, np.radians(60.0))
        found = [robot.forward([np.radians(60.0)], engine=e).configuration() for e in ("program", "pinocchio")]
        angles = [
            (configuration.joint_position("rocker_joint") + np.pi) % (2 * np.pi) - np.pi for configuration in found
        ]
        assert angles[0] == pytest.approx(angles[1], abs=1e-9)
        assert min(np.abs((angles[0] - expected + np.pi) % (2 * np.pi) - np.pi)) < 1e-9
        side = listed["assemblies"][branch - 1]["joints"]["rocker_joint"]
        crank = listed["assemblies"][branch - 1]["joints"]["crank_joint"]
        nearest = [np.abs((a - side + np.pi) % (2 * np.pi) - np.pi) for a in rocker_angles(links, crank)]
        assert np.argmin(nearest) == np.argmin(np.abs((expected - angles[0] + np.pi) % (2 * np.pi) - np.pi))


def test_the_only_side_of_a_singular_home_within_limits_is_taken_and_said(tmp_path, run):
    """A closed collinear four-bar, crank and coupler on ground and rocker; the rocker turns one way only."""
    links = [0.1, 0.3, 0.15, 0.25]
    both = Robot.load(four_bar_files(tmp_path, links))
    assert both.home.closure_residual < 1e-12
    for engine in ("program", "pinocchio"):
        with pytest.raises(SingularConfigurationError, match=r"2 branches meet.*--assemble"):
            both.forward([0.3], engine=engine)
    one = Robot.load(four_bar_files(tmp_path, links, rocker=(0.0, 3.0), crank=(-3.0, 3.0)))
    signs = []
    for engine in ("program", "pinocchio"):
        pose = one.forward([0.3], engine=engine).configuration()
        signs.append(pose.joint_position("rocker_joint"))
        assert min(np.abs(signs[-1] - rocker_angles(links, 0.3))) < 1e-9
    assert signs[0] == pytest.approx(signs[1], abs=1e-9)
    assert "only side of it within limits" in run("info", str(tmp_path / "fb.urdf")).stdout


def random_machine(seed: int) -> Robot:
    """A loop of random hinges, planar or spatial, cut open: its zero is closed, collinear and singular, or open."""
    generator = np.random.default_rng(seed)
    kind, spatial = ("collinear", "closed", "open")[seed % 3], seed % 2
    model = pin.Model()
    model.name = f"random_{kind}_{seed}"
    count = 7 if spatial else 4
    lengths = generator.uniform(0.1, 0.4, count)
    parent, at = 0, pin.SE3.Identity()
    axes = [pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ]
    for k in range(count - 1):
        joint = axes[int(generator.integers(3))] if spatial else pin.JointModelRZ
        parent = model.addJoint(parent, joint(), at, f"j{k}")
        turn = 0.0 if kind == "collinear" else generator.uniform(-1.5, 1.5)
        rotation = pin.rpy.rpyToMatrix(*(generator.uniform(-1.5, 1.5, 3) if spatial and turn else (0.0, 0.0, turn)))
        at = pin.SE3(rotation, np.array([lengths[k], 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, at, pin.FrameType.OP_FRAME))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    end = data.oMf[model.getFrameId("tip")]
    shift = generator.uniform(-0.15, 0.15, 3) * (1.0 if spatial else np.array([1.0, 1.0, 0.0]))
    goal = pin.SE3(end.rotation, end.translation + (shift if kind == "open" else 0.0))
    model.addFrame(pin.Frame("goal", 0, goal, pin.FrameType.OP_FRAME))
    drives = [f"j{k}" for k in range(count - 1 - 3 if spatial else 1)]
    return Robot(model, [LoopClosure("tip", "goal", "3d")], actuated_joints=drives, tool_frame="tip")


@pytest.mark.parametrize("seed", range(24))
def test_random_machines_have_one_branch_in_both_engines_or_one_refusal(seed):
    robot = random_machine(seed)
    widths = np.random.default_rng(seed).uniform(-0.15, 0.15, (6, len(robot.commands)))
    answers: list[object] = []
    for engine in ("program", "pinocchio"):
        try:
            home = robot.at([robot.home.q]).commands[0]
            answers.append(robot.forward(home + widths, on_failure="nan", engine=engine))
        except PM3DofError as error:
            answers.append((type(error), str(error)))
    first, second = answers
    if isinstance(first, tuple):
        assert first == second
        return
    np.testing.assert_array_equal(first.solved, second.solved)
    np.testing.assert_allclose(first.q[first.solved], second.q[second.solved], atol=1e-8)
    np.testing.assert_array_equal(first.branch, 0)


def test_an_arm_with_a_gripper_passes_its_singular_poses(tmp_path: Path) -> None:
    """One finger follows the other: no loop that could have branches."""
    joints = 6
    axes, links, shift = "zyyxyxz", [], "0 0 0.1"
    for k, axis in enumerate(axes[:joints]):
        direction = " ".join("1" if each == axis else "0" for each in "xyz")
        links.append(_joint(f"j{k}", "revolute", f"l{k}", f"l{k + 1}", shift, direction, "-3 3"))
        shift = "0.02 0 0.25"
    fingers = [
        _joint(f"finger{k}", "prismatic", f"l{joints}", f"f{k}", "0 0 0.1", f"0 {side} 0", "0 0.04")
        for k, side in ((1, 1), (2, -1))
    ]
    bodies = "".join(f'<link name="{name}"/>' for name in [*(f"l{k}" for k in range(joints + 1)), "f1", "f2"])
    drives = [f"j{k}" for k in range(joints)]
    alone, gripping = tmp_path / "alone.urdf", tmp_path / "gripping.urdf"
    alone.write_text(f'<robot name="alone">{bodies.split("<link name=" + chr(34) + "f1")[0]}{"".join(links)}</robot>')
    gripping.write_text(f'<robot name="gripping">{bodies}{"".join(links + fingers)}</robot>')
    (tmp_path / "gripping.closures.yaml").write_text("couplings: [{joint: finger2, of: {finger1: 1.0}}]\n")
    arm, robot = (Robot.load(file, tool_frame=f"l{joints}", drives=drives) for file in (alone, gripping))
    commands = np.random.default_rng(3).uniform(-2.5, 2.5, (20, joints))
    assert robot.couplings
    expected = arm.forward(commands).transforms
    for engine in ("program", "pinocchio"):
        poses = robot.with_engine(engine).forward(commands)  # type: ignore[arg-type]
        np.testing.assert_allclose(poses.transforms, expected, atol=1e-12)
    assert not poses.branch.any()


def _joint(name: str, kind: str, parent: str, child: str, place: str, axis: str, limits: str) -> str:
    lower, upper = limits.split()
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{place}"/>'
        f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/></joint>'
    )


@pytest.mark.parametrize("count", [8, 64])
def test_branches_of_more_signs_than_a_number_has_bits(count):
    """Four-bars beside each other, some folded the other way: their ends mirrored in the line from crank to pivot."""
    model = pin.Model()
    pivot, tip, end = np.array([0.3, 0.0]), np.array([0.0, 0.1]), np.array([0.28, 0.2])
    for k in range(count):
        base = np.array([0.0, 0.0, 0.01 * k])
        crank = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), base), f"crank{k}")
        at = pin.SE3(np.eye(3), np.append(tip, 0.0))
        coupler = model.addJoint(crank, pin.JointModelRZ(), at, f"coupler{k}")
        rocker = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), base + np.append(pivot, 0.0)), f"rocker{k}")
        for name, joint, arm in (("a", coupler, end - tip), ("b", rocker, end - pivot)):
            at = pin.SE3(np.eye(3), np.append(arm, 0.0))
            model.addFrame(pin.Frame(f"{name}{k}", joint, at, pin.FrameType.OP_FRAME))
    closures = [LoopClosure(f"a{k}", f"b{k}", "3d") for k in range(count)]
    robot = Robot(model, closures, actuated_joints=[f"crank{k}" for k in range(count)])

    def angle(vector):
        return np.arctan2(vector[1], vector[0])

    folded = 2.0 * np.array([angle(pivot - tip) - angle(end - tip), angle(tip - pivot) - angle(end - pivot)])
    patterns = [(), (0,), (count - 1,), (0, count - 1), (1, count - 1), (count - 2, count - 1), tuple(range(count))]
    q = np.zeros((len(patterns), model.nq))
    for row, pattern in zip(q, patterns, strict=True):
        for k in pattern:
            row[3 * k + 1 : 3 * k + 3] = folded
    assert max(robot.configuration(row).closure_residual for row in q) < 1e-12
    numbers = robot.at(q, engine="pinocchio").branch
    assert numbers[0] == 0
    assert len(set(numbers.tolist())) == len(patterns)
    by_program = robot.at(np.tile(q, (8, 1))).branch.reshape(8, -1)
    np.testing.assert_array_equal(by_program, np.tile(numbers, (8, 1)))
    if count == 8:  # bits of the loops
        assert numbers.tolist() == [sum(1 << k for k in pattern) for pattern in patterns]
    else:  # a walk from one branch does not end on another
        stays = robot.forward(np.full((40, count), 0.01), guess=q[3])
        np.testing.assert_array_equal(stays.branch, numbers[3])
