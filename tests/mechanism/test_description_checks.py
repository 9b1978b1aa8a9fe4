"""Impossible machines are refused by file, place and value, in every dialect, before a parser sees them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pm3dof_pin.description.closures import read_closures
from pm3dof_pin.description.error_file import read_error_file
from pm3dof_pin.description.parameters import read_quantities
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.dynamics.mass_matrix import mass_matrix
from pm3dof_pin.elastic.springs import read_springs
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.robot import Robot

Writer = Callable[..., Path]

ARM = """<robot name="arm">
<link name="base"/>
<link name="forearm">
  <inertial><origin xyz="0.1 0 0" rpy="0 0 0"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
</link>
<joint name="elbow" type="revolute">
  <parent link="base"/><child link="forearm"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="2" effort="1" velocity="1"/>
</joint>
</robot>
"""
MJCF = """<mujoco model="arm"><worldbody><body name="forearm" pos="0 0 0.5">
<inertial mass="2" pos="0.1 0 0" diaginertia="0.02 0.03 0.04"/>
<joint name="elbow" type="hinge" axis="0 0 1" range="-60 90" stiffness="3"/>
<geom type="box" size="0.1 0.1 0.1"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('mass value="2"', f'mass value="{wrong}"', r"link 'forearm': inertial: mass: value: .*" + said)
        for wrong, said in [
            ("-3", "a nonnegative number, not -3 kg"),
            ("0,1945", "a decimal point, not a comma, not '0,1945'"),
            ("nan", "not 'nan'"),
            ("inf", "not 'inf'"),
            ("", "not ''"),
            ("1e308", "at most 1e.09 kg"),
            ("1_0", "not '1_0'"),
            ("0x10", "not '0x10'"),
        ]
    ]
    + [
        ("<mass value", "<weight value", "link 'forearm': inertial: expected <mass>"),
        ('ixx="0.02"', 'ixx="-5"', "link 'forearm': inertial: inertia: ixx: .*not -5 kg"),
        ('ixx="0.02"', "", "link 'forearm': inertial: inertia: has no ixx"),
        ('ixy="0"', 'ixy="1"', "link 'forearm': inertial: inertia: its principal moments are -0.97"),
        ('xyz="0.1 0 0"', 'xyz="0.1 0"', "link 'forearm': inertial: origin: xyz: expected 3 numbers"),
        ('xyz="0.1 0 0"', 'xyz="0.1 0 1e9"', "link 'forearm': inertial: origin: xyz: expected at most 10000 m"),
        ('rpy="0 0 0"', 'rpy="0 90 0"', "link 'forearm': inertial: origin: rpy: .*looks like degrees"),
        ('size="0.1', 'size="-0.1', "link 'forearm': visual: box: size: expected a nonnegative"),
        ('lower="-1"', 'lower="3"', "joint 'elbow': limit: expected lower <= upper, not 3 and 2"),
        ('upper="2"', 'upper="2 3"', "joint 'elbow': limit: upper: expected a number, not '2 3'"),
        ('axis xyz="0 0 1"', 'axis xyz="0 0 0"', "joint 'elbow': axis: expected a direction"),
        ('type="revolute"', 'type="screw"', "joint 'elbow': expected one of fixed, .*not 'screw'"),
        ('name="arm"', 'name=""', "<robot>: has no name"),
        ('<link name="base"/>', '<link name="forearm"/>', "link 'forearm': is defined twice"),
        (
            '<link name="base"/>',
            '<link name="base"/><link name="spare"/>',
            "robot: has several root links, expected one: base, spare",
        ),
        ('parent link="base"', 'parent link="forearm"', "link 'forearm': is its own ancestor"),
        ("<robot", '<!DOCTYPE robot [<!ENTITY a "b">]><robot', "line 1: declares the entity 'a'"),
    ],
)
def test_a_urdf_of_no_machine_is_refused(write_robot: Writer, old: str, new: str, place: str) -> None:
    path = write_robot(ARM.replace(old, new, 1), "tool_frame: forearm\n")
    with pytest.raises(DescriptionError, match=rf"{path}(, line \d+)?: {place}"):
        Robot.load(path)


def test_a_space_behind_a_number_does_not_drop_the_mass(write_robot: Writer) -> None:
    model = Robot.load(write_robot(ARM.replace('mass value="2"', 'mass value=" 2 "'), "tool_frame: forearm\n")).model
    assert model.inertias[1].mass == 2.0


