"""Programs against the Pinocchio engine at random poses of every robot: a small version of the agreement study."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "studies"))

from agreement import (
    DESCRIPTIONS,
    VARIANTS,
    compared_closing,
    compared_elasticity,
    compared_sensitivities,
    load,
    random_values,
)

from pm3dof_pin.elastic.elastic_model import ElasticModel

CLOSED = [name for name in DESCRIPTIONS if name != "ur5"]
CLOSING, MATRICES, OF_VARIANTS = 60, 60, 40
OF_WALKER = 20  # all are found: where one is not, Pinocchio fills a lattice of a thousand waypoints


@pytest.mark.parametrize("given", ["coordinates", "commands"])
@pytest.mark.parametrize("name", CLOSED)
def test_loops_close_the_same_way(name: str, given: str) -> None:
    robot = load(name)
    coordinates = robot.coordinates if given == "coordinates" else robot.command_coordinates
    if given == "commands" and coordinates == robot.coordinates:
        pytest.skip("the coordinates are the commands")
    if given == "commands" and name == "linear_delta":
        pytest.skip("many commands of this robot lie beyond singular poses")
    count = OF_WALKER if name == "walker" else CLOSING
    found = compared_closing(robot, coordinates, count, seed=7)
    assert found.solved > count // 3
    assert (found.found_otherwise, found.other_mode, found.limits) == (0, 0, 0)
    assert found.difference < 1e-10


@pytest.mark.parametrize("name", [*(name for name in CLOSED if name != "walker"), *VARIANTS])
def test_matrices_are_the_same(name: str) -> None:
    base, vary = VARIANTS.get(name, (name, lambda model: model))
    robot = load(base)
    poses = robot.solve(
        random_values(robot, robot.coordinates, MATRICES if name == base else OF_VARIANTS, 8), on_failure="nan"
    )
    q = poses.q[poses.solved]
    for found in compared_elasticity(vary(ElasticModel(robot)), q):
        assert (found.redone, found.missing) == (0, 0)
        assert found.difference < 1e-10
    if name == base:
        assert compared_sensitivities(robot, q[:30]).difference < 1e-10


def test_out_of_reach_for_both() -> None:
    """The pen of a five-bar reaches less than the sum of its links."""
    robot = load("five_bar")
    values = np.random.default_rng(2).uniform([-0.7, 0.05], [0.7, 0.95], (CLOSING, 2))
    found, careful = (robot.solve(values, on_failure="nan", engine=engine) for engine in ("program", "pinocchio"))
    assert 0.2 < found.solved.mean() < 0.8
    np.testing.assert_array_equal(found.solved, careful.solved)
