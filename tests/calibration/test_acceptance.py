"""Tests of ISO 230 on made-up machines whose results follow by hand, and the report to sign."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.stats
import yaml

import pm3dof_pin as pm
from pm3dof_pin.calibration.acceptance import (
    AcceptanceResult,
    InstrumentErrors,
    evaluate_acceptance,
    planned_targets,
    write_acceptance_plan,
)
from pm3dof_pin.calibration.certificate import SCHEMA, Certificate
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, MeasurementError, UnreachablePoseError
from pm3dof_pin.measuring.export_file import ColumnMap
from pm3dof_pin.measuring.plan_file import read_plan

MICROMETRE = 1e-6
MACHINES = Path(__file__).parents[1] / "machines"


def _positions(path: Path, diagonals: int = 0) -> Path:
    """Five targets; means 0 .. 8 um upwards, 3 um more downwards; two runs, 1 um to either side."""
    rows = ["diagonal,target_mm,direction,deviation_um"] if diagonals else ["target_mm,direction,deviation_um"]
    for number in range(1, max(diagonals, 1) + 1):
        for k in range(5):
            for side in (1, -1):
                for run in (-1.0, 1.0):
                    value = number * (2.0 * k + (3.0 if side < 0 else 0.0) + run)
                    rows.append(",".join([*([str(number)] if diagonals else []), str(25.0 * k), str(side), str(value)]))
    path.write_text("\n".join(rows))
    return path


def test_drift_counts_by_the_time_between_readings(tmp_path: Path) -> None:
    """Two runs over five targets up and down: at the first, readings down come 9 of 19 steps later than those up."""
    path, once = tmp_path / "line.csv", [0.0, 0.1, 0.2, 0.3, 0.4]
    targets, sides = np.tile([*once, *once[::-1]], 2), np.tile(np.repeat([1.0, -1.0], 5), 2)
    deviations = np.where((targets == 0.0) & (sides > 0.0), 50e-6, 0.0)  # the greatest reversal, whatever else
    rows = np.column_stack([targets, sides, deviations]).tolist()
    text = "\n".join(",".join(map(repr, row)) for row in rows)
    path.write_text(f"target_m,direction,deviation_m\n{text}\n")
    found = evaluate_acceptance("positioning", path, instrument=InstrumentErrors(drift=1e-6))
    assert found.values["B"] == pytest.approx(50e-6)
    assert found.uncertainties["B"] == pytest.approx(2.0 * 1e-6 * 9.0 / 19.0, rel=0.1)


def test_positioning(tmp_path: Path) -> None:
    """With two runs at +-1 um the standard deviation is 2^(1/2) um: by hand from the definitions of ISO 230-2."""
    found = evaluate_acceptance("positioning", _positions(tmp_path / "line.csv")).values
    s = np.sqrt(2.0)
    expected = {"A": 11.0 + 4.0 * s, "E": 11.0, "M": 8.0, "R": 4.0 * s + 3.0, "B": 3.0}
    assert found == pytest.approx({name: value * MICROMETRE for name, value in expected.items()})


@pytest.mark.parametrize(
    "headings",
    ["target [mm],direction,deviation [um]", "Target mm,Direction,Deviation µm", "TARGET (mm);Direction;deviation_um"],
)
def test_headings_are_read_as_they_come(headings: str, tmp_path: Path) -> None:
    path = _positions(tmp_path / "line.csv")
    rows = path.read_text().splitlines()[1:]
    separator = ";" if ";" in headings else ","
    path.write_text("\n".join([headings, *(row.replace(",", separator) for row in rows)]), encoding="utf-8")
    found = evaluate_acceptance("positioning", path).values
    assert found["E"] == pytest.approx(11.0 * MICROMETRE)
    assert found["B"] == pytest.approx(3.0 * MICROMETRE)


def test_headings_of_a_circle_are_read_as_they_come(tmp_path: Path) -> None:
    """Radii of 100 mm but for one angle, 8 um longer, which hardly moves the centre of 36 angles."""
    rows = [f"{10 * k},1,{100.008 if k == 4 else 100.0}" for k in range(36)]
    path = tmp_path / "circle.csv"
    path.write_text("\n".join(["angle [deg],direction,Radius [mm]", *rows]))
    assert evaluate_acceptance("circular", path).values["G_ccw"] == pytest.approx(8.0 * MICROMETRE, rel=0.15)
    path.write_text("\n".join(["Angle,direction,radius_mm", *rows]))
    with pytest.raises(MeasurementError, match=r"Angle without a unit: expected headings such as Angle \[deg\]"):
        evaluate_acceptance("circular", path)
    given = ColumnMap({"Angle": "angle_deg"})
    assert evaluate_acceptance("circular", path, columns=given).values["G_ccw"] < 9.0 * MICROMETRE


@pytest.mark.parametrize("heading", ["target", "Target"])
def test_a_length_without_a_unit_is_refused(heading: str, tmp_path: Path) -> None:
    path = _positions(tmp_path / "line.csv")
    path.write_text(path.read_text().replace("target_mm", heading))
    with pytest.raises(MeasurementError, match=rf"line 1: {heading} without a unit: .* {heading} \[mm\]"):
        evaluate_acceptance("positioning", path)


def test_diagonals_are_judged_by_the_worst(tmp_path: Path) -> None:
    one = evaluate_acceptance("positioning", _positions(tmp_path / "line.csv")).values
    found = evaluate_acceptance("diagonals", _positions(tmp_path / "box.csv", 4)).values
    assert found == pytest.approx({name: 4.0 * value for name, value in one.items()})


def test_circular(tmp_path: Path) -> None:
    """An oval of +-5 um, out of centre by 20 um, 4 um larger clockwise."""
    angles = np.radians(np.arange(0.0, 360.0, 10.0))
    rows = ["angle_deg,direction,radius_m"]
    for side, more in ((1, 0.0), (-1, 4e-6)):
        radii = 0.1 + 20e-6 * np.cos(angles - 1.0) + 5e-6 * np.cos(2.0 * angles) + more
        rows += [f"{float(np.degrees(a))!r},{side},{r!r}" for a, r in zip(angles.tolist(), radii.tolist(), strict=True)]
    path = tmp_path / "circle.csv"
    path.write_text("\n".join(rows))
    found = evaluate_acceptance("circular", path, radius=0.1, instrument=InstrumentErrors(per_length=1e-5))
    expected = {"G_ccw": 10e-6, "F_max_ccw": 5e-6, "F_min_ccw": -5e-6}
    expected |= {"G_cw": 10e-6, "F_max_cw": 9e-6, "F_min_cw": -1e-6, "H": 4e-6}
    assert found.values == pytest.approx(expected, abs=1e-9)
    # 0.1 m times 10 um/m, twice
    assert found.uncertainties["F_max_ccw"] == pytest.approx(2e-6, rel=0.1)
    assert found.uncertainties["G_ccw"] < 1e-8


@pytest.mark.parametrize("arc", [360.0, 220.0])
def test_directions_are_compared_between_samples_too(tmp_path: Path, arc: float) -> None:
    """A ballbar's samples never lie at the same angles twice; there is nothing to compare outside its arc."""
    rows, generator = ["angle_deg,direction,radius_m"], np.random.default_rng(2)
    for side, more in ((1, 0.0), (-1, 4e-6)):
        angles = np.sort(generator.uniform(0.0, arc, 900))
        radii = 0.1 + 5e-6 * np.cos(np.radians(2.0 * angles)) + more
        rows += [f"{a!r},{side},{r!r}" for a, r in zip(angles.tolist(), radii.tolist(), strict=True)]
    path = tmp_path / "circle.csv"
    path.write_text("\n".join(rows))
    # linear in between, at most 3 degrees apart
    assert evaluate_acceptance("circular", path).values["H"] == pytest.approx(4e-6, abs=2e-8)


