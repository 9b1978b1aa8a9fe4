"""The folder of a calibration: atomic, reproducible byte for byte, loadable elsewhere; and its report."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from pm3dof_pin.calibration import workspace_errors
from pm3dof_pin.calibration.calibrate import Calibration, calibrate
from pm3dof_pin.calibration.folder import read_compensation
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import energy as pose_energy
from pm3dof_pin.exceptions import DescriptionError, OutputError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurement_file import read_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.registration import AT_THE_BASE
from pm3dof_pin.simulation.worlds import World


@pytest.fixture(scope="module")
def calibration(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> Calibration:
    world = World.random("everything", tripod_errors, np.random.default_rng(0))
    measured = world.measure(tripod_nominal.commands[:20], np.random.default_rng(1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace_errors, "_POINTS", 7)
        found = calibrate(measured, tripod_errors)
        assert found.workspace_errors is not None
    return found


pytestmark = pytest.mark.usefixtures("few_folds")


@pytest.fixture(scope="module")
def held_out(calibration: Calibration) -> HeldOut:
    assert calibration.held_out is not None
    return calibration.held_out


@pytest.fixture(scope="module")
def report(calibration: Calibration) -> str:
    return calibration.report()


@pytest.fixture(scope="module")
def folder(calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return calibration.save(tmp_path_factory.mktemp("results") / "calibration")


def test_what_is_read_corrects_the_same(calibration: Calibration, folder: Path, tripod_nominal: Poses) -> None:
    poses, conditions = tripod_nominal[100:110], {"temperature_screws_K": 3.0}
    again = read_compensation(folder)
    wanted = calibration.compensation.corrected(poses, conditions)
    np.testing.assert_array_equal(again.corrected(poses, conditions), wanted)
    expected = calibration.compensation.compensate(poses, conditions).predicted_error
    np.testing.assert_array_equal(again.compensate(poses, conditions).predicted_error, expected)


def test_a_calibration_in_a_frame_of_the_instrument_is_read_again(
    tripod_errors: GeometricErrors, tripod_nominal: Poses, tmp_path: Path
) -> None:
    commands, generator = tripod_nominal[:20].commands, np.random.default_rng(3)
    poses = tripod_errors.apply(tripod_errors.sample(generator)).forward(commands)
    measured = replace(Measurements.from_poses(commands, poses.transforms), registration=AT_THE_BASE)
    found = calibrate(measured, tripod_errors, "lm")
    again = read_compensation(found.save(tmp_path / "calibration"))
    np.testing.assert_array_equal(again.covariance, found.compensation.covariance)


def test_the_calibrated_urdf_is_the_calibrated_machine(
    calibration: Calibration, folder: Path, tripod_nominal: Poses
) -> None:
    poses = tripod_nominal[100:110]
    mechanism = Robot.load(folder / "calibrated" / "pm3dof.urdf")
    reached = mechanism.forward(poses.commands, guess=poses.q).transforms
    expected = calibration.compensation.model_poses(poses).transforms
    np.testing.assert_allclose(reached, expected, atol=1e-12)
    assert pin.buildModelFromUrdf(str(folder / "calibrated" / "pm3dof.urdf")).nv == 12


def test_the_energy_of_pose_errors_stands_beside_the_tip_error(
    calibration: Calibration, held_out: HeldOut, folder: Path, report: str
) -> None:
    """sqrt(a^2 + b^2) <= a + b <= sqrt(2) times that; as described it is that of the measured poses."""
    for tip, energy in zip((held_out.before, held_out.after, held_out.floor), held_out.energies, strict=True):
        assert np.all(tip <= energy * (1.0 + 1e-12))
        assert np.all(energy <= np.sqrt(2.0) * tip * (1.0 + 1e-12))
    measured = calibration.measurements[held_out.rows]
    nominal = calibration.compensation.errors.robot.forward(measured.commands)
    assert measured.rotations is not None
    seen = np.tile(np.eye(4), (len(measured), 1, 1))
    seen[:, :3, :3], seen[:, :3, 3] = measured.rotations, measured.positions
    expected = pose_energy(nominal.transforms, seen, calibration.options.eta)
    np.testing.assert_allclose(np.sort(held_out.energies[0]), np.sort(expected), rtol=1e-6)
    summary = yaml.safe_load((folder / "calibration.yaml").read_text())["held_out"]
    assert summary["energy_before_m"]["mean"] == pytest.approx(expected.mean(), rel=1e-6)
    assert "E of (8.15), corrected" in report


def test_the_summary_says_what_was_found(calibration: Calibration, folder: Path) -> None:
    summary = yaml.safe_load((folder / "calibration.yaml").read_text())
    found = calibration.identification
    assert summary["method"] == "lm+gp"
    assert summary["measurements"]["count"] == 20
    entry = summary["identification"]["parameters"]["O_e.tx"]
    place = found.errors.names.index("O_e.tx")
    assert entry == {
        "value": found.values[place],
        "sigma_of_the_data": found.data_sigmas[place],
        "sigma": found.sigmas[place],
        "tolerance": 1e-4,
        "unit": "m",
    }
    known = found.identifiability
    assert 0 < known.identified < known.rank == 40
    assert summary["identification"]["identifiable_combinations"] == known.identified
    assert len(summary["identification"]["says_nothing_about"]) == 40 - known.identified
    held_out = summary["held_out"]
    assert held_out["tip_error_floor_m"]["mean"] <= held_out["tip_error_after_m"]["mean"]
    assert held_out["tip_error_after_m"]["mean"] < 0.5 * held_out["tip_error_before_m"]["mean"]


def test_the_measurements_are_kept(calibration: Calibration, folder: Path, tripod_errors: GeometricErrors) -> None:
    again = read_measurements(folder / "measurements.csv", tripod_errors.robot)
    np.testing.assert_allclose(again.commands, calibration.measurements.commands, atol=1e-16)
    np.testing.assert_array_equal(again.positions, calibration.measurements.positions)


def test_the_same_bytes_again(
    calibration: Calibration,
    folder: Path,
    tmp_path: Path,
    tripod_errors: GeometricErrors,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(workspace_errors, "_POINTS", 7)
    again = calibrate(calibration.measurements, tripod_errors).save(tmp_path / "again")
    files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    for file in files:
        assert (folder / file).read_bytes() == (again / file).read_bytes(), file


def test_the_page_holds_its_pictures_and_numbers(report: str, held_out: HeldOut) -> None:
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', report)
    assert len(pictures) == 4
    assert all(base64.b64decode(picture).startswith(b"<?xml") for picture in pictures)
    assert not re.search(r"(src|href)=\"http", report)
    assert f"<td>{1e6 * held_out.after.mean():.1f}</td>" in report


def test_maps_know_before_after_and_the_floor(calibration: Calibration) -> None:
    maps = calibration.workspace_errors
    assert maps is not None
    inside = np.isfinite(maps.before)
    assert maps.names == ("theta_x", "theta_y")
    assert 5 < inside.sum() < 49
    np.testing.assert_array_equal(inside, np.isfinite(maps.after))
    assert maps.floor is not None
    assert np.all(maps.floor[inside] <= maps.before[inside])
    assert np.nanmean(maps.after) < 0.6 * np.nanmean(maps.before)


def test_a_section_out_of_reach_has_no_map(calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = calibration.compensation.errors.robot
    beyond = robot.grid(theta_x=(1.3, 1.4, 2), theta_y=(1.3, 1.4, 2))  # tilts are at most 45 degrees
    monkeypatch.setattr(workspace_errors, "section_grid", lambda robot, points: beyond)
    without = replace(calibration)
    assert without.workspace_errors is None
    assert "workspace" not in without.pictures()


def test_a_folder_is_replaced_whole_or_left_alone(calibration: Calibration, tmp_path: Path) -> None:
    target = tmp_path / "calibration"
    calibration.save(target)
    (target / "stale").write_text("")
    calibration.save(target)
    assert not (target / "stale").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["calibration"]

    other = tmp_path / "letters"
    other.mkdir()
    (other / "letter.txt").write_text("dear")
    with pytest.raises(OutputError, match="the path is taken"):
        calibration.save(other)
    assert [path.name for path in other.iterdir()] == ["letter.txt"]


def test_folders_that_are_no_calibration(folder: Path, calibration: Calibration, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"compensation\.json: file: expected a readable file"):
        read_compensation(tmp_path)
    (tmp_path / "compensation.json").write_text("{")
    with pytest.raises(DescriptionError, match="expected the compensation of a calibration"):
        read_compensation(tmp_path)
    target = calibration.save(tmp_path / "damaged")
    data = json.loads((target / "compensation.json").read_text()) | {"format": 1}
    del data["values"]
    (target / "compensation.json").write_text(json.dumps(data))
    with pytest.raises(DescriptionError, match="expected those of format 2"):
        read_compensation(target)


@pytest.mark.parametrize("name", ["compensation.json", "nominal/pm3dof.urdf", "nominal/pm3dof.closures.yaml"])
def test_a_changed_folder_is_refused_by_the_file(folder: Path, tmp_path: Path, name: str) -> None:
    """One digit of one number, a missing file, one file more, and checksums that are missing."""
    place = Path(shutil.copytree(folder, tmp_path / "copy"))
    text = (place / name).read_text()
    digit = max(text.rfind(number) for number in "123456789")
    (place / name).write_text(text[:digit] + "0" + text[digit + 1 :])
    with pytest.raises(DescriptionError, match=rf"{name}: SHA-256: was changed"):
        read_compensation(place)
    (place / name).write_text(text)
    read_compensation(place)
    (place / "report.html").unlink()  # nothing is computed from it
    (place / "nominal" / "robot.yaml").write_text("")
    with pytest.raises(DescriptionError, match=r"robot\.yaml: file: was added"):
        read_compensation(place)
    (place / "nominal" / "robot.yaml").unlink()
    (place / "nominal" / "pm3dof.srdf").unlink()
    with pytest.raises(DescriptionError, match=r"pm3dof\.srdf: file: is missing"):
        read_compensation(place)
    (place / "SHA256SUMS").unlink()
    with pytest.raises(DescriptionError, match="SHA256SUMS"):
        read_compensation(place)


def test_the_sums_are_those_of_other_tools(folder: Path) -> None:
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split("  ")
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


def test_a_folder_of_an_earlier_version_is_read(folder: Path, tmp_path: Path) -> None:
    place = Path(shutil.copytree(folder, tmp_path / "copy"))
    (place / "SHA256SUMS").unlink()
    data = json.loads((place / "compensation.json").read_text())
    (place / "compensation.json").write_text(json.dumps(data | {"format": 1}))
    np.testing.assert_array_equal(read_compensation(place).values, read_compensation(folder).values)


@pytest.mark.usefixtures("report_without_pictures")
def test_without_parameters_no_floor_is_drawn(calibration: Calibration, tripod_errors: GeometricErrors) -> None:
    learned = calibrate(calibration.measurements[:10], tripod_errors, "gp", on_refusal="keep")
    maps = learned.workspace_errors
    assert maps is not None
    assert maps.floor is None
    page = learned.report()
    assert "The part that no command corrects is not drawn" in page
    assert "The floor is the part that no command corrects" not in page
