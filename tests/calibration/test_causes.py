"""The usual mistakes in measurement files are found by trial, and a calibration from them is refused."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.refusals import doubts, likely_cause, refusals
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import CalibrationRefusedError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.measurements import Measurements

pytestmark = pytest.mark.usefixtures("few_folds")

MIRROR = np.diag([1.0, -1.0, 1.0])
TURN = pin.exp3(np.array([0.02, 0.0, 0.0]))


@pytest.fixture(scope="module")
def measured(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> Measurements:
    truth = tripod_errors.sample(np.random.default_rng(8))
    reached = tripod_errors.apply(truth).forward(tripod_nominal[:20].commands, guess=tripod_nominal[:20].q)
    return Measurements.from_poses(reached.commands, reached.transforms)


def _from_row_10(measurements: Measurements, shift: float) -> Measurements:
    later = np.arange(len(measurements))[:, None] >= 10
    return replace(measurements, positions=measurements.positions + later * [shift, 0.0, 0.0])


MISTAKES: dict[str, tuple[Callable[[Measurements], Measurements], str]] = {
    "two drives": (lambda m: replace(m, commands=m.commands[:, [1, 0, 2]]), "u1 holds u2, u2 holds u1"),
    "all drives": (lambda m: replace(m, commands=m.commands[:, [1, 2, 0]]), "u1 holds u2, u2 holds u3, u3 holds u1"),
    "a row": (lambda m: replace(m, commands=np.roll(m.commands, 1, axis=0)), "1 row above their commands"),
    "left-handed": (
        lambda m: replace(m, positions=m.positions @ MIRROR, rotations=MIRROR @ m.rotations @ MIRROR),
        "the axes are mirrored: x, y, z of the base are their x, -y, z",
    ),
    "tool point": (
        lambda m: replace(m, positions=m.positions + m.rotations @ np.array([0.03, 0.0, 0.0])),
        r"the point seen is about \(30",
    ),
    "frame": (
        lambda m: replace(m, positions=m.positions @ TURN.T + [0.002, 0.0, 0.0], rotations=TURN @ m.rotations),
        "--own-frame",
    ),
    "frame, from some line on": (lambda m: _from_row_10(m, 0.03), r"from line 12 on the .* by about \(30"),
    "zero of a drive, seen by heights": (
        lambda m: replace(
            m,
            commands=m.commands + np.array([0.01, 0.0, 0.0]),
            rotations=None,
            sigmas=np.tile([np.inf, np.inf, 1e-5], (len(m), 1)),
            positions=m.positions + m.rotations[:, :, 0] * 0.1,
            points=np.tile([0.1, 0.0, 0.0], (len(m), 1)),
        ),
        "the zero of u1 is off by about (9.9|10)",
    ),
    "inches": (lambda m: replace(m, positions=m.positions / 25.4e-3), "in inches"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_found_by_trying(name: str, measured: Measurements, tripod_errors: GeometricErrors) -> None:
    spoil, words = MISTAKES[name]
    cause = likely_cause(spoil(measured), tripod_errors)
    assert re.search(f"most likely .*{words}", cause), cause


def test_where_nothing_is_wrong_there_is_no_cause_and_no_objection(
    measured: Measurements, tripod_errors: GeometricErrors
) -> None:
    assert likely_cause(measured, tripod_errors) == ""
    assert refusals(fit(measured, tripod_errors, Options("lm")), None) == []


def test_noise_in_a_direction_that_is_hardly_seen_is_no_residual(
    measured: Measurements, tripod_errors: GeometricErrors
) -> None:
    """Eight millimetres of noise in x, as in a camera's depth, of sigmas that say so."""
    sigmas, generator = np.tile(np.repeat([2e-4, 2e-3], 3), (len(measured), 1)), np.random.default_rng(6)
    sigmas[:, 0] = 8e-3
    noisy = measured.positions + generator.standard_normal(measured.positions.shape) * [8e-3, 0.0, 0.0]
    found = fit(replace(measured, positions=noisy, sigmas=sigmas), tripod_errors, Options("lm"))
    assert refusals(found, HeldOut.from_cross_validation(found)) == []


def test_a_frame_that_is_a_little_wrong_is_objected_to(measured: Measurements, tripod_errors: GeometricErrors) -> None:
    """Parameters can explain part of a rotated frame, but only by being many tolerances off."""
    spoil, _ = MISTAKES["frame"]
    reasons = refusals(fit(spoil(measured), tripod_errors, Options("lm")), None)
    assert len(reasons) == 1
    assert re.search("tolerances .* from the description|larger than the machine could be off", reasons[0])


def test_a_change_too_small_to_be_refused_is_named(measured: Measurements, tripod_errors: GeometricErrors) -> None:
    found = calibrate(_from_row_10(measured, 4e-4), tripod_errors, "lm")
    assert re.search("times the noise: most likely from line 12 on the (instrument|point)", " ".join(found.warnings))


