"""Programs against the Pinocchio engine at random poses of every robot: a small version of the agreement study."""

from __future__ import annotations

import sys
from pathlib import Path

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
CLOSING, MATRICES, OF_VARIANTS = 20, 60, 40


@pytest.mark.parametrize("name", ["hexapod", "delta", "walker"])
def test_loops_close_the_same_way(name: str) -> None:
    robot = load(name)
    found = compared_closing(robot, robot.coordinates, CLOSING, seed=7)
    assert found.solved > CLOSING // 3
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
