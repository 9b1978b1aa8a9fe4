"""Polytopes of forces and rates against linear programs, and against shapes with known numbers."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.stats import special_ortho_group

from pm3dof_pin.capability.polytopes import Polytopes
from pm3dof_pin.exceptions import InvalidValueError


@pytest.mark.parametrize(("dimensions", "drives"), [(1, 1), (1, 3), (2, 2), (2, 4), (3, 3), (3, 5), (6, 6), (6, 8)])
def test_forces_of_drives_against_linear_programs(dimensions: int, drives: int) -> None:
    generator = np.random.default_rng(dimensions * drives)
    matrices = generator.normal(size=(3, dimensions, drives))
    lower, upper = -generator.uniform(1.0, 2.0, drives), generator.uniform(1.0, 3.0, drives)
    centre = 0.01 * generator.normal(size=(3, dimensions))
    forces = Polytopes.from_box(matrices, lower, upper, centre=centre)
    assert forces.shape == (3,)
    for direction in generator.normal(size=(4, dimensions)):
        extent = forces.extent(direction)
        for k, matrix in enumerate(matrices):
            # the greatest s with M t + c = s d
            system = np.hstack([matrix, -direction[:, None]])
            ends = [*zip(lower, upper, strict=True), (0.0, None)]
            found = linprog([0.0] * drives + [-1.0], A_eq=system, b_eq=-centre[k], bounds=ends)
            np.testing.assert_allclose(extent[k], found.x[-1], rtol=1e-9)


@pytest.mark.parametrize(("dimensions", "drives"), [(2, 2), (2, 4), (3, 3), (3, 5)])
def test_vertices_span_the_images_of_all_corners(dimensions: int, drives: int) -> None:
    generator = np.random.default_rng(7)
    matrix = generator.normal(size=(dimensions, drives))
    corners = np.stack(np.meshgrid(*[(-1.0, 2.0)] * drives), axis=-1).reshape(-1, drives) @ matrix.T
    vertices = Polytopes.from_box(matrix, np.full(drives, -1.0), np.full(drives, 2.0)).vertices()
    expected, found = ConvexHull(corners), ConvexHull(vertices)
    assert len(vertices) == len(expected.vertices)
    np.testing.assert_allclose(found.volume, expected.volume, rtol=1e-9)


def test_rates_are_bounded_by_every_drive() -> None:
    """Two drives along x, and one along the diagonal of x and y."""
    rates = Polytopes.from_inequalities([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [-3.0, -1.0, -2.0], [3.0, 2.0, 2.0])
    assert rates.extent([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [-1.0, 1.0]]).tolist() == [2.0, 1.0, 2.0, 1.0]
    np.testing.assert_allclose(rates.ball_radius, 1.0)
    np.testing.assert_allclose(sorted(map(tuple, rates.vertices())), [(-1, -1), (-1, 3), (2, -4), (2, 0)], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_where_many_drives_are_at_their_limits_at_once(seed: int) -> None:
    """36 symmetric drives, whatever the base's axes: |x_i + x_j|, |x_i - x_j| and |x_i| up to 1.

    By hand, the vertices are the ends of the axes, where eleven drives are at their limits, and all (±1/2, ..., ±1/2),
    where fifteen are. The fourteenth digits of turned rates differ.
    """
    axes, generator = np.eye(6), np.random.default_rng(seed)
    rows = [axes[i] + sign * axes[j] for i, j in combinations(range(6), 2) for sign in (1.0, -1.0)]
    rates = np.array([*rows, *axes])
    turn = special_ortho_group.rvs(6, random_state=seed)
    turned = (rates + 1e-14 * generator.normal(size=rates.shape)) @ turn.T
    vertices = Polytopes.from_inequalities(turned, -np.ones(36), np.ones(36)).vertices() @ turn
    expected = np.vstack([axes, -axes, list(product((-0.5, 0.5), repeat=6))])
    distances = np.linalg.norm(vertices[:, None] - expected, axis=-1)
    assert distances.min(axis=1).max() < 1e-9  # every one found is one of these
    assert distances.min(axis=0).max() < 1e-9  # and every one of these is found


def test_a_load_beyond_the_drives_leaves_nothing() -> None:
    forces = Polytopes.from_box(np.eye(2), [-1.0, -1.0], [1.0, 1.0], centre=[0.0, -3.0])
    assert not forces.contains_origin
    assert np.isnan(forces.extent([1.0, 0.0]))
    assert forces.ball_radius == -2.0
    np.testing.assert_allclose(forces.margin([0.5, -3.0]), 0.5)
    np.testing.assert_allclose(forces.vertices().mean(axis=0), [0.0, -3.0])


def test_a_drive_that_moves_nothing_and_one_without_a_limit() -> None:
    rates = Polytopes.from_inequalities([[1.0, 0.0], [0.0, 0.0]], [-1.0, -1.0], [1.0, 1.0])
    assert rates.extent([0.0, 1.0]) == np.inf
    with pytest.raises(InvalidValueError, match="unbounded"):
        rates.vertices()
    assert len(Polytopes.from_inequalities([[1.0], [0.0]], [-1.0, 1.0], [1.0, 2.0]).vertices()) == 0


def test_parallel_drives_give_no_facet_of_their_own() -> None:
    generators = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    forces = Polytopes.from_box(generators, [-1.0] * 3, [1.0] * 3)
    assert forces.extent([[1.0, 0.0], [0.0, 1.0]]).tolist() == [2.0, 1.0]
    assert len(forces.vertices()) == 4


def test_impossible_limits_are_refused() -> None:
    with pytest.raises(InvalidValueError, match="at least 2"):
        Polytopes.from_box(np.ones((2, 1)), [-1.0], [1.0])
    with pytest.raises(InvalidValueError, match="lower one first"):
        Polytopes.from_box(np.eye(1), [1.0], [-1.0])
    with pytest.raises(InvalidValueError, match="finite"):
        Polytopes.from_box(np.eye(1), [-np.inf], [1.0])


def test_too_many_drives_are_refused_before_any_work() -> None:
    with pytest.raises(InvalidValueError, match="1,712,304"):
        Polytopes.from_box(np.zeros((6, 48)), -np.ones(48), np.ones(48))


def test_directions_that_rounded_numbers_nearly_let_the_drives_feel_are_unlimited() -> None:
    """A tool whose torque about one axis is carried by the structure but for a description's tenth digit."""
    felt = np.array([[1.0, 5e-12]])
    forces = Polytopes.from_box(np.eye(1), [-3.0], [3.0]).pulled_back(felt)
    assert forces.extent([1.0, 0.0]) == pytest.approx(3.0)
    assert np.isinf(forces.extent([0.0, 1.0]))


def test_corners_of_many_parallelepipeds() -> None:
    generator = np.random.default_rng(4)
    matrices = generator.normal(size=(2, 5, 3, 3))
    matrices[1, 4] = np.nan
    polytopes = Polytopes.from_box(matrices, [-1.0, -2.0, -0.5], [1.5, 2.0, 0.7], centre=[0.1, 0.0, -0.2])
    corners = polytopes.corners()
    assert corners.shape == (2, 5, 8, 3)
    assert np.isnan(corners[1, 4]).all()
    for index in np.ndindex(2, 4):
        one = polytopes.vertices(index)
        distances = np.linalg.norm(corners[index][:, None] - one[None], axis=-1)
        assert distances.min(axis=1).max() < 1e-9 * np.abs(one).max()
        assert len(set(distances.argmin(axis=1))) == 8
    with pytest.raises(InvalidValueError, match="one polytope"):
        polytopes.vertices()
    with pytest.raises(InvalidValueError, match="facets"):
        Polytopes.from_box(generator.normal(size=(2, 3)), [-1.0] * 3, [1.0] * 3).corners()
