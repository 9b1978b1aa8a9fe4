"""Instruments as files and lines of a table: what a simulated one gives tells the machine; a new one is one file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError, UnreachablePoseError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.datum import DatumKind, axes_of_extents
from pm3dof_pin.measuring.instrument import Instrument, circle_of_targets
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.measuring.instruments.table import INSTRUMENTS, placed_instrument
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.measuring.registration import Registration
from pm3dof_pin.simulation.simulated_machine import GeometricSource, SimulatedMachine
from pm3dof_pin.simulation.worlds import World

LENGTHS = tuple(f"strut{k}_tip.tz" for k in range(1, 7))
LONGER = np.array([80, -120, 60, 150, -40, -100]) * 1e-6
POINT = (0.02, -0.03, 0.04)
JOINTS = ("universal1_first_joint", "universal3_second_joint")

# ---- all that a new instrument needs: this as a file, and a line in the table

BAR = DatumKind(
    "bar",
    dimension=1,
    moves=(0, 1, 3, 4),
    min_rows=6,
    measured=lambda x: np.linalg.norm(x[:, :2], axis=1, keepdims=True),
    gradient=lambda x: (x * [1.0, 1.0, 0.0] / np.maximum(np.linalg.norm(x[:, :2], axis=1, keepdims=True), 1e-9))[
        :, None
    ],
    start=lambda points, values: [
        (np.roll(axes, k, axis=0), points.mean(axis=0) + side * values.mean() * np.roll(axes, k, axis=0)[0])
        for axes in [axes_of_extents(points)]
        for k in range(3)
        for side in (-1.0, 1.0)
    ],
    columns=("gap_m",),
    needed=True,
    sigma_column="sigma_gap_m",
    read=lambda cells: (cells, 1.0),
    written=lambda numbers: numbers,
)


def _place(setting: Setting) -> Instrument:
    return setting.at(setting.one(BAR, np.eye(3), setting.middle + np.array([0.1, 0.02, 0.0])))


EDDY_CURRENT = InstrumentKind("eddy-current", "the distance from a round bar", "the bar", 2e-6, _place, BAR)

# ----


@pytest.fixture(autouse=True)
def table() -> Iterator[None]:
    INSTRUMENTS["eddy-current"] = EDDY_CURRENT
    yield
    del INSTRUMENTS["eddy-current"]


@pytest.fixture(scope="module")
def errors() -> GeometricErrors:
    return GeometricErrors.load("hexapod").select(LENGTHS)


def _world(errors: GeometricErrors) -> World:
    return World(SimulatedMachine(errors.robot, GeometricSource(errors, LONGER)))


def _tells(errors: GeometricErrors, instrument: Instrument, path: Path, **reading: Any) -> None:
    """Six lengths are found as their covariance says, from the file that the instrument gives."""
    generator = np.random.default_rng(3)
    commands = reachable_poses(errors.robot, 40, generator, margin=0.1).commands
    given = _world(errors).measure(commands, generator, instrument)
    seen = read_measurements(write_measurements(given, errors.robot, path), errors.robot, target_sigma=0.0, **reading)
    assert len(seen) == len(given)
    found = identify(seen, errors, loss="squares")
    off = found.values[:6] - LONGER
    assert off @ np.linalg.solve(found.covariance[:6, :6], off) < 22.5  # 99.9 % of six
    assert np.sqrt(np.linalg.eigvalsh(found.covariance[:6, :6]))[:2].max() < 1e-4  # a tolerance


@pytest.mark.parametrize("name", [*INSTRUMENTS, "eddy-current"])
def test_what_an_instrument_gives_tells_the_machine(name: str, errors: GeometricErrors, tmp_path: Path) -> None:
    poses = reachable_poses(errors.robot, 100, np.random.default_rng(0), margin=0.1)
    point = None if name in ("tracker", "level", "camera", "lock") else POINT
    _tells(errors, placed_instrument(name, poses, point=point, joints=JOINTS), tmp_path / "seen.csv")


def test_targets_and_encoders_have_noise_of_their_own(errors: GeometricErrors, tmp_path: Path) -> None:
    targets = Instrument("position", position_sigma=5e-6, targets=circle_of_targets(3))
    _tells(errors, targets, tmp_path / "targets.csv")
    joint = next(name for name in errors.robot.passive_joints if name.startswith("universal1"))
    _tells(errors, Instrument("position", position_sigma=5e-6, encoders=(joint,)), tmp_path / "encoder.csv")


def test_each_station_of_a_tracker_has_a_frame(errors: GeometricErrors, tmp_path: Path) -> None:
    """The second half is seen from elsewhere: lengths as their covariance says, the place as it was."""
    generator = np.random.default_rng(8)
    commands = reachable_poses(errors.robot, 40, generator, margin=0.1).commands
    given = _world(errors).measure(commands, generator)
    turn, away = Rotation.from_rotvec([0.3, -0.8, 2.0]).as_matrix(), np.array([2.0, -1.0, 0.5])
    moved = given.with_rows_in_axes(np.arange(40) >= 20, Registration(turn, away, 0.0))
    stations = np.repeat([0, 3], 20)
    path = write_measurements(replace(moved, stations=stations), errors.robot, tmp_path / "seen.csv")
    seen = read_measurements(path, errors.robot)
    assert seen.stations is not None
    np.testing.assert_array_equal(seen.stations, stations)
    found = identify(seen, errors, loss="squares")
    assert found.nuisances.names == tuple(f"station3.{axis}" for axis in ("tx", "ty", "tz", "rx", "ry", "rz"))
    off = found.values[:6] - LONGER
    assert off @ np.linalg.solve(found.covariance[:6, :6], off) < 22.5  # 99.9 % of six
    # settled, the second half is where it was seen from the base: 8 µm of noise and the lengths' error
    assert found.settled.rotations is not None
    np.testing.assert_allclose(found.settled.positions, given.positions, atol=4e-5)
    np.testing.assert_allclose(found.settled.rotations, given.rotations, atol=4e-4)
    own = read_measurements(path, errors.robot, own_frame=True)
    kinds = [part.kind for part in Nuisances.from_measurements(own, ("m",) * 6).parts]
    assert kinds == ["frame", "stations"]
    path.write_text(path.read_text().replace(",3.0\n", ",3.5\n"))
    with pytest.raises(MeasurementError, match="station is a number of places"):
        read_measurements(path, errors.robot)


def test_a_machine_goes_on_until_it_touches(errors: GeometricErrors) -> None:
    """A probe without noise: the machine itself is on the plane, where the described one is not."""
    poses = reachable_poses(errors.robot, 20, np.random.default_rng(0), margin=0.1)
    probe = placed_instrument("probe", poses, sigma=1e-12, point=POINT)
    world = _world(errors)
    seen = world.measure(poses.commands, np.random.default_rng(1), probe)
    true = world.poses(seen.commands, {})
    points = true[:, :3, 3] + true[:, :3, :3] @ np.array(POINT)
    np.testing.assert_allclose(points[:, 2], probe.placed[0].origin[2], atol=2e-8)
    assert np.ptp(seen.points_on(errors.robot.forward(seen.commands))[:, 2]) > 2e-5
    far = placed_instrument("probe", poses, centres=((0.0, 0.0, 9.0),))
    with pytest.raises(UnreachablePoseError, match="does not reach the plane"):
        world.measure(poses.commands, np.random.default_rng(1), far)


def test_a_gauge_stands_across_the_plane_of_a_planar_machine() -> None:
    """A pen's heights above its own plane are all zero."""
    robot = Robot.load(Path(__file__).parents[1] / "machines" / "five_bar")
    (placed,) = placed_instrument("gauge", reachable_poses(robot, 30, np.random.default_rng(0))).placed
    assert abs(placed.axes[2][2]) < 1e-9


