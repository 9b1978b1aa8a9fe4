"""The page's own computations, run by Node: poses, limits, compliance, forces and shares of many robots."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.shares import shares
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.continuation import Continuation
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import ellipsoids
from pm3dof_pin.viewer.bodies import joint_placements
from pm3dof_pin.viewer.page_programs import PagePrograms
from pm3dof_pin.viewer.plane import MotionSpace
from pm3dof_pin.viewer.sliders import Sliders

MACHINES = Path(__file__).parents[1] / "machines"
ROBOTS = ("pm3dof", "hexapod", "three_rps", "delta", "five_bar", "four_bar", "ur5")
WRENCH = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]

# for rows of values of a set: the page's display there, each reached from home
SCRIPT = """
const robot = new Robot(data, programs);
const plain = (key, value) => typeof value === "number" && !Number.isFinite(value) ? String(value) : value;
const answers = rows.map((values) => {
    const pose = robot.moved(robot.home(), robot.data.sets[set], values);
    if (!pose) return null;
    const compliance = programs.compliance ? robot.compliance(pose) : null;
    return {
        q: [...pose.q],
        values: robot.data.sets.map((each) => pose.values(each)),
        placements: Array.from({ length: robot.data.placements }, (_, index) => pose.placement(index)),
        residual: pose.residual,
        broken: pose.brokenLimits(),
        forces: programs.holding ? robot.holdingForces(pose) : null,
        compliance,
        shares: compliance && springs.length ? robot.shares(pose, springs, wrench) : null,
        blocks: compliance ? kinds.map((kind) => robot.block(compliance, kind)) : null,
    };
});
console.log(JSON.stringify(answers, plain));
"""
KINDS = [
    {"motion": motion, "of": of, "others": others}
    for motion in ("translation", "rotation")
    for of in ("stiffness", "compliance")
    for others in ("free", "held")
]


def robot_program() -> str:
    return files("pm3dof_pin.viewer").joinpath("assets", "robot.js").read_text(encoding="utf-8")


def run(script: str) -> Any:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Node")
    answer = subprocess.run([node, "-"], input=script, capture_output=True, text=True, check=False, timeout=120)
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout)


@cache
def load(name: str) -> Robot:
    if name == "ur5":
        arm = pytest.importorskip("example_robot_data").load("ur5")
        arm.model.referenceConfigurations["home"] = np.array([0.3, -1.2, 1.4, -0.6, 0.9, 0.2])
        return Robot(arm.model, tool_frame="tool0")
    path = MACHINES / name / f"{name}.urdf"
    return Robot.load(path if path.exists() else name)


@cache
def programs_of(name: str) -> PagePrograms:
    return PagePrograms(load(name))


def slider_values(name: str, number: int, count: int) -> np.ndarray:
    """Random values between the ends of the sliders of a set, those without limits near home."""
    robot = load(name)
    entry = Sliders(robot, programs_of(name)).machine_data(())["sets"][number]
    home = (robot.at([robot.home.q])[0].coordinates, robot.at([robot.home.q])[0].commands)[number]
    rows = np.random.default_rng(3).uniform(-1.0, 1.0, (count, len(home)))
    ends = [[n["slider"][end] / n["slider"]["factor"] for n in entry["numbers"]] for end in ("least", "greatest")]
    lower, upper = np.array(ends) * 0.999
    half = np.minimum(0.5 * (upper - lower), 0.6)
    return np.clip(home + rows * half, lower, upper)


@cache
def answered(name: str, number: int) -> tuple[np.ndarray, list[Any]]:
    robot, programs = load(name), programs_of(name)
    values = slider_values(name, number, 40)
    data = {
        "data": Sliders(robot, programs).machine_data(()),
        "rows": values.tolist(),
        "set": number,
        "wrench": WRENCH,
        "kinds": KINDS,
        "springs": [programs.spring_places([s]) for s in ElasticModel(robot).spring_names] if robot.springs else [],
    }
    constants = "\n".join(f"const {key} = {json.dumps(entry)};" for key, entry in data.items())
    answers = run("\n".join([programs.source, robot_program(), constants, SCRIPT]))
    return values, answers


def configurations(name: str, number: int) -> list[tuple[np.ndarray, Any]]:
    values, answers = answered(name, number)
    return [(row, answer) for row, answer in zip(values, answers, strict=True) if answer is not None]


@pytest.mark.parametrize(
    ("name", "number"), [(name, k) for name in ROBOTS for k in (0, 1) if (name, k) != ("four_bar", 1)]
)
def test_sliders_place_every_body_where_pinocchio_does(name: str, number: int) -> None:
    robot = load(name)
    if number and robot.commands and robot.coordinates == robot.command_coordinates:
        pytest.skip("its coordinates are its commands")
    values, answers = answered(name, number)
    solve = robot.forward if number else robot.solve
    reached = np.array([answer is not None for answer in answers])
    solver = Continuation(robot, robot.command_coordinates if number else robot.coordinates)
    walked, _ = solver._reached(np.tile(robot.home.q, (len(values), 1)), values)
    np.testing.assert_array_equal(reached, np.isfinite(walked[:, 0]))
    assert reached.sum() >= 12
    places = np.flatnonzero(reached)[:16]  # the Pinocchio engine is slow, especially out of reach
    expected = solve(values[places], on_failure="nan", engine="pinocchio")
    assert expected.solved.sum() >= 0.9 * len(places)
    for place, index in enumerate(places):
        answer, pose = answers[index], expected[place]
        if not pose.solved:
            continue
        configuration = robot.configuration(answer["q"])  # rods may have another spin
        placements = [np.reshape(matrix, (4, 4)).T for matrix in answer["placements"]]
        wanted = [*joint_placements(configuration), configuration.tool_placement.homogeneous]
        np.testing.assert_allclose(placements, wanted, rtol=0, atol=1e-12)
        assert answer["residual"] < 1e-13
        np.testing.assert_allclose(placements[-1], pose.transforms, rtol=0, atol=1e-9)
        np.testing.assert_allclose(answer["values"][number], values[index], rtol=0, atol=1e-12)
        if len(answer["values"]) > 1:  # coordinates that are not the commands
            np.testing.assert_allclose(answer["values"][1], pose.commands, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_are_those_of_python_in_the_same_words(name: str) -> None:
    robot = load(name)
    for _, answer in configurations(name, 0):
        assert answer["broken"] == [str(each) for each in broken_limits(robot, robot.configuration(answer["q"]))]


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps", "delta", "five_bar"])
def test_elastic_behaviour_is_that_of_the_general_engine(name: str) -> None:
    robot = load(name)
    if not robot.springs:
        pytest.skip("has no springs")
    model = ElasticModel(robot)
    found = [(row, answer) for row, answer in configurations(name, 0) if answer["compliance"]][:10]
    assert found
    space = MotionSpace.from_configuration(robot.home)
    for _, answer in found:
        behaviour = cartesian_compliance(model, robot.configuration(answer["q"]))
        size = np.sqrt(np.diag(behaviour.compliance))
        size[size == 0.0] = 1.0  # rigid directions
        np.testing.assert_allclose(
            np.array(answer["compliance"]) / np.outer(size, size),
            behaviour.compliance / np.outer(size, size),
            atol=1e-10,
        )
        np.testing.assert_allclose(answer["shares"], shares(behaviour.contributions, WRENCH), atol=1e-6)
        for kind, block in zip(KINDS, answer["blocks"], strict=True):
            try:
                choice = kind["motion"], kind["of"], kind["others"]
                expected = ellipsoids.block(None, behaviour.compliance, *choice, space)
            except SingularConfigurationError:
                assert not np.isfinite(np.array(block, dtype=float)).all()
                continue
            np.testing.assert_allclose(block, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps", "ur5"])
def test_forces_hold_the_weight(name: str) -> None:
    robot = load(name)
    found = [answer for _, answer in configurations(name, 0) if answer["forces"]][:10]
    assert found
    for answer in found:
        expected = holding_forces(robot.configuration(answer["q"])).actuator_forces
        np.testing.assert_allclose(answer["forces"], expected, atol=1e-8 * np.abs(expected).max())


def test_a_pose_beyond_reach_is_not_found() -> None:
    robot, programs = load("pm3dof"), programs_of("pm3dof")
    data = json.dumps(Sliders(robot, programs).machine_data(()))
    call = "const robot = new Robot(data, programs), home = robot.home(), set = robot.data.sets[0];"
    far = "console.log(JSON.stringify([0.9, 0.5].map((z) => robot.moved(home, set, [0, 0, z]) !== null)));"
    assert run("\n".join([programs.source, robot_program(), f"const data = {data};", call, far])) == [False, True]


def test_principal_axes() -> None:
    """Jacobi rotations on matrices of all kinds, including equal values and large ratios, against LAPACK."""
    generator = np.random.default_rng(5)
    blocks = []
    for values in (
        [1.0, 2.0, 3.0],
        [1.0, 1.0, 1.0],
        [1e-9, 1e-9, 1.0],
        [2.0, 5.0, 5.0],
        [1e-6, 1.0, 1e6],
        [-1.0, 0.0, 2.0],
    ):
        rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        blocks += [rotation @ np.diag(values) @ rotation.T, np.diag(values[::-1])]
    call = f"console.log(JSON.stringify({json.dumps(np.array(blocks).tolist())}.map(Robot.principal)));"
    for block, answer in zip(blocks, run("\n".join([robot_program(), call])), strict=True):
        values, axes = np.array(answer["values"]), np.array(answer["axes"])
        scale = np.abs(block).max()
        np.testing.assert_allclose(values, np.linalg.eigvalsh(block), atol=1e-14 * scale)
        np.testing.assert_allclose(axes @ np.diag(values) @ axes.T, 0.5 * (block + block.T), atol=1e-14 * scale)
        np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)
        assert np.linalg.det(axes) == pytest.approx(1.0)
