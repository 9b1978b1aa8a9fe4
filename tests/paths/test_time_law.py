"""Laws of motion along a path against arithmetic by hand and integrals, and the limits of drives that they keep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.paths.bounds import MotionLimits
from pm3dof_pin.paths.evaluation import PathEvaluation, PathOptions, evaluate_path
from pm3dof_pin.paths.time_law import Speeds, corner_speed, look_ahead
from pm3dof_pin.paths.tool_path import read_path

ACCELERATION, OVER = 0.4, 0.05


def steps(count: int, size: float = 2e-4) -> np.ndarray:
    return np.insert(np.full(count, size), 0, 0.0)


def random_bounds() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lengths, feeds that change from stretch to stretch, and corners, one of which is a stop."""
    generator = np.random.default_rng(3)
    length = steps(3000)
    bound = np.repeat(generator.uniform(0.01, 0.08, 31), 100)[: len(length)]
    at = np.full(len(length), np.inf)
    at[generator.choice(3000, 12, replace=False)] = generator.uniform(0.0005, 0.03, 12)
    at[1500] = 0.0
    return length, bound, at


def test_one_move_takes_its_trapezoid_and_the_time_of_the_mean() -> None:
    length = steps(1000)
    for over in (0.0, OVER):
        speeds = look_ahead(
            length, np.full(1001, 0.05), np.full(1001, np.inf), np.full(1001, ACCELERATION), averaged_over=over
        )
        # 0.2 m at 0.05 m/s and 0.4 m/s^2: 4 s, and half of 2 x 0.125 s for speeding up and slowing down
        assert speeds.duration.sum() == pytest.approx(4.0 + 0.125 + over, abs=1e-9)
        assert speeds.speed.max() == pytest.approx(0.05, abs=1e-12)


def test_mean_keeps_bounds_accelerations_and_jerk_and_gets_there() -> None:
    length, bound, at = random_bounds()
    found = look_ahead(length, bound, at, np.full(len(length), ACCELERATION), averaged_over=OVER)
    v, time = found.speed, np.cumsum(found.duration)
    rounding = 1e-9
    assert (v <= np.minimum(at, bound) + rounding).all()
    assert (v[:-1] <= bound[1:] + rounding).all()
    assert v[[0, 1500, -1]].tolist() == [0.0, 0.0, 0.0]
    lasting = found.duration[1:]
    assert (np.abs(np.diff(v)) <= ACCELERATION * lasting + rounding).all()
    jerk = 2.0 * ACCELERATION / OVER
    inside = (v[1:-1] > 0.0) & (v[:-2] > 0.0)
    assert (np.abs(np.diff(found.acceleration[:-1])) <= jerk * lasting[:-1] + 1e-6)[inside].all()
    # the mean of the speeds at both ends leaves out how far the acceleration changes between them
    bent = np.abs(length[1:] - 0.5 * (v[1:] + v[:-1]) * lasting)
    assert (bent <= jerk * lasting**3 / 12.0 + ACCELERATION * lasting**2 / 8.0 + 1e-12).all()
    plain = look_ahead(length, bound, at, np.full(len(length), ACCELERATION))
    assert time[-1] > plain.duration.sum() + 2.0 * OVER - rounding


def test_blocks_are_like_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    length, bound, at = random_bounds()

    def found(over: float) -> Speeds:
        return look_ahead(length, bound, at.copy(), np.full(len(length), ACCELERATION), averaged_over=over)

    whole = [found(over) for over in (0.0, OVER)]
    monkeypatch.setattr("pm3dof_pin.paths.time_law._BLOCK", 171)
    for one, over in zip(whole, (0.0, OVER), strict=True):
        for expected, values in zip(one, found(over), strict=True):
            np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-9)


def fast(folder: Path, **limits: object) -> PathEvaluation:
    """Return a fast path of a delta, near its limits of force and acceleration."""
    robot = pm.load("linear_delta")
    z = 1e3 * robot.home.tool_placement.translation[2]
    (folder / "part.ngc").write_text(
        f"G21 G64 P0.5\nG0 X0 Y0 Z{z}\nG1 X30 F60000\nG3 X0 Y30 I-30 J0\nG1 Z{z + 20}\nM2\n"
    )
    chosen = MotionLimits(acceleration=30.0, drive_speed=np.full(3, 9.0), **limits)  # type: ignore[arg-type]
    path = read_path(robot, folder / "part.ngc")
    return evaluate_path(robot, path, PathOptions(limits=chosen, spacing=0.002))