def test_the_commands_know_a_new_instrument(tmp_path: Path, run: Callable[..., Any]) -> None:
    robot = ("--robot", "hexapod")
    words = ("--instrument", "eddy-current", "--point", "0.02", "-0.03", "0.04")
    few = ("--poses", "30", "--candidates", "60", "--machines", "2", "--out", "plan.csv")
    planned = run("calibration-plan", *robot, *words, *few, "--json", cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr
    assert json.loads(planned.stdout)["estimated_beside_them"] == ["targets", "bar"]
    measured = run("measure", *robot, *words, "--plan", "plan.csv", "--out", "seen.csv", cwd=tmp_path)
    assert measured.returncode == 0, measured.stderr
    assert "30 rows (eddy-current)" in measured.stdout
    checked = run("measurements", "check", "seen.csv", *robot, cwd=tmp_path)
    assert "30 rows of a bar" in checked.stdout
    unknown = run("measure", *robot, "--instrument", "sextant", cwd=tmp_path)
    assert unknown.returncode == 2
    assert "eddy-current" in unknown.stderr


def test_what_a_probe_touched_when_planned_is_where_it_is_measured(tmp_path: Path, run: Callable[..., Any]) -> None:
    robot, probe = ("--robot", "hexapod"), ("--instrument", "probe", "--centre", "0", "0", "0.14")
    few = ("--poses", "12", "--candidates", "60", "--machines", "1", "--out", "plan.csv")
    assert run("calibration-plan", *robot, *probe, *few, cwd=tmp_path).returncode == 0
    done = run("measure", *robot, "--instrument", "probe", "--plan", "plan.csv", "--world", "geometry", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    nominal = GeometricErrors.load("hexapod").robot
    seen = read_measurements(tmp_path / "results" / "measurements.csv", nominal)
    # where the described machine is when the real one touches: tolerances of 0.1 mm from the plane of the plan
    np.testing.assert_allclose(nominal.forward(seen.commands).positions[:, 2], 0.14, atol=2e-3)
    frame = run("measure", *robot, "--own-frame", "--out", "frame.csv", cwd=tmp_path)
    assert frame.returncode == 0
    check = run("measurements", "check", "frame.csv", *robot, "--own-frame", cwd=tmp_path)
    assert "frame" in check.stdout
    wrong = run("measure", *robot, "--instrument", "probe", "--own-frame", cwd=tmp_path)
    assert wrong.returncode == 2


def test_wrong_placements_are_refused(errors: GeometricErrors) -> None:
    poses = reachable_poses(errors.robot, 10, np.random.default_rng(0))
    for words, says in (
        ({"sigma": 0.0}, "positive"),
        ({"length": -1.0}, "positive number of metres"),
        ({"centres": ((0.0, 0.0, 0.0),) * 2}, "expected 1 for a ballbar"),
    ):
        with pytest.raises(InvalidValueError, match=says):
            placed_instrument("ballbar", poses, **words)  # type: ignore[arg-type]
