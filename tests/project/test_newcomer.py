"""A newcomer's protocol: four machines written by hand as the docs show, each with at most one forgotten line.

The first answer to a forgotten line says what to add; the second is the stiffness, which a closed form checks.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DRIVE = 1500.0  # N m/rad
STRUT = 2.0e6  # N/m
STEP = 1e-6
HEIGHT = np.array([0.0, 0.0, 0.5])


Run = Callable[..., Any]


def compliance_of(run: Run, path: Path, *words: str) -> np.ndarray:
    done = run("stiffness", "--robot", str(path), "--json", *words)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout)["C"])


def meeting(a: np.ndarray, b: np.ndarray, from_a: float, from_b: float) -> np.ndarray:
    """The upper point at two distances from two points of the plane."""
    apart = np.linalg.norm(b - a)
    along = (apart**2 + from_a**2 - from_b**2) / (2.0 * apart)
    ahead = (b - a) / apart
    return np.asarray(a + along * ahead + np.sqrt(from_a**2 - along**2) * np.array([-ahead[1], ahead[0]]))


FOUR_BAR = """<robot name="bars">
  <link name="frame"/><link name="input"/><link name="link"/><link name="output"/>
  <link name="link_end"/><link name="output_end"/><link name="pen"/>
  <joint name="motor" type="revolute"><parent link="frame"/><child link="input"/><origin xyz="0 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="pin" type="continuous"><parent link="input"/><child link="link"/><origin xyz="0 0.12 0"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="pivot" type="continuous"><parent link="frame"/><child link="output"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="a" type="fixed"><parent link="link"/><child link="link_end"/><origin xyz="0.3 0 0"/></joint>
  <joint name="b" type="fixed"><parent link="output"/><child link="output_end"/><origin xyz="0 0.12 0"/></joint>
  <joint name="c" type="fixed"><parent link="link"/><child link="pen"/><origin xyz="0.1 0.05 0"/></joint>
