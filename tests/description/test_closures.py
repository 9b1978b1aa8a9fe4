"""Closures files read, and refused with the place where they are wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pm3dof_pin.description.closures import LoopClosure, read_closures
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import DescriptionError

TWO_LOOPS = """
closed_loop: [[tip_a, socket_a], [tip_b, socket_b]]
type: ['3d', '6D']
name_mot: [motor_a]
"""


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


def test_the_existing_convention_is_read_as_it_is(tmp_path: Path) -> None:
    text = TWO_LOOPS + "joint_name: [hip]\njoint_type: [SPHERICAL]\n"
    closures = read_closures(_write(tmp_path, text))
    assert closures.closures == (LoopClosure("tip_a", "socket_a", "3d"), LoopClosure("tip_b", "socket_b", "6d"))
    assert closures.actuated_joints == ("motor_a",)
    assert closures.tool_frame is None
    assert closures.motion_coordinates == ()
    assert closures.springs == ()


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
        ("closed_loop: [[a, b], [c, d]]\ntype: ['3d']\n", "type", "one entry for each of 2 closures"),
        ("closed_loop: [[a, b, c]]\ntype: ['3d']\n", "closed_loop[0]", "expected two frame names"),
        ("closed_loop: [[a, 1]]\ntype: ['3d']\n", "closed_loop[0]", "expected two frame names"),
        ("closed_loop: [[a, b]]\ntype: ['2d']\n", "type[0]", "expected '3d' or '6d', not '2d'"),
        (TWO_LOOPS + "closure_limits: [null]\n", "closure_limits", "one entry for each of 2 closures"),
        (TWO_LOOPS + "closure_limits: [0.5, null]\n", "closure_limits[0]", "expected {swing_rad"),
        (TWO_LOOPS + "closure_limits: [{swing_rad: -1}, null]\n", "closure_limits[0]", "expected {swing_rad"),
        (TWO_LOOPS + "closure_limits: [{swing_rad: .nan}, null]\n", "closure_limits[0]", "expected {swing_rad"),
        ("name_mot: motor\n", "name_mot", "expected a list of names"),
        ("name_mot: [motor, motor]\n", "name_mot", "names a joint twice"),
        (TWO_LOOPS + "tool_frame: 3\n", "tool_frame", "expected a frame name"),
        (TWO_LOOPS + "springs: stiff\n", "springs", "expected a list of mappings"),
        ("closed_loop: [[a, b]\ntype: x\n", "line 2", "expected YAML"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path: Path, text: str, element: str, said: str) -> None:
    path = _write(tmp_path, text)
    with pytest.raises(DescriptionError) as caught:
        read_closures(path)
    assert (caught.value.path, caught.value.element) == (path, element)
    assert said in str(caught.value)
