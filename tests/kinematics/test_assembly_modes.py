"""Assembly modes against published numbers of postures, closed forms and circles that intersect."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.direct_kinematics import all_assembly_modes
from pm3dof_pin.cli.kinematics import _completeness
from pm3dof_pin.exceptions import InvalidValueError, ProgramError, SingularConfigurationError
from pm3dof_pin.kinematics.assembly_modes import AssemblyModes, assembly_modes
from pm3dof_pin.kinematics.closing_programs import ProgramSource

_MACHINES = Path(__file__).parents[1] / "machines"

# P. Dietmaier, The Stewart-Gough platform of general geometry can have 40 real postures, ARK 1998
_BASE = np.array(
    [
        [0, 0, 0],
        [1.107915, 0, 0],
        [0.549094, 0.756063, 0],
        [0.735077, -0.223935, 0.525991],
        [0.514188, -0.526063, -0.368418],
        [0.590473, 0.094733, -0.205018],
    ]
)
_PLATFORM = np.array(
    [
        [0, 0, 0],
        [0.542805, 0, 0],
        [0.956919, -0.528915, 0],
        [0.665885, -0.353482, 1.402538],
        [0.478359, 1.158742, 0.107672],
        [-0.137087, -0.235121, 0.353913],
    ]
)
_LENGTHS = np.array([1, 0.645275, 1.086284, 1.503439, 1.281933, 0.771071])


def _gaps(pose: Any) -> Any:
    return np.linalg.norm(pose[:3] + Rotation.from_rotvec(pose[3:]).apply(_PLATFORM) - _BASE, axis=1) - _LENGTHS


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)


@pytest.fixture(scope="module")
def dietmaier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The platform as MJCF, home in one of its postures."""
    generator = np.random.default_rng(0)
    pose = np.ones(6)
    while np.abs(_gaps(pose)).max() > 1e-14:
        pose = least_squares(_gaps, generator.uniform(-1.5, 1.5, 6), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    turn = Rotation.from_rotvec(pose[3:])
    massive = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    text = '<mujoco model="dietmaier"><compiler angle="radian"/><worldbody>'
    for k, leg in enumerate(pose[:3] + turn.apply(_PLATFORM) - _BASE):
        along = Rotation.align_vectors([leg / np.linalg.norm(leg)], [[0, 0, 1]])[0]
        text += f'<body pos="{_text(_BASE[k])}" quat="{_text(along.as_quat()[[3, 0, 1, 2]])}">{massive}'
        text += f'<joint name="x{k}" axis="1 0 0"/><joint name="y{k}" axis="0 1 0"/><body>{massive}'
        text += f'<joint name="leg{k}" type="slide" axis="0 0 1"/>'
        text += f'<site name="A{k}" pos="0 0 {float(np.linalg.norm(leg))!r}"/></body></body>'
    quaternion = _text(turn.as_quat()[[3, 0, 1, 2]])
    text += f'<body name="platform" pos="{_text(pose[:3])}" quat="{quaternion}"><freejoint name="free"/>{massive}'
    text += "".join(f'<site name="B{k}" pos="{_text(point)}"/>' for k, point in enumerate(_PLATFORM))
    text += "</body></worldbody><equality>"
    text += "".join(f'<connect site1="A{k}" site2="B{k}"/>' for k in range(6))
    text += "</equality><actuator>" + "".join(f'<motor joint="leg{k}"/>' for k in range(6)) + "</actuator></mujoco>"
    path = tmp_path_factory.mktemp("dietmaier") / "dietmaier.xml"
    path.write_text(text)
    return path


def test_forty_real_postures(dietmaier: Path) -> None:
    robot = pm.load(dietmaier, tool_frame="platform")
    modes = assembly_modes(robot, np.zeros(6))
    assert len(modes.poses) == 40 == modes.estimated
    assert modes.from_home
    assert modes.missed < 0.01
    placements = modes.poses.transforms
    points = np.einsum("nij,kj->nki", placements[:, :3, :3], _PLATFORM) + placements[:, None, :3, 3]
    lengths = np.linalg.norm(points - _BASE, axis=-1)
    np.testing.assert_allclose(lengths, np.tile(_LENGTHS, (40, 1)), atol=1e-11)
    differences = placements[:, None] - placements[None]
    apart = np.abs(differences).max(axis=(-2, -1)) + np.eye(40)
    assert apart.min() > 1e-3


def test_those_of_the_tripod_are_the_closed_forms() -> None:
    commands = [0.257, 0.26, 0.2245]
    found = assembly_modes(pm.load("pm3dof"), commands).poses.coordinates
    expected = np.array(all_assembly_modes(Tripod.load(), commands))
    assert len(found) == len(expected) == 8
    for mode in expected:
        assert np.abs(found - mode).max(axis=1).min() < 1e-9


@pytest.mark.parametrize(("name", "count"), [("five_bar", 2), ("agile_eye", 8), ("ankle", 4)])
def test_known_numbers(name: str, count: int) -> None:
    """Two circles meet twice; the agile eye has eight (I. A. Bonev and others); the ankle's are counted below."""
    robot = pm.load(_MACHINES / name if name != "ankle" else _MACHINES / "ankle" / "ankle.xml")
    assert len(assembly_modes(robot, robot.home.commands).poses) == count


def test_the_ankles_modes_are_where_rods_have_their_length() -> None:
    """Pitch and roll at which both balls are a rod's length from the crank."""
    robot = pm.load(_MACHINES / "ankle" / "ankle.xml")
    pitch, roll = np.meshgrid(np.linspace(-np.pi, np.pi, 400), np.linspace(-np.pi, np.pi, 401), indexing="ij")
    turned = Rotation.from_euler("YX", np.stack([pitch.ravel(), roll.ravel()], axis=1))
    gaps = []
    for crank, ball, length in (
        ((-0.055, 0.045, 0.22), (-0.055, 0.045, 0.02), 0.2),
        ((-0.055, -0.045, 0.12), (-0.055, -0.045, 0.02), 0.1),
    ):
        gaps.append((np.linalg.norm(turned.apply(ball) - crank, axis=1) - length).reshape(pitch.shape))
    starts = np.argwhere((np.abs(gaps[0]) < 2e-3) & (np.abs(gaps[1]) < 2e-3))
    assert len(starts)
    modes = assembly_modes(robot, robot.home.commands).poses
    angles = np.array([[modes[k].configuration().joint_position(name) for name in ("pitch", "roll")] for k in range(4)])
    at = np.stack([pitch, roll], axis=-1)[tuple(starts.T)]
    away = np.abs((at[:, None] - angles + np.pi) % (2 * np.pi) - np.pi)
    assert (away.max(axis=2).min(axis=1) < 0.2).all()


def test_without_programs_and_with_redundant_drives() -> None:
    robot = pm.load(_MACHINES / "five_bar").with_engine("pinocchio")
    assert len(assembly_modes(robot, robot.home.commands, max_starts=64).poses) == 2
    robot = pm.load(_MACHINES / "four_rrr")
    modes = assembly_modes(robot, robot.home.commands)
    np.testing.assert_allclose(modes.poses.commands, np.tile(robot.home.commands, (len(modes.poses), 1)), atol=1e-6)


def test_starts_are_fewer_where_damped_steps_have_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a long chain of loops, whose starts by Pinocchio's Jacobians take most of a second each."""

    def too_long(*_: object) -> None:
        raise ProgramError("too many operations")

    monkeypatch.setattr(ProgramSource, "damped_step", too_long)
    robot = pm.load(_MACHINES / "five_bar")
    found = assembly_modes(robot, robot.home.commands, max_starts=1)
    assert (found.starts, len(found.poses)) == (64, 2)
    monkeypatch.setattr("pm3dof_pin.kinematics.assembly_modes._WORK_WITHOUT", 2 * robot.model.nv**3)
    assert assembly_modes(robot, robot.home.commands, times=100).starts == 32


def test_the_estimate() -> None:
    """By hand: 3 met once and 1 twice give 5 + 3 * 2 / (2 * 2)."""
    found = AssemblyModes(poses=None, counts=(1, 1, 1, 2, 9), starts=20, from_home=False)  # type: ignore[arg-type]
    assert found.estimated == 6.5
    assert found.missed == pytest.approx(np.exp(-1.0))


def test_the_command(answer: Callable[..., Any], run: Callable[..., Any]) -> None:
    commands = answer("ik", "--robot", "hexapod", "--configuration", "home")["u_m"]
    result = answer("fk", "--all", "--robot", "hexapod", *map(repr, commands))
    assert len(result["assembly_modes"]) == 8 == result["estimated_modes"]
    assert result["assembly_modes"][0]["within_limits"] is True
    assert all(mode["residual_m"] < 1e-9 for mode in result["assembly_modes"])
    far = run("fk", "--all", "--robot", "hexapod", "0.3", *map(repr, commands[1:]))
    assert far.returncode == 1
    assert "Error: no pose closes the loops at u1_m = 0.3" in far.stderr


def test_drives_that_do_not_determine_the_pose() -> None:
    robot = pm.load("hexapod")
    loose = robot.replace(actuated_joints=robot.actuated_joints[:5], commands=robot.commands[:5])
    with pytest.raises(SingularConfigurationError, match="do not determine the pose"):
        assembly_modes(loose, loose.home.commands)


def test_too_many_isolated_modes_are_not_a_free_motion(tmp_path: Path) -> None:
    """Ten four-bars side by side: each coupler ends at one of the two points where two circles meet, 1024 in all."""
    text, loops, drives = "", "", ""
    massive = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    for k in range(10):
        text += f"""<body pos="0 {k} 0">{massive}<joint name="crank{k}" axis="0 1 0"/><body pos="0 0 0.2">{massive}
          <joint name="coupler{k}" axis="0 1 0"/><site name="A{k}" pos="0.5 0 0.2"/></body></body>
          <body pos="0.5 {k} 0">{massive}<joint name="rocker{k}" axis="0 1 0"/><site name="B{k}" pos="0 0 0.4"/>
          </body>"""
        loops += f'<connect site1="A{k}" site2="B{k}"/>'
        drives += f'<motor joint="crank{k}"/>'
    path = tmp_path / "many.xml"
    path.write_text(
        f"<mujoco><worldbody>{text}</worldbody><equality>{loops}</equality><actuator>{drives}</actuator></mujoco>"
    )
    robot = pm.load(path)
    found = assembly_modes(robot, robot.home.commands)
    assert found.more
    assert 200 < len(found.counts) <= 1024
    assert 600 < found.estimated < 1500
    angles = [[pose.joint_position(f"rocker{k}") for k in range(10)] for pose in found.poses]
    # the rocker's end is mirrored in the line from the crank's end, at (0, 0.2), to the rocker's joint, at (0.5, 0)
    mirrored = 2.0 * (np.pi / 2.0 + np.arctan2(0.2, 0.5))
    away = np.abs(np.asarray(angles)[:, :, None] - np.array([0.0, mirrored - np.pi * 2.0]))
    assert np.minimum(away, 2.0 * np.pi - away).min(axis=2).max() < 1e-6
    assert len(np.unique(np.round(np.cos(angles), 6), axis=0)) == len(found.counts)
    loose = robot.replace(actuated_joints=robot.actuated_joints[:9], commands=robot.commands[:9])
    with pytest.raises(SingularConfigurationError, match="with these at rest the robot can move"):
        assembly_modes(loose, loose.home.commands)


def test_a_model_without_joints_has_no_modes() -> None:
    with pytest.raises(InvalidValueError, match="has no joints: expected joints to assemble"):
        assembly_modes(pm.load(pin.Model()), [])


@pytest.mark.parametrize(
    ("counts", "more", "words"),
    [
        ((0,), False, "none of 64 random starts closes the loops, so that nothing is known of others"),
        ((0, 1, 1), True, "from 64 random starts, and home's, which none of these met; there are more"),
        ((0, 40, 24), False, "2 assembly modes from 64 random starts, and home's, which none of these met; others"),
        ((32, 32), False, "2 assembly modes from 64 random starts, each met at least 5 times"),
    ],
)
def test_what_is_said_of_modes_not_met(counts: tuple[int, ...], more: bool, words: str) -> None:
    """Home's mode is known without a start, and is not one that starts have met."""
    modes = AssemblyModes(poses=None, counts=counts, starts=64, from_home=True, more=more)  # type: ignore[arg-type]
    assert words in _completeness(modes)
    assert "0 times" not in _completeness(modes)