def test_probing_as_another_optimiser_fits_it(tmp_path: Path) -> None:
    points, _ = planned_targets("probing", (0.1, 0.2, 0.3, 0.0125))
    assert len(points) == 25
    assert (points[:, 2] >= 0.3 - 1e-12).all()
    seen = points + np.random.default_rng(0).normal(scale=3e-6, size=points.shape)
    path = tmp_path / "sphere.csv"
    path.write_text("x_m,y_m,z_m\n" + "\n".join(",".join(map(repr, row)) for row in seen.tolist()))

    def off(x: np.ndarray) -> np.ndarray:
        return 1e6 * (np.linalg.norm(seen - x[:3], axis=1) - x[3])

    best = scipy.optimize.least_squares(off, [0.1, 0.2, 0.3, 0.0125], xtol=1e-15, ftol=1e-15, x_scale=1e-6)
    found = evaluate_acceptance("probing", path, radius=0.0125).values
    assert found["P"] == pytest.approx(1e-6 * np.ptp(off(best.x)), rel=1e-6)
    assert found["size"] == pytest.approx(best.x[3] - 0.0125, abs=1e-10)


def test_noise_is_in_the_uncertainty(tmp_path: Path) -> None:
    """Of a reversal that is a difference of means of two readings each: 2 times 1 um, or more as it is a maximum."""
    path = _positions(tmp_path / "line.csv")
    found = evaluate_acceptance("positioning", path, instrument=InstrumentErrors(noise=1e-6))
    assert 1.5e-6 < found.uncertainties["B"] < 4e-6
    assert AcceptanceResult.read(_saved(found, tmp_path)) == found


