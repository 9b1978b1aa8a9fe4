"""The 3-RPS machine: its geometry, its redundant constraints, and its compliance against a frame of beam elements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import yourdfpy
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.actuation import independent_motions, tool_motions
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularities
from pm3dof_pin.mechanism.configuration import Configuration

LEGS = (1, 2, 3)
LEGS_ARE_AT = np.radians([0.0, 120.0, -120.0])
TANGENTS = np.column_stack([-np.sin(LEGS_ARE_AT), np.cos(LEGS_ARE_AT), np.zeros(3)])
OUTWARD = np.column_stack([np.cos(LEGS_ARE_AT), np.sin(LEGS_ARE_AT), np.zeros(3)])
UP = np.array([0.0, 0.0, 1.0])
Matrix = NDArray[np.float64]
Numbers = dict[str, Any]


@pytest.fixture(scope="module")
def machine() -> Robot:
    return Robot.load("three_rps")


@pytest.fixture(scope="module")
def numbers(numbers_of: Callable[[str], Numbers]) -> Numbers:
    return numbers_of("three_rps")


@pytest.fixture(scope="module")
def hinges(numbers: Numbers) -> Matrix:
    """A_i in the base frame, out of the YAML, shape=(3, 3)."""
    height = float(numbers["geometry.hinge_height"])
    return np.asarray(numbers["geometry.hinge_radius"] * OUTWARD + height * UP)


@pytest.fixture(scope="module")
def platform_joints(numbers: Numbers) -> Matrix:
    """E_i from O_e in the platform's axes, out of the YAML, shape=(3, 3)."""
    drop = float(numbers["geometry.tool_height"] - numbers["geometry.platform_joint_height"])
    return np.asarray(numbers["geometry.platform_joint_radius"] * OUTWARD - drop * UP)


@pytest.fixture(scope="module")
def configurations(machine: Robot) -> list[Configuration]:
    """Home and random heights and tilts."""
    random = np.random.default_rng(3).uniform(-1.0, 1.0, (12, 3)) * [0.05, 0.25, 0.25]
    return [machine.home, *(machine.solve(machine.home_coordinates + row).configuration() for row in random)]


def _legs(configuration: Configuration, hinges: Matrix, platform_joints: Matrix) -> tuple[Matrix, Matrix]:
    """E_i from O_e, and A_i E_i, in world axes, shape=(3, 3) each."""
    pose = configuration.tool_placement
    arms = platform_joints @ pose.rotation.T
    return arms, pose.translation + arms - hinges


# Geometry


def test_joints_are_where_the_yaml_puts_them(hinges: Matrix, platform_joints: Matrix, numbers: Numbers) -> None:
    tree = yourdfpy.URDF.load(str(find_robot("three_rps").urdf))
    tool = numbers["geometry.tool_height"] * UP
    np.testing.assert_allclose(tree.get_transform("O_e", "base")[:3, 3], tool, atol=1e-16)
    for leg, foot, ball, tangent in zip(LEGS, hinges, tool + platform_joints, TANGENTS, strict=True):
        axis = (ball - foot) / np.linalg.norm(ball - foot)
        head = foot + numbers["geometry.head_distance"] * axis
        np.testing.assert_allclose(tree.get_transform(f"A{leg}", "base")[:3, :3].T @ tangent, [0, 1, 0], atol=1e-15)
        for frame in (f"A{leg}", f"head{leg}", f"rod{leg}_tip", f"E{leg}"):
            np.testing.assert_allclose(tree.get_transform(frame, "base")[:3, 2], axis, atol=1e-15)
        for frame, point in ((f"A{leg}", foot), (f"head{leg}", head), (f"rod{leg}_tip", ball), (f"E{leg}", ball)):
            np.testing.assert_allclose(tree.get_transform(frame, "base")[:3, 3], point, atol=1e-15)
        for name, side in (("left", 1.0), ("right", -1.0)):
            hinge = foot + side * numbers["geometry.hinge_spacing"] / 2 * tangent
            tube, tip = (tree.get_transform(frame, "base") for frame in (f"{name}{leg}", f"{name}{leg}_tip"))
            np.testing.assert_allclose(tube[:3, 3], hinge, atol=1e-15)
            np.testing.assert_allclose(tip[:3, 3], head, atol=1e-15)
            np.testing.assert_allclose(tip[:3, 2], (head - hinge) / np.linalg.norm(head - hinge), atol=1e-14)
            axis_in_tube = tree.joint_map[f"hinge{leg}_{name}_joint"].axis
            np.testing.assert_allclose(tube[:3, :3] @ axis_in_tube, tangent, atol=1e-15)


