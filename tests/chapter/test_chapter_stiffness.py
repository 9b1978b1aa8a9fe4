"""The chapter's diagonal against an independent evaluation of its formula."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.chapter_stiffness import AXES, chapter_stiffness, global_index
from pm3dof_pin.chapter.kinematics import link_jacobian, slider_jacobian
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError


def test_diagonal_equals_the_matrix_formula(tripod: Tripod, reachable_poses: np.ndarray) -> None:
    poses = reachable_poses[:1000]
    j_a, j_t = link_jacobian(tripod, poses), slider_jacobian(tripod, poses)
    length = poses[:, 2] - tripod.clamp_height
    bending = 899.6698 / length**3
    matrix = 1.5177e10 * np.swapaxes(j_a, 1, 2) @ j_a + 9.5950e7 * np.swapaxes(j_t, 1, 2) @ j_t
    motion = np.einsum("nii->ni", matrix) + np.stack([bending, bending, 0 * bending], axis=-1)
    expected = np.concatenate(
        [motion, np.stack([bending / length**2, bending / length**2, 697.4185 / length**2], axis=-1)], axis=-1
    )
    diagonal = chapter_stiffness(tripod, poses)
    np.testing.assert_allclose(diagonal, expected, rtol=1e-12)
    np.testing.assert_allclose(global_index(diagonal), expected.sum(axis=1) / 6, rtol=1e-13)


def test_constrained_axes_do_not_depend_on_the_tilt(tripod: Tripod) -> None:
    level, tilted = chapter_stiffness(tripod, [[0.0, 0.0, 0.48], [0.3, -0.2, 0.48]])
    constrained = [AXES.index(axis) for axis in ("t_x", "t_y", "theta_z")]
    np.testing.assert_array_equal(level[constrained], tilted[constrained])


def test_out_of_reach(tripod: Tripod) -> None:
    with pytest.raises(UnreachablePoseError):
        chapter_stiffness(tripod, [0.0, 0.0, 0.9])
    assert np.all(np.isnan(chapter_stiffness(tripod, [0.0, 0.0, 0.9], on_failure="nan")))


def test_below_the_clamp(tripod: Tripod) -> None:
    with pytest.raises(InvalidValueError, match="clamps the passive leg"):
        chapter_stiffness(tripod, [0.0, 0.0, 0.35])
    assert np.all(np.isnan(chapter_stiffness(tripod, [0.0, 0.0, 0.35], on_failure="nan")))
