"""The SRDF written from xacro: configurations completed by closing the loops, and errors named."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from pm3dof_pin.description.expand import expand_xacro
from pm3dof_pin.exceptions import DescriptionError, JointNotFoundError
from pm3dof_pin.export.named_configurations import srdf_text

HINGE = """<link name="{child}"/>
<joint name="{child}_joint" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{at}"/><axis xyz="0 -1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>"""
FRAME = """<link name="{child}"/>
<joint name="{child}_fixed" type="fixed"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{at}"/></joint>"""
# A parallelogram: two cranks of 1 m, 3 m apart, and a coupler
URDF = f"""<robot name="linkage"><link name="ground"/>
{HINGE.format(child="crank", parent="ground", at="0 0 0")}
{HINGE.format(child="coupler", parent="crank", at="0 0 1")}
{HINGE.format(child="rocker", parent="ground", at="3 0 0")}
{FRAME.format(child="coupler_tip", parent="coupler", at="3 0 0")}
{FRAME.format(child="rocker_tip", parent="rocker", at="0 0 1")}</robot>"""
CLOSURES = "closed_loop: [[coupler_tip, rocker_tip]]\ntype: ['3d']\nname_mot: [crank_joint]\n"
JOINTS = ["crank_joint", "coupler_joint", "rocker_joint"]


def _state(name: str, joint: str, value: str) -> str:
    return f'<group_state name="{name}" group="all"><joint name="{joint}" value="{value}"/></group_state>'


def _srdf(tmp_path: Path, content: str) -> str:
    path = tmp_path / "linkage.srdf.xacro"
    root = f"<robot name='linkage' xmlns:xacro='http://www.ros.org/wiki/xacro'>{content}</robot>"
    path.write_text(root, encoding="utf-8")
    return srdf_text(path, expand_xacro(path), URDF, CLOSURES)


def test_the_other_joints_follow_from_the_loops(tmp_path: Path) -> None:
    """In a parallelogram the rocker turns with the crank, and the coupler back."""
    states = _state("home", "crank_joint", "0") + _state("half", "rocker_joint", "0.5")
    root = ElementTree.fromstring(_srdf(tmp_path, f'{states}<group name="all"/>'))
    assert [child.tag for child in root] == ["group", "group_state", "group_state", "passive_joint", "passive_joint"]
    home, half = root.findall("group_state")
    assert [(joint.get("name"), joint.get("value")) for joint in home] == [(name, "0.0") for name in JOINTS]
    assert [joint.get("name") for joint in half] == JOINTS
    np.testing.assert_allclose([float(joint.get("value", "")) for joint in half], [0.5, -0.5, 0.5], atol=1e-13)
    assert [joint.get("name") for joint in root.findall("passive_joint")] == JOINTS[1:]


def test_what_cannot_be_reached_is_left_out_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    far = _state("far", "crank_joint", "2.5")
    torn = '<group_state name="torn" group="all">' + "".join(
        f'<joint name="{joint}" value="{value}"/>' for joint, value in zip(JOINTS, (1.0, 0.0, 0.0), strict=True)
    )
    with caplog.at_level(logging.WARNING):
        text = _srdf(tmp_path, _state("home", "crank_joint", "0") + far + f"{torn}</group_state>")
    assert re.findall(r'group_state name="(\w+)"', text) == ["home"]
    assert "no named configuration 'far': crank_joint at 2.5 is outside -2 .. 2" in caplog.text
    assert "no named configuration 'torn': the loops do not close" in caplog.text


def test_a_value_that_is_no_number_is_named(tmp_path: Path) -> None:
    said = r"linkage\.srdf\.xacro: group_state 'up': joint 'crank_joint': expected one number, not 'high'"
    with pytest.raises(DescriptionError, match=said):
        _srdf(tmp_path, _state("up", "crank_joint", "high"))


def test_a_joint_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(JointNotFoundError, match="no joint 'wheel_joint'"):
        _srdf(tmp_path, _state("up", "wheel_joint", "1"))
