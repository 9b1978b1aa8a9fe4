"""Traces of a ballbar: of machines as described and with errors, by angle and by time, in both senses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.measuring.ballbar import Circle, ballbar_columns
from pm3dof_pin.measuring.measurement_file import read_measurements

SOCKET = np.array([2e-4, -1e-4, 3e-4])  # beside the centre of the circle
LENGTH = 0.006


@pytest.fixture(scope="module")
def hexapod() -> pm.Robot:
    return pm.load("hexapod")


def trace(robot: pm.Robot, machine: pm.SimulatedMachine, circle: Circle, angles: np.ndarray) -> np.ndarray:
    """Return readings [m] while the controller goes round by the description's inverse kinematics."""
    goals = np.tile(robot.home.tool_placement.homogeneous, (len(angles), 1, 1))
    goals[:, :2, 3] += LENGTH * np.column_stack([np.cos(angles), np.sin(angles)])
    reached = machine.poses(robot.reach(goals).commands)[:, :3, 3]
    return np.asarray(np.linalg.norm(reached - np.array(circle.centre) - SOCKET, axis=1) - LENGTH)


@pytest.mark.parametrize("sense", ["ccw", "cw"])
def test_rows_are_those_of_the_machine(sense: Any, hexapod: pm.Robot, tmp_path: Path, run: Callable[..., Any]) -> None:
    errors = pm.GeometricErrors.load("hexapod")
    machine = pm.SimulatedMachine.random(errors, np.random.default_rng(2), everything=False)
    centre = hexapod.home.tool_placement.translation
    circle = Circle(tuple(centre.tolist()), LENGTH, start=0.5, sense=sense, feed=0.02)
    seconds = np.linspace(0.0, 2.0 * np.pi * LENGTH / 0.02, 721)
    angles = 0.5 + (1.0 if sense == "ccw" else -1.0) * seconds * 0.02 / LENGTH
    readings = trace(hexapod, machine, circle, angles)
    (tmp_path / "trace.csv").write_text(
        "Time [s];Reading [um]\n"
        + "".join(f"{t!r};{1e6 * r!r}\n" for t, r in zip(seconds.tolist(), readings.tolist(), strict=True))
    )
    words = [
        "--centre",
        *map(repr, centre.tolist()),
        "--length",
        str(LENGTH),
        "--start-deg",
        repr(np.degrees(0.5).item()),
    ]
    words += ["--sense", sense, "--feed", "0.02", "--samples", "37", "--out", "rows.csv", "--robot", "hexapod"]
    done = run("measurements", "ballbar", "trace.csv", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "37 distances from one socket" in done.stdout
    rows = read_measurements(tmp_path / "rows.csv", hexapod)
    assert rows.approaches is not None
    # the machine that made the trace fits it to the digits of the file, from the true socket
    true = machine.geometric.errors.apply(machine.geometric.values).forward(rows.commands)
    there = rows.with_datum(replace(rows.datums[0], origin=np.array(circle.centre) + SOCKET))
    assert np.abs(there.residuals(true)[:, 0]).max() < 1e-12
    # the drives' directions, by the rows before and after
    ahead = np.sign(rows.commands[2:] - rows.commands[:-2])
    moving = np.abs(rows.commands[2:] - rows.commands[:-2]) > 0.1 * np.ptp(rows.commands)
    assert moving.mean() > 0.3
    np.testing.assert_array_equal(rows.approaches[1:-1][moving], ahead[moving])


def test_angles_in_degrees_and_wrong_files(hexapod: pm.Robot, tmp_path: Path) -> None:
    centre = tuple(hexapod.home.tool_placement.translation.tolist())
    circle, path = Circle(centre, LENGTH), tmp_path / "trace.csv"
    path.write_text("angle_deg,reading_um\n" + "".join(f"{angle},{3.0}\n" for angle in range(0, 360, 10)))
    found = ballbar_columns(path, hexapod, circle, samples=5, sphere=2)
    np.testing.assert_allclose(found["distance_m"], LENGTH + 3e-6)
    assert (found["sphere"] == 2.0).all()
    assert (found["sigma_distance_m"] == 1e-6).all()  # a ballbar's, not that of the instrument of other files
    for text, words in (
        ("time_s,reading_um\n0,1\n1,2\n", "expected the feed"),
        ("reading_um\n0\n1\n", "angle_rad"),
        ("angle_deg,reading_m\n0,0.1\n9,0.1\n", "another unit"),
        ("angle_deg,reading_um\n0,a\n9,b\n", "line 2"),
        ("angle_deg,reading_um\n270,1\n180,2\n90,1\n0,1\n", "they fall, which is clockwise, .* said to be ccw"),
    ):
        path.write_text(text)
        with pytest.raises(MeasurementError, match=words):
            ballbar_columns(path, hexapod, replace(circle, feed=None))
