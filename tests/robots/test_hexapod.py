"""The hexapod: its geometry, its inverse kinematics and Jacobian in vectors, and its published compliance."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import yourdfpy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pm3dof_pin.description.robots import find_robot, robots_directory
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.actuation import independent_motions, tool_motions
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularities
from pm3dof_pin.mechanism.configuration import Configuration

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

from generate_description import description_files

STRUTS = range(1, 7)
TOOL_AT_HOME = np.array([0.0, 0.0, 0.135])
Matrix = NDArray[np.float64]

# T. Dehaeze, stewart-simscape, dynamics study: compliance of six struts of 2e7 N/m [m/N, rad/(N m), 1/N]
PUBLISHED = {
    (0, 0): "4.7e-08",
    (1, 1): "4.7e-08",
    (2, 2): "2.1e-08",
    (3, 3): "5.2e-06",
    (4, 4): "5.2e-06",
    (5, 5): "1.7e-06",
    (0, 4): "3.2e-07",
    (1, 3): "-3.2e-07",
}


@pytest.fixture(scope="module")
def hexapod() -> Robot:
    return Robot.load("hexapod")


@pytest.fixture(scope="module")
def numbers(numbers_of: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
    return numbers_of("hexapod")


@pytest.fixture(scope="module")
def base_joints(numbers: dict[str, Any]) -> Matrix:
    """A_i in the base frame, out of the YAML, shape=(6, 3)."""
    return _circle(numbers, "base_joint")


@pytest.fixture(scope="module")
def platform_joints(numbers: dict[str, Any]) -> Matrix:
    """B_i from O_e in the platform's axes, out of the YAML, shape=(6, 3)."""
    return _circle(numbers, "platform_joint") - [0.0, 0.0, numbers["geometry.tool_height"]]


def _circle(numbers: dict[str, Any], joint: str) -> Matrix:
    angles, radius = numbers[f"geometry.{joint}_angles"], numbers[f"geometry.{joint}_radius"]
    heights = np.full(6, numbers[f"geometry.{joint}_height"])
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])


@pytest.fixture(scope="module")
def coordinates() -> Matrix:
    """Random x, y, z [m] and angles of Rx Ry Rz [rad] of the platform, from home, shape=(50, 6)."""
    return np.random.default_rng(6).uniform(-1.0, 1.0, (50, 6)) * np.repeat([0.008, 0.09], 3)


def _rotation(coordinates: Matrix) -> Matrix:
    return Rotation.from_euler("XYZ", coordinates[3:]).as_matrix()


# Geometry


def test_joints_are_where_the_source_puts_them(base_joints: Matrix, platform_joints: Matrix) -> None:
    tree = yourdfpy.URDF.load(str(find_robot("hexapod").urdf))
    np.testing.assert_allclose(tree.get_transform("O_e", "base")[:3, 3], TOOL_AT_HOME, atol=1e-16)
    for i in STRUTS:
        a, b = base_joints[i - 1], platform_joints[i - 1]
        np.testing.assert_allclose(tree.get_transform(f"A{i}", "base")[:3, 3], a, atol=1e-16)
        np.testing.assert_allclose(tree.get_transform(f"cross{i}", "base")[:3, 3], a, atol=1e-16)
        np.testing.assert_allclose(tree.get_transform(f"B{i}", "O_e")[:3, 3], b, atol=1e-16)
        tip = tree.get_transform(f"strut{i}_tip", "base")
        np.testing.assert_allclose(tip[:3, 3], TOOL_AT_HOME + b, atol=1e-15)
        direction = (tip[:3, 3] - a) / np.linalg.norm(tip[:3, 3] - a)
        for frame in (f"strut{i}_tip", f"A{i}", f"B{i}", f"cylinder{i}"):
            np.testing.assert_allclose(tree.get_transform(frame, "base")[:3, 2], direction, atol=1e-14)
        np.testing.assert_array_equal(tree.joint_map[f"strut{i}_joint"].axis, [0, 0, 1])