def test_an_unknown_shape_is_named_and_takes_nothing_along(
    write_robot: Writer, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_robot(ARM.replace("<visual>", "<visual><geometry><capsule/></geometry></visual><visual>"), "{}\n")
    assert Robot.load(path).model.inertias[1].mass == 2.0
    assert "link 'forearm': visual: unsupported capsule is ignored" in caplog.text


@pytest.mark.parametrize(("izz", "possible"), [("0.0502", True), ("0.06", False)])
def test_moments_of_no_body_give_no_equations_of_motion(
    write_robot: Writer, caplog: pytest.LogCaptureFixture, izz: str, possible: bool
) -> None:
    # a flat plate has izz = ixx + iyy = 0.05, the maximum of any body; 0.4 % above it is rounding
    robot = Robot.load(write_robot(ARM.replace('izz="0.04"', f'izz="{izz}"'), "tool_frame: forearm\n"))
    if possible:
        # about the elbow: izz + m r^2
        assert mass_matrix(robot.home)[0, 0] == pytest.approx(float(izz) + 2.0 * 0.1**2, rel=1e-12)
        assert not caplog.records
    else:
        assert "link 'forearm': inertial: its principal moments are 0.02, 0.03 and 0.06" in caplog.text
        with pytest.raises(DescriptionError, match=r"link 'forearm'.*the greatest is above the sum of the others"):
            mass_matrix(robot.home)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('mass="2"', 'mass="-2"', "<inertial>: mass: expected a nonnegative"),
        ('mass="2"', 'mass="2,5"', "<inertial>: mass: .*a decimal point"),
        ('mass="2"', "", "<inertial>: has no mass"),
        ('diaginertia="0.02 ', 'diaginertia="-5 ', "<inertial>: diaginertia: expected a nonnegative"),
        ('diaginertia="0.02 0.03 0.04"', 'fullinertia="0.02 0.03 0.04 1 0 0"', "<inertial>: inertia: its principal"),
        ('pos="0 0 0.5"', 'pos="0 0 nan"', "<body name='forearm'>: pos: expected a number, not 'nan'"),
        ('axis="0 0 1"', 'axis="0 0 0"', "<joint name='elbow'>: axis: expected a direction"),
        ('range="-60 90"', 'range="90 -60"', "<joint name='elbow'>: range: expected lower <= upper"),
        ('stiffness="3"', 'stiffness="-3"', "<joint name='elbow'>: stiffness: expected a nonnegative"),
        ('size="0.1 0.1 0.1"', 'size="0.1 0.1 1e99"', "<geom>: size: expected at most"),
    ],
)
def test_an_mjcf_of_no_machine_is_refused(tmp_path: Path, old: str, new: str, place: str) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(MJCF, encoding="utf-8")
    assert Robot.load(path).model.inertias[1].mass == 2.0
    path.write_text(MJCF.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DescriptionError, match=rf"{path}, line \d: {place}"):
        Robot.load(path)


def test_lengths_tolerances_and_springs_within_reach(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("commands: [{name: u, joint: j, unit: m, offset: 1.0e+30}]", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"commands\[0\].offset"):
        read_closures(path)
    error = "classes: {{links: {{length_tolerance_m: {}, angle_tolerance_rad: {}, errors: [{{at: a, rotation: x}}]}}}}"
    for length, angle in (("1000.0", "0.001"), ("0.001", "1.0e+20")):
        path.write_text(error.format(length, angle), encoding="utf-8")
        with pytest.raises(DescriptionError, match=r"classes.links.(length|angle)_tolerance_.*expected"):
            read_error_file(path)
    path.write_text("inertia: {mass: {value: -1.0, unit: kg, status: chosen, source: guess}}", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"inertia\.mass\.value: expected a nonnegative number, not -1 kg"):
        read_quantities(path)
    for stiffness in (1e-320, 1e308, 0.0):
        spring = {"name": "k", "type": "joint", "joint": "j", "unit": "N/m", "stiffness": stiffness}
        with pytest.raises(DescriptionError, match=r"springs\[0\] 'k'.stiffness"):
            read_springs([spring], path)


# twenty-two lists of two aliases each, of the one before: four million entries
_LAUGHS = "a0: &a0 [1, 2]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]\n" for k in range(1, 22))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: " + "[" * 60 + "]" * 60, "at most 50 deep"),
        ("a: " + "[" * 100_000, "at most 50 deep|exceeded maximum nesting depth"),  # the latter by PyYAML itself
        (_LAUGHS, "at most 1000000 entries"),
        ("a: &a [*a]", "at most 1000000 entries"),
    ],
)
def test_yaml_bombs_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bomb.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DescriptionError, match=said):
        read_mapping(path)


def _chain(links: int) -> str:
    link = '<link name="l{0}"/><joint name="j{0}" type="{1}"><parent link="l{2}"/><child link="l{0}"/></joint>'
    chain = "".join(link.format(k, "fixed", k - 1) for k in range(1, links))
    return f'<robot name="chain"><link name="l0"/>{chain}</robot>'


_DEPTHS = (
    ("chain.urdf", _chain(10_000), "a chain of more than 200 links"),
    ("deep.urdf", "<robot>" + 200_000 * "<a>", "at most 200 deep"),
    ("deep.srdf", "<robot>" + 200_000 * "<a>", "at most 200 deep"),
    ("deep.xml", "<mujoco><worldbody>" + 200_000 * "<body>", "at most 200 deep"),
    ("scene.xml", f"<mujoco><worldbody>{41 * '<body><freejoint/></body>'}</worldbody></mujoco>", "at most 40"),
)
_LOAD_ALL = """
import sys
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.robot import Robot
for path in sys.argv[1:]:
    try:
        Robot.load(path)
    except DescriptionError as error:
        print(error, flush=True)
"""


def test_depths_are_bounded(tmp_path: Path) -> None:
    # in a separate process: anything unbounded ends it by a signal
    paths = []
    for name, text, _ in _DEPTHS:
        path = tmp_path / Path(name).suffix[1:] / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        if path.suffix == ".srdf":
            path = path.with_suffix(".urdf")
            path.write_text(_chain(2), encoding="utf-8")
        paths.append(str(path))
    done = subprocess.run([sys.executable, "-c", _LOAD_ALL, *paths], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for (name, _, said), line in zip(_DEPTHS, done.stdout.splitlines(), strict=True):
        assert line.startswith(str(tmp_path / Path(name).suffix[1:] / name))
        assert said in line
