"""Drives that do not determine the pose, at home or anywhere: commands are refused, coordinates are not."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.calibration.acceptance import write_acceptance_plan
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.capability.tool_capability import tool_capability
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.dynamics.batch import actuator_forces
from pm3dof_pin.dynamics.inverse_dynamics import inverse_dynamics
from pm3dof_pin.dynamics.mass_matrix import drive_mass_matrix
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.kinematics.branches import branches_of
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantities import select_quantities
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.paths.evaluation import evaluate_path
from pm3dof_pin.paths.tool_path import read_path
from pm3dof_pin.typing import Engine
from pm3dof_pin.viewer.lacks import lacks_of
from pm3dof_pin.viewer.sliders import sets_of

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import Drawing

MACHINES = Path(__file__).parents[1] / "machines"
ENGINES: list[Engine] = ["program", "pinocchio"]
CORNERS = np.array([[np.cos(angle), np.sin(angle)] for angle in np.radians([10.0, 110.0, 200.0, 300.0])])


def hexagons(error: float) -> Drawing:
    """A platform on six legs whose ends are similar hexagons but for errors of this size [m].

    Without errors no lengths determine its place (O. Ma and J. Angeles, ICRA 1991).
    """
    drawing, generator = Drawing("similar"), np.random.default_rng(0)
    for k in range(6):
        at = (0.0, 0.0, 0.3) if k == 0 else (0.0, 0.0, 0.0)
        kind = "prismatic" if k < 3 else "revolute"
        drawing.tool = drawing.joint(drawing.tool or "base", f"p{k}", at, kind=kind, axis=np.eye(3)[k % 3])
    for k, angle in enumerate(np.radians([-20.0, 20.0, 100.0, 140.0, 220.0, 260.0])):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        end = 0.12 * direction + error * generator.normal(size=3)
        cross = drawing.joint("base", f"u{k}", 0.2 * direction, kind="revolute", axis=(1.0, 0.0, 0.0))
        lower = drawing.joint(cross, f"v{k}", kind="revolute", axis=(0.0, 1.0, 0.0))
        along = np.array([0.0, 0.0, 0.3]) + end - 0.2 * direction
        rod = drawing.joint(lower, f"s{k}", kind="prismatic", axis=along / np.linalg.norm(along))
        drawing.close(rod, along, drawing.tool, end)
        drawing.drives.append(f"s{k}_joint")
    return drawing


def planar(feet: np.ndarray, heads: np.ndarray, **described: Any) -> Robot:
    """A planar platform on legs with driven lengths, from feet to heads at home, shape=(n, 2) [m]."""
    model, closures = pin.Model(), []
    model.name = "planar"
    ways = heads - feet
    for leg, (foot, way) in enumerate(zip(feet, ways, strict=True)):
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, float(np.arctan2(way[1], way[0])))
        swing = model.addJoint(0, pin.JointModelRZ(), pin.SE3(turn, np.array([*foot, 0.0])), f"swing{leg}")
        along = pin.SE3(np.eye(3), np.array([np.linalg.norm(way), 0.0, 0.0]))
        slide = model.addJoint(swing, pin.JointModelPX(), along, f"u{leg}")
        model.addFrame(pin.Frame(f"tip{leg}", slide, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        if leg == 0:
            turned = pin.SE3(turn.T, np.zeros(3))
            platform = model.addJoint(slide, pin.JointModelRZ(), turned, "platform")
        else:
            closures.append(LoopClosure(f"tip{leg}", f"head{leg}", "3d"))
        place = pin.SE3(np.eye(3), np.array([*(heads[leg] - heads[0]), 0.0]))
        model.addFrame(pin.Frame(f"head{leg}", platform, place, pin.FrameType.OP_FRAME))
    place = pin.SE3(np.eye(3), np.array([*-heads[0], 0.0]))
    model.addFrame(pin.Frame("tool", platform, place, pin.FrameType.OP_FRAME))
    drives = [f"u{leg}" for leg in range(len(feet))]
    return Robot(model, closures, actuated_joints=drives, tool_frame="tool", **described)


def coordinates(names: str) -> list[Coordinate]:
    return [Coordinate(name, "m" if name in "xyz" else "rad", tool=name) for name in names.split()]


def four_legs() -> Robot:
    """Similar quadrilaterals, one in the other: all legs meet at the centre, about which the platform turns at home."""
    return planar(0.4 * CORNERS, 0.1 * CORNERS, coordinates=coordinates("x y rz"))


@pytest.mark.parametrize("error", [0.0, 1e-9, 1e-7, 1e-6, 1e-5])
def test_legs_between_hexagons_that_are_similar_or_nearly_so(error: float, tmp_path: Path) -> None:
    """Their commands are refused as those of a singular architecture; the poses of coordinates are found."""
    robot = Robot.load(hexagons(error).write(tmp_path))
    values = robot.home_coordinates + np.random.default_rng(0).uniform(-0.03, 0.03, (10, 6))
    for engine in ENGINES:
        poses = robot.solve(values, engine=engine)
        np.testing.assert_allclose(poses.coordinates, values, atol=1e-9)
        for commands in (robot.home.commands, poses.commands):
            with pytest.raises(SingularConfigurationError, match="do not determine the pose, at home and all around"):
                robot.forward(commands, engine=engine, on_failure="nan")
    assert branches_of(robot).conditions == ("serial",)  # the sign of a determinant that is nearly zero bounds nothing
    with pytest.raises(SingularConfigurationError, match="do not determine the pose"):
        Controller(robot)
    assert [entry["title"] for entry in sets_of(robot)] == ["Coordinates"]
    assert any("no sliders of the commands" in words for words in lacks_of(robot))


@pytest.mark.parametrize("error", [0.0, 1e-7, 1e-5])
def test_nothing_that_needs_drives_is_told_of_them(error: float, tmp_path: Path) -> None:
    """Forces, rates and errors by drives that are dependent would be rounding, or a thousand times too large."""
    robot = Robot.load(hexagons(error).write(tmp_path))
    pose = robot.solve(robot.home_coordinates + np.array([0.01, 0.02, 0.01, 0.02, -0.03, 0.01]))
    points = pose.transforms[None, :3, 3]
    path = tmp_path / "path.csv"
    path.write_text("x_m,y_m,z_m,rx_rad,ry_rad,rz_rad\n0,0,0.3,0,0,0\n0,0,0.31,0,0,0\n", encoding="utf-8")
    errors = GeometricErrors(robot, [])
    q = pose.configuration()
    refused: list[Callable[[], Any]] = [
        lambda: holding_forces(q),
        lambda: actuator_forces(robot, pose),
        lambda: drive_mass_matrix(q),
        lambda: tool_capability(robot, pose, effort=1.0, speed=1.0),
        lambda: evaluate_path(robot, read_path(robot, path)),
        lambda: write_acceptance_plan(robot, points, {}, tmp_path / "plan.csv"),
        lambda: Compensation(errors).compensate(pose),
        lambda: sensitivities(errors, pose.reshape(1)),
    ]
    for answer in refused:
        with pytest.raises(SingularConfigurationError, match="do not determine the pose, at home and all around"):
            answer()
    with pytest.raises(SingularConfigurationError):  # by whichever of two judgements comes first
        inverse_dynamics(q, np.zeros(6), np.zeros(6))
    mapped = MappedRobot(robot)
    for name in ("holding_forces", "drive_inertia", "geometric_error", "force_capability"):
        with pytest.raises(InvalidValueError, match=f"has no {name} .*drives that determine its pose"):
            select_quantities([name], mapped)
    assert select_quantities(["felt_stiffness", "singularity_distance", "natural_frequencies"], mapped)


def test_true_answers_come_with_a_word_about_the_drives(run: Any, tmp_path: Path) -> None:
    """The commands of a pose exist, and the stiffness of a machine with errors, however small."""
    path = str(hexagons(1e-5).write(tmp_path))
    values = ["0", "0", "0.31", "0", "0", "0"]
    for command in ("ik", "stiffness", "modes"):
        done = run(command, "--robot", path, *values)
        assert done.returncode == 0
        assert "do not determine the pose" in done.stderr
    for command in ("statics", "capability"):
        assert run(command, "--robot", path, *values).returncode == 1


@pytest.mark.parametrize("engine", ENGINES)
def test_legs_between_hexagons_that_differ_by_a_hundredth(engine: Engine, tmp_path: Path) -> None:
    """A millimetre in 0.12 m is enough to be determined: commands give back their pose."""
    robot = Robot.load(hexagons(1e-3).write(tmp_path))
    values = robot.home_coordinates + np.random.default_rng(0).uniform(-0.01, 0.01, (5, 6))
    found = robot.forward(robot.solve(values, engine=engine).commands, engine=engine)
    np.testing.assert_allclose(found.coordinates, values, atol=1e-8)


def test_three_legs_to_one_point() -> None:
    """They hold the point and leave the platform free to turn, at every pose."""
    feet, heads = np.array([[0.0, 0.0], [0.4, 0.0], [0.2, -0.1]]), np.tile([0.2, 0.3], (3, 1))
    undeclared = planar(feet, heads)
    declared = undeclared.replace(coordinates=coordinates("x y rz"))
    for engine in ENGINES:
        for robot in (undeclared, declared):
            with pytest.raises(SingularConfigurationError, match="do not determine the pose"):
                robot.forward(robot.home.commands, engine=engine)
        with pytest.raises(SingularConfigurationError, match="Place it by coordinates of the tool"):
            undeclared.solve(undeclared.home.commands, engine=engine)  # its coordinates are the commands
        poses = declared.solve([0.01, 0.02, 0.5], engine=engine)
        np.testing.assert_allclose(poses.coordinates, [0.01, 0.02, 0.5], atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_redundant_drives_that_are_singular_at_home(engine: Engine) -> None:
    """To either side of home, poses turned by opposite angles have the same commands, by symmetry."""
    robot = four_legs()
    one, other = robot.solve([[0.0, 0.0, 0.1], [0.0, 0.0, -0.1]], engine=engine)
    np.testing.assert_allclose(one.commands, other.commands, atol=1e-12)
    for guess in (None, robot.home):
        with pytest.raises(SingularConfigurationError, match="do not determine the pose at home"):
            robot.forward(other.commands, guess=guess, engine=engine)
    # with a home beside it, or a guess, as the message says
    near = robot.solve([0.0, 0.0, -0.05], engine=engine).q
    moved = robot.with_home(near).with_engine(engine)
    for found in (robot.forward(other.commands, guess=near, engine=engine), moved.forward(other.commands)):
        np.testing.assert_allclose(found.coordinates, [0.0, 0.0, -0.1], atol=1e-8)


def test_what_redundant_drives_do_beside_a_singular_home() -> None:
    """Speeds of the legs follow from the twist by their directions, u' = e . (v + omega x r), at a regular pose."""
    robot = four_legs()
    pose = robot.solve([0.01, 0.01, 0.2])
    found = tool_capability(robot, pose, effort=100.0, speed=1.0)
    twists = found.tool_rates[[0, 1, 5]]
    expected = []
    for corner in CORNERS:
        head = pose.transforms[:2, :2] @ (0.1 * corner)
        way = pose.transforms[:2, 3] + head - 0.4 * corner
        way = way / np.linalg.norm(way)
        expected.append([*way, way[1] * head[0] - way[0] * head[1]])
    np.testing.assert_allclose(found.drive_rates, np.array(expected) @ twists, atol=1e-9)


def test_too_few_drives_leave_joints_free(run: Any) -> None:
    """One drive of a five-bar leaves a motion: a pose is found and said to be one of many."""
    done = run("fk", "--robot", str(MACHINES / "five_bar"), "--drives", "left_motor", "5")
    assert done.returncode == 0
    assert re.search("the drives leave joints free: this is one of many poses", done.stderr)
    assert "one of many" not in run("fk", "--robot", str(MACHINES / "five_bar"), "5", "-5").stderr


def test_a_machine_whose_springs_do_not_hold_it_is_converted(run: Any, tmp_path: Path) -> None:
    """It has no compliance at home, neither before nor after."""
    done = run("convert", str(hexagons(0.0).write(tmp_path)), str(tmp_path / "hexagons.xml"))
    assert done.returncode == 0, done.stderr
    assert "stiffness at home" not in done.stdout + done.stderr
