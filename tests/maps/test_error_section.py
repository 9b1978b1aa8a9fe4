"""The error map over a section, its pictures, and the command that makes them, for any robot."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.errors.error_map import error_map, section_grid
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.figures.error_ranking import error_ranking
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.grid_map import ERROR_VARIABLES, error_section, errors_over
from pm3dof_pin.maps.limit_space import limits_over

Run = Callable[..., Any]
MACHINES = Path(__file__).parents[1] / "machines"


@pytest.fixture(scope="module")
def grid(tripod_errors: GeometricErrors) -> Grid:
    found = section_grid(tripod_errors.robot, points=9, fixed={"z_e": 0.5})
    assert found is not None
    return found


def test_each_value_stands_at_its_pose(tripod: Tripod, tripod_errors: GeometricErrors, grid: Grid) -> None:
    section, mapped = error_section(tripod_errors, grid)
    inside = limit_flags(tripod, grid.values) == 0
    assert section.tip_rms.dims == ("theta_x", "theta_y")
    np.testing.assert_array_equal(np.isfinite(section.tip_rms.values), inside)
    np.testing.assert_array_equal(section.broken_limits.values == 0, inside)
    assert section.broken_limits.attrs["flag_meanings"] == "reach stroke universal spherical tilt height"
    assert len(mapped.poses) == np.sum(inside)
    row, column = np.argwhere(inside)[3]
    pose = [section.theta_x.values[row], section.theta_y.values[column], 0.5]
    alone = error_map(tripod_errors, tripod_errors.robot.solve([pose]))
    for name, (unit, _) in ERROR_VARIABLES.items():
        assert section[name].values[row, column] == pytest.approx(getattr(alone, name)[0], rel=1e-9)
        assert section[name].attrs["units"] == unit


def test_sections_of_any_robot(tripod_errors: GeometricErrors, tripod: Tripod, serial_arm: Robot) -> None:
    """The first two coordinates with ranges, the others in the middle of theirs; or the given ones."""
    default = section_grid(tripod_errors.robot, points=3)
    assert default is not None
    np.testing.assert_allclose(default.axes["theta_x"], np.radians([-40.0, 0.0, 40.0]))
    assert default.fixed["z_e"] == pytest.approx(tripod.middle_height)
    named = section_grid(Robot.load("hexapod"), ranges={"z": (0.13, 0.14, 4)}, fixed={"rx": 0.01})
    assert named is not None
    assert named.shape == (4,)
    assert named.fixed["rx"] == 0.01
    assert named.fixed["y"] == pytest.approx(0.0, abs=1e-15)
    assert section_grid(serial_arm) is None  # x, y, z and three angles, none of which has a range
    with pytest.raises(InvalidValueError, match="one of theta_x, theta_y, z_e"):
        section_grid(tripod_errors.robot, fixed={"height": 0.5})


def test_on_pinocchio_pose_by_pose(tripod_errors: GeometricErrors) -> None:
    few = section_grid(tripod_errors.robot, points=3, fixed={"z_e": 0.5})
    assert few is not None
    reference = GeometricErrors(tripod_errors.robot.with_engine("pinocchio"), tripod_errors.parameters)
    compiled, careful = (error_section(errors, few)[0] for errors in (tripod_errors, reference))
    for name in ERROR_VARIABLES:
        np.testing.assert_allclose(compiled[name], careful[name], rtol=1e-9)


def test_uniform_tolerances_are_narrower(tripod_errors: GeometricErrors, grid: Grid) -> None:
    normal, _ = error_section(tripod_errors, grid)
    uniform, _ = error_section(tripod_errors, grid, distribution="uniform")
    ratio = normal.tip_rms / uniform.tip_rms
    np.testing.assert_allclose(ratio.values[np.isfinite(ratio.values)], np.sqrt(3.0))
    np.testing.assert_allclose(normal.worst_tip, uniform.worst_tip)


def test_pictures(tripod_errors: GeometricErrors, grid: Grid, tmp_path: Path) -> None:
    section, mapped = error_section(tripod_errors, grid, eta=0.2)
    exact, broken = (
        errors_over(tripod_errors, grid, "tip_rms", eta=0.2),
        limits_over(tripod_errors.robot, grid.dims, grid.fixed),
    )
    tilts = np.radians([[10.0, -7.0], [3.0, 12.0], [60.0, 0.0]])
    expected = error_map(tripod_errors, tripod_errors.robot.solve(np.column_stack([tilts[:2], [0.5, 0.5]])), eta=0.2)
    np.testing.assert_allclose(exact(tilts), [*expected.tip_rms, np.nan], rtol=1e-12)
    figure = section_map(section, "tip_rms", within=lambda points: broken(points) == 0, exact=exact)
    assert save_figure(figure, tmp_path / "a.png").stat().st_size > 10_000
    assert save_figure(error_ranking(mapped.ranking(), "hexapod"), tmp_path / "b.png").stat().st_size > 10_000
    with pytest.raises(InvalidValueError):
        error_ranking([], "hexapod")


def test_a_section_out_of_reach_is_refused(tripod_errors: GeometricErrors) -> None:
    grid = section_grid(tripod_errors.robot, points=3, fixed={"z_e": 0.9})
    assert grid is not None
    with pytest.raises(UnreachablePoseError, match=r"no pose of the grid over theta_x, theta_y at z_e = 0\.9"):
        error_section(tripod_errors, grid)


@pytest.mark.usefixtures("unpainted")
def test_the_command(tmp_path: Path, run: Run) -> None:
    done = run("error-map", "--points", "7", "--out", "maps", "--target", "1e-4", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert [Path(file).name for file in result["files"]] == [
        "error_map.nc",
        "error_map.csv",
        "error_map_tip.png",
        "error_map_uncompensable.png",
        "error_map_worst.png",
        "error_ranking.csv",
        "error_ranking.png",
    ]
    assert all((tmp_path / file).is_file() for file in result["files"])
    assert result["parameters"] == 40
    assert result["z_e_m"] == pytest.approx(0.487333, abs=1e-6)
    assert result["mean"]["uncompensable_rms_m"] < result["mean"]["tip_rms_m"] < result["mean"]["worst_tip_m"]
    assert result["allocation"]["least_cost_with_corrected_commands"]["legs [m]"] is None  # any will do
    rows = list(csv.DictReader((tmp_path / "maps/error_ranking.csv").read_text().splitlines()))
    assert len(rows) == 40
    assert sum(float(row["share"]) for row in rows) == pytest.approx(1.0)


def test_a_name_and_a_path_are_one_robot(tmp_path: Path, run: Run) -> None:
    path = Path(__file__).parents[2] / "robots/pm3dof_description/urdf/pm3dof.urdf"
    options = ("--points", "5", "--no-pictures", "--json", "--out", str(tmp_path))
    first, second = (run("error-map", "--robot", robot, *options) for robot in ("pm3dof", str(path)))
    assert first.returncode == 0, first.stderr
    assert first.stdout == second.stdout


def test_other_robots(tmp_path: Path, run: Run) -> None:
    options = ("--no-pictures", "--out", str(tmp_path))
    done = run("error-map", "--robot", str(MACHINES / "five_bar"), "--samples", "5", *options)
    assert done.returncode == 0, done.stderr
    assert "left out because the loops cannot close with them" in done.stderr
    assert "no command can undo" in done.stdout
    assert run("error-map", "--robot", "nonsense", *options).returncode == 1
    done = run("error-map", "--robot", "hexapod", "--over", "rz", "-2", "2", "3", "--at", "z", "0.13", *options)
    assert done.returncode == 0, done.stderr
    section = xr.load_dataset(tmp_path / "error_map.nc")
    np.testing.assert_allclose(section.rz, np.radians([-2.0, 0.0, 2.0]))
    assert float(section.z) == 0.13
    assert run("error-map", "--robot", str(MACHINES / "five_bar"), "--points", "3", *options).returncode == 0
