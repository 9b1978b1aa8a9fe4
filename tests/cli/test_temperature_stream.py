"""`pm3dof compensate --temperatures`: rows of temperatures and poses in, commands out."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import pm3dof_pin as pm
from pm3dof_pin.cli.app import app
from pm3dof_pin.errors.error_parameters import GeometricErrors

EXPANSION = 11.5e-6
ROWS = "theta_x_deg,theta_y_deg,z_e_m,rise_all_K\n0,0,0.49,0\n0,0,0.49,8\n10,-15,0.5,-6\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration that found next to nothing: the machine is as described."""
    errors, generator = GeometricErrors.load("pm3dof"), np.random.default_rng(0)
    poses = pm.reachable_poses(errors.robot, 40, generator)
    measurements = pm.Measurements.from_poses(poses.commands, poses.transforms)
    path = tmp_path_factory.mktemp("warm") / "calibration"
    pm.calibrate(measurements, errors, "lm", on_refusal="keep").save(path)
    return path


def test_a_file_and_standard_input_are_answered_alike(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text(ROWS)
    options = ["compensate", "--calibration", str(folder), "--temperatures"]
    table = json.loads(CliRunner().invoke(app, [*options, str(tmp_path / "rows.csv"), "--json"]).stdout)["columns"]
    commands = np.column_stack([table[f"u{k}_m"] for k in (1, 2, 3)])
    lines = CliRunner().invoke(app, [*options, "-"], input=f"# a comment\n{ROWS}").stdout.splitlines()
    assert lines[0].endswith("u1_m,u2_m,u3_m,broken_limits")
    streamed = np.loadtxt(io.StringIO("\n".join(lines[1:])), delimiter=",", usecols=(4, 5, 6))
    np.testing.assert_allclose(streamed, commands, atol=1e-11)
    # a machine that is warm all over is a scaled one: its counters read as if the platform were asked to be lower, at
    # z / (1 + a dT), where the level platform's legs reach it
    robot = pm.load("pm3dof")
    expected = robot.solve([0.0, 0.0, 0.49 / (1.0 + 8.0 * EXPANSION)]).commands - robot.solve([0.0, 0.0, 0.49]).commands
    np.testing.assert_allclose(commands[1] - commands[0], expected, atol=2e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_x_deg,theta_y_deg,z_e_m\n0,0,0.49\n", "names: all, screws"),
        ("theta_x_deg,theta_y_deg,z_e_m,rise_gantry_K\n0,0,0.49,3\n", "gantry"),
        ("", "header"),
        ("theta_x_deg,theta_y_deg,z_e_m,rise_all_K\n0,0,0.49,3\n\n0,0,0.49\n", "standard input: line 4: 3 cells"),
    ],
)
def test_wrong_rows_are_refused(folder: Path, text: str, message: str) -> None:
    result = CliRunner().invoke(app, ["compensate", "--calibration", str(folder), "--temperatures", "-"], input=text)
    assert result.exit_code == 1
    assert message in result.stderr + str(result.exception)


def test_other_poses_and_conditions_are_refused(folder: Path) -> None:
    result = CliRunner().invoke(
        app, ["compensate", "0", "0", "0.49", "--calibration", str(folder), "--temperatures", "-"]
    )
    assert result.exit_code == 2