def test_the_numbers_of_the_source(base_joints: Matrix, platform_joints: Matrix) -> None:
    """0.115 m at z = 0.015 and 0.09 m at z = 0.075, in pairs; the tool at 0.135 m."""
    np.testing.assert_allclose(np.hypot(*base_joints[:, :2].T), 0.115, atol=1e-16)
    np.testing.assert_allclose(np.hypot(*platform_joints[:, :2].T), 0.09, atol=1e-16)
    np.testing.assert_allclose(base_joints[:, 2], 0.015, atol=1e-16)
    np.testing.assert_allclose(platform_joints[:, 2], 0.075 - 0.135, atol=1e-16)
    base, platform = (np.degrees(np.arctan2(j[:, 1], j[:, 0])) % 360 for j in (base_joints, platform_joints))
    np.testing.assert_allclose(base, [350, 10, 110, 130, 230, 250], atol=1e-12)
    np.testing.assert_allclose(platform, [310, 50, 70, 170, 190, 290], atol=1e-12)


def test_limits_and_springs_are_those_of_the_yaml(hexapod: Robot, numbers: dict[str, Any]) -> None:
    for i in STRUTS:
        index = hexapod.single_joint(f"strut{i}_joint").q_index
        stroke = numbers["joints.strut_stroke"]
        assert (hexapod.lower_limits[index], hexapod.upper_limits[index]) == (-stroke, stroke)
        assert hexapod.closures[i - 1].swing_limit == numbers["joints.spherical_limit"]
    assert [spring["stiffness"] for spring in hexapod.springs] == [2e7] * 6
    assert max(hexapod.home.swing(closure) for closure in range(6)) < 1e-7


# Kinematics


def test_six_freedoms_and_no_redundant_constraint(hexapod: Robot) -> None:
    for configuration in (hexapod.home, generic_configuration(hexapod.home)):
        mobility = instantaneous_mobility(configuration)
        assert (mobility.count, mobility.tool_mobility, mobility.redundant_constraints) == (6, 6, 0)
        assert mobility.idle_motions.shape[1] == 0
        assert not singularities(configuration)


def test_strut_lengths(hexapod: Robot, coordinates: Matrix, base_joints: Matrix, platform_joints: Matrix) -> None:
    at_home = np.linalg.norm(TOOL_AT_HOME + platform_joints - base_joints, axis=1)
    for row in coordinates:
        tool = TOOL_AT_HOME + row[:3]
        expected = np.linalg.norm(tool + platform_joints @ _rotation(row).T - base_joints, axis=1)
        configuration = hexapod.solve(hexapod.home_coordinates + row).configuration()
        assert configuration.closure_residual < 1e-12
        np.testing.assert_allclose(configuration.tool_placement.translation, tool, atol=1e-15)
        np.testing.assert_allclose(configuration.tool_placement.rotation, _rotation(row), atol=1e-14)
        np.testing.assert_allclose(at_home + configuration.commands, expected, rtol=0, atol=1e-12)


def test_coordinates_are_the_pose_of_the_tool_in_the_base(hexapod: Robot, coordinates: Matrix) -> None:
    """x, y, z absolute, and the angles of Rx Ry Rz."""
    assert [(c.name, c.unit) for c in hexapod.coordinates] == [
        *((name, "m") for name in ("x", "y", "z")),
        *((name, "rad") for name in ("rx", "ry", "rz")),
    ]
    for row in coordinates:
        pose = hexapod.solve([*(TOOL_AT_HOME + row[:3]), *row[3:]]).configuration().tool_placement
        np.testing.assert_allclose(pose.translation, TOOL_AT_HOME + row[:3], atol=1e-15)
        np.testing.assert_allclose(pose.rotation, _rotation(row), atol=1e-14)


def test_lengths_give_the_pose_back(hexapod: Robot, coordinates: Matrix) -> None:
    for row in coordinates[:10]:
        lengths = hexapod.solve(hexapod.home_coordinates + row).commands
        back = hexapod.forward(lengths).coordinates - hexapod.home_coordinates
        np.testing.assert_allclose(back, row, rtol=0, atol=1e-11)