def test_the_uncertainty_counts_what_noise_adds_to_a_maximum(tmp_path: Path) -> None:
    """Of readings without deviation: B is the greatest of five |differences of means|; its rms follows by quadrature.

    Each difference of means of two readings has the standard deviation of one reading.
    """
    path = tmp_path / "still.csv"
    rows = [f"{k},{side},0" for k in range(5) for side in (1, -1) for _ in range(2)]
    path.write_text("\n".join(["target_mm,direction,deviation_um", *rows]))
    found = evaluate_acceptance("positioning", path, instrument=InstrumentErrors(noise=1e-6))
    # E max^2 = int_0^inf P(max^2 > x) dx
    mean_square = scipy.integrate.quad(lambda x: 1.0 - scipy.stats.chi2.cdf(x, 1) ** 5, 0.0, np.inf)[0]
    assert found.values["B"] == 0.0
    assert found.uncertainties["B"] == pytest.approx(2e-6 * np.sqrt(mean_square), rel=0.1)  # 400 draws


def test_without_an_instrument_no_uncertainty_is_stated(tmp_path: Path, run: Callable[..., Any]) -> None:
    _positions(tmp_path / "line.csv")
    done = run("acceptance", "evaluate", "positioning", "line.csv", "--out", "line.json", cwd=tmp_path)
    assert "not stated" in done.stdout
    found = AcceptanceResult.read(tmp_path / "line.json")
    assert set(found.uncertainties.values()) == {None}
    assert "2 runs" in done.stderr
    assert "2 runs" in found.notes[0]
    assert found.as_data()["standard"] == "after ISO 230-2"


def test_five_runs_are_those_of_the_standard(tmp_path: Path) -> None:
    path = tmp_path / "line.csv"
    rows = [f"{k},{side},{run}" for k in range(5) for side in (1, -1) for run in range(5)]
    path.write_text("\n".join(["target_mm,direction,deviation_um", *rows]))
    found = evaluate_acceptance("positioning", path)
    assert (found.notes, found.standard) == ((), "ISO 230-2")


@pytest.mark.parametrize(("arc", "words"), [(360, ""), (220, "an arc of 219 degrees"), (120, "an arc of 119 degrees")])
def test_an_arc_is_named(arc: int, words: str, tmp_path: Path) -> None:
    path = tmp_path / "arc.csv"
    path.write_text("angle_deg,direction,radius_mm\n" + "\n".join(f"{k},1,{100 + 1e-4 * (k % 7)}" for k in range(arc)))
    found = evaluate_acceptance("circular", path)
    assert words in "; ".join(found.notes)
    assert bool(words) == bool(found.notes)
    assert found.standard == ("after ISO 230-4" if words else "ISO 230-4")


def _touches(path: Path, points: np.ndarray) -> Path:
    path.write_text("x_m,y_m,z_m\n" + "\n".join(",".join(map(repr, row)) for row in points.tolist()))
    return path