def test_two_changes_that_explain_the_same_are_both_named() -> None:
    """The platform of a delta never turns, so that an instrument that has moved is another point of the tool."""
    errors, rng = GeometricErrors.load("linear_delta"), np.random.default_rng(2)
    sample = reachable_poses(errors.robot, 24, rng)
    reached = errors.apply(errors.sample(rng)).forward(sample.commands, guess=sample.q)
    seen = Measurements.from_poses(reached.commands, reached.transforms)
    moved = replace(seen, positions=seen.positions + rng.normal(0.0, 1e-5, seen.positions.shape))
    words = " ".join(calibrate(_from_row_10(moved, 1e-3), errors, "lm").warnings)
    assert re.search(r"most likely from line 1[1-3] on the .*, or from line 1[1-3] on the ", words), words
    assert "the instrument or the base has moved" in words
    assert "the point seen is elsewhere on the tool" in words


def test_a_bad_machine_is_no_mistake_in_its_file() -> None:
    """Parts are three tolerances off: another frame brings the poses nearer to the description, but not the parts."""
    errors, rng = GeometricErrors.load("three_rps"), np.random.default_rng(2)
    sample = reachable_poses(errors.robot, 24, rng)
    reached = errors.apply(3.0 * errors.sample(rng)).forward(sample.commands, guess=sample.q)
    seen = Measurements.from_poses(reached.commands, reached.transforms)
    noisy = replace(seen, positions=seen.positions + rng.normal(0.0, 1e-5, seen.positions.shape))
    found = fit(noisy, errors, Options("lm"))
    assert refusals(found, None) == []
    words = " ".join(doubts(found, noisy))
    assert "far from the description" in words
    assert "none of the usual mistakes explains it" in words.lower()


@pytest.mark.usefixtures("report_without_pictures")
def test_the_command_says_no_and_writes_nothing(
    run: Callable[..., Any], answer: Callable[..., dict[str, Any]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    answer("measure", "--poses", "12", "--world", "geometry", "--out", "m.csv", cwd=tmp_path)
    header, *rows = (tmp_path / "m.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    swapped = [",".join([b, a, *rest]) for a, b, *rest in cells]
    (tmp_path / "swapped.csv").write_text("\n".join([header, *swapped]) + "\n")
    (tmp_path / "one.csv").write_text("\n".join([header, rows[0]]) + "\n")
    refused = run("calibrate", "one.csv", "--method", "lm", "--out", "no", cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "one pose" in refused.stderr
    assert "no" not in os.listdir(tmp_path)
    forced = answer("calibrate", "swapped.csv", "--method", "lm", "--out", "no", "--force", cwd=tmp_path)
    assert "noise factor" in forced["forced_against"][0]
    assert "most likely the drives' columns are permuted" in forced["forced_against"][-1]
    assert "forced_against" in (tmp_path / "no" / "calibration.yaml").read_text()
    with pytest.raises(CalibrationRefusedError) as of_library:
        calibrate(tmp_path / "swapped.csv", "pm3dof", "lm")
    assert list(of_library.value.reasons) == forced["forced_against"]
    kept = calibrate(tmp_path / "swapped.csv", tripod_errors, "lm", on_refusal="keep")
    assert list(kept.refusals) == forced["forced_against"]


def test_what_explains_all_goes_before_what_is_simpler_and_leaves_more_than_the_tolerances() -> None:
    """A five-bar's pen measured 4 mm off in the plane moves nearly as in another base frame."""
    errors = closable(GeometricErrors.load(Path(__file__).parents[1] / "machines" / "five_bar"))
    rng = np.random.default_rng(0)
    poses = errors.robot.forward(errors.robot.home.commands + rng.uniform(-0.25, 0.25, (20, 2)))
    seen = Measurements.from_poses(poses.commands, poses.transforms)
    assert seen.rotations is not None
    shifted = seen.positions + seen.rotations @ np.array([0.003, -0.002, 0.0]) + rng.normal(0.0, 8e-6, (20, 3))
    cause = likely_cause(replace(seen, positions=shifted), errors)
    assert re.match(r"most likely the point seen is about \((2.9|3.0|3)\S*, -(2.0|1.9|2)", cause), cause


@pytest.mark.parametrize("count", [7, 41])
@pytest.mark.parametrize("stops", [(1.4e-3, -0.9e-3, 0.6e-3), (8e-3, 8e-3, 8e-3), (-14e-3, 0.0, 0.0)])
def test_touches_of_a_printer_with_end_stops_elsewhere_are_in_no_other_unit(
    count: int, stops: tuple[float, float, float]
) -> None:
    """Deviations of a bed's heights shrink with every smaller unit; that is no evidence of it."""
    errors, rng = GeometricErrors.load("linear_delta"), np.random.default_rng(0)
    home = errors.robot.home.tool_placement.translation
    radius, angle = 0.08 * np.sqrt(rng.uniform(0.0, 1.0, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, home[2])])
    touches = errors.apply(errors.sample(rng)).solve(errors.robot.solve(places).coordinates)
    heights = np.where([False, False, True], home[2] + rng.normal(0.0, 1e-5, (count, 1)), 0.0)
    sigmas = np.tile([np.inf, np.inf, 1e-5], (count, 1))
    measured = Measurements(touches.commands + stops, heights, None, sigmas, np.zeros((count, 3)))
    try:
        said = " ".join(calibrate(measured, errors, "lm").warnings)
    except CalibrationRefusedError as refused:
        said = str(refused)
        assert max(map(abs, stops)) > 10 * errors.tolerances[2], said
    assert not re.search("positions are in|lengths are|commands are in", said), said
    if stops == (-14e-3, 0.0, 0.0):
        assert re.search("the zero of u1 is off by about -1[34]", said), said
