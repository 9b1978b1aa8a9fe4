"""Shares of the springs: they add up, follow from the energies, and are the derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import contribution_names, elastic_stiffness, spring_contributions
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.elastic.shares import shares
from pm3dof_pin.exceptions import InvalidValueError


def assert_close(matrices: np.ndarray, expected: np.ndarray, contributions: np.ndarray) -> None:
    """Entries are compared relative to the whole compliance."""
    scale = np.sqrt(np.einsum("nsii->ni", contributions))
    difference = (matrices - expected) / scale[:, :, None] / scale[:, None, :]
    assert np.abs(difference).max() < 1e-7


@pytest.fixture(scope="module")
def contributions(tripod: Tripod, reachable_poses: np.ndarray) -> np.ndarray:
    return spring_contributions(tripod, reachable_poses[:100])


def test_contributions_add_up_to_the_compliance(
    tripod: Tripod, reachable_poses: np.ndarray, contributions: np.ndarray
) -> None:
    expected = inverse_definite(elastic_stiffness(tripod, reachable_poses[:100]))
    scale = np.sqrt(np.einsum("nii->ni", expected))
    difference = (contributions.sum(axis=1) - expected) / scale[:, :, None] / scale[:, None, :]
    assert np.abs(difference).max() < 1e-9
    assert np.all(np.einsum("nsii->nsi", contributions) >= -1e-12 * np.einsum("nii->ni", expected)[:, None])


@pytest.mark.parametrize(
    ("field", "springs"),
    [("actuator_stiffness", slice(0, 3)), ("link_stiffness", slice(3, 6))],
)
def test_contributions_are_the_derivatives(
    tripod: Tripod, reachable_poses: np.ndarray, contributions: np.ndarray, field: str, springs: slice
) -> None:
    """All springs of a kind together: k dC/dk = -sum C_j, by central differences."""
    value, step = getattr(tripod.parameters, field), 1e-4

    def moved(factor: float) -> np.ndarray:
        changed = Tripod(dataclasses.replace(tripod.parameters, **{field: value * factor}))
        return inverse_definite(elastic_stiffness(changed, reachable_poses[:100]))

    slope = (moved(1.0 + step) - moved(1.0 - step)) / (2.0 * step)
    expected = -contributions[:, springs].sum(axis=1)
    assert_close(slope, expected, contributions)


def test_passive_leg_by_scaling_both_of_its_constants(
    tripod: Tripod, reachable_poses: np.ndarray, contributions: np.ndarray
) -> None:
    p, step = tripod.parameters, 1e-4

    def moved(factor: float) -> np.ndarray:
        changed = dataclasses.replace(
            p, bending_stiffness=p.bending_stiffness * factor, torsional_stiffness=p.torsional_stiffness * factor
        )
        return inverse_definite(elastic_stiffness(Tripod(changed), reachable_poses[:100]))

    slope = (moved(1.0 + step) - moved(1.0 - step)) / (2.0 * step)
    expected = -contributions[:, 6]
    assert_close(slope, expected, contributions)


def test_level_platform_pushed_down(tripod: Tripod) -> None:
    """By symmetry each leg has a third, and within a leg actuator : link = c^2 / k_a : 1 / k_t."""
    parts = shares(spring_contributions(tripod, tripod.home), [0.0, 0.0, -100.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(parts[:3], parts[0], rtol=1e-9)
    h = (0.37425 - 0.240272 * np.cos(np.radians(50.0)) - 0.075) / 0.353
    cosine = h * np.cos(np.radians(50.0)) + np.sqrt(1 - h**2) * np.sin(np.radians(50.0))
    assert parts[0] / parts[3] == pytest.approx(cosine**2 * 1.5177e10 / 9.5950e7, rel=1e-9)
    assert parts[6] == pytest.approx(0.0, abs=1e-9)
    assert parts.sum() == pytest.approx(1.0)


def test_a_sideways_force_bends_the_passive_leg(tripod: Tripod) -> None:
    parts = shares(spring_contributions(tripod, tripod.home), [100.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert contribution_names(tripod)[parts.argmax()] == "passive_leg"
    assert parts.max() > 0.5
    assert parts.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("wrench", [[0.0] * 6, [1.0, 2.0], [np.nan, 0, 0, 0, 0, 0]])
def test_nonsense_loads_are_refused(contributions: np.ndarray, wrench: list[float]) -> None:
    with pytest.raises(InvalidValueError, match="wrench"):
        shares(contributions, wrench)