def test_touches_that_are_not_of_a_hemisphere_are_refused(tmp_path: Path) -> None:
    points, _ = planned_targets("probing", (0.1, 0.2, 0.3, 0.0125))
    path, centre = tmp_path / "sphere.csv", np.array([0.1, 0.2, 0.3])
    flat = points * (1.0, 1.0, 0.0) + np.arange(25.0)[:, None] * (1e-6, 0.0, 0.0)
    cap = centre + 0.0125 * ((cap := (points - centre) + (0.0, 0.0, 0.0125)) / np.linalg.norm(cap, axis=1)[:, None])
    for wrong, says in (
        (flat, "height is 0 % of their width"),
        (cap, "all over a hemisphere"),  # half of the polar angles: up to 45 degrees
        (points[:24], "24 touches, 24 of them distinct"),
        (np.tile(points[:1], (25, 1)), "25 touches, 1 of them distinct"),
    ):
        with pytest.raises(MeasurementError, match=says):
            evaluate_acceptance("probing", _touches(path, wrong))
    for radius in (0.125, 0.025):
        with pytest.raises(MeasurementError, match=f"radius of 0.0125 m as measured, nominally {radius} m"):
            evaluate_acceptance("probing", _touches(path, points), radius=radius)
    assert evaluate_acceptance("probing", path, radius=0.0125).values["size"] == pytest.approx(0.0, abs=1e-9)


def test_a_circle_of_another_radius_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "circle.csv"
    path.write_text("angle_deg,direction,radius_mm\n" + "\n".join(f"{10 * k},1,100" for k in range(36)))
    with pytest.raises(MeasurementError, match=r"radius of 0\.1 m as measured, nominally 0\.01 m"):
        evaluate_acceptance("circular", path, radius=0.01)


def test_diagonals_are_four_and_no_line(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match="has diagonals 1, 2, 3: expected the 4"):
        evaluate_acceptance("diagonals", _positions(tmp_path / "three.csv", 3))
    with pytest.raises(MeasurementError, match="has a column diagonal"):
        evaluate_acceptance("positioning", _positions(tmp_path / "box.csv", 4))


def _saved(found: AcceptanceResult, folder: Path) -> Path:
    path = folder / "result.json"
    path.write_text(json.dumps(found.as_data()))
    return path


