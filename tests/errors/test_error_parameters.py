"""Geometric error parameters: their displacements, their names, and the file that lists them."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.description.error_file import read_error_file
from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter
from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

GOOD_CLASS = "{length_tolerance_m: 1, angle_tolerance_rad: 0.1, errors: [{at: b, rotation: x}]}"


def test_the_tripod_has_27_parameters_in_its_legs_and_13_in_the_middle(tripod_errors: GeometricErrors) -> None:
    assert len(tripod_errors) == 40
    assert len(tripod_errors.indices("legs")) + len(tripod_errors.indices("platform")) == 27
    assert len(tripod_errors.indices("passive_leg")) + len(tripod_errors.indices("tool")) == 13


def test_screws_are_held_at_the_base_joints(tripod_errors: GeometricErrors, tripod: Tripod) -> None:
    np.testing.assert_allclose(tripod_errors.fixed_bearings, -tripod.parameters.slider_home, atol=1e-15)


def test_everything_can_be_wrong(mechanism: Robot) -> None:
    """12 joints and the tool with six each, six closure points with three."""
    errors = GeometricErrors(mechanism)
    assert len(errors) == 13 * 6 + 6 * 3
    assert set(errors.groups) == {"legs", "tool_chain", "platform", "tool"}
    assert set(GeometricErrors(Robot.load("hexapod")).groups) == set(errors.groups)


def test_each_place_moves_by_its_displacement(tripod_errors: GeometricErrors) -> None:
    values = 50.0 * tripod_errors.sample(np.random.default_rng(0))
    p = tripod_errors.named(values)
    nominal, moved = tripod_errors.robot.home, tripod_errors.apply(values).home
    length = moved.frame_placement("universal1_second_joint").actInv(moved.frame_placement("link1_tip"))
    np.testing.assert_allclose(length.translation, [0.0, 0.0, 0.353 + p["link1_tip.tz"]], atol=1e-15)
    np.testing.assert_allclose(
        moved.frame_placement("slider2_joint").translation - nominal.frame_placement("slider2_joint").translation,
        [p["slider2_joint.tx"], p["slider2_joint.ty"], p["slider2_joint.tz"]],
        atol=1e-15,
    )
    turn = pin.log3(moved.frame_placement("slider2_joint").rotation)
    assert turn @ tripod_errors.robot.joint_axis("slider2_joint") == pytest.approx(0.0, abs=1e-15)
    assert np.linalg.norm(turn) == pytest.approx(np.hypot(p["slider2_joint.r_across1"], p["slider2_joint.r_across2"]))


def test_turning_about_across1_changes_the_slope_and_about_across2_the_heading(tripod_errors: GeometricErrors) -> None:
    guide = tripod_errors.robot.model.jointPlacements[4].rotation @ tripod_errors.robot.joint_axis("slider1_joint")
    for name, unchanged in (("slider1_joint.r_across1", np.arctan2), ("slider1_joint.r_across2", np.arctan2)):
        model = tripod_errors.apply({name: 1e-3}).model
        moved = model.jointPlacements[model.getJointId("slider1_joint")].rotation @ guide
        slope = np.arcsin(moved[2]) - np.arcsin(guide[2])
        heading = unchanged(moved[1], moved[0]) - unchanged(guide[1], guide[0])
        if name.endswith("1"):
            assert abs(slope) == pytest.approx(1e-3, rel=1e-6)
            assert heading == pytest.approx(0.0, abs=1e-12)
        else:
            assert slope == pytest.approx(0.0, abs=1e-6)
            assert abs(heading) == pytest.approx(1e-3 / np.cos(np.radians(50.0)), rel=1e-3)


def test_values_by_name_and_selections(tripod_errors: GeometricErrors) -> None:
    few = tripod_errors.select(["O_e.tz", "link1_tip.tz"])
    assert few.names == ("O_e.tz", "link1_tip.tz")
    np.testing.assert_array_equal(few.values({"link1_tip.tz": 2e-4}), [0.0, 2e-4])
    assert len(tripod_errors.without(few.names)) == 38
    for wrong in ({"nonsense": 1.0}, [1.0, np.nan], [1.0]):
        with pytest.raises(InvalidValueError):
            few.values(wrong)
    with pytest.raises(InvalidValueError, match="legs"):
        tripod_errors.indices("nonsense")


def test_errors_of_a_robot_that_is_loaded(tripod_errors: GeometricErrors) -> None:
    found = GeometricErrors.load(tripod_errors.robot)
    assert found.robot is tripod_errors.robot
    assert found.parameters == GeometricErrors.load("pm3dof").parameters


def test_samples_keep_their_tolerances(tripod_errors: GeometricErrors) -> None:
    rng = np.random.default_rng(5)
    normal = np.array([tripod_errors.sample(rng) for _ in range(4000)]) / tripod_errors.tolerances
    uniform = np.array([tripod_errors.sample(rng, "uniform") for _ in range(4000)]) / tripod_errors.tolerances
    np.testing.assert_allclose(normal.std(axis=0), 1.0, atol=0.06)
    np.testing.assert_allclose(uniform.std(axis=0), 1.0 / np.sqrt(3.0), atol=0.03)
    assert np.abs(uniform).max() <= 1.0
    assert normal.tobytes() != uniform.tobytes()


def test_they_travel_to_other_processes(tripod_errors: GeometricErrors) -> None:
    copy = pickle.loads(pickle.dumps(tripod_errors))
    assert copy.parameters == tripod_errors.parameters
    np.testing.assert_array_equal(copy.fixed_bearings, tripod_errors.fixed_bearings)


def test_bad_parameters_are_refused(mechanism: Robot) -> None:
    good = GeometricParameter("a", "O_e", "translation", (1.0, 0.0, 0.0), "tool", 1e-4)
    for changes, error in (
        ({"axis": (1.0, 1.0, 0.0)}, InvalidValueError),
        ({"tolerance": 0.0}, InvalidValueError),
        ({"place": "nowhere"}, FrameNotFoundError),
    ):
        with pytest.raises(error):
            GeometricErrors(mechanism, [GeometricParameter(**{**good.__dict__, **changes})])
    with pytest.raises(InvalidValueError, match="once"):
        GeometricErrors(mechanism, [good, good])


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("classes: {}", "classes"),
        ("klasses: {}", "klasses"),
        ("classes: {a: {length_tolerance_m: 1, angle_tolerance_rad: 0.1, errors: []}}", "errors"),
        ("classes: {a: {length_tolerance_m: -1, angle_tolerance_rad: 0.1, errors: [{at: b, rotation: x}]}}", "length"),
        ("classes: {a: {length_tolerance_m: 1, angle_tolerance_rad: 0.1, errors: [{at: b, rotation: w}]}}", "not 'w'"),
        ("classes: {a: {length_tolerance_m: 1, angle_tolerance_rad: 0.1, errors: [{at: b}]}}", "errors\\[0\\]"),
        (f"command_zeros: [a]\nclasses: {{a: {GOOD_CLASS}}}", "zeros"),
    ],
)
def test_bad_error_files_are_refused(text: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.errors.yaml"
    path.write_text(text)
    with pytest.raises(DescriptionError, match=place):
        read_error_file(path)
