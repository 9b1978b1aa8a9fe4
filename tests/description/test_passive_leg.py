"""The passive leg as data: its section, and the end with its universal joint."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.passive_leg import with_passive_leg_radius
from pm3dof_pin.description.expand import expand_xacro
from pm3dof_pin.description.parameters import RoundSection, find_parameters, read_parameters
from pm3dof_pin.description.robots import robots_directory
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.export.description import temporary_description
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantities import QUANTITIES
from pm3dof_pin.maps.quantity import MappedRobot

EI, GJ, MASS, RADIUS = 899.6698, 697.4185, 0.2, 8.6e-3
STEEL = 2.0941e11


def _changed(folder: Path, text: str) -> Path:
    path = folder / "changed.yaml"
    path.write_text(f"extends: pm3dof\nname: changed\n{text}")
    return path


def test_the_printed_numbers_are_those_of_the_section_as_it_stands(tripod: Tripod) -> None:
    p = tripod.parameters
    assert (p.bending_stiffness, p.torsional_stiffness, p.passive_leg_mass) == (EI, GJ, MASS)  # to the last bit
    assert p.youngs_modulus == pytest.approx(4.0 * EI / (np.pi * RADIUS**4))
    assert p.youngs_modulus == pytest.approx(STEEL, rel=1e-3)
    assert p.axial_stiffness == pytest.approx(4.0 * EI / RADIUS**2)


@pytest.mark.parametrize(("radius", "bore"), [(10.32, 0.0), (12.0, 9.0)])
def test_one_radius_changes_stiffness_mass_and_drawing(
    tmp_path: Path, rigid_in_shear: Callable[..., Robot], radius: float, bore: float
) -> None:
    values = f"passive_leg_radius: {{value: {radius}}}, passive_leg_bore: {{value: {bore}}}"
    path = _changed(tmp_path, f"section: {{{values}}}\n")
    fourth, second = (((1e-3 * radius) ** n - (1e-3 * bore) ** n) / RADIUS**n for n in (4, 2))
    machine, robot = Tripod.load(path), Robot.load(temporary_description("pm3dof", path))
    p = machine.parameters
    assert p.bending_stiffness == pytest.approx(fourth * EI)
    assert p.torsional_stiffness == pytest.approx(fourth * GJ)
    assert p.passive_leg_mass == pytest.approx(second * MASS)
    assert p.youngs_modulus == pytest.approx(4.0 * EI / (np.pi * RADIUS**4))
    urdf = Path(robot.source).read_text() if str(robot.source).endswith(".urdf") else None
    urdf = urdf or next(Path(robot.source).parent.glob("*.urdf")).read_text()
    assert f'<cylinder radius="{1e-3 * radius:g}"' in urdf
    moving = sum(inertia.mass for inertia in robot.model.inertias)
    known = sum(inertia.mass for inertia in pm.load("pm3dof").model.inertias)
    assert moving - known == pytest.approx((second - 1.0) * MASS, abs=1e-9)
    shears = next(entry["shear_stiffness"] for entry in robot.springs if entry["name"] == "passive_leg")
    nu, m = EI / GJ - 1.0, (bore / radius) ** 2  # G. Cowper's coefficient of a tube
    coefficient = 6 * (1 + nu) * (1 + m) ** 2 / ((7 + 6 * nu) * (1 + m) ** 2 + (20 + 12 * nu) * m)
    shear_modulus = GJ / (0.5 * np.pi * RADIUS**4)
    assert shears == pytest.approx(coefficient * shear_modulus * np.pi * 1e-6 * (radius**2 - bore**2))
    pose, robot = [0.2, -0.3, 0.5], rigid_in_shear(robot)
    np.testing.assert_allclose(
        pm.stiffness(robot, robot.solve(pose)), elastic_stiffness(machine, pose), rtol=1e-7, atol=1e-2
    )


def test_a_factor_is_the_same_as_another_radius(tripod: Tripod, tmp_path: Path) -> None:
    given = Tripod.load(_changed(tmp_path, "section: {passive_leg_radius: {value: 10.32}}\n")).parameters
    scaled = with_passive_leg_radius(tripod, 1.2).parameters
    for field in ("bending_stiffness", "torsional_stiffness", "passive_leg_mass", "axial_stiffness"):
        assert getattr(given, field) == pytest.approx(getattr(scaled, field))
    assert dataclasses.astuple(given.passive_leg) == pytest.approx(dataclasses.astuple(scaled.passive_leg))


def test_a_file_without_a_section_is_read_as_before(tmp_path: Path) -> None:
    import yaml

    whole = read_parameters(find_parameters("pm3dof", "pm3dof"))
    del whole["section"], whole["universal_joint"]
    whole["drawing"]["passive_leg_radius"] = {"value": 20.0, "unit": "mm", "status": "chosen", "source": "as it was"}
    path = tmp_path / "old.yaml"
    path.write_text(yaml.safe_dump(whole))
    assert Tripod.load(path).parameters.bending_stiffness == EI
    robot = Robot.load(temporary_description("pm3dof", path))
    spring = next(entry for entry in robot.springs or () if entry["name"] == "passive_leg")
    assert (spring["bending_stiffness"], spring["shear_stiffness"]) == (EI, "rigid")  # its section is unknown


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("section: {passive_leg_bore: {value: 9.0}}\n", "greater than the bore"),
        ("section: {passive_leg_radius: {value: 0.0}}\n", "greater than the bore"),
        ("universal_joint: middle\n", "platform or base"),
    ],
)
def test_what_cannot_be(tmp_path: Path, text: str, words: str) -> None:
    path = _changed(tmp_path, text)
    with pytest.raises(DescriptionError, match=r"changed\.yaml"):
        Robot.load(temporary_description("pm3dof", path))
    if "section" in text:
        with pytest.raises(DescriptionError, match=words):
            Tripod.load(path)
        with pytest.raises(InvalidValueError):
            RoundSection(1e-3, 2e-3, 1e-3)


def test_files_that_extend_each_other(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("extends: b.yaml\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\n")
    with pytest.raises(DescriptionError, match="leads back"):
        read_parameters(tmp_path / "a.yaml")
    (tmp_path / "c.yaml").write_text("extends: [a]\n")
    with pytest.raises(DescriptionError, match="extends"):
        read_parameters(tmp_path / "c.yaml")


@pytest.fixture(scope="module")
def at_base() -> Robot:
    return Robot.load(temporary_description("pm3dof", "universal_joint_at_base"))


def _stiffness_with_joint_at_base(tripod: Tripod, robot: Robot, pose: Any) -> np.ndarray:
    """K in plain NumPy: the usual legs, and a bar clamped in the platform, whose far end a joint at z_b holds."""
    configuration = robot.solve(pose).configuration()
    tool = configuration.frame_placement("O_e")
    origin, R, p = tool.translation, tool.rotation, tripod.parameters
    K = np.zeros((6, 6))
    for leg in range(3):
        arm = R @ tripod.platform_joints[leg]
        guide = tripod.guide_directions[leg]
        w = origin + arm - tripod.base_joints[leg]
        along = w @ guide
        n = (w - (along - np.sqrt(along**2 - w @ w + p.link_length**2)) * guide) / p.link_length
        wrench = np.append(n, np.cross(arm, n))
        K += np.outer(wrench, wrench) / ((n @ guide) ** 2 / 9.595e7 + 1.0 / 1.5177e10)
    pivot = np.array([0.0, 0.0, tripod.clamp_height])
    length = np.linalg.norm(origin - pivot)
    np.testing.assert_allclose((origin - pivot) / length, R[:, 2], atol=1e-9)  # the bar is part of the platform
    flexible = np.diag([length**3 / (3 * EI)] * 2 + [0.0] + [length / EI] * 2 + [length / GJ])
    nu = EI / GJ - 1.0
    flexible[[0, 1], [0, 1]] += length * RADIUS**2 / (12.0 * (1.0 + nu) / (7.0 + 6.0 * nu) * GJ)  # shear
    flexible[0, 4] = flexible[4, 0] = -(length**2) / (2 * EI)  # from the platform down
    flexible[1, 3] = flexible[3, 1] = length**2 / (2 * EI)
    turn = np.kron(np.eye(2), R)
    flexible = turn @ flexible @ turn.T
    cross = np.cross([1.0, 0.0, 0.0], R[:, 1])
    S = np.zeros((3, 6))
    S[0, :3], S[1, :3], S[2, 3:] = R[:, 0], R[:, 1], cross / np.linalg.norm(cross)
    at_pivot = np.eye(6)
    d = pivot - origin
    at_pivot[:3, 3:] = -np.array([[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]])
    held = S @ at_pivot
    return K + held.T @ np.linalg.inv(S @ flexible @ S.T) @ held


@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.487], [0.3, 0.0, 0.5], [0.25, -0.35, 0.48], [-0.4, 0.2, 0.52]])
def test_stiffness_with_the_joint_at_the_base(tripod: Tripod, at_base: Robot, pose: list[float]) -> None:
    expected = _stiffness_with_joint_at_base(tripod, at_base, pose)
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    assert np.abs((pm.stiffness(at_base, at_base.solve(pose)) - expected) / scale).max() < 1e-8


def test_the_tool_point_leaves_the_vertical(tripod: Tripod, mechanism: Robot, at_base: Robot) -> None:
    pose = [np.radians(20.0), 0.0, 0.5]
    assert pm.instantaneous_mobility(at_base.home).tool_mobility == 3
    position = at_base.solve(pose).positions
    assert position[1] == pytest.approx(-np.tan(np.radians(20.0)) * (0.5 - tripod.clamp_height))
    assert position[2] == pytest.approx(0.5)
    assert np.abs(mechanism.solve(pose).positions[:2]).max() < 1e-12
    np.testing.assert_allclose(at_base.home.frame_placement("O_e").homogeneous, mechanism.home.frame_placement("O_e"))


def test_xacro_has_it_as_an_argument(at_base: Robot) -> None:
    xacro = robots_directory() / "pm3dof_description" / "xacro" / "pm3dof.urdf.xacro"
    text = expand_xacro(xacro, {"universal_joint": "base"})
    assert 'name="passive_sleeve"' in text
    assert 'name="passive_sleeve"' not in expand_xacro(xacro)
    assert "passive_sleeve" in {frame.name for frame in at_base.model.frames}


def test_the_closed_form_is_not_for_it(at_base: Robot, run: Callable[..., Any]) -> None:
    assert not QUANTITIES["chapter_global"].exists(MappedRobot(at_base))
    with pytest.raises(DescriptionError, match="universal_joint"):
        Tripod.load(find_parameters("pm3dof", "universal_joint_at_base"))
    assert run("evaluate", "--config", "universal_joint_at_base", "--model", "chapter").returncode == 2