def _classic_rows(configuration: Configuration, base_joints: Matrix, platform_joints: Matrix) -> Matrix:
    """Rows [n; b x n] of the inverse Jacobian: rates of the struts' lengths over the twist, shape=(6, 6)."""
    pose = configuration.tool_placement
    arms = platform_joints @ pose.rotation.T
    struts = pose.translation + arms - base_joints
    directions = struts / np.linalg.norm(struts, axis=1)[:, None]
    return np.hstack([directions, np.cross(arms, directions)])


def test_actuation_jacobian(hexapod: Robot, coordinates: Matrix, base_joints: Matrix, platform_joints: Matrix) -> None:
    for row in [np.zeros(6), *coordinates]:
        configuration = hexapod.solve(hexapod.home_coordinates + row).configuration()
        rows = _classic_rows(configuration, base_joints, platform_joints)
        expected = rows @ tool_motions(configuration)
        np.testing.assert_allclose(
            independent_motions(configuration)[configuration.mechanism.actuated_indices], expected, rtol=0, atol=1e-12
        )
    np.testing.assert_allclose(tool_motions(hexapod.home), np.eye(6), atol=1e-12)


# Compliance


def _struts_only(rows: Matrix, stiffness: float) -> Matrix:
    """C = (sum k w w^T)^-1."""
    return np.linalg.inv(stiffness * sum(np.outer(w, w) for w in rows))


def test_the_published_compliance_to_its_printed_digits(
    hexapod: Robot, base_joints: Matrix, platform_joints: Matrix
) -> None:
    formula = _struts_only(_classic_rows(hexapod.home, base_joints, platform_joints), 2e7)
    engine = cartesian_compliance(ElasticModel(hexapod), hexapod.home).compliance
    for compliance in (formula, engine):
        for (row, column), printed in PUBLISHED.items():
            assert f"{compliance[row, column]:.1e}" == printed
            assert f"{compliance[column, row]:.1e}" == printed
        rest = compliance.copy()
        for row, column in PUBLISHED:
            rest[row, column] = rest[column, row] = 0.0
        assert np.abs(rest).max() < 1e-19


def test_compliance_away_from_home(
    hexapod: Robot, coordinates: Matrix, base_joints: Matrix, platform_joints: Matrix
) -> None:
    elastic = ElasticModel(hexapod)
    scale = np.repeat([0.1, 1.0], 3)
    for row in coordinates:
        configuration = hexapod.solve(hexapod.home_coordinates + row).configuration()
        expected = _struts_only(_classic_rows(configuration, base_joints, platform_joints), 2e7)
        computed = cartesian_compliance(elastic, configuration)
        difference = (computed.compliance - expected) / np.outer(scale, scale)
        assert np.abs(difference).max() < 1e-10 * np.abs(expected / np.outer(scale, scale)).max()
        np.testing.assert_allclose(computed.contributions.sum(axis=0), computed.compliance, rtol=0, atol=1e-18)


# A machine with other parameters


def test_eight_struts_of_other_places(tmp_path: Path) -> None:
    tree = yaml.safe_load((robots_directory() / "hexapod_description" / "config" / "hexapod.yaml").read_text())
    tree["name"] = "octopod"
    angles = np.repeat([0.0, 90.0, 180.0, 270.0], 2)
    tree["geometry"]["base_joint_angles"]["value"] = (angles + np.tile([-12.0, 12.0], 4)).tolist()
    tree["geometry"]["platform_joint_angles"]["value"] = (angles + np.tile([-35.0, 35.0], 4)).tolist()
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    for name, text in description_files("hexapod", config=tmp_path / "mine.yaml").items():
        write_text_atomically(tmp_path / name, text)
    octopod = Robot.load(tmp_path / "urdf" / "octopod.urdf")
    assert octopod.home.closure_residual < 1e-12
    assert len(octopod.actuated_joints) == 8
    assert (instantaneous_mobility(octopod.home).count, len(octopod.named_configurations)) == (6, 8)
