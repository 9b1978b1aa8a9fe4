"""The shell of the workspace: a closed surface, with points on the boundary and values of the maps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.kinematics import placement
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.viewer.layers import Layer, ScalarQuantity
from pm3dof_pin.viewer.shell import Shell, _tool_tips, workspace_shell

LENGTH = 0.2


@pytest.fixture(scope="module")
def shell(slender: Robot) -> Shell:
    return workspace_shell(slender, "felt_stiffness:z", tool_length=LENGTH, cells=16)


def poses_of(tips: np.ndarray) -> np.ndarray:
    """Tilts and height from the tip alone: x = h sin ty, y = -h sin tx cos ty."""
    theta_y = np.arcsin(tips[:, 0] / LENGTH)
    theta_x = np.arcsin(-tips[:, 1] / (LENGTH * np.cos(theta_y)))
    return np.column_stack([theta_x, theta_y, tips[:, 2] - LENGTH * np.cos(theta_x) * np.cos(theta_y)])


def test_tips_are_on_the_platforms_normal(mechanism: Robot) -> None:
    coordinates = np.random.default_rng(0).uniform([-0.6, -0.6, 0.42], [0.6, 0.6, 0.54], (50, 3))
    expected = placement(coordinates) @ np.array([0.0, 0.0, LENGTH, 1.0])
    tips = _tool_tips(mechanism.solve(coordinates), LENGTH)
    np.testing.assert_allclose(tips, expected[:, :3], atol=1e-12)
    np.testing.assert_allclose(poses_of(tips), coordinates, atol=1e-11)


def test_the_surface_is_closed_and_faces_outwards(shell: Shell) -> None:
    edges = Counter((int(face[k]), int(face[(k + 1) % 3])) for face in shell.faces for k in range(3))
    assert set(edges.values()) == {1}
    assert all((end, start) in edges for start, end in edges)
    assert len(shell.vertices) - len(edges) // 2 + len(shell.faces) == 2  # Euler: like a sphere
    a, b, c = (shell.vertices[shell.faces[:, k]] for k in range(3))
    assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0 > 0.0  # volume by the divergence theorem


def test_its_points_are_the_boundary(shell: Shell, tripod: Tripod) -> None:
    """A step towards the middle stays within all limits, one away breaks one; but for corners that are cut."""
    poses, middle = poses_of(shell.vertices), np.array([0.0, 0.0, 0.49])
    inside, outside = middle + 0.99 * (poses - middle), middle + 1.01 * (poses - middle)
    assert np.all(limit_flags(tripod, poses) == 0)
    assert np.mean(limit_flags(tripod, inside) == 0) > 0.999
    assert np.mean(limit_flags(tripod, outside) != 0) > 0.98  # of flat faces that lie along the step


def test_its_values_are_the_stiffness_there(shell: Shell, tripod: Tripod) -> None:
    stiffness = elastic_stiffness(tripod, poses_of(shell.vertices))
    felt = 1.0 / np.linalg.inv(stiffness)[:, 2, 2]
    layer = shell.layers[0]
    np.testing.assert_allclose(layer.values[: len(felt)], felt, rtol=1e-6)
    assert layer.unit == "N/m"
    assert layer.places.min() == 0.0
    assert layer.places.max() == 1.0
    assert np.all(np.diff(layer.places[np.argsort(layer.values)]) >= 0.0)


def test_points_inside_are_within_the_limits(shell: Shell, tripod: Tripod) -> None:
    """Points have the values of their own poses, in every layer that the page offers."""
    assert len(shell.points) > 500
    poses = poses_of(shell.points)
    assert np.all(limit_flags(tripod, poses) == 0)
    compliance = np.linalg.inv(elastic_stiffness(tripod, poses))
    layers = {layer.name: layer.values[len(shell.vertices) :] for layer in shell.layers}
    for axis, name in enumerate(("x", "y", "z", "rx", "ry", "rz")):
        np.testing.assert_allclose(layers[f"felt stiffness, {name}"], 1.0 / compliance[:, axis, axis], rtol=1e-6)
    least = 1.0 / np.linalg.eigvalsh(compliance[:, :3, :3])[:, -1]
    np.testing.assert_allclose(layers["translational stiffness, least"], least, rtol=1e-6)


def test_wide_ranges_are_logarithmic() -> None:
    wide = Layer(np.array([1.0, 10.0, 100.0]), "", "", "")
    assert wide.logarithmic
    np.testing.assert_allclose(wide.places, [0.0, 0.5, 1.0])
    near = Layer(np.array([1.0, 2.0, 3.0]), "", "", "")
    assert not near.logarithmic
    np.testing.assert_allclose(near.places, [0.0, 0.5, 1.0])


@pytest.fixture(scope="module")
def mapped(mechanism: Robot) -> MappedRobot:
    return MappedRobot(mechanism)


def test_every_listed_quantity_is_one_number(mapped: MappedRobot) -> None:
    names = ScalarQuantity.names(mapped)
    assert {"condition_number", "felt_stiffness:z", "translational_stiffness:least", "commands:u2"} <= set(names)
    for name in names:
        assert ScalarQuantity.find(mapped, name).values(mapped, mapped.robot.solve([[0.1, 0.1, 0.49]])).shape == (1,)
    assert ScalarQuantity.find(mapped, "felt_stiffness:rx").unit == "N m/rad"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("colour", "expected some of"),
        ("felt_stiffness", "and one of x, y, z, rx"),
        ("felt_stiffness:w", "and one of x, y, z, rx"),
        ("condition_number:z", "alone, which is a single number"),
        ("K", "a number or a list"),
    ],
)
def test_bad_quantities(mapped: MappedRobot, name: str, words: str) -> None:
    with pytest.raises(InvalidValueError, match=words):
        ScalarQuantity.find(mapped, name)


def test_positions_need_no_tool(load: Callable[[str], Robot]) -> None:
    """The hexapod's is the boundary of the tool's own positions, its corners within all limits by a hair."""
    robot = load("hexapod")
    shell = workspace_shell(robot, "felt_stiffness:z", tool_length=0.0, cells=10)
    middle = np.array([0.0, 0.0, 0.135])
    inside, outside = middle + 0.99 * (shell.vertices - middle), middle + 1.01 * (shell.vertices - middle)
    fill = np.zeros((len(inside), 3))
    assert robot.solve(np.hstack([inside, fill])).within_limits.mean() > 0.9
    ranges = np.array([robot.range_of(c) for c in robot.coordinates[:3]])
    beyond = np.any((outside < ranges[:, 0]) | (outside > ranges[:, 1]), axis=1)
    broken = ~robot.solve(np.hstack([outside, fill]), on_failure="nan").within_limits
    assert np.mean(broken | beyond) > 0.95  # but for edges, which are cut
