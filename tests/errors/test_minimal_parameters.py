"""Minimal and complete sets of error parameters: as many as the rank of finite differences, as in textbooks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from pm3dof_pin.description.error_file import error_file_text, read_error_file
from pm3dof_pin.description.robots import find_robot, robot_names
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.minimal_parameters import error_entries, minimal_parameters
from pm3dof_pin.errors.pose_error import pose_difference
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot


@pytest.fixture(scope="module", params=robot_names())
def declared(request: pytest.FixtureRequest) -> GeometricErrors:
    return GeometricErrors.load(request.param)


@pytest.fixture(scope="module")
def everything(declared: GeometricErrors) -> GeometricErrors:
    others = [p for p in GeometricErrors(declared.robot).parameters if p.name not in declared.names]
    return GeometricErrors(declared.robot, [*declared.parameters, *others])


@pytest.fixture(scope="module")
def poses(declared: GeometricErrors) -> Poses:
    return reachable_poses(declared.robot, 60, np.random.default_rng(3))


def _by_differences(errors: GeometricErrors, poses: Poses, step: float = 1e-5) -> np.ndarray:
    """The tool's motion with each error on the closed machine, by central differences of solved loops."""
    columns = []
    for unit in step * np.eye(len(errors)):
        ahead, back = (errors.apply(p).forward(poses.commands, guess=poses.q).transforms for p in (unit, -unit))
        columns.append((pose_difference(back, ahead) * [1, 1, 1, 0.1, 0.1, 0.1]).ravel() / (2.0 * step))
    return np.array(columns).T * errors.tolerances


def test_the_files_of_robots_are_complete_and_without_redundancy(
    declared: GeometricErrors, everything: GeometricErrors, poses: Poses
) -> None:
    found = minimal_parameters(everything, poses, first=declared.names)
    assert found.names == declared.names
    np.testing.assert_array_equal(found.tolerances, declared.tolerances)  # as declared, whatever they stand for


def test_what_is_left_out_does_what_the_others_do(declared: GeometricErrors, poses: Poses) -> None:
    """Two errors missing in the tripod's file, by finite differences: up to 3e-4 of the greatest effect."""
    if declared.robot.name != "pm3dof":
        pytest.skip("one robot will do")
    shown = _by_differences(declared, poses[:15])
    assert np.linalg.matrix_rank(shown, tol=1e-8 * np.linalg.norm(shown, 2)) == len(declared) == 40
    others = GeometricErrors(declared.robot).select(["universal1_first_joint.tx", "platform_y_joint.rx", "O_e.ry"])
    extra = _by_differences(others, poses[:15])
    left = extra - shown @ np.linalg.lstsq(shown, extra, rcond=1e-10)[0]
    assert np.linalg.norm(left, axis=0).max() < 3e-4 * np.linalg.norm(shown, axis=0).max()


def test_as_many_as_the_rank_of_everything(mechanism: Robot) -> None:
    """In any order, as many as there are nonzero singular values of closed loops' finite differences."""
    few, everything = reachable_poses(mechanism, 24, np.random.default_rng(4)), GeometricErrors(mechanism)
    found = minimal_parameters(everything, few, least_effect=0.0)
    values = np.linalg.svd(_by_differences(everything, few, 1e-4), compute_uv=False)
    assert len(found) == 43
    assert values[42] > 1e-6 * values[0]
    assert values[43] < 0.03 * values[42]


def test_a_ur5_has_4r_plus_6(serial_arm: Robot) -> None:
    poses = serial_arm.forward(np.random.default_rng(0).uniform(-2.0, 2.0, (60, 6)))
    found = minimal_parameters(GeometricErrors(serial_arm), poses)
    assert len(found) == 4 * 6 + 6
    zeros = {f"{joint}.r{axis}" for joint, axis in zip(serial_arm.actuated_joints, _axes(serial_arm), strict=True)}
    kept = zeros.intersection(found.names)
    assert len(kept) == 6, "zeros of the drives come first"


def test_what_is_left_out_counts_in_what_is_kept(serial_arm: Robot) -> None:
    """Offsets along three parallel axes and up to the next are one of twice 0.1 mm; the poses scatter as with all."""
    poses = serial_arm.forward(np.random.default_rng(0).uniform(-2.0, 2.0, (60, 6)))
    everything = GeometricErrors(serial_arm)
    found = minimal_parameters(everything, poses)
    assert dict(zip(found.names, found.tolerances, strict=True))["shoulder_lift_joint.ty"] == 2e-4
    assert {p.group for p in found.parameters if p.tolerance == 2e-4} == {"tool_chain_200_um"}
    of_all, of_found, narrow = (
        np.linalg.norm(_by_differences(errors, poses[:20]))
        for errors in (everything, found, everything.select(found.names))
    )
    assert narrow < 0.94 * of_all < 0.95 * of_found < 0.98 * of_all


def test_a_joint_of_a_pair_of_rods_is_as_wide_as_its_four() -> None:
    """Each of them moves the platform as the left one on the carriage, some with others: the root of four."""
    errors = GeometricErrors.load("linear_delta")
    poses = reachable_poses(errors.robot, 12, np.random.default_rng(3))
    places = ("rod2_left_first_joint", "rod2_right_first_joint", "B2_left", "B2_right")
    ends = GeometricErrors(errors.robot).select(f"{place}.t{axis}" for place in places for axis in "xyz")
    shown = _by_differences(errors, poses) / errors.tolerances
    shares = np.linalg.lstsq(shown, _by_differences(ends, poses), rcond=1e-10)[0]
    for axis in "xz":
        own = errors.names.index(f"{places[0]}.t{axis}")
        assert np.linalg.norm(shares[own]) == pytest.approx(2e-4, rel=0.02)
        assert errors.tolerances[own] == 2e-4


def _axes(arm: Robot) -> list[str]:
    return ["xyz"[int(np.argmax(np.abs(arm.joint_axis(joint))))] for joint in arm.actuated_joints]


def test_a_file_is_written_and_read(declared: GeometricErrors, tmp_path: Path) -> None:
    text = error_file_text(error_entries(declared), comment="Found.\nSo.", command_zeros={"a": "b"})
    path = tmp_path / "x.errors.yaml"
    path.write_text(text)
    again = read_error_file(path)
    assert again.command_zeros == {"a": "b"}
    assert isinstance(yaml.safe_load(text)["classes"]["legs" if "legs" in declared.groups else "rods"], dict)
    without_zeros = tmp_path / "y.errors.yaml"
    without_zeros.write_text(error_file_text(error_entries(declared), comment="Found.", command_zeros={}))
    copy = GeometricErrors.from_file(declared.robot, without_zeros)
    assert {p: t for p, t in zip(copy.names, copy.tolerances, strict=True)} == {
        p: t for p, t in zip(declared.names, declared.tolerances, strict=True)
    }
    assert find_robot(declared.robot.name).errors.is_file()