</robot>"""
FOUR_BAR_LOOP = 'closed_loop: [[link_end, output_end]]\ntype: ["3d"]\nname_mot: [motor]\n'


def pen(angle: float) -> np.ndarray:
    """The pen of a parallelogram turns on a circle about a point that stands still."""
    return 0.12 * np.array([-np.sin(angle), np.cos(angle)]) + [0.1, 0.05]


def test_a_four_bar_linkage(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "bars.urdf"
    path.write_text(FOUR_BAR, encoding="utf-8")
    (tmp_path / "bars.closures.yaml").write_text(FOUR_BAR_LOOP, encoding="utf-8")
    wrong = run("stiffness", "--robot", str(path), "--drive-stiffness", str(DRIVE), "10")
    assert wrong.returncode == 1
    assert "tool" in wrong.stderr
    assert "--tool-frame" in wrong.stderr
    C = compliance_of(run, path, "--tool-frame", "pen", "--drive-stiffness", str(DRIVE), "10")
    at = np.radians(10.0)
    rate = (pen(at + STEP) - pen(at - STEP)) / (2.0 * STEP)
    np.testing.assert_allclose(C[:2, :2], np.outer(rate, rate) / DRIVE, rtol=1e-6, atol=1e-12)


def three_rpr() -> str:
    """Three struts in the plane from the corners of a triangle to those of a smaller one."""
    links = ['<link name="ground"/>', '<link name="platform"/>']
    joints = []
    for k, (base, top) in enumerate(zip(BASES, TOPS, strict=True)):
        angle = np.arctan2(*(top - base)[::-1])
        length = np.linalg.norm(top - base)
        links += [f'<link name="cylinder{k}"/><link name="rod{k}"/><link name="end{k}"/><link name="corner{k}"/>']
        joints.append(
            f'<joint name="pivot{k}" type="continuous"><parent link="ground"/><child link="cylinder{k}"/>'
            f'<origin xyz="{base[0]} {base[1]} 0" rpy="0 0 {angle}"/><axis xyz="0 0 1"/></joint>'
            f'<joint name="strut{k}" type="prismatic"><parent link="cylinder{k}"/><child link="rod{k}"/>'
            f'<origin xyz="{length} 0 0"/><axis xyz="1 0 0"/><limit lower="-.1" upper=".1" effort="1" velocity="1"/>'
            f'</joint><joint name="end_of_{k}" type="fixed"><parent link="rod{k}"/><child link="end{k}"/></joint>'
            f'<joint name="corner_of_{k}" type="fixed"><parent link="platform"/><child link="corner{k}"/>'
            f'<origin xyz="{top[0]} {top[1]} 0"/></joint>'
        )
    for number, (name, parent, kind, axis) in enumerate(
        (("px", "ground", "prismatic", "1 0 0"), ("py", "x", "prismatic", "0 1 0"), ("turn", "y", "revolute", "0 0 1"))
    ):
        child = ("x", "y", "platform")[number]
        links += [f'<link name="{child}"/>'] if child != "platform" else []
        joints.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    return f'<robot name="three_struts">{"".join(links)}{"".join(joints)}</robot>'


BASES = np.array([[0.0, 0.0], [0.6, 0.0], [0.3, 0.5]]) - [0.3, 0.17]
TOPS = np.array([[0.02, -0.06], [0.07, 0.02], [-0.06, 0.04]])


def test_a_three_rpr(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "three_struts.urdf"
    path.write_text(three_rpr(), encoding="utf-8")
    loops = ", ".join(f"[end{k}, corner{k}]" for k in range(3))
    text = f'closed_loop: [{loops}]\ntype: ["3d", "3d", "3d"]\nname_mot: [strut0, strut1, strut2]\n'
    (tmp_path / "three_struts.closures.yaml").write_text(text + "tool_frame: platform\n", encoding="utf-8")
    wrong = run("stiffness", "--robot", str(path))
    assert wrong.returncode == 1
    assert "--drive-stiffness" in wrong.stderr
    C = compliance_of(run, path, "--drive-stiffness", str(STRUT))
    along = (TOPS - BASES) / np.linalg.norm(TOPS - BASES, axis=1)[:, None]
    J = np.column_stack([along, TOPS[:, 0] * along[:, 1] - TOPS[:, 1] * along[:, 0]])
    plane = [0, 1, 5]
    np.testing.assert_allclose(C[np.ix_(plane, plane)], np.linalg.inv(STRUT * J.T @ J), rtol=1e-7, atol=1e-15)


FIVE_BAR = """<mujoco model="five_bar"><compiler angle="radian"/><worldbody>
  <body name="left_crank" pos="-0.1 0 0"><joint name="left" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 -0.1 0.1 0" size=".01" mass=".1"/>
    <body name="left_rod" pos="-0.1 0.1 0"><joint name="left_elbow" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 0.2 0.2 0" size=".01" mass=".1"/>
      <site name="left_end" pos="0.2 0.2 0"/><site name="{tool}" pos="0.2 0.2 0"/></body></body>
  <body name="right_crank" pos="0.1 0 0"><joint name="right" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0.1 0.1 0" size=".01" mass=".1"/>
    <body name="right_rod" pos="0.1 0.1 0"><joint name="right_elbow" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 -0.2 0.2 0" size=".01" mass=".1"/><site name="right_end" pos="-0.2 0.2 0"/>
    </body></body>
