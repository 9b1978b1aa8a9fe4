"""Planar machines: their plane, the camera and the ellipse in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.ellipsoids import block
from pm3dof_pin.viewer.labels import display_label, display_name, display_title
from pm3dof_pin.viewer.plane import SPATIAL, MotionSpace

MACHINES = Path(__file__).parents[1] / "machines"


def space_of(robot: str | Path) -> MotionSpace:
    return MotionSpace.from_configuration(Robot.load(robot).home)


@pytest.mark.parametrize(
    ("name", "normal"),
    [("five_bar", (0, 0, 1)), ("four_rrr", (0, 0, 1)), ("three_rpr", (0, 0, 1)), ("four_bar", (0, 0, 1))],
)
def test_planar_machines(name: str, normal: tuple[float, ...]) -> None:
    """The axes of their revolute joints, as written in their files, towards the usual camera."""
    space = space_of(MACHINES / name)
    assert space.normal is not None
    np.testing.assert_allclose(space.normal, normal, atol=1e-12)
    np.testing.assert_allclose(space.basis.T @ space.basis, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(space.basis[:3, :2].T @ space.normal, 0.0, atol=1e-12)
    azimuth, elevation = np.radians(space.camera)
    camera = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    assert camera @ space.normal > np.cos(np.radians(25.0))


@pytest.mark.parametrize("name", ["hexapod", "pm3dof", MACHINES / "agile_eye", MACHINES / "delta"])
def test_spatial_machines(name: str | Path) -> None:
    space = space_of(name)
    assert space.normal is None
    assert space.camera == SPATIAL


def test_the_ellipse_of_a_diagonal_compliance() -> None:
    """Springs along x and y and about z: their inverses, and nothing out of the plane."""
    space = space_of(MACHINES / "five_bar")
    compliance = np.diag([2.0, 3.0, 0.0, 0.0, 0.0, 5.0])
    felt = block(None, compliance, "translation", "stiffness", "free", space)
    np.testing.assert_allclose(felt, np.diag([1.0 / 2.0, 1.0 / 3.0, 0.0]), atol=1e-12)
    turned = block(None, compliance, "rotation", "stiffness", "held", space)
    np.testing.assert_allclose(turned, np.diag([0.0, 0.0, 1.0 / 5.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("three_rps", "Three RPS"),
        ("hexapod", "Hexapod"),
        ("linear_delta", "Linear delta"),
        ("ur5", "UR5"),
        ("MyArm", "MyArm"),
    ],
)
def test_names_of_robots(name: str, shown: str) -> None:
    assert display_name(name) == shown


def test_a_programs_name_is_no_title(tmp_path: Path) -> None:
    (tmp_path / "urdf").mkdir()
    for folder in ("", "urdf"):
        path = tmp_path / folder / "robot.urdf"
        path.write_text('<robot name="onshape"><link name="base"/></robot>', encoding="utf-8")
        assert display_title(Robot.load(path)) == display_name(tmp_path.name)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("rx", "tilt about x"),
        ("theta_y", "tilt about y"),
        ("rz", "turn about z"),
        ("z_e", "z_e"),
        ("left_hip_joint", "left hip"),
        ("wrist_1_joint", "wrist 1"),
        ("x", "x"),
    ],
)
def test_names_of_coordinates(name: str, shown: str) -> None:
    assert display_label(name) == shown
