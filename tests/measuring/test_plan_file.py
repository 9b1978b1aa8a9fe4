"""Plans as files, the picture of their accuracy, and the command that makes them."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.calibration.planning import PlanningProblem
from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.plan_accuracy import plan_accuracy
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.plan_file import write_plan

FEW = ("--candidates", "150", "--seed", "3")


Run = Callable[..., Any]


def test_commands_are_slider_travels(
    tripod: Tripod, tripod_errors: GeometricErrors, tripod_nominal: Poses, tmp_path: Path
) -> None:
    """As printed by `pm3dof ik`, to the last digits."""
    problem = PlanningProblem(tripod_errors, tripod_nominal[:50])
    plan = problem.plan(9, "random", np.random.default_rng(0))
    rows = list(csv.DictReader(write_plan(plan.poses, tmp_path / "plan.csv").read_text().splitlines()))
    assert list(rows[0]) == [
        "u1_m", "u2_m", "u3_m", "nominal_x_m", "nominal_y_m", "nominal_z_m",
        "nominal_qw", "nominal_qx", "nominal_qy", "nominal_qz",
    ]  # fmt: skip
    poses = plan.poses.coordinates
    written = np.array([[float(row[f"u{leg}_m"]) for leg in (1, 2, 3)] for row in rows])
    np.testing.assert_allclose(written, inverse_kinematics(tripod, poses), atol=1e-12)
    heights = [float(row["nominal_z_m"]) for row in rows]
    np.testing.assert_allclose(heights, poses[:, 2], atol=1e-12)


def test_the_picture(tmp_path: Path) -> None:
    curves = {"d-optimal": np.array([[2e-5], [1e-5]]), "random": np.array([[4e-5, 5e-5], [2e-5, 1.5e-5]])}
    figure = plan_accuracy([9, 20], curves, 9)  # type: ignore[arg-type]
    assert save_figure(figure, tmp_path / "a.png").stat().st_size > 10_000
    with pytest.raises(InvalidValueError, match="random"):
        plan_accuracy([9], {"random": curves["random"]})


def test_the_command(tmp_path: Path, run: Run) -> None:
    first = run("calibration-plan", "--poses", "9", "--out", "a.csv", "--json", *FEW, cwd=tmp_path)
    again = run("calibration-plan", "--poses", "9", "--out", "b.csv", *FEW, cwd=tmp_path)
    assert first.returncode == again.returncode == 0, first.stderr + again.stderr
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    result = json.loads(first.stdout)
    assert (result["identifiable"], result["least_number_of_poses"]) == (40, 9)
    assert result["not_identifiable"] == []
    assert len(result["commands_m"]) == 9
    predicted = result["predicted_tip_rms_by_strategy_m"]
    assert predicted["d-optimal"] == result["predicted_tip_rms_m"] < predicted["random"]
    assert "40 have an effect" in again.stdout


def test_too_few_poses_are_reported(tmp_path: Path, run: Run) -> None:
    done = run("calibration-plan", "--poses", "4", "--strategy", "random", *FEW, cwd=tmp_path)
    assert done.returncode == 0
    assert "24 have an effect" in done.stdout
    assert "19 more" in done.stdout
    assert run("calibration-plan", "--poses", "149", "--strategy", "random", *FEW, cwd=tmp_path).returncode == 1
