"""The closures file written from xacro: every statement arrives, and errors are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.description.closures import LoopClosure, read_closures
from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup
from pm3dof_pin.description.expand import expand_xacro
from pm3dof_pin.elastic.springs import BeamSpring, CantileverSpring, JointSpring, read_springs
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.closures_file import closures_text

HEAD = "<closures xmlns:xacro='http://www.ros.org/wiki/xacro'>"
MATRIX = np.diag([1e5, 2e5, 3e-5, 4.0, 5.0, 1e17])


def _text(tmp_path: Path, content: str) -> str:
    path = tmp_path / "x.closures.xacro"
    path.write_text(HEAD + content + "</closures>", encoding="utf-8")
    return closures_text(path, expand_xacro(path))


def test_what_is_said_arrives(tmp_path: Path) -> None:
    content = f"""
        <tool frame="hand" motions="x y rz"/><motion joint="lift"/>
        <limits name="reach_of_arm" joint="motor"/><limits name="all" joint="lift"/>
        <coordinate name="height" joint="lift" unit="m" offset="0.2" lower="-1" upper="1e-3"/>
        <coordinate name="rx" tool="rx" unit="rad"/>
        <closure frame_a="a" frame_b="b" type="3d" limits="all"/>
        <closure frame_a="c" frame_b="d" type="6d" swing_rad="${{radians(60)}}"/>
        <actuated joint="motor" command="u1" unit="rad" offset="${{radians(90)}}" scale="-2"/>
        <spring name="7" type="joint" joint="motor" stiffness="1e-05" unit="N/m"/>
        <spring name="box" type="beam" at="b" matrix="{" ".join(map(repr, MATRIX.ravel().tolist()))}"/>
        <spring name="rod" type="cantilever" at="d" axis="0 1 0" bending_stiffness="2" torsional_stiffness="1e+17"
            unit="N m^2"><length joint="lift" at_zero="0.3"/></spring>"""
    path = tmp_path / "x.closures.yaml"
    path.write_text(_text(tmp_path, content), encoding="utf-8")
    closures = read_closures(path)
    assert closures.closures == (LoopClosure("a", "b", "3d"), LoopClosure("c", "d", "6d", np.radians(60.0)))
    assert (closures.tool_frame, closures.motion_coordinates, closures.actuated_joints) == (
        "hand",
        ("lift",),
        ("motor",),
    )
    assert closures.commands == (Command("u1", "motor", "rad", offset=np.pi / 2.0, scale=-2.0),)
    assert closures.coordinates == (
        Coordinate("height", "m", joint="lift", offset=0.2, lower=-1.0, upper=1e-3),
        Coordinate("rx", "rad", tool="rx"),
    )
    assert closures.limit_groups == (LimitGroup("reach_of_arm", ("motor",)), LimitGroup("all", ("lift",), (0,)))
    assert closures.tool_motions == ("x", "y", "rz")
    motor, box, rod = read_springs(closures.springs, path)
    assert isinstance(motor, JointSpring)
    assert motor.name == "7"
    assert motor.stiffness == closures.springs[0]["stiffness"] == 1e-5
    assert isinstance(box, BeamSpring)
    np.testing.assert_array_equal(box.matrix, MATRIX)
    assert isinstance(rod, CantileverSpring)
    assert (rod.axis, rod.torsional_stiffness) == ((0.0, 1.0, 0.0), 1e17)
    assert (closures.springs[2]["torsional_stiffness"], closures.springs[2]["length"]["at_zero"]) == (1e17, 0.3)


def test_a_robot_without_loops_or_springs(tmp_path: Path) -> None:
    text = _text(tmp_path, "<actuated joint='shoulder'/>")
    assert "springs" not in text
    assert "closure_limits" not in text
    path = tmp_path / "x.closures.yaml"
    path.write_text(text, encoding="utf-8")
    assert read_closures(path).actuated_joints == ("shoulder",)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("<loop/>", "<loop>: expected closure, actuated, tool, motion, coordinate, limits or spring"),
        ("<closure frame_a='a' type='3d'/>", "<closure>: expected the attribute 'frame_b'"),
        ("<coordinate name='a' unit='m' lower='1'/>", "<coordinate name='a'>: expected the attribute 'upper'"),
        ("<actuated/>", "<actuated>: expected the attribute 'joint'"),
        (
            "<spring name='s' type='beam' at='a' matrix='1 2 3'/>",
            "<spring name='s'>: matrix: expected a square one, not 3 numbers",
        ),
        ("<spring name='s' type='joint' joint='j' stiffness='soft'/>", "<spring name='s'>: stiffness: .*'soft'"),
        ("<spring name='s' type='joint' joint='j' stiffness=''/>", "<spring name='s'>: stiffness: .*''"),
        ("<closure frame_a='a' frame_b='b' type='3d' swing_rad='wide'/>", "<closure>: swing_rad: .*'wide'"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, content: str, said: str) -> None:
    with pytest.raises(DescriptionError, match=rf"x\.closures\.xacro: {said}"):
        _text(tmp_path, content)
