"""Errors of all sources over sections and whole workspaces, and the region least sensitive to them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.errors.error_budget import error_budget
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.figures.least_sensitive_region import least_sensitive_region
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.grid_map import (
    LEAST_SENSITIVE,
    budget_map,
    quantity_map,
    whole_workspace_grid,
)
from pm3dof_pin.maps.quantity import MappedRobot


@pytest.fixture(scope="module")
def mapped(tripod_errors: GeometricErrors) -> xr.Dataset:
    sources = ErrorSources(tripod_errors, wrench=[0.0, 0.0, -500.0, 0.0, 0.0, 0.0])
    return budget_map(sources, whole_workspace_grid(tripod_errors.robot, 5), names=["thermal", "wrench"])[0]


def test_the_map_holds_the_budget_of_each_pose(mapped: xr.Dataset, tripod_errors: GeometricErrors) -> None:
    """The deflection along z is 500 N times C_zz; beyond the limits there is none."""
    robot = tripod_errors.robot
    poses = robot.solve(whole_workspace_grid(robot, 5), on_failure="nan")
    assert np.array_equal(np.isfinite(mapped.tip_rms.values), poses.within_limits)
    assert set(mapped.data_vars) >= {"tip_rms_thermal_growth", "tip_rms_wrench", "energy", "left_rms", "worst_tip"}
    assert "tip_rms_weight" not in mapped
    index = (2, 2, 2)  # level, in the middle
    stiffness = 2.6e8  # N/m felt along z there, of the elastic model's documentation
    assert float(mapped.tip_rms_wrench[index]) == pytest.approx(500.0 / stiffness, rel=0.05)
    together = mapped.tip_rms_wrench**2 + mapped.tip_rms_thermal_growth**2 + mapped.tip_rms_thermal_gradient**2
    np.testing.assert_allclose(mapped.tip_rms**2, together, rtol=1e-9)


def test_the_region_is_the_fifth_with_the_least_errors(mapped: xr.Dataset) -> None:
    region = mapped[LEAST_SENSITIVE].values == 1.0
    tip = mapped.tip_rms.values
    assert region.sum() == round(0.2 * np.isfinite(tip).sum())
    assert tip[region].max() <= np.nanmin(tip[(mapped[LEAST_SENSITIVE] == 0.0).values])
    assert len(least_sensitive_region(mapped).axes) > 3  # slices across z_e, and a bar of colours
    assert least_sensitive_region(mapped.isel(z_e=2)).axes


def test_where_to_calibrate(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """By geometry alone it is the region of the error map."""
    sources, candidates = ErrorSources(tripod_errors), tripod_nominal[:60]
    alone = [f"geometry_{group}" for group in tripod_errors.groups]
    chosen = error_budget(sources, candidates, names=alone).least_sensitive()
    assert np.array_equal(chosen, error_map(tripod_errors, candidates).least_sensitive())
    table, _ = budget_map(sources, candidates[:5])
    assert dict(table.sizes) == {"pose": 5}
    np.testing.assert_allclose(table.z_e, candidates.coordinates[:5, 2])


def test_grids_over_whole_workspaces(tripod_errors: GeometricErrors, serial_arm: Robot) -> None:
    assert whole_workspace_grid(tripod_errors.robot, 3).shape == (3, 3, 3)
    with pytest.raises(InvalidValueError, match="at most 58 over 3 coordinates"):
        whole_workspace_grid(tripod_errors.robot, 100)
    with pytest.raises(UnreachablePoseError, match="no pose of the grid"):
        budget_map(ErrorSources(tripod_errors), tripod_errors.robot.grid(z_e=(0.9, 1.0, 2)))


@pytest.mark.parametrize("name", ["pm3dof", "hexapod"])
def test_errors_as_quantities_of_maps(name: str) -> None:
    errors = GeometricErrors.load(name)
    first = errors.robot.coordinates[0].name
    half = 0.1 if errors.robot.coordinates[0].unit == "rad" else 0.005
    grid = errors.robot.grid(**{first: (-half, half, 3)})
    names = ("geometric_error", "geometric_error_left", "geometric_error_energy", "thermal_error", "error_budget")
    mapped = quantity_map(MappedRobot(errors.robot), grid, names)
    poses = errors.robot.solve(grid)
    budget = error_budget(ErrorSources(errors), poses)
    np.testing.assert_allclose(mapped.geometric_error, budget.select(["kinematic parameters"]).tip_rms, rtol=1e-9)
    np.testing.assert_allclose(mapped.thermal_error, budget.select(["thermal"]).tip_rms, rtol=1e-9)
    assert list(mapped.error_source.values) == [*budget.names, "together"]
    np.testing.assert_allclose(mapped.error_budget.sel(error_source="together"), budget.tip_rms, rtol=1e-9)


@pytest.mark.usefixtures("unpainted")
def test_the_command(tmp_path: Path, run: Callable[..., Any]) -> None:
    words = ("error-map", "--whole", "--points", "4", "--wrench", "0", "0", "-500", "0", "0", "0", "--rise", "5")
    done = run(*words, "--out", "maps", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    lines = {line["name"]: line for line in result["budget"]}
    assert list(lines)[-1] == "together"
    assert lines["wrench"]["error_class"] == "stiffness"
    assert lines["together"]["tip_rms_m"] > lines["geometry_legs"]["tip_rms_m"] > lines["thermal_growth"]["tip_rms_m"]
    assert result["rise_K"] == 5.0
    names = [Path(file).name for file in result["files"]]
    assert names[-4:] == ["error_budget.nc", "error_budget.csv", "least_sensitive.csv", "least_sensitive_region.png"]
    assert all((tmp_path / file).is_file() for file in result["files"])
    # the region is a plan to measure at
    plan = ("measure", "--plan", "maps/least_sensitive.csv", "--out", "m.csv", "--world", "geometry")
    assert run(*plan, cwd=tmp_path).returncode == 0
    failed = run("error-map", "--points", "3", "--source", "heat", "--no-pictures", "--out", "maps", cwd=tmp_path)
    assert failed.returncode == 1
    assert "heat" in failed.stderr
    assert run("error-map", "--whole", "--samples", "3", cwd=tmp_path).returncode == 2
