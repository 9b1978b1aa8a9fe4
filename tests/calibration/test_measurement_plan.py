"""Plans for instruments: what must touch touches, ranges are kept, machines far out of tolerance take every pose."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.calibration import measurement_plan
from pm3dof_pin.calibration.assembled import OUT_OF_TOLERANCE
from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.measurement_plan import plan_measurements
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.instruments.table import INSTRUMENTS, placed_instrument
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import joint_coordinates
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.measuring.observation import planned_measurements
from pm3dof_pin.simulation.worlds import World
from pm3dof_pin.typing import Mask

MACHINES = Path(__file__).parents[1] / "machines"
NAMES = tuple(INSTRUMENTS)


@pytest.fixture(scope="module")
def errors() -> GeometricErrors:
    return closable(GeometricErrors.load("hexapod"))


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("tracker", "level")])
def test_what_must_touch_touches(name: str, errors: GeometricErrors, tmp_path: Path) -> None:
    """Judged from the tool's poses alone; and the planned rows are those of a file."""
    point = None if name == "lock" else (0.01, -0.02, 0.03)
    joints = ("universal1_first_joint",) if name == "lock" else ()
    found = plan_measurements(errors, 10, instrument=name, point=point, joints=joints, candidates=120, machines=2)
    poses, own = found.poses, found.problem.instrument
    tips = poses.positions + poses.rotations @ np.array(point or np.zeros(3))
    assert poses.within_limits.all()
    if name == "ballbar":
        assert np.ptp(np.linalg.norm(tips - own.placed[0].origin, axis=1)) < 1e-7
    if name == "lock":
        assert np.ptp(joint_coordinates(errors.robot, poses.q, joints)) < 1e-7
    extents = np.linalg.svd(tips - tips.mean(axis=0), compute_uv=False)
    flat = {"probe": 1, "line": 2, "socket": 3}.get(name, 0)
    assert (extents[3 - flat :] < 1e-7).all()
    assert (extents[: 3 - flat] > 1e-4).all()
    seen = planned_measurements(poses, own)
    path = write_measurements(seen, errors.robot, tmp_path / "planned.csv")
    again = read_measurements(path, errors.robot, target_sigma=0.0)
    np.testing.assert_allclose(again.residuals(errors.robot.forward(again.commands))[again.seen], 0.0, atol=1e-8)
    assert len(again) == len(seen)


@pytest.mark.parametrize(("name", "point"), [("probe", (0.01, -0.02, 0.03)), ("camera", None)])
def test_a_plan_estimates_what_a_calibration_does(
    name: str, point: tuple[float, float, float] | None, errors: GeometricErrors, tmp_path: Path
) -> None:
    """The places of targets on the tool too, unless they are known."""
    units = tuple(command.unit for command in errors.robot.commands)
    for known in ({}, {"target_sigma": 0.0}):
        found = plan_measurements(errors, 10, instrument=name, point=point, candidates=60, machines=0, **known)
        seen = planned_measurements(found.poses, found.problem.instrument)
        path = write_measurements(seen, errors.robot, tmp_path / "planned.csv")
        read = Nuisances.from_measurements(read_measurements(path, errors.robot, **known), units)
        assert found.problem.nuisances.names == read.names
        assert any("target" in each for each in read.names) == (not known)


def test_wires_from_known_points(errors: GeometricErrors) -> None:
    """Points that were measured beforehand are not estimated: twelve numbers more for the machine."""
    centres = ((0.3, 0.0, 0.4), (-0.2, 0.3, 0.4), (-0.2, -0.3, 0.5), (0.0, 0.0, 0.9))
    poses = reachable_poses(errors.robot, 12, np.random.default_rng(0))
    own = placed_instrument("wires", poses, centres=centres)
    seen = [planned_measurements(poses, replace(own, known_centres=known)) for known in (False, True)]
    units = tuple(command.unit for command in errors.robot.commands)
    assert [len(Nuisances.from_measurements(each, units)) for each in seen] == [12, 0]
    tips = poses.positions[:, None] - np.array(centres)
    distances = np.linalg.norm(tips, axis=2)
    np.testing.assert_allclose(seen[1].distances, distances.ravel(), atol=1e-12)
    found = [datum.values[datum.rows, 0] for datum in seen[0].datums]
    np.testing.assert_allclose(found, distances.T, atol=1e-12)
    with pytest.raises(InvalidValueError, match="those of wires or a ballbar"):
        plan_measurements(errors, 10, instrument="probe", centres=centres[:1], known_centres=True, candidates=50)