@pytest.mark.parametrize(
    ("test", "place"), [("positioning", (-8e-3, 0, 0.13, 8e-3, 2e-3, 0.133)), ("circular", (0, 0, 0.13, 8e-3))]
)
def test_planned_commands_bring_the_tool_there(test: Any, place: tuple[float, ...], tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    points, columns = planned_targets(test, place, runs=2)
    path = write_acceptance_plan(robot, points, columns, tmp_path / "plan.csv")
    commands, _ = read_plan(path, robot)
    poses = robot.forward(commands)
    np.testing.assert_allclose(poses.positions, points, atol=1e-9)
    np.testing.assert_allclose(
        poses.rotations,
        np.broadcast_to(robot.configuration(robot.home.q).tool_placement.rotation, poses.rotations.shape),
        atol=1e-9,
    )


def test_a_tool_whose_orientation_follows_from_its_position(tmp_path: Path) -> None:
    """A five-bar with motors at (-0.1, 0) and (0.1, 0): its elbows are 0.25 m from these and 0.35 m from the pen."""
    robot = pm.load(MACHINES / "five_bar")
    points, columns = planned_targets("positioning", (-0.05, 0.41, 0.0, 0.05, 0.43, 0.0), runs=2)
    path = write_acceptance_plan(robot, points, columns, tmp_path / "plan.csv")
    commands, _ = read_plan(path, robot)
    angles = np.array([2.2823075170803215, 0.8592851365094715]) + commands
    for k, side in enumerate((-0.1, 0.1)):
        elbows = np.column_stack([side + 0.25 * np.cos(angles[:, k]), 0.25 * np.sin(angles[:, k])])
        np.testing.assert_allclose(np.linalg.norm(elbows - points[:, :2], axis=1), 0.35, rtol=1e-9)
    with pytest.raises(UnreachablePoseError):  # out of its plane
        write_acceptance_plan(robot, points + np.array([0.0, 0.0, 0.01]), columns, path)


@pytest.mark.parametrize("calibrated", [False, True])
def test_a_plan_beyond_the_limits_is_refused(calibrated: bool, calibration_folder: Path, tmp_path: Path) -> None:
    """The limits of the drives are those of z; two of five targets are above them."""
    known = pm.read_compensation(calibration_folder)
    robot = known.errors.robot
    z = next(coordinate for coordinate in robot.coordinates if coordinate.name == "z_e")
    high = float(robot.range_of(z)[1])
    points, columns = planned_targets("positioning", (0.0, 0.0, high - 0.06, 0.0, 0.0, high + 0.04), runs=2)
    path = tmp_path / "plan.csv"
    with pytest.raises(UnreachablePoseError, match=r"8 of 20 points break a limit, first point 4 at \(.*outside .* m"):
        write_acceptance_plan(robot, points, columns, path, known if calibrated else None)
    assert not path.exists()


def test_targets_come_from_both_sides() -> None:
    points, columns = planned_targets("diagonals", (0, 0, 0, 1, 1, 1), targets=5, runs=3)
    assert len(points) == 4 * 5 * 2 * 3
    for number in range(1, 5):
        own = columns["diagonal"] == number
        along = columns["target_m"][own]
        assert np.ptp(along) == pytest.approx(np.sqrt(3.0))
        # upwards, then downwards
        assert (np.diff(along[:5]) > 0.0).all()
        assert (np.diff(along[5:10]) < 0.0).all()
    with pytest.raises(InvalidValueError, match="6 finite numbers"):
        planned_targets("positioning", (0, 0, 0, 1))


@pytest.mark.parametrize(
    ("test", "text", "says"),
    [
        ("positioning", "target_m,direction,deviation_m\n0,1,0\n0,1,0", "has 1 targets"),
        ("positioning", "target_m,direction,deviation_m\n0,2,0", "line 2: direction is neither 1 nor -1"),
        ("positioning", "target_m,deviation_m\n0,0", "no column direction"),
        ("circular", "angle_deg,direction,radius_m\n0,1,0.1\n90,1,0.1", "fewer than 12 angles"),
        (
            "circular",
            "angle_deg,direction,radius_m\n" + "\n".join(f"{k},1,0.1" for k in range(60)),
            "an arc of 59 degrees ccw: expected the whole circle, or 90",
        ),
        ("probing", "x_m,y_m,z_m\n0,0,1\n0,1,0", "has 2 touches"),
    ],
)
def test_a_wrong_file_is_refused(test: Any, text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError, match=says):
        evaluate_acceptance(test, path)


_TRACKER = {"name": "Laser tracker", "serial_number": 750123}
ABOUT = {
    "date": "2026-03-01",
    "machine": {"name": "Tripod 7", "serial_number": "T-007"},
    "instrument": {"name": "Laser tracker", "serial_number": 750123, "certificate": "DKD-1 <2025>"},
    "temperature_C": [19.8, 20.3],
    "procedure": "40 poses by tracker, then the tests, all with corrected commands.",
    "signed_by": "A. B.",
}


def test_a_report_to_sign(calibration_folder: Path, tmp_path: Path, run: Callable[..., Any]) -> None:
    """Decisions by the rule of ISO 14253-1, worked out here; the JSON is as the schema says."""
    about, results = tmp_path / "about.yaml", tmp_path / "positioning.json"
    values, spread = {"A": 10e-6, "B": 5e-6, "R": 9e-6}, {"A": 2e-6, "B": 2e-6, "R": 2e-6}
    results.write_text(json.dumps(AcceptanceResult("positioning", values, spread, 20).as_data()))
    limits = {"positioning.A": 13e-6, "positioning.B": 6e-6, "positioning.R": 6e-6}
    written = ", ".join(f"{symbol}: {1e6 * limit:.0f}e-6" for symbol, limit in limits.items())  # a word in YAML 1.1
    about.write_text(yaml.safe_dump(ABOUT) + f"limits_m: {{{written}}}\n")
    done = run(
        "certificate",
        str(calibration_folder),
        "--about",
        "about.yaml",
        "--test",
        "positioning.json",
        "--out",
        "r",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    data = json.loads((tmp_path / "r" / "certificate.json").read_text())
    jsonschema.validate(data, json.loads((tmp_path / "r" / "certificate.schema.json").read_text()))
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    decisions = {each["symbol"]: each["decision"] for each in data["statements"]}
    assert decisions["positioning.A"] == "conforms"
    assert decisions["positioning.B"] == "undecided"
    assert decisions["positioning.R"] == "does not conform"
    assert decisions["tip.bound_95"] == "no limit"
    summary = yaml.safe_load((calibration_folder / "calibration.yaml").read_text())
    rms = next(each for each in data["statements"] if each["symbol"] == "tip.rms")
    low, high = summary["tip_error_rms_95_percent_interval_m"]
    assert rms["value_m"] - rms["expanded_uncertainty_k2_m"] == pytest.approx(low)
    assert rms["value_m"] + rms["expanded_uncertainty_k2_m"] == pytest.approx(high)
    page = (tmp_path / "r" / "certificate.html").read_text()
    assert "DKD-1 &lt;2025&gt;" in page
    assert "Not claimed" in page
    assert any("Other temperatures" in text for text in data["not_claimed"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"test_uncertainties_k2_m": {"A": -1.0}}, "uncertainty of A = -1.0: expected a finite number of at least 0"),
        ({"test_uncertainties_k2_m": {"A": float("nan")}}, "uncertainty of A = nan"),
        ({"test_uncertainties_k2_m": {"A": float("inf")}}, "uncertainty of A = inf"),
        ({"test_uncertainties_k2_m": {"A": "1e-6"}}, "uncertainty of A = 1e-6"),
        ({"test_uncertainties_k2_m": {"A": True}}, "uncertainty of A = True"),
        ({"test_uncertainties_k2_m": {}}, "expected those of"),
        ({"results_m": {"A": None}}, "result A = None: expected a finite number"),
        ({"test": "drilling"}, "expected one of positioning"),
        ({"readings": 0}, "readings = 0"),
    ],
)
def test_impossible_results_are_refused(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    path, right = tmp_path / "line.json", AcceptanceResult("positioning", {"A": 1e-5}, {"A": 1e-6}, 50)
    path.write_text(json.dumps(right.as_data()))
    assert AcceptanceResult.read(path) == right
    path.write_text(json.dumps(right.as_data() | change))
    with pytest.raises(DescriptionError, match=says):
        AcceptanceResult.read(path)


def test_tests_of_one_kind_are_told_apart(calibration_folder: Path, tmp_path: Path) -> None:
    results = []
    for name, value, notes in (("x", 10e-6, ()), ("y", 30e-6, ("as few as 2 runs",))):
        found = AcceptanceResult("positioning", {"A": value}, {"A": None}, 50, notes)
        (tmp_path / f"{name}.json").write_text(json.dumps(found.as_data()))
        results.append(AcceptanceResult.read(tmp_path / f"{name}.json"))
    about = tmp_path / "about.yaml"
    limits = {"positioning.x.A": 20e-6, "positioning.y.A": 20e-6}
    about.write_text(yaml.safe_dump(ABOUT | {"limits_m": limits, "decision_rule": "simple"}))
    data = Certificate.make(calibration_folder, about, results).data
    jsonschema.validate(data, SCHEMA)
    found_ = {each["symbol"]: each for each in data["statements"]}
    assert found_["positioning.x.A"]["decision"] == "conforms"
    assert found_["positioning.y.A"]["decision"] == "does not conform"
    assert found_["positioning.y.A"]["name"] == "positioning test y, A"
    assert "as few as 2 runs" in found_["positioning.y.A"]["source"]
    assert any("as few as 2 runs" in text for text in data["not_claimed"])
    with pytest.raises(InvalidValueError, match=r"several named positioning\.x"):
        Certificate.make(calibration_folder, about, [results[0], results[0]])
    # not stated: nothing is decided by the guarded rule
    about.write_text(yaml.safe_dump(ABOUT | {"limits_m": limits}))
    data = Certificate.make(calibration_folder, about, results).data
    assert {each["decision"] for each in data["statements"] if each["symbol"] in limits} == {"undecided"}


@pytest.mark.parametrize(
    ("rule", "factor", "decision"),
    [
        ("guarded", 1.01, "conforms"),
        ("guarded", 0.99, "undecided"),
        ("simple", 1.01, "conforms"),
        ("simple", 0.99, "does not conform"),
    ],
)
def test_a_bound_has_no_uncertainty_beside_it(
    rule: str, factor: float, decision: str, calibration_folder: Path, tmp_path: Path
) -> None:
    bound = yaml.safe_load((calibration_folder / "calibration.yaml").read_text())["tip_error_95_percent_bound_m"]
    about = tmp_path / "about.yaml"
    about.write_text(
        yaml.safe_dump(ABOUT | {"limits_m": {"tip.bound_95": factor * bound}, "decision_rule": rule}), encoding="utf-8"
    )
    found = Certificate.make(calibration_folder, about)
    stated = next(each for each in found.data["statements"] if each["symbol"] == "tip.bound_95")
    assert (stated["expanded_uncertainty_k2_m"], stated["decision"]) == (None, decision)
    assert "<td>included</td>" in found.as_html()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"date": None}, "date is missing"),
        ({"date": "1 March"}, "expected YYYY-MM-DD"),
        ({"date": "2026-02-30"}, "expected YYYY-MM-DD, a day of the calendar, not 2026-02-30"),
        ({"date": "２０２６-03-01"}, "expected YYYY-MM-DD"),
        ({"date": "20260301--"}, "expected YYYY-MM-DD"),
        (
            {"instrument": _TRACKER | {"calibrated_until": "2026-02"}},
            "until 2026-02, expected no day before 2026-03-01",
        ),
        ({"machine": _TRACKER | {"calibrated_until": "2026-02-28"}}, "machine.* until 2026-02-28, expected no day"),
        (
            {"instrument": _TRACKER | {"calibrated_until": "March 2027"}},
            "expected calibrated_until YYYY-MM-DD or YYYY-MM",
        ),
        ({"temperature_C": [20.3, 19.8]}, r"expected the lowest first, not \[20.3, 19.8\]"),
        ({"temperature_C": [-300.0, 19.8]}, "expected the lowest first"),
        ({"limits_m": {"tip.rms": "１e-4"}}, "positive numbers"),
        ({"date": "2026-13-45"}, "expected YYYY-MM-DD, a day of the calendar, not 2026-13-45"),
        ({"machine": {"name": "x"}}, "expected name and serial_number"),
        ({"machine": {"name": " ", "serial_number": "1"}}, "machine: name: expected words or a number, not ' '"),
        ({"machine": {"name": "x", "serial_number": None}}, "machine: serial_number: expected words .* not None"),
        ({"instrument": {"name": "x", "serial_number": ""}}, "instrument: serial_number: expected words"),
        ({"temperature_C": [30, 10]}, "the lowest first"),
        ({"temperature_C": [-300, 10]}, "expected"),
        ({"temperature_C": 20}, "lowest and highest"),
        ({"limits_m": {"tip.rms": -1.0}}, "positive numbers"),
        ({"limits_m": {"tip.best": 1.0}}, "expected symbols of statements, .*tip.rms.*; not tip.best"),
        ({"decision_rule": "generous"}, "simple or guarded"),
        ({"colour": "red"}, "not colour"),
        ({"procedure": " "}, "expected words"),
    ],
)
def test_a_wrong_description_is_refused(
    change: dict[str, Any], says: str, calibration_folder: Path, tmp_path: Path
) -> None:
    about = tmp_path / "about.yaml"
    about.write_text(yaml.safe_dump({key: value for key, value in (ABOUT | change).items() if value is not None}))
    with pytest.raises(DescriptionError, match=says):
        Certificate.make(calibration_folder, about)


@pytest.mark.parametrize("until", ["2026-03", "2026-03-01", "2027-01"])
def test_an_instrument_calibrated_until_then_is_signed_for(
    until: str, calibration_folder: Path, tmp_path: Path
) -> None:
    about = tmp_path / "about.yaml"
    about.write_text(yaml.safe_dump(ABOUT | {"instrument": _TRACKER | {"calibrated_until": until}}))
    assert Certificate.make(calibration_folder, about).data["instrument"]["calibrated_until"] == until


def test_a_changed_summary_is_not_signed(calibration_folder: Path, tmp_path: Path) -> None:
    about, summary = tmp_path / "about.yaml", calibration_folder / "calibration.yaml"
    about.write_text(yaml.safe_dump(ABOUT))
    text = summary.read_text()
    summary.write_text(text.replace("method: lm", "method: gp"))
    with pytest.raises(DescriptionError, match="was changed since the calibration was written"):
        Certificate.make(calibration_folder, about)
    summary.write_text(text)
    assert Certificate.make(calibration_folder, about).data["versions"]["pin"]
