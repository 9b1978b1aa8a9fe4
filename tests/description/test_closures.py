"""Closures files read, and refused with the place of the error."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pm3dof_pin.description.closures import LoopClosure, read_closures
from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import DescriptionError, JointNotFoundError
from pm3dof_pin.kinematics.robot import Robot

TWO_LOOPS = """
closed_loop: [[tip_a, socket_a], [tip_b, socket_b]]
type: ['3d', '6D']
name_mot: [motor_a]
"""

COMMAND = "name_mot: [motor_a]\ncommands: [{{name: u1, joint: motor_a, {}}}]\n"
COORDINATE = "coordinates: [{{name: a, {}}}]\n"


def _write(folder: Path, text: str) -> Path:
    path = folder / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_closures_of_the_chapters_machine() -> None:
    closures = read_closures(find_robot("pm3dof").closures)
    assert closures.closures == tuple(
        LoopClosure(f"link{leg}_tip", f"E{leg}", "3d", math.radians(45.0)) for leg in (1, 2, 3)
    )
    assert closures.actuated_joints == ("slider1_joint", "slider2_joint", "slider3_joint")
    assert closures.tool_frame == "O_e"
    assert closures.motion_coordinates == ("platform_x_joint", "platform_y_joint", "passive_slider_joint")
    assert closures.commands == tuple(Command(f"u{leg}", f"slider{leg}_joint", "m", 0.240272) for leg in (1, 2, 3))
    tilt = math.radians(40.0)
    assert closures.coordinates[:2] == tuple(
        Coordinate(f"theta_{axis}", "rad", joint=f"platform_{axis}_joint", lower=-tilt, upper=tilt) for axis in "xy"
    )
    # a level platform: the link spans the difference of the radii, 374.25 - 75 - u cos 50 deg, and the height
    heights = [
        math.sqrt(0.353**2 - (0.37425 - 0.075 - u * math.cos(math.radians(50.0))) ** 2)
        + u * math.sin(math.radians(50.0))
        for u in (0.240272 - 0.085, 0.240272, 0.240272 + 0.085)
    ]
    z_e = closures.coordinates[2]
    assert (z_e.name, z_e.unit, z_e.joint) == ("z_e", "m", "passive_slider_joint")
    assert [z_e.lower, z_e.offset, z_e.upper] == pytest.approx([height - 0.013 for height in heights], abs=1e-12)
    assert [group.name for group in closures.limit_groups] == ["stroke", "universal", "spherical", "tilt", "height"]
    assert closures.limit_groups[2] == LimitGroup("spherical", closures=(0, 1, 2))


def test_the_existing_convention_is_read_as_it_is(tmp_path: Path) -> None:
    text = TWO_LOOPS + "joint_name: [hip, knee]\njoint_type: [SPHERICAL, UJOINT_XY]\n"
    closures = read_closures(_write(tmp_path, text))
    assert closures.closures == (LoopClosure("tip_a", "socket_a", "3d"), LoopClosure("tip_b", "socket_b", "6d"))
    assert closures.actuated_joints == ("motor_a",)
    assert closures.tool_frame is None
    assert closures.motion_coordinates == ()
    assert closures.springs == ()
    assert closures.joint_types == {"hip": "SPHERICAL", "knee": "UJOINT_XY"}
    assert (closures.commands, closures.coordinates, closures.limit_groups) == ((), (), ())


def test_what_the_drives_count_and_the_tool_is_placed_with(tmp_path: Path) -> None:
    text = (
        TWO_LOOPS
        + """
commands: [{name: u1, joint: motor_a, unit: m, offset: 1e-3, scale: -1}]
coordinates:
  - {name: height, joint: lift, unit: m, offset: 0.3, range: [0.1, 0.5]}
  - {name: tilt, tool: rx, unit: rad}
