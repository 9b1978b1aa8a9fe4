"""The elastic stiffness and its design derivatives against the matrix formula, for real and complex numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.design_derivatives import DESIGN_PARAMETERS, design_derivatives
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError

ALPHA = np.radians([-30.0, 90.0, -150.0])
DESIGN = {
    "base_radius": 0.37425,
    "platform_radius": 0.075,
    "link_length": 0.353,
    "guide_slope": np.radians(50.0),
    "guide_heading": np.pi,
    "platform_joint_height": 0.013,
    "clamp_depth_ratio": 0.1,
    "actuator_stiffness": 9.5950e7,
    "link_stiffness": 1.5177e10,
    "bending_stiffness": 899.6698,
    "torsional_stiffness": 697.4185,
}


def formula(pose: np.ndarray, d: Mapping[str, complex]) -> np.ndarray:
    """K of docs/theory.md, in matrices; d may contain complex numbers."""
    zero, outward = 0 * ALPHA, np.stack([np.cos(ALPHA), np.sin(ALPHA)], axis=1)
    heading = ALPHA + d["guide_heading"]
    slope = d["guide_slope"]
    guide = np.stack([np.cos(slope) * np.cos(heading), np.cos(slope) * np.sin(heading), np.sin(slope) + zero], axis=1)
    base = np.concatenate([d["base_radius"] * outward, zero[:, None]], axis=1)
    joint = np.concatenate([d["platform_radius"] * outward, d["platform_joint_height"] + zero[:, None]], axis=1)

    def level_height(u: float) -> complex:
        x, y, z = (joint - base - u * guide)[0]
        return np.sqrt(d["link_length"] ** 2 - x * x - y * y) - z

    lowest, highest = level_height(0.155272), level_height(0.325272)
    length = pose[2] - lowest + d["clamp_depth_ratio"] * (highest - lowest)
    cx, sx, cy, sy = np.cos(pose[0]), np.sin(pose[0]), np.cos(pose[1]), np.sin(pose[1])
    arms = joint @ np.array([[cy, 0, sy], [sx * sy, cx, -sx * cy], [-cx * sy, sx, cx * cy]]).T
    w = arms + np.array([0, 0, pose[2]]) - base
    along = np.sum(w * guide, axis=1)
    u = along - np.sqrt(along**2 - np.sum(w * w, axis=1) + d["link_length"] ** 2)
    n = (w - u[:, None] * guide) / d["link_length"]
    wrenches = np.concatenate([n, np.cross(arms, n)], axis=1)
    springs = 1 / (np.sum(n * guide, axis=1) ** 2 / d["actuator_stiffness"] + 1 / d["link_stiffness"])
    e_i, g_j = d["bending_stiffness"], d["torsional_stiffness"]
    tip = np.diag([length**3 / (3 * e_i), length**3 / (3 * e_i), 0, length / e_i, length / e_i, length / g_j])
    tip[0, 4] = tip[4, 0] = length**2 / (2 * e_i)
    tip[1, 3] = tip[3, 1] = -(length**2) / (2 * e_i)
    held = np.zeros((3, 6))
    held[0, 0] = held[1, 1] = 1.0
    held[2, 3:] = [0.0, -sx, cx]
    return wrenches.T @ (springs[:, None] * wrenches) + held.T @ np.linalg.solve(held @ tip @ held.T, held)


def test_it_equals_the_matrix_formula(tripod: Tripod, reachable_poses: np.ndarray) -> None:
    for pose, matrix in zip(reachable_poses[:500], elastic_stiffness(tripod, reachable_poses[:500]), strict=True):
        expected = formula(pose, DESIGN)
        scale = np.sqrt(np.diag(expected))
        assert np.abs((matrix - expected) / scale[:, None] / scale).max() < 1e-12
        np.testing.assert_array_equal(matrix, matrix.T)


def test_positive_definite_over_the_workspace(tripod: Tripod, reachable_poses: np.ndarray) -> None:
    matrices = elastic_stiffness(tripod, reachable_poses)
    scale = np.sqrt(np.einsum("nii->ni", matrices))
    assert np.linalg.eigvalsh(matrices / scale[:, :, None] / scale[:, None, :]).min() > 1e-4


@pytest.mark.parametrize("name", DESIGN_PARAMETERS)
def test_design_derivatives_by_complex_step(tripod: Tripod, reachable_poses: np.ndarray, name: str) -> None:
    poses = reachable_poses[:20]
    derivatives = design_derivatives(tripod, poses, [name])[name]
    for pose, derivative in zip(poses, derivatives, strict=True):
        step = 1e-30 * (abs(DESIGN[name]) or 1.0)
        changed = formula(pose, DESIGN | {name: DESIGN[name] + 1j * step}).imag / step
        tool = np.linalg.inv(formula(pose, DESIGN))
        expected = -tool @ changed @ tool
        scale = np.sqrt(np.diag(tool)) / np.sqrt(abs(DESIGN[name]))
        assert np.abs((derivative - expected) / scale[:, None] / scale).max() < 5e-8


def test_bad_input(tripod: Tripod) -> None:
    with pytest.raises(UnreachablePoseError):
        elastic_stiffness(tripod, [0.0, 0.0, 0.9])
    with pytest.raises(InvalidValueError, match="clamps the passive leg"):
        elastic_stiffness(tripod, [0.0, 0.0, 0.37])
    assert np.all(np.isnan(elastic_stiffness(tripod, [[0.0, 0.0, 0.9], [0.0, 0.0, 0.37]], on_failure="nan")))
    with pytest.raises(InvalidValueError, match="parameter = colour"):
        design_derivatives(tripod, [0.0, 0.0, 0.5], ["colour"])