def forces(found: PathEvaluation) -> np.ndarray:
    return np.abs(np.stack([found.columns[f"u{k}_force_N"] for k in (1, 2, 3)], axis=1))


def test_forces_of_the_drives_bound_the_feed(tmp_path: Path) -> None:
    free, bound = fast(tmp_path, drive_force=np.full(3, np.inf)), fast(tmp_path, drive_force=np.full(3, 15.0))
    assert forces(free).max() > 15.0
    assert forces(bound).max() <= 15.0 * (1.0 + 1e-9)
    assert bound.summary["time_s"] > 1.02 * free.summary["time_s"]
    assert bound.summary["points_beyond_drive_force"] == 0
    assert bound.summary["least_feed_ceiling_m_s"] < free.summary["least_feed_ceiling_m_s"]


def test_forces_are_bounded_where_the_tool_point_turns_back(tmp_path: Path) -> None:
    """There the tool only turns for a moment, and what the drives do per length of the path differs from row to row."""
    turns = 2.0 * np.pi * np.linspace(0.0828, 0.0838, 101)
    poses = np.stack([3.0 * np.sin(9.0 * turns), 3.0 * np.cos(7.0 * turns), 0.5 + 0.01 * np.sin(3.0 * turns)], axis=1)
    rows = [",".join(f"{number:.9g}" for number in (*pose, 0.02)) for pose in poses]
    (tmp_path / "rows.csv").write_text("\n".join(["theta_x_deg,theta_y_deg,z_e_m,feed_m_s", *rows]) + "\n")
    robot = pm.load("pm3dof")
    found = evaluate_path(robot, read_path(robot, tmp_path / "rows.csv"), PathOptions(spacing=1.0))
    assert found.columns["feed_m_s"].max() > 1e-4
    assert 100.0 < forces(found).max() <= 500.0  # of the description


def test_drives_that_do_not_hold_the_robot_are_named(tmp_path: Path) -> None:
    found = fast(tmp_path, drive_force=np.full(3, 1.0))
    assert found.summary["points_beyond_drive_force"] == len(found)
    assert found.summary["first_line_beyond_drive_force"] == 2
    assert found.summary["least_feed_ceiling_m_s"] == 0.0


def test_limits_of_axes_and_across_the_path(tmp_path: Path) -> None:
    found = fast(tmp_path, axis_speed={"X": 0.2}, axis_acceleration={"Z": 2.0})
    tool = np.stack([found.columns[f"tool_{axis}_m"] for axis in "xyz"], axis=1)
    time, lines = found.columns["time_s"], found.columns["line"]
    with np.errstate(divide="ignore", invalid="ignore"):
        speeds = np.diff(tool[:, 0]) / np.diff(time)
    assert np.nanmax(np.abs(speeds)) <= 0.2 * (1.0 + 1e-6)
    arc = lines == 4
    assert (found.columns["feed_m_s"][arc] ** 2 / 0.03).max() <= 30.0 * (1.0 + 1e-3)
    rise = lines == 5  # 20 mm at 2 m/s^2 from rest, or almost, to rest
    assert np.ptp(time[rise]) > 0.9 * np.sqrt(2.0 * 0.02 / 2.0)


def test_jerk_of_a_path_is_bounded_and_positive(tmp_path: Path) -> None:
    smooth = fast(tmp_path, jerk=600.0)
    a, time, line = smooth.timed.speeds.acceleration, smooth.columns["time_s"], smooth.columns["line"]
    inside = (
        (line[1:-1] == line[2:]) & (smooth.timed.speeds.speed[1:-1] > 1e-3) & (smooth.timed.speeds.speed[:-2] > 1e-3)
    )
    rates = np.abs(np.diff(a[:-1]))[inside] / np.diff(time)[:-1][inside]
    assert rates.max() <= 600.0 * 1.01
    assert smooth.summary["time_s"] > fast(tmp_path).summary["time_s"]
    with pytest.raises(InvalidValueError, match="jerk"):
        MotionLimits(jerk=0.0)


def test_a_corner_is_rounded_by_the_arc_that_stays_within_the_tolerance() -> None:
    """The apex of an arc of radius r in a right angle is r (sqrt(2) - 1) from the corner: v^2 = A e (1 + sqrt(2))."""
    tolerance = np.array([1e-4, 0.0, 1e-4, 1e-4])
    speeds = corner_speed(np.array([0.0, 0.0, -1.0, 1.0]), tolerance, 2.0)
    np.testing.assert_allclose(speeds, [np.sqrt(2.0 * 1e-4 * (1.0 + np.sqrt(2.0))), 0.0, 0.0, np.inf], atol=1e-12)