def test_a_level_sees_two_tilts(errors: GeometricErrors) -> None:
    poses = reachable_poses(errors.robot, 5, np.random.default_rng(0))
    seen = planned_measurements(poses, placed_instrument("level", poses))
    assert seen.seen.sum(axis=0).tolist() == [0, 0, 0, 5, 5, 0]


@pytest.mark.parametrize("robot", ["pm3dof", str(MACHINES / "five_bar")])
def test_200_machines_three_tolerances_out_take_every_pose(robot: str) -> None:
    """Other machines than those that the plan tried."""
    errors = closable(GeometricErrors.load(robot))
    found = plan_measurements(errors, 9, candidates=300)
    generator = np.random.default_rng(77)
    for _ in range(200):
        machine = errors.apply(OUT_OF_TOLERANCE * errors.sample(generator))
        poses = machine.forward(found.poses.commands, guess=found.poses.q, on_failure="nan", engine="pinocchio")
        assert poses.solved.all()


def test_declared_ranges_are_kept() -> None:
    """Of a delta whose joints would permit more."""
    errors = closable(GeometricErrors.load("linear_delta"))
    found = plan_measurements(errors, 9, candidates=150, machines=1)
    robot = errors.robot
    lower, upper = np.array([robot.range_of(coordinate) for coordinate in robot.coordinates]).T
    everything = found.problem.candidates.coordinates
    assert ((everything >= lower - 1e-9) & (everything <= upper + 1e-9)).all()
    drawn = reachable_poses(robot, 150, np.random.default_rng(0)).coordinates
    assert not ((drawn >= lower) & (drawn <= upper)).all()


def test_what_cannot_be_is_refused(errors: GeometricErrors) -> None:
    with pytest.raises(UnreachablePoseError, match="plane at 0 0 9 is out of reach"):
        plan_measurements(errors, 9, instrument="probe", centres=((0.0, 0.0, 9.0),), candidates=50, machines=1)
    with pytest.raises(InvalidValueError, match="expected 1 for a ballbar"):
        plan_measurements(errors, 9, instrument="ballbar", centres=((0.0, 0.0, 0.1),) * 2, candidates=50)
    with pytest.raises(InvalidValueError, match="lm, without an accuracy"):
        plan_measurements(errors, 9, instrument="camera", method="gp", candidates=50)


@pytest.mark.parametrize("instrument", ["gauge", "ballbar", "wires"])
def test_a_point_that_never_leaves_a_line_locates_nothing(instrument: str) -> None:
    """The tripod's tool point moves along z only: a plane may be tilted, a centre turned about z, unseen."""
    errors = GeometricErrors.load("pm3dof")
    with pytest.raises(InvalidValueError, match="stays on a line or at one place"):
        plan_measurements(errors, 15, instrument=instrument, candidates=60, machines=0)
    assert plan_measurements(errors, 15, instrument="gauge", point=(0.1, 0.0, 0.0), candidates=60, machines=0).poses


@pytest.mark.parametrize("instrument", ["probe", "gauge"])
@pytest.mark.parametrize("machine", ["three_rpr", "five_bar", "five_bar on edge"])
def test_planar_machines_touch_planes_across_their_own(machine: str, instrument: str, tmp_path: Path) -> None:
    """In xy and in xz: touches along a line, whose plane may lean as it likes; another machine finds it by itself."""
    name, _, on_edge = machine.partition(" ")
    folder = tmp_path / name
    shutil.copytree(MACHINES / name, folder)
    if on_edge:
        urdf, closures = folder / f"{name}.urdf", folder / f"{name}.closures.yaml"
        stand = '<link name="ground"/><joint name="stand" type="fixed"><parent link="ground"/><child link="base"/>'
        stand += f'<origin rpy="{np.pi / 2.0!r} 0 0"/></joint><link name="base">'
        urdf.write_text(urdf.read_text().replace('<link name="base">', stand))
        closures.write_text(closures.read_text().replace("{name: y, tool: y", "{name: y, tool: z"))
    errors = closable(GeometricErrors.load(folder))
    found = plan_measurements(errors, 9, instrument=instrument, candidates=300, machines=2)
    own, normal = found.problem.instrument.placed[0], np.array([0.0, 1.0, 0.0] if on_edge else [0.0, 0.0, 1.0])
    assert abs(own.axes[2] @ normal) < 1e-9
    tips = found.poses.positions
    heights = (tips - np.array(own.origin)) @ np.array(own.axes[2])
    assert (np.ptp(heights) < 1e-7) == (instrument == "probe")
    assert np.ptp(tips @ np.array(own.axes[1])) > 0.02
    assert found.plan.identifiability.identified > 0
    seen_by = placed_instrument(instrument, found.poses)
    world = World.random("geometry", errors, np.random.default_rng(3))
    seen = world.measure(found.poses.commands, np.random.default_rng(4), seen_by)
    again = read_measurements(write_measurements(seen, errors.robot, tmp_path / "seen.csv"), errors.robot)
    leaning = "plane1.ry" in Nuisances.from_measurements(again, ("rad",) * len(errors.robot.commands)).names
    assert leaning == (instrument == "gauge")
    assert np.isfinite(calibrate(again, errors, "lm", on_refusal="keep").identification.values).all()