def test_tubes_weigh_what_their_steel_does(numbers: Numbers) -> None:
    tree = yourdfpy.URDF.load(str(find_robot("three_rps").urdf))
    inertials = {link.name: link.inertial for link in tree.robot.links}
    tube_length = np.hypot(numbers["geometry.hinge_spacing"] / 2, numbers["geometry.head_distance"])
    for name, length, diameters in (
        ("left1", tube_length, numbers["beams.tube_diameters"]),
        ("right3", tube_length, numbers["beams.tube_diameters"]),
        ("rod2", numbers["beams.rod_length"], numbers["beams.rod_diameters"]),
    ):
        outer, inner = (  # a solid cylinder of each diameter: mass, moments about its middle
            np.array([1.0, d**2 / 16 + length**2 / 12, d**2 / 8]) * 7850.0 * np.pi / 4 * d**2 * length
            for d in diameters
        )
        mass, across, along = outer - inner
        assert inertials[name].mass == pytest.approx(mass, rel=1e-14)
        np.testing.assert_allclose(inertials[name].inertia, np.diag([across, across, along]), rtol=1e-12)


# DegreesOfFreedom


def test_three_freedoms_and_fifteen_redundant_constraints(machine: Robot) -> None:
    """27 equations on 15 joints leave 3 degrees of freedom, so 15 are redundant: five in each A."""
    assert [closure.type for closure in machine.closures] == ["6d"] * 3 + ["3d"] * 3
    for configuration in (machine.home, generic_configuration(machine.home)):
        mobility = instantaneous_mobility(configuration)
        assert (mobility.count, mobility.tool_mobility, mobility.redundant_constraints) == (3, 3, 15)
        assert mobility.constraint_rank.gap > 1e9
        assert mobility.idle_motions.shape[1] == 0
        assert not singularities(configuration)


def test_coordinates_are_height_and_tilts_of_the_tool_in_the_base(configurations: list[Configuration]) -> None:
    """The height is absolute; R = Rx Ry Rz, with Rz dependent on the tilts."""
    for configuration in configurations:
        robot = configuration.mechanism
        coordinates = [configuration.joint_position(c.joint or "") + c.offset for c in robot.declared_coordinates]
        pose = configuration.tool_placement
        angles = Rotation.from_matrix(pose.rotation).as_euler("XYZ")
        np.testing.assert_allclose(coordinates, [pose.translation[2], *angles[:2]], atol=1e-14)
    assert [c.name for c in robot.declared_coordinates] == ["z", "rx", "ry"]


def test_leg_lengths(
    configurations: list[Configuration], hinges: Matrix, platform_joints: Matrix, machine: Robot
) -> None:
    at_home = np.linalg.norm(_legs(machine.home, hinges, platform_joints)[1], axis=1)
    for configuration in configurations:
        _, legs = _legs(configuration, hinges, platform_joints)
        np.testing.assert_allclose(np.sum(legs * TANGENTS, axis=1), 0.0, atol=1e-12)  # hinges block sideways motion
        expected = np.linalg.norm(legs, axis=1) - at_home
        np.testing.assert_allclose(configuration.commands, expected, rtol=0, atol=1e-12)


def test_actuation_jacobian(configurations: list[Configuration], hinges: Matrix, platform_joints: Matrix) -> None:
    """Lengths change by [n; b x n] times the twist; the hinges block twists with nonzero [t; b x t] times the twist."""
    for configuration in configurations:
        arms, legs = _legs(configuration, hinges, platform_joints)
        directions = legs / np.linalg.norm(legs, axis=1)[:, None]
        motions = tool_motions(configuration)
        rows = np.hstack([directions, np.cross(arms, directions)])
        np.testing.assert_allclose(
            independent_motions(configuration)[configuration.mechanism.actuated_indices],
            rows @ motions,
            rtol=0,
            atol=1e-11,
        )
        held = np.hstack([TANGENTS, np.cross(arms, TANGENTS)])
        np.testing.assert_allclose(held @ motions, 0.0, atol=1e-11)


# Compliance, against a frame of beam elements


def _beam_element(length: float, ea: float, ei: float, gj: float, direction: Matrix) -> Matrix:
    """Stiffness of a beam between two nodes with six degrees of freedom each, world axes, shape=(12, 12)."""
    bend, slope, near, far = 12 * ei / length**3, 6 * ei / length**2, 4 * ei / length, 2 * ei / length
    local = np.zeros((12, 12))  # x along the beam; y deflects with rz, z with ry
    for first, second, stiffness in ((0, 6, ea / length), (3, 9, gj / length)):
        local[np.ix_([first, second], [first, second])] = stiffness * np.array([[1, -1], [-1, 1]])
    for deflection, rotation, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        s = sign * slope
        ends = [deflection, rotation, deflection + 6, rotation + 6]
        local[np.ix_(ends, ends)] = [
            [bend, s, -bend, s],
            [s, near, -s, far],
            [-bend, -s, bend, -s],
            [s, far, -s, near],
        ]
    side = np.cross(direction, UP if abs(direction[2]) < 0.9 else OUTWARD[0])
    side /= np.linalg.norm(side)
    turn = block_diag(*[np.array([direction, side, np.cross(direction, side)])] * 4)
    return np.asarray(turn.T @ local @ turn)


