"""Invalid arguments: typed errors of the package instead of NumPy's or a solver's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin import Atlas, Measurements, Robot, open_atlas, reachable_poses, sensitivities, stiffness
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.simulation.simulated_machine import SimulatedMachine

NO_NUMBERS: dict[str, Any] = {
    "a text": "abc",
    "texts": ["0.1", "0.2", "0.5"],
    "bytes": b"x",
    "complex numbers": [1j, 0.0, 0.5],
    "nothing": None,
    "objects": np.array([object()] * 3),
    "truth values": [True, False, True],
    "an empty list": [],
    "a ragged list": [[1, 2], [3]],
    "another shape": np.zeros((2, 7)),
    "NaN": [np.nan] * 3,
    "masked numbers": np.ma.masked_array([0.1, 0.2, 0.5], [0, 1, 0]),
    "dates": np.array(["2020-01-01"] * 3, dtype="M8[D]"),
    "numbers that overflow": [1e308, 0.0, 0.5],
}


@pytest.fixture(scope="module")
def takers(mechanism: Robot, tripod_errors: GeometricErrors) -> dict[str, Callable[[Any], Any]]:
    machine = SimulatedMachine.random(tripod_errors, np.random.default_rng(1), everything=False)
    return {
        "solve": mechanism.solve,
        "forward": mechanism.forward,
        "reach": mechanism.reach,
        "at": mechanism.at,
        "configuration": mechanism.configuration,
        "grid": lambda ends: mechanism.grid(theta_x=ends),
        "guess": lambda guess: mechanism.solve([0.0, 0.0, 0.5], guess="" if guess is None else guess),
        "stiffness": lambda q: stiffness(mechanism, q),
        "of_poses": lambda commands: Measurements.from_poses(commands, np.eye(4)[None]),
        "measure": lambda commands: machine.measure(commands, np.random.default_rng(0)),
        "values": lambda values: tripod_errors.values("" if values is None else values),
    }


@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_are_no_numbers(kind: str, takers: dict[str, Callable[[Any], Any]]) -> None:
    for name, take in takers.items():
        if kind == "NaN" and name == "at":
            continue  # there is no pose
        with pytest.raises(PM3DofError) as caught:
            take(NO_NUMBERS[kind])
        assert str(caught.value).isprintable()


@pytest.mark.parametrize("word", ["Raise", "", None, 1, ["nan"]])
def test_a_choice_that_is_none(word: Any, mechanism: Robot, tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    pose, home = [0.1, -0.2, 0.5], mechanism.at([mechanism.home.q])
    with pytest.raises(PM3DofError, match="on_failure"):
        mechanism.solve(pose, on_failure=word)
    with pytest.raises(PM3DofError, match="on_failure"):
        stiffness(mechanism, home, on_failure=word)
    grid = mechanism.grid(theta_x=(-0.1, 0.1, 3))
    for take in (
        lambda: mechanism.with_engine(word),
        lambda: pm.load("pm3dof", engine=word),
    ):
        with pytest.raises(PM3DofError, match="engine"):
            take()
    for take in (
        lambda: mechanism.solve(pose, engine=word),
        lambda: mechanism.at(mechanism.home.q, engine=word),
        lambda: stiffness(mechanism, home, engine=word),
        lambda: sensitivities(tripod_errors, home, engine=word),
    ):
        if word is not None:  # None is the robot's own engine
            with pytest.raises(PM3DofError, match="engine"):
                take()
    with pytest.raises(PM3DofError, match="precision"):
        Atlas(mechanism, grid, ("condition_number",), tmp_path / "atlas.nc", precision=word)


@pytest.mark.parametrize("count", [-1, 1.5, "3", True, None])
def test_a_count_that_is_none(count: Any, mechanism: Robot) -> None:
    with pytest.raises(PM3DofError, match="count"):
        reachable_poses(mechanism, count, np.random.default_rng(0))
    if count is not None:
        with pytest.raises(PM3DofError, match="threads"):
            mechanism.solve([0.0, 0.0, 0.5], threads=count)


def test_a_name_is_no_robot_and_poses_are_no_configuration(mechanism: Robot, tmp_path: Path) -> None:
    grid, name = mechanism.grid(z_e=3), "pm3dof"
    takers: list[tuple[str, Callable[[Any], Any]]] = [
        ("a Robot, as returned by pm.load", pm.ElasticModel),
        ("a Robot, as returned by pm.load", pm.GeometricErrors),
        ("a Robot, as returned by pm.load", pm.Viewer),
        ("a Robot, as returned by pm.load", lambda robot: stiffness(robot, mechanism.home.q)),
        ("a Robot, as returned by pm.load", lambda robot: Atlas(robot, grid, ("commands",), tmp_path / "a.nc")),
        ("a Grid, as returned by Robot.grid", lambda word: Atlas(mechanism, word, ("commands",), tmp_path / "a.nc")),
        ("an ElasticModel, as returned by pm.ElasticModel.load", lambda m: pm.cartesian_compliance(m, mechanism.home)),
        ("a Configuration, as returned by Poses.configuration", pm.singularities),
        ("a Configuration, as returned by Poses.configuration", pm.instantaneous_mobility),
        ("the path of its description", lambda _: pm.load(3)),
    ]
    for expected, take in takers:
        for given in (name, None, mechanism.solve([0.0, 0.0, 0.5])):
            with pytest.raises(PM3DofError, match=expected):
                take(given)


def test_an_atlas_has_a_path_and_is_one(mechanism: Robot, tmp_path: Path) -> None:
    grid = mechanism.grid(theta_x=(-0.1, 0.1, 3))
    assert Atlas(mechanism, grid, ("condition_number",), str(tmp_path / "atlas.nc")).path == tmp_path / "atlas.nc"
    (tmp_path / "text.nc").write_text("no atlas", encoding="utf-8")
    for name in ("text.nc", "nowhere.nc", "nowhere.zarr", "atlas.txt"):
        with pytest.raises(PM3DofError, match="expected an atlas"):
            open_atlas(tmp_path / name)
