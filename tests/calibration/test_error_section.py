"""The error map over a section, its pictures, and the command that makes them."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import broken_limits
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.figures.error_ranking import error_ranking
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.error_section import QUANTITIES, error_outline, error_section
from pm3dof_pin.maps.grid import RectangularGrid

GRID = RectangularGrid(shape=(9, 9))


def _run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from pm3dof_pin.cli.app import main; main()", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def test_each_value_stands_at_its_pose(tripod: Tripod, tripod_errors: GeometricErrors) -> None:
    section, mapped = error_section(tripod, tripod_errors, GRID, 0.5)
    flags = broken_limits(tripod, GRID.poses(0.5))
    assert section.tip_rms.dims == ("theta_x", "theta_y")
    np.testing.assert_array_equal(np.isnan(section.tip_rms.values), flags != 0)
    np.testing.assert_array_equal(section.broken_limits.values, flags)
    assert len(mapped.poses) == np.sum(flags == 0)
    row, column = np.argwhere(flags == 0)[3]
    pose = [section.theta_x.values[row], section.theta_y.values[column], 0.5]
    mechanism = tripod_errors.mechanism
    alone = error_map(tripod_errors, mechanism.solve([pose]))
    for name, (unit, _) in QUANTITIES.items():
        assert section[name].values[row, column] == pytest.approx(getattr(alone, name)[0], rel=1e-9)
        assert section[name].attrs["units"] == unit


def test_uniform_tolerances_are_narrower(tripod: Tripod, tripod_errors: GeometricErrors) -> None:
    normal, _ = error_section(tripod, tripod_errors, GRID)
    uniform, _ = error_section(tripod, tripod_errors, GRID, distribution="uniform")
    ratio = normal.tip_rms / uniform.tip_rms
    np.testing.assert_allclose(ratio.values[np.isfinite(ratio.values)], np.sqrt(3.0))
    np.testing.assert_allclose(normal.worst_tip, uniform.worst_tip)


def test_pictures(tripod: Tripod, tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    section, mapped = error_section(tripod, tripod_errors, GRID, eta=0.2)
    outline = error_outline(tripod, tripod_errors, GRID, section)
    assert outline is not None
    assert outline.attrs["eta_m_per_rad"] == 0.2
    assert np.isfinite(outline.tip_rms.values).all()
    assert save_figure(section_map(section, "tip_rms", outline), tmp_path / "a.png").stat().st_size > 10_000
    assert save_figure(error_ranking(mapped.ranking()), tmp_path / "b.png").stat().st_size > 10_000
    with pytest.raises(InvalidValueError):
        error_ranking([])


def test_what_has_no_section_is_refused(tripod: Tripod, tripod_errors: GeometricErrors) -> None:
    with pytest.raises(UnreachablePoseError):
        error_section(tripod, tripod_errors, GRID, 0.9)
    with pytest.raises(InvalidValueError, match="tripod"):
        error_section(tripod, GeometricErrors(Robot.load("hexapod")), GRID)


def test_the_command(tmp_path: Path) -> None:
    done = _run("error-map", "--points", "7", "--out", "here", "--target", "1e-4", "--json", cwd=tmp_path)
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
    assert result["parameters"] == 35
    assert result["mean"]["uncompensable_rms_m"] < result["mean"]["tip_rms_m"] < result["mean"]["worst_tip_m"]
    assert result["allocation"]["least_cost_with_corrected_commands"]["legs [m]"] is None  # any will do
    rows = list(csv.DictReader((tmp_path / "here/error_ranking.csv").read_text().splitlines()))
    assert len(rows) == 35
    assert sum(float(row["share"]) for row in rows) == pytest.approx(1.0)


def test_the_command_for_another_robot(tmp_path: Path) -> None:
    done = _run("error-map", "--robot", "three_rps", "--samples", "5", "--no-pictures", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "left out, as the loops cannot close with them" in done.stderr
    assert "no command can undo" in done.stdout
    assert _run("error-map", "--robot", "nonsense", cwd=tmp_path).returncode == 1