limit_groups: {knees: [knee_a, knee_b], balls: [tip_a-socket_a, 1], mixed: [hip, tip_b-socket_b]}
"""
    )
    closures = read_closures(_write(tmp_path, text))
    assert closures.commands == (Command("u1", "motor_a", "m", offset=0.001, scale=-1.0),)
    assert closures.coordinates == (
        Coordinate("height", "m", joint="lift", offset=0.3, lower=0.1, upper=0.5),
        Coordinate("tilt", "rad", tool="rx"),
    )
    assert closures.limit_groups == (
        LimitGroup("knees", joints=("knee_a", "knee_b")),
        LimitGroup("balls", closures=(0, 1)),
        LimitGroup("mixed", joints=("hip",), closures=(1,)),
    )


def test_drives_may_be_named_by_their_commands_alone(tmp_path: Path) -> None:
    text = "commands: [{name: u1, joint: elbow, unit: rad}]\n"
    assert read_closures(_write(tmp_path, text)).actuated_joints == ("elbow",)


def test_a_limit_may_be_given_for_some_closures_only(tmp_path: Path) -> None:
    text = TWO_LOOPS + "closure_limits: [null, {swing_rad: 0.5}]\n"
    assert [closure.swing_limit for closure in read_closures(_write(tmp_path, text)).closures] == [None, 0.5]


def test_a_robot_without_loops_is_a_robot(tmp_path: Path) -> None:
    closures = read_closures(_write(tmp_path, "name_mot: [shoulder, elbow]\n"))
    assert closures.closures == ()
    assert closures.actuated_joints == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("text", "element", "said"),
    [
        (TWO_LOOPS + "name_motor: [a]\n", "name_motor", "unknown key, expected some of closed_loop"),
        ("closed_loop: [[a, b], [c, d]]\ntype: ['3d']\n", "type", "one entry for each of the 2 entries of closed_loop"),
        ("closed_loop: [[a, b, c]]\ntype: ['3d']\n", "closed_loop[0]", "expected a list of length 2"),
        ("closed_loop: [[a, 1]]\ntype: ['3d']\n", "closed_loop[0][1]", "expected text, not 1"),
        (
            "closed_loop: [[a, b]]\ntype: ['2d']\n",
            "type[0]",
            "expected one of 3d, 6d, hinge, universal, prismatic, cylindrical, planar, distance, not '2d'",
        ),
        (TWO_LOOPS + "closure_limits: [null]\n", "closure_limits", "one entry for each of the 2 entries"),
        (TWO_LOOPS + "closure_limits: [0.5, null]\n", "closure_limits[0]", "expected a mapping, not 0.5"),
        (TWO_LOOPS + "closure_limits: [{swing: 1}, null]\n", "closure_limits[0].swing", "expected some of swing_rad"),
        (TWO_LOOPS + "closure_limits: [{swing_rad: -1}, null]\n", "closure_limits[0].swing_rad", "a number > 0.0"),
        (TWO_LOOPS + "closure_limits: [{swing_rad: .nan}, null]\n", "closure_limits[0].swing_rad", "not nan"),
        (TWO_LOOPS + "closure_limits: [{swing_rad: 3.2}, null]\n", "closure_limits[0].swing_rad", "<= 3.14"),
        ("name_mot: motor\n", "name_mot", "expected a list, not 'motor'"),
        ("name_mot: [motor, motor]\n", "name_mot", "duplicate 'motor'"),
        ("joint_name: [hip]\n", "joint_type", "one entry for each of the 1 entries of joint_name, not 0"),
        (TWO_LOOPS + "tool_frame: 3\n", "tool_frame", "expected text, not 3"),
        (TWO_LOOPS + "springs: stiff\n", "springs", "expected a list, not 'stiff'"),
        (TWO_LOOPS + "springs: [stiff]\n", "springs[0]", "expected a mapping, not 'stiff'"),
        (TWO_LOOPS + "3: 4\n", "file", "expected names as keys"),
        ("closed_loop: [[a, b]\ntype: x\n", "line 2", "expected YAML"),
        (TWO_LOOPS + "tool_frame: a\ntool_frame: b\n", "line 6", "has 'tool_frame' twice in one mapping"),
        (COMMAND.format("unit: m, offset: 1.0, unit: m"), "line 2", "has 'unit' twice in one mapping"),
        (COMMAND.format("unit: mm"), "commands[0].unit", "expected one of m, rad, not 'mm'"),
        (COMMAND.format("offset: 1.0"), "commands[0].unit", "is missing"),
        (COMMAND.format("unit: m, offset: true"), "commands[0].offset", "expected a number, not True"),
        (COMMAND.format("unit: m, offset: .nan"), "commands[0].offset", "expected a finite number, not nan"),
        (COMMAND.format("unit: m, offset: nan"), "commands[0].offset", "expected a finite number, not nan"),
        (COMMAND.format("unit: m, scale: 0"), "commands[0].scale", "magnitude"),
        (COMMAND.format("unit: m, zero: 1"), "commands[0].zero", "unknown key, expected some of joint, name, offset"),
        (COMMAND.replace("[motor_a]", "[motor_b]").format("unit: m"), "commands", "in that order: motor_b"),
        (COORDINATE.format("unit: m"), "coordinates[0]", "either 'joint' or 'tool'"),
        (COORDINATE.format("unit: m, tool: x, joint: lift"), "coordinates[0]", "either 'joint' or 'tool'"),
        (COORDINATE.format("unit: m, tool: a"), "coordinates[0].tool", "expected one of x, y, z, rx, ry, rz, not 'a'"),
        (COORDINATE.format("unit: m, tool: rx"), "coordinates[0]", "with its unit"),
        (COORDINATE.format("unit: m, tool: x, range: [1]"), "coordinates[0].range", "a list of length 2"),
        (COORDINATE.format("unit: m, tool: x, range: [1, a]"), "coordinates[0].range[1]", "expected a number, not 'a'"),
        (COORDINATE.format("unit: m, tool: x, range: [2, 1]"), "coordinates[0].range", "[lower, upper]"),
        (TWO_LOOPS + "coordinates: [3]\n", "coordinates[0]", "expected a mapping, not 3"),
        (TWO_LOOPS + "limit_groups: {knees: knee}\n", "limit_groups.knees", "expected a list, not 'knee'"),
        (TWO_LOOPS + "limit_groups: {a: [knee], b: [0.5]}\n", "limit_groups.b[0]", "a whole number or text, not 0.5"),
        (TWO_LOOPS + "limit_groups: {balls: [2]}\n", "limit_groups.balls", "expected closures 0 .. 1, not 2"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path: Path, text: str, element: str, said: str) -> None:
    path = _write(tmp_path, text)
    with pytest.raises(DescriptionError) as caught:
        read_closures(path)
    assert (caught.value.path, caught.value.element) == (path, element)
    assert said in str(caught.value)


def test_a_limit_group_of_a_joint_that_is_not_there(tmp_path: Path) -> None:
    for source in (find_robot("pm3dof").path, find_robot("pm3dof").source):
        text = source.read_text(encoding="utf-8").replace("stroke: [slider1_joint", "stroke: [elbow")
        (tmp_path / source.name).write_text(text, encoding="utf-8")
    with pytest.raises(JointNotFoundError, match=r"limit_groups: stroke: no joint 'elbow'"):
        Robot.load(tmp_path / "pm3dof.urdf")
