"""Covectors of closures, eliminated one by one, against one dense solution of all of them together."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.errors.loop_covectors import RankInDoubtError, covectors
from pm3dof_pin.typing import Array, Indices

CLOSURES, ROWS, OWN, SHARED = 4, 5, 4, 4  # columns: own followers of each closure, then shared ones, then drives


def machine(seed: int, drives: int, own: int = OWN) -> tuple[list[tuple[Array, Indices]], Array, Indices, Indices]:
    """Return closures of three poses by the columns that move them, the tool, and which columns follow and drive."""
    generator, followers = np.random.default_rng(seed), CLOSURES * own + SHARED
    columns, closures = followers + drives + 2, []  # two more, as of errors
    for k in range(CLOSURES):
        moving = np.r_[np.arange(k * own, (k + 1) * own), CLOSURES * own : columns]
        closures.append((generator.standard_normal((3, ROWS, len(moving))), generator.permutation(moving)))
    tool = generator.standard_normal((3, 6, columns))
    return closures, tool, np.arange(followers), followers + np.arange(drives)


def dense(closures: list[tuple[Array, Indices]], columns: int) -> Array:
    """Return all rows of the closures by all columns, shape=(3, rows, columns)."""
    matrix = np.zeros((3, CLOSURES * ROWS, columns))
    for k, (rows, moving) in enumerate(closures):
        matrix[:, k * ROWS : (k + 1) * ROWS, moving] = rows
    return matrix


def test_regular_closures() -> None:
    closures, tool, free, driven = machine(0, drives=3)
    found = covectors(closures, tool, free, driven, excess=0)
    matrix = dense(closures, tool.shape[2])[:, :, free]
    np.testing.assert_allclose(found.tool @ matrix, tool[:, :, free], atol=1e-11)
    assert found.unmet.shape == (3, 0, CLOSURES * ROWS)


def test_redundant_closures_take_part_by_the_least_norm() -> None:
    closures, tool, free, driven = machine(1, drives=3, own=3)
    found = covectors(closures, tool, free, driven, excess=0)
    matrix = dense(closures, tool.shape[2])[:, :, free]
    np.testing.assert_allclose(found.tool, tool[:, :, free] @ np.linalg.pinv(matrix), atol=1e-11)
    np.testing.assert_allclose(found.unmet @ matrix, 0.0, atol=1e-12)
    assert np.linalg.norm(found.unmet, axis=2).min() > 0.1


def test_more_drives_than_degrees_of_freedom_give_way_by_the_least_norm() -> None:
    """Of all motions that close an opening, the one of least norm of the drives, by Lagrange's multipliers."""
    closures, tool, free, driven = machine(2, drives=6, own=3)
    excess = CLOSURES * ROWS - len(free)
    found = covectors(closures, tool, free, driven, excess)
    matrix = dense(closures, tool.shape[2])[:, :, : len(free) + 6]
    weights = np.diag(np.r_[np.zeros(len(free)), np.ones(6)])
    for acting, rows, moved in zip(found.tool, matrix, tool, strict=True):
        conditions = np.block([[weights, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
        answer = np.linalg.solve(conditions, np.vstack([np.zeros((len(weights), len(rows))), np.eye(len(rows))]))
        np.testing.assert_allclose(acting, moved[:, : len(weights)] @ answer[: len(weights)], atol=1e-9)


def test_a_rank_in_doubt_is_said() -> None:
    closures, tool, free, driven = machine(0, drives=3)
    rows, moving = closures[2]
    own = np.flatnonzero((moving >= 2 * OWN) & (moving < 3 * OWN))
    rows[1, :, own[0]] = rows[1, :, own[1]]  # at the second pose, two joints do the same
    with pytest.raises(RankInDoubtError):
        covectors(closures, tool, free, driven, excess=0)