def _point_of_platform(arm: Matrix) -> Matrix:
    """Velocity of a point of the platform over the platform's twist, shape=(3, 6)."""
    x, y, z = arm
    return np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])


def _frame_stiffness(configuration: Configuration, hinges: Matrix, platform_joints: Matrix, numbers: Numbers) -> Matrix:
    """Stiffness of the platform on its legs, shape=(6, 6), by the direct stiffness method.

    Unknowns of a leg: the rotations of both tubes about the hinges, the six displacements of the head, the rotation of
    the rod's end in the ball. The rod is an element from head to ball, the actuator in series with its axial stiffness.
    """
    e, g = numbers["beams.youngs_modulus"], numbers["beams.shear_modulus"]

    def beam(diameters: Matrix, start: Matrix, end: Matrix, in_series: float = np.inf) -> Matrix:
        area, second = (np.pi / c * (diameters[0] ** p - diameters[1] ** p) for c, p in ((4, 2), (64, 4)))
        length = float(np.linalg.norm(end - start))
        axial = 1.0 / (length / (e * area) + 1.0 / in_series)
        return _beam_element(length, axial * length, e * second, 2 * g * second, (end - start) / length)

    total = np.zeros((6, 6))
    for foot, arm, leg, tangent in zip(hinges, *_legs(configuration, hinges, platform_joints), TANGENTS, strict=True):
        head = foot + numbers["geometry.head_distance"] * leg / np.linalg.norm(leg)
        stiffness = np.zeros((17, 17))  # hinge left, hinge right, head (6), ball (3), platform (6)
        for hinge, side in ((0, 1.0), (1, -1.0)):
            start = foot + side * numbers["geometry.hinge_spacing"] / 2 * tangent
            nodes = np.zeros((12, 17))
            nodes[3:6, hinge] = tangent
            nodes[6:12, 2:8] = np.eye(6)
            stiffness += nodes.T @ beam(numbers["beams.tube_diameters"], start, head) @ nodes
        nodes = np.zeros((12, 17))
        nodes[:6, 2:8] = np.eye(6)
        nodes[6:9, 11:] = _point_of_platform(arm)
        nodes[9:, 8:11] = np.eye(3)
        actuator = float(numbers["stiffness.actuator"])
        stiffness += nodes.T @ beam(numbers["beams.rod_diameters"], head, foot + leg, actuator) @ nodes
        inner, coupling = stiffness[:11, :11], stiffness[:11, 11:]
        total += stiffness[11:, 11:] - coupling.T @ np.linalg.solve(inner, coupling)
    return total


def test_the_frame_oracle_knows_a_cantilever() -> None:
    """A transverse force at the tip: L^3 / (3 E I); an axial one: L / (E A); a torque: L / (G J)."""
    compliance = np.linalg.inv(_beam_element(0.5, 3.0, 5.0, 7.0, np.array([0.0, 0.6, 0.8]))[6:, 6:])
    across, along = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])
    assert across @ compliance[:3, :3] @ across == pytest.approx(0.5**3 / 15.0)
    assert along @ compliance[:3, :3] @ along == pytest.approx(0.5 / 3.0)
    assert along @ compliance[3:, 3:] @ along == pytest.approx(0.5 / 7.0)


def test_stiffness_of_the_beam_machine(
    machine: Robot,
    configurations: list[Configuration],
    hinges: Matrix,
    platform_joints: Matrix,
    numbers: Numbers,
) -> None:
    elastic = ElasticModel(machine)
    scale = np.outer(*[np.repeat([1.0, 0.3], 3)] * 2)
    for configuration in configurations:
        expected = _frame_stiffness(configuration, hinges, platform_joints, numbers) / scale
        computed = cartesian_compliance(elastic, configuration)
        assert computed.exists
        assert np.abs(computed.stiffness / scale - expected).max() < 1e-9 * np.abs(expected).max()
        compliance = np.linalg.inv(expected)
        assert np.abs(computed.compliance * scale - compliance).max() < 1e-9 * np.abs(compliance).max()


def test_each_spring_of_the_closures_file_counts(machine: Robot) -> None:
    contributions = cartesian_compliance(ElasticModel(machine), machine.home).contributions
    assert len(contributions) == len(machine.springs) == 12
    for spring, part in zip(machine.springs, contributions, strict=True):
        assert np.trace(part[:3, :3]) > 1e-10, spring["name"]
