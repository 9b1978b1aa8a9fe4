"""A thicker passive leg: cantilever formulas, the chapter's claim about theta_z, and effects on other axes."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.axis_stiffness import felt_stiffness, held_stiffness
from pm3dof_pin.chapter.chapter_stiffness import AXES, chapter_stiffness
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.passive_leg import with_passive_leg_radius
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


@pytest.fixture(scope="module")
def poses(tripod: Tripod) -> Array:
    tilts = np.random.default_rng(8).uniform(-0.6, 0.6, (200, 2))
    drawn = np.column_stack([tilts, np.full(200, tripod.middle_height)])
    return drawn[limit_flags(tripod, drawn) == 0]


def test_a_sideways_force_at_the_tool_bends_the_passive_leg_alone(tripod: Tripod, poses: Array) -> None:
    """The links carry no part of a force through O_e across the passive leg: 3 E I / L^3."""
    p, length = tripod.parameters, tripod.middle_height - tripod.clamp_height
    felt = felt_stiffness(tripod, poses)
    for axis in ("t_x", "t_y"):
        np.testing.assert_allclose(felt[:, AXES.index(axis)], 3.0 * p.bending_stiffness / length**3, rtol=1e-9)


def test_the_level_platform_turns_with_the_end_of_the_passive_leg(tripod: Tripod) -> None:
    p, length = tripod.parameters, tripod.middle_height - tripod.clamp_height
    centre = [0.0, 0.0, tripod.middle_height]
    for reading in (held_stiffness, felt_stiffness):
        assert reading(tripod, centre)[AXES.index("theta_z")] == pytest.approx(p.torsional_stiffness / length, rel=1e-9)


def test_readings_are_in_the_order_of_the_chapters_axes(tripod: Tripod) -> None:
    """Diagonals of K and C, whose rows are x, y, z, rx, ry, rz, at a pose where all differ."""
    pose = [0.25, -0.1, 0.5]
    stiffness = elastic_stiffness(tripod, pose)
    rows = {"t_x": 0, "t_y": 1, "t_z": 2, "theta_x": 3, "theta_y": 4, "theta_z": 5}
    own = [rows[axis] for axis in AXES]
    np.testing.assert_allclose(held_stiffness(tripod, pose), stiffness.diagonal()[own], rtol=1e-12)
    compliance = np.linalg.inv(stiffness).diagonal()[own]
    np.testing.assert_allclose(felt_stiffness(tripod, pose), 1.0 / compliance, rtol=1e-6)


@pytest.mark.parametrize("factor", [0.7, 1.2, 2.0])
def test_a_radius_counts_with_its_fourth_power(tripod: Tripod, factor: float) -> None:
    centre = [0.0, 0.0, tripod.middle_height]
    machine = with_passive_leg_radius(tripod, factor)
    assert machine.parameters.passive_leg_mass == pytest.approx(factor**2 * tripod.parameters.passive_leg_mass)
    readings = {"chapter": chapter_stiffness, "held": held_stiffness, "felt": felt_stiffness}
    for name, reading in readings.items():
        gain = reading(machine, centre) / reading(tripod, centre)
        assert gain[AXES.index("theta_z")] == pytest.approx(factor**4), name
        assert gain[AXES.index("t_z")] == pytest.approx(1.0), name


def test_a_thick_leg_leaves_the_legs_as_the_only_springs_of_the_tilts(tripod: Tripod) -> None:
    """As the passive leg becomes rigid, tilts are as stiff as with x and y held."""
    centre = [0.0, 0.0, tripod.middle_height]
    rigid = with_passive_leg_radius(tripod, 100.0)
    tilts = [AXES.index("theta_x"), AXES.index("theta_y")]
    np.testing.assert_allclose(felt_stiffness(rigid, centre)[tilts], held_stiffness(tripod, centre)[tilts], rtol=1e-5)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_no_radius(tripod: Tripod, factor: float) -> None:
    with pytest.raises(InvalidValueError, match="factor"):
        with_passive_leg_radius(tripod, factor)