</worldbody><equality><connect site1="left_end" site2="right_end"/></equality>
<actuator><motor joint="left"/><motor joint="right"/></actuator></mujoco>"""


def five_bar_tip(angles: np.ndarray) -> np.ndarray:
    elbows = []
    for start, first, angle in zip(([-0.1, 0.0], [0.1, 0.0]), ([-0.1, 0.1], [0.1, 0.1]), angles, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        elbows.append(np.array(start) + np.array([[c, -s], [s, c]]) @ first)
    return meeting(elbows[0], elbows[1], np.sqrt(0.08), np.sqrt(0.08))


@pytest.mark.parametrize(("name", "words"), [("tool", ()), ("tip", ("--tool-frame", "tip"))])
def test_a_five_bar(run: Run, tmp_path: Path, name: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "five_bar.xml"
    path.write_text(FIVE_BAR.format(tool=name), encoding="utf-8")
    if words:
        wrong = run("stiffness", "--robot", str(path), "--drive-stiffness", str(DRIVE))
        assert wrong.returncode == 1
        assert "--tool-frame" in wrong.stderr
    C = compliance_of(run, path, *words, "--drive-stiffness", str(DRIVE))
    J = np.column_stack([(five_bar_tip(d) - five_bar_tip(-d)) / (2.0 * STEP) for d in STEP * np.eye(2)])
    np.testing.assert_allclose(C[:2, :2], J @ J.T / DRIVE, rtol=1e-6, atol=1e-12)


def stewart() -> tuple[str, np.ndarray, np.ndarray]:
    """A platform on six struts between a wide hexagon and a narrow one; the text, and both ends of the struts."""
    turns = np.radians([-10.0, 10.0, 110.0, 130.0, 230.0, 250.0])
    bases = 0.4 * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(6)])
    turns = np.radians([-50.0, 50.0, 70.0, 170.0, 190.0, 290.0])
    tops = 0.2 * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(6)])
    legs, sites, connects, motors = [], [], [], []
    for k, (base, top) in enumerate(zip(bases, tops, strict=True)):
        rod = top + HEIGHT - base
        length = np.linalg.norm(rod)
        at = " ".join(map(str, rod / length))
        x = np.cross([0.0, 1.0, 0.0], rod)
        x /= np.linalg.norm(x)
        y = np.cross(rod / length, x)
        axes = [" ".join(map(str, axis)) for axis in (x, y)]
        legs.append(
            f'<body name="cylinder{k}" pos="{" ".join(map(str, base))}"><joint name="u{k}" axis="{axes[0]}"/>'
            f'<joint name="v{k}" axis="{axes[1]}"/><geom size=".02" mass=".5"/><body name="rod{k}">'
            f'<joint name="strut{k}" type="slide" axis="{at}" range="-.1 .1"/><geom size=".01" mass=".2"/>'
            f'<site name="end{k}" pos="{" ".join(map(str, rod))}"/></body></body>'
        )
        sites.append(f'<site name="corner{k}" pos="{" ".join(map(str, top))}"/>')
        connects.append(f'<connect site1="end{k}" site2="corner{k}"/>')
        motors.append(f'<motor joint="strut{k}"/>')
    platform = f'<body name="platform" pos="0 0 .5"><freejoint/><geom size=".1" mass="3"/>{"".join(sites)}'
    text = f'<mujoco model="stewart"><worldbody>{"".join(legs)}{platform}<site name="tool"/></body></worldbody>'
    text += f"<equality>{''.join(connects)}</equality><actuator>{''.join(motors)}</actuator></mujoco>"
    return text, bases, tops


def test_a_stewart_platform(run: Run, tmp_path: Path) -> None:
    text, bases, tops = stewart()
    path = tmp_path / "stewart.xml"
    path.write_text(text, encoding="utf-8")
    wrong = run("stiffness", "--robot", str(path))
    assert wrong.returncode == 1
    assert "--drive-stiffness" in wrong.stderr
    C = compliance_of(run, path, "--drive-stiffness", str(STRUT))
    rods = tops + HEIGHT - bases
    along = rods / np.linalg.norm(rods, axis=1)[:, None]
    J = np.column_stack([along, np.cross(tops, along)])
    np.testing.assert_allclose(C, np.linalg.inv(STRUT * J.T @ J), rtol=1e-7, atol=1e-15)