def test_poses_at_one_distance_keep_apart_within_the_ranges_that_they_have() -> None:
    """All round a circle of 50 mm: in parts of the commands' ranges there, an ellipse with room for two dozen poses."""
    errors = closable(GeometricErrors.load(MACHINES / "five_bar"))
    centre = (0.0, 0.41, 0.0)
    plan = plan_measurements(
        errors, 12, instrument="ballbar", centres=(centre,), length=0.05, candidates=300, machines=2
    )
    np.testing.assert_allclose(np.linalg.norm(plan.poses.positions - centre, axis=1), 0.05, rtol=0.0, atol=1e-8)
    taken = np.ptp(plan.poses.commands, axis=0)
    for k, commands in enumerate(plan.poses.commands):
        others = np.delete(plan.poses.commands, k, axis=0)
        assert np.sqrt(np.mean(((others - commands) / taken) ** 2, axis=1)).min() > 0.05


def test_poses_that_cannot_keep_apart_are_refused_before_any_is_sought(
    errors: GeometricErrors, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of six ranges has three parts of a third, so that their cells have a diagonal of a third: less than 0.4."""
    sought = "poses are sought"

    def seek(*_: object) -> None:
        raise AssertionError(sought)

    monkeypatch.setattr(measurement_plan, "closable", seek)
    with pytest.raises(InvalidValueError, match=f"expected at most about {3**6} poses at least 0.4 of the ranges"):
        plan_measurements(errors, 3**6 + 1, min_distance=0.4)
    with pytest.raises(AssertionError, match=sought):
        plan_measurements(errors, 3**6, min_distance=0.4)


def test_poses_too_few_to_locate_a_plane_are_refused_for_that() -> None:
    with pytest.raises(InvalidValueError, match="poses are too few to tell plane1"):
        plan_measurements(GeometricErrors.load("hexapod"), 2, instrument="gauge", candidates=60, machines=0)


def test_a_level_tells_nothing_of_a_tool_that_only_translates() -> None:
    with pytest.raises(InvalidValueError, match="sees nothing of what the drives of linear_delta move"):
        plan_measurements(GeometricErrors.load("linear_delta"), 9, instrument="level", candidates=60, machines=0)


def test_a_point_that_drives_do_not_move_sideways_touches_no_line() -> None:
    """The tripod as described is always on the z axis, and no other machine is: its drives cannot bring it there."""
    with pytest.raises(UnreachablePoseError, match="a machine with errors misses the line"):
        plan_measurements(GeometricErrors.load("pm3dof"), 9, instrument="line", candidates=60, machines=0)


@pytest.mark.parametrize("part", [0.3, 0.01])
def test_poses_at_which_machines_cannot_be_assembled_are_replaced_as_long_as_there_are_others(
    part: float, errors: GeometricErrors, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of machines that can be assembled at a part of all commands only, in no relation to sensitivities."""

    def near_one_end(errors: GeometricErrors, poses: Poses, machines: int, seed: int) -> Mask:
        return np.asarray(poses.commands[:, 0] < np.quantile(everything, part))

    everything = reachable_poses(errors.robot, 200, np.random.default_rng(0)).commands[:, 0]
    monkeypatch.setattr(measurement_plan, "assembled", near_one_end)
    if part < 0.05:
        with pytest.raises(UnreachablePoseError, match=r"at \d of \d+ poses to choose from, and 9 are planned"):
            plan_measurements(errors, 9, candidates=200)
        return
    found = plan_measurements(errors, 9, candidates=200)
    assert near_one_end(errors, found.poses, 0, 0).all()
