"""Delta printers from files of their firmware, against trilateration and a textbook fit written here."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.interpolate
import scipy.optimize

import pm3dof_pin as pm
from pm3dof_pin.exceptions import CalibrationRefusedError, MeasurementError, OutputError, PM3DofError
from pm3dof_pin.printers.firmware import is_of_firmware, read_firmware
from pm3dof_pin.printers.m665 import GCodeLog
from pm3dof_pin.printers.printer_calibration import calibrate_printer
from pm3dof_pin.printers.touches import Touches

BASE = np.radians([210.0, 330.0, 90.0])
MICROSTEP = 40.0 / (200.0 * 16.0)  # [mm]


@dataclass(frozen=True)
class Delta:
    """A linear delta in millimetres and radians, by three spheres."""

    radius: float = 130.0
    angles: tuple[float, ...] = tuple(BASE)
    arms: tuple[float, ...] = (270.0, 270.0, 270.0)
    stops: tuple[float, ...] = (245.0, 245.0, 245.0)

    def nozzle(self, travels: np.ndarray) -> np.ndarray:
        arms, stops = np.array(self.arms), np.array(self.stops)
        heights = stops + np.sqrt(arms**2 - self.radius**2) - travels
        towers = self.radius * np.column_stack([np.cos(self.angles), np.sin(self.angles)])

        c = np.column_stack([towers, heights])
        first, second = c[1] - c[0], c[2] - c[0]
        length = np.linalg.norm(first)
        along = first / length
        across = second - (second @ along) * along
        across /= np.linalg.norm(across)
        i, j = along @ second, across @ second
        x = (arms[0] ** 2 - arms[1] ** 2 + length**2) / (2.0 * length)
        y = (arms[0] ** 2 - arms[2] ** 2 + i**2 + j**2) / (2.0 * j) - i / j * x
        return np.asarray(c[0] + x * along + y * across - np.sqrt(arms[0] ** 2 - x**2 - y**2) * np.cross(along, across))

    def travels(self, x: float, y: float, z: float = 0.0) -> np.ndarray:
        arms, stops = np.array(self.arms), np.array(self.stops)
        towers = self.radius * np.column_stack([np.cos(self.angles), np.sin(self.angles)])
        rise = np.sqrt(arms**2 - np.sum((towers - [x, y]) ** 2, axis=1))
        return np.asarray(stops + np.sqrt(arms**2 - self.radius**2) - z - rise)


def points(rings: tuple[tuple[float, int], ...] = ((50.0, 6), (95.0, 12))) -> np.ndarray:
    angles = [(r, 2.0 * np.pi * k / n) for r, n in rings for k in range(n)]
    return np.array([(0.0, 0.0), *((r * np.cos(a), r * np.sin(a)) for r, a in angles)])


def touched(truth: Delta, believed: Delta, at: np.ndarray, noise: np.random.Generator) -> np.ndarray:
    """Return the travels at which the nozzle meets the bed; the printer goes down where it believes the points are."""
    found = []
    for x, y in at:
        down = scipy.optimize.brentq(lambda z, x=x, y=y: truth.nozzle(believed.travels(x, y, z))[2], -5.0, 5.0)
        found.append(believed.travels(x, y, down) + noise.normal(0.0, 0.01))
    return np.array(found)


def klipper(believed: Delta, travels: np.ndarray, more: str = "") -> str:
    lines = ["[printer]", "kinematics: delta", f"delta_radius: {believed.radius}", "[bed_mesh]", "speed = 50"]
    for axis, angle, arm, stop in zip("abc", np.degrees(believed.angles), believed.arms, believed.stops, strict=True):
        lines += [f"[stepper_{axis}]", "microsteps: 16", "rotation_distance: 40  # belt", f"angle: {float(angle)!r}"]
        lines += [f"arm_length: {arm}", f"position_endstop: {stop}"]
    lines += ["#*# <---------------------- SAVE_CONFIG ---------------------->", "#*# [delta_calibrate]"]
    for k, row in enumerate(travels / MICROSTEP):
        lines += [f"#*# height{k} = 0.0", f"#*# height{k}_pos = {','.join(f'{value:.3f}' for value in row)}"]
    return "\n".join([*lines, more, ""])


def textbook(travels: np.ndarray, start: Delta, arms: int) -> Delta:
    """Fit radius, end stops, two angles and 0, 1 or 3 arm lengths, weakly held, by scipy."""

    def printer(x: np.ndarray) -> Delta:
        longer = np.zeros(3) if arms == 0 else np.resize(x[6:], 3)
        return Delta(
            start.radius + x[0],
            tuple(np.array(start.angles) + np.array([*(0.01 * x[4:6]), 0.0])),
            tuple(np.array(start.arms) + longer),
            tuple(np.array(start.stops) + x[1:4]),
        )

    def left(x: np.ndarray) -> np.ndarray:
        heights = [printer(x).nozzle(row)[2] / 0.025 for row in travels]
        sizes = np.array([3.0, 5.0, 5.0, 5.0, 2.0, 2.0, *[1.0] * arms])
        return np.concatenate([heights, x / sizes])

    return printer(np.asarray(scipy.optimize.least_squares(left, np.zeros(6 + arms), x_scale="jac").x))


TRUTH = Delta(131.2, tuple(BASE + np.radians([0.3, -0.2, 0.0])), (270.0, 270.0, 270.0), (245.6, 244.2, 244.9))


@pytest.fixture(scope="module")
def travels() -> np.ndarray:
    return touched(TRUTH, Delta(), points(), np.random.default_rng(0))


def test_the_robot_is_the_printer(tmp_path: Path) -> None:
    from pm3dof_pin.printers.printer_calibration import calibrate_printer as calibrate

    rows = np.array([TRUTH.travels(x, y) for x, y in points()])
    (tmp_path / "printer.cfg").write_text(klipper(Delta(), rows))
    found = calibrate(tmp_path / "printer.cfg")
    folder = found.save(tmp_path / "out")
    robot = pm.load(folder / "robot" / "printer.urdf")
    after = found.after
    mine = Delta(
        1e3 * after.radius, after.angles, tuple(1e3 * np.array(after.arms)), tuple(1e3 * np.array(after.end_stops))
    )
    reached = robot.forward(-1e-3 * rows).positions
    np.testing.assert_allclose(1e3 * reached, [mine.nozzle(row) for row in rows], atol=1e-6)
    # without noise the printer itself is found, apart from its arms
    assert after.radius == pytest.approx(1e-3 * TRUTH.radius, abs=2e-5)
    np.testing.assert_allclose(1e3 * np.array(after.end_stops), TRUTH.stops, atol=0.05)
    np.testing.assert_allclose(after.angles, TRUTH.angles, atol=5e-4)


def test_as_good_as_a_textbook_fit(travels: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "printer.cfg").write_text(klipper(Delta(), travels))
    found = calibrate_printer(tmp_path / "printer.cfg")
    folds = np.random.default_rng(1).permutation(np.arange(len(travels)) % 10)
    errors = {}
    for count, arms in ((6, 0), (7, 1), (9, 3)):
        parts = [
            [textbook(travels[folds != k], Delta(), arms).nozzle(row)[2] for row in travels[folds == k]]
            for k in range(10)
        ]
        errors[count] = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
    ours = {choice.count: 1e3 * np.sqrt(choice.mean_square) for choice in found.choices}
    for count, error in errors.items():
        assert ours[count] < 1.3 * error, (count, ours, errors)
    low, high = (1e3 * value for value in found.interval)
    assert 0.7 * low < errors[found.chosen.count] < 1.3 * high
    fresh = points(((30.0, 7), (80.0, 9)))
    after = found.after
    mine = Delta(
        1e3 * after.radius, after.angles, tuple(1e3 * np.array(after.arms)), tuple(1e3 * np.array(after.end_stops))
    )
    off = [TRUTH.nozzle(mine.travels(x, y))[2] for x, y in fresh]
    assert np.sqrt(np.mean(np.square(off))) < 2e-3 * 5.0  # half the noise of a touch: it averages
    assert found.gain > 20.0
    assert any("arm_a" in words for words in found.undetermined)


def test_standard_deviations_of_the_numbers(tmp_path: Path) -> None:
    """Against the covariance of a linear fit of all nine numbers, each known beforehand as well as by a ruler."""
    truth = replace(TRUTH, arms=(270.6, 270.4, 270.5))
    rows = touched(truth, Delta(), points(), np.random.default_rng(8))
    (tmp_path / "printer.cfg").write_text(klipper(Delta(), rows))
    found = calibrate_printer(tmp_path / "printer.cfg")

    def heights(x: np.ndarray) -> np.ndarray:
        printer = Delta(
            130.0 + x[0], tuple(BASE + np.array([*x[1:3], 0.0])), tuple(270.0 + x[3:6]), tuple(245.0 + x[6:])
        )
        return np.array([printer.nozzle(row)[2] for row in rows])

    slopes = np.array([(heights(step) - heights(-step)) / 2e-4 for step in 1e-4 * np.eye(9)])
    ruler = np.array([3.0, 0.02, 0.02, 1.0, 1.0, 1.0, 5.0, 5.0, 5.0])
    sigmas = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T / 0.025**2 + np.diag(ruler**-2.0))))
    places = {"radius": 0, "angle_a": 1, "angle_b": 2, "end_stop_a": 6, "end_stop_b": 7, "end_stop_c": 8}
    off = [truth.radius - 130.0, *(np.array(truth.angles) - BASE)[:2], *np.zeros(3), *(np.array(truth.stops) - 245.0)]
    assert found.chosen.count == 6
    for name, change in found.summary()["changes"].items():
        scale = 1.0 if change["unit"] == "rad" else 1e3
        assert scale * change["sigma"] == pytest.approx(sigmas[places[name]], rel=0.1), name
        assert abs(scale * change["value"] - off[places[name]]) < 3.0 * scale * change["sigma"], name
    stop = found.summary()["changes"]["end_stop_a"]
    assert stop["value"] == pytest.approx(found.after.end_stops[0] - 0.245)
    assert stop["sigma_of_the_data"] < 0.5 * stop["sigma"]


def test_distances_determine_the_arms(tmp_path: Path) -> None:
    truth, noise = replace(TRUTH, arms=(270.8, 270.8, 270.8)), np.random.default_rng(2)
    rows, lines = touched(truth, Delta(), points(), noise), []
    for k, (one, two) in enumerate((((-90.0, 0.0), (90.0, 0.0)), ((0.0, -90.0), (0.0, 90.0)))):
        ends = [Delta().travels(*place) for place in (one, two)]
        length = float(np.linalg.norm(truth.nozzle(ends[1]) - truth.nozzle(ends[0])))
        lines += [f"#*# distance{k} = {length:.4f}"]
        for number, end in enumerate(ends, start=1):
            lines.append(f"#*# distance{k}_pos{number} = {','.join(f'{v:.3f}' for v in end / MICROSTEP)}")
    (tmp_path / "printer.cfg").write_text(klipper(Delta(), rows, "\n".join(lines)))
    found = calibrate_printer(tmp_path / "printer.cfg")
    assert len(found.touches.distances) == 2
    before = np.array([truth.nozzle(Delta().travels(x, 0.0))[0] for x in (-90.0, 90.0)])
    after = found.after
    mine = Delta(
        1e3 * after.radius, after.angles, tuple(1e3 * np.array(after.arms)), tuple(1e3 * np.array(after.end_stops))
    )
    printed = np.array([truth.nozzle(mine.travels(x, 0.0))[0] for x in (-90.0, 90.0)])
    assert abs(np.ptp(printed) - 180.0) < 0.2 * abs(np.ptp(before) - 180.0)


def analysed(believed: Delta, truth: Delta, noise: np.random.Generator) -> str:
    """Return the twelve distances of DELTA_ANALYZE: along the spokes of its object, and along those of its pillars."""
    angles = np.radians([210.0, 270.0, 330.0, 30.0, 90.0, 150.0])
    spokes, lines = np.column_stack([np.cos(angles), np.sin(angles)]), []
    for k in range(12):
        along, pillar = (spokes[k], np.zeros(2)) if k < 6 else (spokes[(k - 4) % 6], 65.0 * spokes[k - 6])
        ends = [believed.travels(*(pillar + r * along)) for r in (4.5, 69.5)]
        length = float(np.linalg.norm(truth.nozzle(ends[1]) - truth.nozzle(ends[0]))) + noise.normal(0.0, 0.05)
        lines += [f"#*# distance{k} = {length:.4f}"]
        for number, end in enumerate(ends, start=1):
            lines.append(f"#*# distance{k}_pos{number} = {','.join(f'{v:.3f}' for v in end / MICROSTEP)}")
    return "\n".join(lines)


def test_touches_and_distances_have_noise_of_their_own() -> None:
    """A probe repeats to 25 um, a caliper to 50."""
    place = np.array([[-0.1, -0.1, -0.1], [-0.1, -0.11, -0.1]])
    touches = Touches.of(place, np.zeros(2), [(0.1, place[0], place[1])])
    np.testing.assert_allclose(touches.sigmas, [25e-6, 25e-6, 50e-6])


@pytest.mark.parametrize("longer", [0.0, 1.5])
def test_distances_count_where_the_bed_is_flat_already(longer: float, tmp_path: Path) -> None:
    """Calibrated from seven touches, all of which fit, a printer whose arms are longer prints 0.4 % too large."""
    truth, noise = replace(TRUTH, arms=(270.0 + longer,) * 3), np.random.default_rng(1)
    scattered = np.array([0.0, 90.2, 85.5, 80.8, 66.5, 71.2, 76.0])  # as DELTA_CALIBRATE goes
    spokes = np.radians([0.0, *np.arange(90.0, 450.0, 60.0)])
    rows = touched(truth, Delta(), scattered[:, None] * np.column_stack([np.cos(spokes), np.sin(spokes)]), noise)
    flat = textbook(rows, Delta(), 0)
    path = tmp_path / "printer.cfg"
    path.write_text(klipper(flat, rows, analysed(flat, truth, noise)))
    if not longer:
        with pytest.raises(CalibrationRefusedError, match=r"; distances by \d+ and \d+ µm: it is calibrated as well"):
            calibrate_printer(path)
        return
    found = calibrate_printer(path)
    assert found.chosen.count == 7

    def scale(printer: Delta) -> float:
        ends = [truth.nozzle(printer.travels(x, 0.0)) for x in (-60.0, 60.0)]
        return float(np.linalg.norm(ends[1] - ends[0])) / 120.0

    after = found.after
    mine = Delta(
        1e3 * after.radius, after.angles, tuple(1e3 * np.array(after.arms)), tuple(1e3 * np.array(after.end_stops))
    )
    assert abs(scale(flat) - 1.0) > 3e-3
    assert abs(scale(mine) - 1.0) < 5e-4
    # of held-out distances: the caliper's noise, and no more than a little of the fit's
    errors = found.summary()["distance_error_rms_m"]
    assert errors["before"] > 2e-4
    assert errors["after"] == pytest.approx(5e-5, rel=0.6)


def test_distances_stand_for_touches(tmp_path: Path) -> None:
    """Four touches and twelve distances carry the radius, end stops, angles and arms; three touches do not."""
    truth, noise = replace(TRUTH, arms=(271.5,) * 3), np.random.default_rng(0)
    rows = touched(truth, Delta(), points(((80.0, 3),)), noise)
    distances = analysed(Delta(), truth, noise)
    path = tmp_path / "printer.cfg"
    path.write_text(klipper(Delta(), rows, distances))
    after = calibrate_printer(path).after
    mine = Delta(
        1e3 * after.radius, after.angles, tuple(1e3 * np.array(after.arms)), tuple(1e3 * np.array(after.end_stops))
    )
    for printer, least in ((mine, 0.0), (Delta(), 0.3)):
        off = [truth.nozzle(printer.travels(x, y))[2] for x, y in points(((30.0, 7), (80.0, 9)))]
        assert least <= float(np.sqrt(np.mean(np.square(off)))) < least + 0.05 + least
    path.write_text(klipper(Delta(), rows[:3], distances))
    with pytest.raises(CalibrationRefusedError, match="3 touches and 12 distances for 6 parameters: touch at least 4"):
        calibrate_printer(path)


def test_the_new_file_replaces_the_old_numbers(travels: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "printer.cfg"
    path.write_text(klipper(Delta(), travels))
    found = calibrate_printer(path)
    text = (found.save(tmp_path / "out") / "printer.cfg").read_text()
    again = read_firmware(path, text)
    printer = again.printer()
    for name in ("radius", "angles", "arms", "end_stops"):
        np.testing.assert_allclose(getattr(printer, name), getattr(found.after, name), atol=2e-9, rtol=1e-8)
    np.testing.assert_array_equal(again.touches(printer).travels, found.touches.travels)
    assert "#delta_radius: 130.0" in text
    assert "\nspeed = 50" in text
    assert text.count("delta_radius = ") == 1
    with pytest.raises(OutputError, match="another folder"):
        found.save(tmp_path)
    (tmp_path / "saved.cfg").write_text(text)  # now it is as good as these touches tell
    with pytest.raises(CalibrationRefusedError, match="as well as these touches tell"):
        calibrate_printer(tmp_path / "saved.cfg")
    assert calibrate_printer(tmp_path / "saved.cfg", on_refusal="keep").gain < 1.0


def test_included_files_are_read_and_stay_as_they_are(travels: np.ndarray, tmp_path: Path) -> None:
    path, text = tmp_path / "printer.cfg", klipper(Delta(), travels)
    motors = "".join(f"[stepper_{axis}]\nmicrosteps: 16\nrotation_distance: 40  # belt\n" for axis in "abc")
    apart = re.sub("(microsteps|rotation_distance): .*\n", "", text)
    path.write_text(f"[include more/*.cfg]\n[include /etc/passwd]\n[include ../*]\n{apart}")
    with pytest.raises(MeasurementError, match=r"rotation_distance is missing; it includes more/\*\.cfg, .* not found"):
        calibrate_printer(path)
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "motors.cfg").write_text(motors)
    whole = tmp_path / "whole.cfg"
    whole.write_text(text)
    assert calibrate_printer(path).after == calibrate_printer(whole).after
    (tmp_path / "more" / "motors.cfg").write_text(f"{motors}[include ../printer.cfg]\n")
    with pytest.raises(MeasurementError, match="include itself"):
        calibrate_printer(path)
    (tmp_path / "more" / "motors.cfg").write_text(f"{motors}[printer]\ndelta_radius: 130\n")
    found = calibrate_printer(path)
    with pytest.raises(MeasurementError, match=r"delta_radius stands in motors\.cfg"):
        found.save(tmp_path / "out")


def test_the_section_of_the_printer_may_be_included(travels: np.ndarray, tmp_path: Path) -> None:
    """Written numbers are saved in the file itself, where they hold as long as no file that is included has them."""
    path, own = tmp_path / "printer.cfg", "[printer]\nkinematics: delta\ndelta_radius: 130.0\n"
    included = klipper(Delta(), travels).replace(own, "[include kin*.cfg]\n")
    file = read_firmware(path, included)
    with pytest.raises(MeasurementError, match=r"\[printer\] kinematics is missing; it includes kin\*\.cfg, not found"):
        file.printer()
    (tmp_path / "kin1.cfg").write_text("[printer]\nkinematics: delta\n")
    saved = included + "#*# [printer]\n#*# delta_radius = 130.0\n"
    file = read_firmware(path, saved)
    printer = replace(file.printer(), radius=0.1312)
    assert read_firmware(path, file.with_printer(printer)).printer().radius == pytest.approx(0.1312)
    (tmp_path / "kin2.cfg").write_text("[printer]\ndelta_radius: 131\n")
    file = read_firmware(path, saved)
    assert file.printer().radius == pytest.approx(0.131)  # over the saved one, as in Klipper
    with pytest.raises(MeasurementError, match=r"delta_radius stands in kin2\.cfg"):
        file.with_printer(printer)


@pytest.mark.parametrize("lost", [r"#\*# height3 = .*\n", r"#\*# height3(_pos)? = .*\n"])
def test_touches_with_a_number_missing_are_refused(lost: str, travels: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "printer.cfg").write_text(re.sub(lost, "", klipper(Delta(), travels)))
    with pytest.raises(MeasurementError, match="height3 is missing"):
        calibrate_printer(tmp_path / "printer.cfg")


def test_steps_of_one_drive_are_those_of_all_and_comments_are_none(travels: np.ndarray, tmp_path: Path) -> None:
    text = re.sub("(microsteps|rotation_distance): .*\n", "", klipper(Delta(), travels))
    (tmp_path / "printer.cfg").write_text(text.replace("[stepper_a]", f"[stepper_a]\nstep_distance: {MICROSTEP}"))
    usual = klipper(Delta(), travels).replace("angle: 90.0", "angle: 90.0 ; of the third tower")
    (tmp_path / "usual.cfg").write_text(usual)
    one, other = (calibrate_printer(tmp_path / name).after for name in ("printer.cfg", "usual.cfg"))
    np.testing.assert_allclose(one.end_stops, other.end_stops, rtol=1e-9)
    log = tmp_path / "bed.log"
    log.write_text("; not a [printer] of Klipper\nM665 L270 R130 H245\nM666 X0 Y0 Z0\n")
    assert read_firmware(log, log.read_text()).firmware == "RepRapFirmware"


@pytest.mark.parametrize("kept", [7, 19])
def test_one_wrong_touch_is_named(kept: int, tmp_path: Path) -> None:
    """Ten millimetres more of one drive: seven touches are too few to fit without it, nineteen are enough."""
    travels = touched(TRUTH, TRUTH, points()[:kept], np.random.default_rng(3))
    travels[4, 1] += 10.0
    (tmp_path / "printer.cfg").write_text(klipper(TRUTH, travels))
    with pytest.raises(CalibrationRefusedError, match="touch 4, counted from 0, is off by"):
        calibrate_printer(tmp_path / "printer.cfg")


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("R130", "R130,5", 1),
        ("H245", "H2.45e2", 1),
        ("X0.1", "X0.1mm", 2),
        ("Z: 0.02", "Z: nan", 5),
        ("Z: 0.02", "Z: 0,02", 5),
    ],
)
def test_words_that_are_no_numbers_are_refused(right: str, wrong: str, line: int, tmp_path: Path) -> None:
    probed = [f"Bed X: {10 * k}.0 Y: 0.0 Z: 0.0{k}" for k in range(8)]
    text = "\n".join(["Send: M665 L270 R130 H245 (mm)*71", "Send: M666 X0.1 Y0 Z0 ; M665, M666", *probed])
    path = tmp_path / "printer.log"
    file = read_firmware(path, text.replace("*71", ""))
    assert len(file.touches(file.printer())) == 8
    assert read_firmware(path, text.replace("(mm)", " ")).printer() == file.printer()
    with pytest.raises(MeasurementError, match=f"line {line}: .*expected"):
        read_firmware(path, text.replace(right, wrong))


def test_a_rotary_delta(tmp_path: Path) -> None:
    """Elbows of upper arms about shoulders, then three spheres."""
    angles, upper, lower = np.radians([30.0, 150.0, 270.0]), 170.0, 320.0

    def elbows(height: float, turns: np.ndarray) -> np.ndarray:
        out = 33.9 + upper * np.cos(turns)
        return np.column_stack([out * np.cos(angles), out * np.sin(angles), height + upper * np.sin(turns)])

    def turns(height: float, place: list[float], k: int) -> float:
        def miss(turn: float) -> float:
            return float(np.linalg.norm(elbows(height, np.full(3, turn))[k] - place) - lower)

        return float(scipy.optimize.brentq(miss, -1.4, 1.2))

    truth = 414.1, np.array([turns(414.1, [0, 0, stop], k) for k, stop in enumerate((252.8, 251.1, 252.4))])
    described = np.array([turns(412.9, [0, 0, 252.0], k) for k in range(3)])
    lines = ["[printer]", "kinematics: rotary_delta", "shoulder_radius: 33.9", "shoulder_height: 412.9"]
    for axis in "abc":
        lines += [f"[stepper_{axis}]", "gear_ratio: 107:16, 60:16", "microsteps: 16", "position_endstop: 252"]
        lines += [f"upper_arm_length: {upper}", f"lower_arm_length: {lower}"]
    lines += ["#*# [delta_calibrate]"]
    step = 2.0 * np.pi / (200 * 16 * 107 / 16 * 60 / 16)
    for number, (x, y) in enumerate(points(((40.0, 6), (70.0, 6)))):

        def height(z: float, x: float = x, y: float = y) -> np.ndarray:
            down = np.array([turns(412.9, [x, y, z], k) for k in range(3)]) - described
            centres = elbows(truth[0], truth[1] + down)
            return np.array(
                [*scipy.optimize.fsolve(lambda p: np.linalg.norm(centres - p, axis=1) - lower, [x, y, z]), *down]
            )

        z = scipy.optimize.brentq(lambda z: height(z)[2], -8.0, 8.0)
        lines += [
            f"#*# height{number} = 0",
            f"#*# height{number}_pos = {','.join(f'{-v / step:.3f}' for v in height(z)[3:])}",
        ]
    (tmp_path / "printer.cfg").write_text("\n".join(lines))
    found = calibrate_printer(tmp_path / "printer.cfg")
    assert found.heights_before.std() > 1e-4
    assert np.abs(found.heights_after).max() < 5e-6
    text = found.file.with_printer(found.after)
    assert read_firmware(tmp_path / "x.cfg", text).printer().shoulder_height == pytest.approx(
        found.after.shoulder_height
    )


@pytest.mark.parametrize("arms", [(270.0, 270.0, 270.0), (270.6, 269.5, 270.2)])
@pytest.mark.parametrize("firmware", ["RepRapFirmware", "Marlin"])
def test_logs_of_g_code(firmware: str, arms: tuple[float, ...], tmp_path: Path) -> None:
    """Heights at which a printer touches the bed where its own numbers say z; end stops are corrected in both signs."""
    sign = 1.0 if firmware == "RepRapFirmware" else -1.0
    believed = Delta(130.0, tuple(BASE + np.radians([0.1, 0.0, 0.0])), arms, stops=(245.2, 245.0, 245.5))
    truth, noise = replace(TRUTH, arms=arms), np.random.default_rng(5)
    at, heights = points(), []
    for x, y in at:
        z = scipy.optimize.brentq(lambda z, x=x, y=y: truth.nozzle(believed.travels(x, y, z))[2], -5.0, 5.0)
        heights.append(z + noise.normal(0.0, 0.01))
    lengths, trims = ":".join(map(str, arms)), ""
    if firmware == "Marlin":
        lengths, trims = "270", "".join(f" {name}{arm - 270:.1f}" for name, arm in zip("ABC", arms, strict=True))
    lines = [f"M665 L{lengths} R130 H245 X0.1 Y0 Z0{trims}", f"M666 X{sign * 0.2} Y0 Z{sign * 0.5} ; end stops"]
    if firmware == "Marlin":
        lines += [f"Bed X: {x:.6f} Y: {y:.6f} Z: {z:.6f}" for (x, y), z in zip(at, heights, strict=True)]
    else:
        lines += [f"G30 P{k} X{x:.6f} Y{y:.6f} Z-99999" for k, (x, y) in enumerate(at)]
        lines += [f"G32 bed probe heights: {' '.join(f'{z:.6f}' for z in heights)}, mean 0.1, deviation from mean 0.2"]
    (tmp_path / "log.g").write_text("\n".join(lines))
    found = calibrate_printer(tmp_path / "log.g")
    assert found.file.firmware == firmware
    assert found.after.radius == pytest.approx(1e-3 * TRUTH.radius, abs=3e-4)
    again = read_firmware(
        tmp_path / "log.g", found.file.with_printer(found.after) + "Bed X: 0 Y: 0 Z: 0" * (sign < 0.0)
    )
    written = re.search(r"M666 X(\S+) Y(\S+) Z(\S+)", found.file.with_printer(found.after))
    assert written is not None
    corrections = [float(value) for value in written.groups()]
    if firmware == "Marlin":  # which refuses others, as carriages only move back
        assert max(corrections) == 0.0
    else:
        assert sum(corrections) == pytest.approx(0.0, abs=2e-4)
    np.testing.assert_allclose(again.printer().end_stops, found.after.end_stops, atol=1e-7)
    np.testing.assert_allclose(again.printer().angles, found.after.angles, atol=1e-5)
    np.testing.assert_allclose(again.printer().arms, found.after.arms, atol=1e-7)
    np.testing.assert_allclose(np.ptp(found.after.arms), 1e-3 * np.ptp(arms), atol=2e-4)


CIRCLE = {"x": 210.0, "y": 330.0, "z": 90.0, "yz": 30.0, "zx": 150.0, "xy": 270.0}


def g33(believed: Delta, settings: str, radius: float) -> str:
    """Return what G33 V0 prints of the true printer that believes itself another one."""

    def height(r: float, angle: float) -> float:
        x, y = r * np.cos(np.radians(angle)), r * np.sin(np.radians(angle))
        return scipy.optimize.brentq(lambda z: TRUTH.nozzle(believed.travels(x, y, z))[2], -5.0, 5.0)

    centre = np.mean([height(0.1 * radius, CIRCLE[tower]) for tower in "xyz"])
    found = {"c": centre} | {name: height(radius, angle) for name, angle in CIRCLE.items()}
    signed = {name: f"{name}:{value:+.2f}" if round(value, 2) else f"{name}: 0.00" for name, value in found.items()}
    towers, opposite = ("  ".join(signed[name] for name in names) for names in ("cxyz", ("yz", "zx", "xy")))
    return f"{settings}\n.      {towers}\n.                 {opposite}\nEnd DRY-RUN          std dev:0.306\n"


def test_reports_of_g33(tmp_path: Path) -> None:
    """Three circles that Marlin 2 probed with the same settings; what it reports afterwards is of other settings."""
    believed = Delta(130.0, tuple(BASE + np.radians([0.1, 0.0, 0.0])), (270.0,) * 3, stops=(245.2, 245.0, 245.5))
    before = ".Height:245.00  Ex:-0.20  Ey: 0.00  Ez:-0.50  Radius:130.00\n.             Tx:+0.10  Ty: 0.00  Tz: 0.00"
    older = (
        ".Height:245.00  Ex:-0.20  Ey: 0.00  Ez:-0.50  Radius:130.00\n.Tower angle :    Tx:+0.10  Ty: 0.00  Tz: 0.00"
    )
    after = ".Height:244.20  Ex:-0.90  Ey: 0.00  Ez:-0.10  Radius:131.00\n.             Tx:+0.20  Ty: 0.00  Tz: 0.00"
    text = "echo:  M665 L270.00 R99.00 H240.00 S100 X0.00 Y0.00 Z0.00 A0.00 B0.00 C0.00\n"
    text += "Send: G33 P3 V3\nChecking... AC at radius:90.00\n"
    text += f"{after}\n.      c:+0.50  x:+0.50  y:+0.50  z:+0.50\n.   yz:+0.50  zx:+0.50  xy:+0.50\n"
    for radius in (90.0, 70.0, 45.0):
        text += f"G33 P3 V0 R{90 - radius:g}\nG33 Auto Calibrate\nChecking... AC at radius:{radius:.2f} (DRY-RUN)\n"
        text += g33(believed, before if radius > 60.0 else older, radius)
    path = tmp_path / "marlin.log"
    path.write_text(
        text + f"Calibration OK       rolling back.\n{after}\nSave with M500 and/or copy to Configuration.h\n"
    )
    found = calibrate_printer(path)
    assert (found.file.firmware, len(found.heights_before)) == ("Marlin", 21)
    np.testing.assert_allclose(1e3 * np.array(found.before.end_stops), [245.2, 245.0, 245.5], atol=1e-9)
    assert np.degrees(found.before.angles[0]) == pytest.approx(210.1)
    assert found.after.radius == pytest.approx(1e-3 * TRUTH.radius, abs=4e-4)
    # its centre is the mean of three touches a tenth of the circle away, and all are rounded
    assert np.abs(found.heights_after).max() < 2e-5 < 1e-4 < np.abs(found.heights_before).max()


def test_marlin_1_has_one_arm_length_and_a_radius_of_g33(tmp_path: Path) -> None:
    """The B of its M665 is no trim of an arm; its G33 has no R."""
    believed = Delta(130.0, tuple(BASE), (270.0,) * 3, stops=(245.0, 245.0, 245.0))
    settings = (
        ".Height:245.00  Ex: 0.00  Ey: 0.00  Ez: 0.00  Radius:130.00\n.Tower angle :    Tx: 0.00  Ty: 0.00  Tz: 0.00"
    )
    text = "M665 L270.00 R130.00 H245.00 S100.00 B90.00 X0.00 Y0.00 Z0.00\nM666 X0.00 Y0.00 Z0.00\n>>> G33 P3 V0 R10\n"
    file = read_firmware(tmp_path / "marlin.log", text + g33(believed, settings, 90.0))
    assert file.most_parameters == 7
    printer = file.printer()
    np.testing.assert_allclose(printer.arms, 0.27)
    assert np.abs(file.touches(printer).travels - printer.drives(np.zeros((7, 3)))).max() > 0.0
    x, y = 90.0 * np.cos(np.radians(210.0)), 90.0 * np.sin(np.radians(210.0))
    z = scipy.optimize.brentq(lambda z: TRUTH.nozzle(believed.travels(x, y, z))[2], -5.0, 5.0)
    expected = -1e-3 * np.array(believed.travels(x, y, round(z, 2)))
    np.testing.assert_allclose(file.touches(printer).travels[1], expected, atol=1e-9)
    written = file.with_printer(printer)
    assert "B90" in written
    assert " A" not in written
    assert " C" not in written


@pytest.mark.parametrize(
    ("command", "report", "radius", "expected"),
    [
        ("G33 P3 V0", "Checking... AC (DRY-RUN)", "B75", 75.0),
        ("G33 P3 V0 R60", "Checking... AC (DRY-RUN)", "B75", 60.0),
        ("G33 P3 V0 R60", "Checking... AC (DRY-RUN)", "A0 B0 C0", 60.0),
        ("g33p3v0r60", "Checking... AC (DRY-RUN)", "", 60.0),
        ("G33 P3 V0 R60", "Checking... AC at radius:15.00 (DRY-RUN)", "A0 B0 C0", 15.0),
        ("G33 P3 V0 R60", ".Tower angle :    Tx:+0.00  Ty:+0.00  Tz:+0.00", "B75", 75.0),
    ],
)
def test_the_radius_of_g33(command: str, report: str, radius: str, expected: float, tmp_path: Path) -> None:
    """Versions of Marlin that print no radius take R for it, those that print it take R off, and old ones have no R."""
    text = f"M665 L270 R130 H245 {radius}\n{command}\n{report}\n.      c:+0.03     x:+0.32   y:+0.34   z:+0.41\n"
    probed = GCodeLog.parse(tmp_path / "marlin.log", text).probed
    assert [np.hypot(x, y) for x, y, _ in probed] == pytest.approx([0.0, expected, expected, expected])


def test_circles_of_marlin_1(tmp_path: Path) -> None:
    """M665 with B alone chooses another circle, and keeps what was probed on the first; other numbers do not."""
    heights = "G33 P3 V0\n.      c:+0.03     x:+0.32   y:+0.34   z:+0.41\n"
    text = f"M665 L270 R130 H245 B75\n{heights}M665 B60\n{heights}"
    probed = GCodeLog.parse(tmp_path / "marlin.log", text).probed
    assert [np.hypot(x, y) for x, y, _ in probed] == pytest.approx([0.0, 75.0, 75.0, 75.0, 0.0, 60.0, 60.0, 60.0])
    for other in ("M665 B60 R131", "M665 A0.1 B0 C0"):
        assert not GCodeLog.parse(tmp_path / "marlin.log", text + other).probed


@pytest.mark.parametrize(
    ("command", "radius", "problem"),
    [
        ("G33 P4 V0", "B80", "G33 P4: heights that may be averages"),
        ("G33 V0", "B80", "G33 without P"),
        ("G33 P3 V0", "", "unknown radius"),
        ("G33 P3 V0", "A0 B0 C0", "unknown radius"),  # trims of Marlin 2
    ],
)
def test_heights_of_g33_at_no_known_place(command: str, radius: str, problem: str, tmp_path: Path) -> None:
    text = f"M665 L270 R130 H245 {radius}\n{command}\n.      c:+0.03     x:+0.32   y:+0.34   z:+0.41\n"
    with pytest.raises(MeasurementError, match=problem):
        read_firmware(tmp_path / "marlin.log", text)


LABELS = {
    1: "xmin,xmax,ymin,ymax,radius,spacing,xnum,ynum\n{0},{1},{0},{1},95.00,{2},{3},{3}",
    2: "xmin,xmax,ymin,ymax,radius,xspacing,yspacing,xnum,ynum\n{0},{1},{0},{1},95.00,{2},{2},{3},{3}",
    3: "axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1\nX,Y,{0},{1},{0},{1},95.00,{2},{2},{3},{3}",
}


def height_map(
    truth: Delta,
    believed: Delta,
    *,
    version: int = 2,
    probe: tuple[float, float] = (0.0, 0.0),
    width: float = 80.0,
    count: int = 9,
) -> str:
    """Return what G29 saves: the probe's points are the grid's, the nozzle is beside them; not all are reached."""
    noise, places = np.random.default_rng(6), np.linspace(-width, width, count)

    def height(x: float, y: float) -> float:
        at = (x - probe[0], y - probe[1])
        return scipy.optimize.brentq(lambda z: truth.nozzle(believed.travels(*at, z))[2], -5.0, 5.0)

    rows = []
    for y in places:
        reached = [np.hypot(x - probe[0], y - probe[1]) < 0.73 * believed.radius for x in places]
        touches = [
            f"{height(x, y) + noise.normal(0.0, 0.01):7.3f}" if at else "0"
            for x, at in zip(places, reached, strict=True)
        ]
        rows.append(", ".join(f"{cell:>7}" for cell in touches))
    grid = LABELS[version].format(-width, width + 0.1, 2.0 * width / (count - 1), count)
    return "\n".join([f"RepRapFirmware height map file v{min(version, 2)} generated at 2026-01-16", grid, *rows, ""])


BELIEVED = Delta(130.0, tuple(BASE + np.radians([0.1, 0.0, 0.0])), stops=(245.2, 245.0, 245.5))
CONFIG = "; Duet\r\nG31 P25 X0 Y-18 Z2.1 ; probe\r\nM665 L270 R130 H245 X0.1\r\nM666 X0.2 Z0.5  ; stops\r\nT0\r\n"


@pytest.mark.parametrize("version", LABELS)
def test_height_maps_of_a_duet(version: int, tmp_path: Path) -> None:
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED, version=version, probe=(0.0, -18.0)))
    (tmp_path / "config.g").write_text(CONFIG, newline="")
    (tmp_path / "config-override.g").write_text("M665 R999\n")  # nothing calls it
    for name in ("heightmap.csv", "config.g"):
        found = calibrate_printer(tmp_path / name)
        assert found.file.path.name == "config.g"
        assert 60 < len(found.touches) < 81
        assert found.chosen.count == 6
        assert np.sqrt(np.mean(found.held_out**2)) == pytest.approx(1e-5, rel=0.3)
        assert found.after.radius == pytest.approx(1e-3 * TRUTH.radius, abs=5e-5)
        np.testing.assert_allclose(1e3 * np.array(found.after.end_stops), TRUTH.stops, atol=0.05)
    folder = found.save(tmp_path / "out")
    written = (folder / "config.g").read_bytes().decode()
    assert re.fullmatch(r"(.*\r\n){2}M665 L270.0000 R131.*\r\nM666 .*  ; stops\r\nT0\r\n", written)
    assert not (folder / "config-override.g").exists()


def test_saved_numbers_of_a_duet_override_its_configuration(tmp_path: Path) -> None:
    """M501 calls what M500 saved; arms of towers that do not carry the nozzle are kept."""
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED))
    (tmp_path / "config.g").write_text("M665 L280 R120 H250\nM666 X9\nM501 ; saved numbers\n")
    saved = "M665 L270:270:270:200 R130 H245 B90 X0.1 Y0 Z0\nM666 X0.2 Y0 Z0.5 A0 B0 U1.5"
    (tmp_path / "config-override.g").write_text(saved)
    found = calibrate_printer(tmp_path / "config.g")
    assert found.before.radius == pytest.approx(0.13)
    np.testing.assert_allclose(1e3 * np.array(found.before.end_stops), BELIEVED.stops)
    folder = found.save(tmp_path / "out")
    assert {file.name for file in folder.iterdir()} == {"config-override.g", "calibration.yaml", "robot"}
    m665, m666 = (folder / "config-override.g").read_text().splitlines()
    assert re.match(r"M665 L270.0000:270.0000:270.0000:200 R13\d.\d{4} H24\d.\d{4} B90 X", m665)
    assert m666.endswith("A0 B0 U1.5")
    # the same touches, known to the old printer by its own numbers, are at the bed of the new one
    assert np.abs(found.heights_after).max() < 5e-5 < 2e-4 < np.abs(found.heights_before).max()


def test_letters_of_g_code_may_be_small(tmp_path: Path) -> None:
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED))
    (tmp_path / "config.g").write_text(CONFIG.lower(), newline="")
    file = read_firmware(tmp_path / "config.g", CONFIG.lower())
    printer = file.printer()
    assert printer.radius == pytest.approx(0.13)
    np.testing.assert_allclose(1e3 * np.array(printer.end_stops), BELIEVED.stops)
    written = file.with_printer(printer)
    assert re.fullmatch(r"(.*\r\n){2}M665 L270.0000 R130.*\r\nM666 .*  ; stops\r\nt0\r\n", written)
    lines = ["M665 L270 R130 H245", "M666 X0 Y0 Z0", "G31 X1 Y2", "G30 P0 X1 Y2 Z-99999", "bed probe heights: 0.5"]
    logs = [GCodeLog.parse(tmp_path / "log.g", text) for text in ("\n".join(lines), "\n".join(lines).lower())]
    assert logs[0] == logs[1]


def test_points_of_several_calibrations_in_one_log(tmp_path: Path) -> None:
    """P numbers points, and P0 begins anew: after a calibration, after one that failed, after a first dummy probe."""
    settings, places = "M665 L270 R130 H245", ((0.0, 0.0), (50.0, 0.0), (0.0, 50.0))
    calls = [f"G30 P{k} X{x} Y{y} Z-99999" for k, (x, y) in enumerate(places)]
    one, two = "G32 bed probe heights: 9 9 9, mean 9", "G32 bed probe heights: 0.1 0.2 0.3, mean 0.2"
    expected = tuple((x, y, height) for (x, y), height in zip(places, (0.1, 0.2, 0.3), strict=True))
    for lines in (
        [settings, *calls, one, settings, *calls, two],
        [settings, *calls, "G30 P3 X9 Y9 Z-99999", "bed probe heights: 9 9 9 9", settings, *calls, two],
        [settings, *calls[:2], "Error: probe not triggered", *calls, two],
        [settings, "G30 P0 X7 Y7 Z-99999", *calls, two],
        [*calls, settings, two],
    ):
        assert GCodeLog.parse(tmp_path / "log.g", "\n".join(lines)).probed == expected
    again = "\n".join([settings, *calls, two, *calls, two])
    assert GCodeLog.parse(tmp_path / "log.g", again).probed == 2 * expected


def test_arms_that_a_ruler_would_show_wrong_are_not_taken(tmp_path: Path) -> None:
    """Arms 5 mm longer than described fit better, but so they would on a bed that is bowed."""
    believed = Delta(228.0, arms=(440.0,) * 3, stops=(400.0,) * 3)
    truth = Delta(229.0, tuple(BASE + np.radians([0.2, -0.1, 0.0])), (445.0,) * 3, (401.0, 401.5, 400.5))
    (tmp_path / "heightmap.csv").write_text(height_map(truth, believed, width=150.0))
    (tmp_path / "config.g").write_text("M665 L440 R228 H400\nM666 X0 Y0 Z0\n")
    found = calibrate_printer(tmp_path / "config.g")
    errors = {choice.count: choice.mean_square for choice in found.choices}
    assert errors[7] < errors[6]
    assert found.implausible[7] == ("arms",)
    assert found.chosen.count == 6


def test_the_size_of_prints(tmp_path: Path) -> None:
    """Circles printed with the old numbers, whose real size three spheres tell, have their own with the new ones."""
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED))
    (tmp_path / "config.g").write_text(CONFIG.replace("Y-18", "Y0"))
    found = calibrate_printer(tmp_path / "config.g")
    after = Delta(
        1e3 * found.after.radius,
        found.after.angles,
        tuple(1e3 * np.array(found.after.arms)),
        tuple(1e3 * np.array(found.after.end_stops)),
    )
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    circle = 40.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    old = np.array([after.nozzle(BELIEVED.travels(x, y)) for x, y in circle])
    size = np.mean(np.linalg.norm(old[:, :2] - old[:, :2].mean(axis=0), axis=1))
    assert found.print_scale == pytest.approx(40.0 / size, abs=2e-4)
    assert abs(found.print_scale - 1.0) > 1e-3


def test_touches_of_a_small_part_of_the_bed_are_refused(tmp_path: Path) -> None:
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED, width=15.0, count=3))
    (tmp_path / "config.g").write_text(CONFIG.replace("Y-18", "Y0"))
    with pytest.raises(CalibrationRefusedError, match="touch a wider part of the bed"):
        calibrate_printer(tmp_path / "config.g")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("xnum", "columns", "num0 of the grid is ''"),
        ("9,9", "9,10", "9 rows of heights; expected 10"),
        ("9,9", "8,9", "line 4: 9 heights; expected 8"),
        ("      0, ", "  x.0, ", "line 4: 'x.0': expected a height"),
        ("ynum\n-80.0", "ynum\nnan", "min0 of the grid is 'nan'"),
    ],
)
def test_damaged_height_maps(old: str, new: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED).replace(old, new, 1))
    with pytest.raises(MeasurementError, match=r"no config.g beside it"):
        calibrate_printer(tmp_path / "heightmap.csv")
    (tmp_path / "config.g").write_text(CONFIG)
    with pytest.raises(MeasurementError, match=words):
        calibrate_printer(tmp_path / "heightmap.csv")


def test_tables_of_measurements_are_no_height_maps(tmp_path: Path) -> None:
    """In whatever encoding they are."""
    for name, encoding in (("a.csv", "utf-16"), ("b.csv", "latin-1")):
        (tmp_path / name).write_text("u1_m,x_m # \u00b5m\n0,1\n", encoding=encoding)
        assert not is_of_firmware(tmp_path / name)
    (tmp_path / "c.csv").write_text(height_map(TRUTH, BELIEVED), encoding="utf-8-sig")
    assert is_of_firmware(tmp_path / "c.csv")
    assert not is_of_firmware(tmp_path / "none.csv")


def test_a_probe_at_an_unknown_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "heightmap.csv").write_text(height_map(TRUTH, BELIEVED))
    (tmp_path / "config.g").write_text(CONFIG.replace("Y-18", "Y{global.probe}"))
    with pytest.raises(MeasurementError, match=r"line 2: 'G31 .*expected numbers after X and Y"):
        calibrate_printer(tmp_path / "config.g")


def test_a_sloping_bed_of_reprapfirmware(tmp_path: Path) -> None:
    """M666 A and B [%]: the drives' frame is where z is higher by 0.01 (A x + B y), so a level printer touches at 0."""
    lines = ["M665 L270 R130 H245", "M666 X0 Y0 Z0 A0.4 B-0.2"]
    lines += [f"G30 P{k} X{x:.6f} Y{y:.6f} Z-99999" for k, (x, y) in enumerate(points())]
    lines += [f"G32 bed probe heights: {' '.join(['0.0'] * len(points()))}"]
    file = read_firmware(tmp_path / "log.g", "\n".join(lines))
    printer = file.printer()
    touches = file.touches(printer)
    steep = [Delta().travels(x, y, 0.004 * x - 0.002 * y) for x, y in points()]
    np.testing.assert_allclose(touches.travels, -1e-3 * np.array(steep), atol=1e-12)
    np.testing.assert_allclose(touches.heights, 1e-3 * (points() @ [0.004, -0.002]), atol=1e-12)
    assert "A0.4 B-0.2" in file.with_printer(printer)


def test_a_bed_mesh(tmp_path: Path) -> None:
    """A bed with waves that no parameter makes: the mesh and the new numbers together put the nozzle over it."""

    def bed(x: Any, y: Any) -> Any:
        return 0.12 * np.sin(x / 35.0) * np.cos(y / 40.0)

    noise = np.random.default_rng(3)
    rows = []
    for x, y in points(((35.0, 6), (65.0, 12), (95.0, 18))):

        def over(z: float, x: float = x, y: float = y) -> float:
            place = TRUTH.nozzle(Delta().travels(x, y, z))
            return float(place[2] - bed(place[0], place[1]))

        rows.append(Delta().travels(x, y, scipy.optimize.brentq(over, -5.0, 5.0)) + noise.normal(0.0, 0.01))
    path = tmp_path / "printer.cfg"
    old = "#*# [bed_mesh old]\n#*# version = 1\n#*# points =\n#*# \t  0.1, 0.2\n#*# \t  0.3, 0.4\n#*# x_count = 2\n#*#"
    path.write_text(klipper(Delta(), np.array(rows), old))
    found = calibrate_printer(path, bed_mesh=True)
    text = (found.save(tmp_path / "out") / "printer.cfg").read_text()
    assert "#*# points = \n#*# \t0.1, 0.2\n#*# \t0.3, 0.4\n#*# x_count = 2" in text
    assert found.summary()["meshes_to_be_probed_again"] == ["old"]
    block = text.split("[bed_mesh default]")[1]
    grid = np.array(
        [[float(v) for v in line[4:].split(",")] for line in block.splitlines() if line.startswith("#*# \t")]
    )
    end = float(block.split("max_x = ")[1].split()[0])
    side = np.linspace(-end, end, 9)
    mesh = scipy.interpolate.RegularGridInterpolator((side, side), grid)
    after = found.after
    mine = Delta(
        1e3 * after.radius, after.angles, tuple(1e3 * np.array(after.arms)), tuple(1e3 * np.array(after.end_stops))
    )
    off = {}
    for meshed in (False, True):
        places = [TRUTH.nozzle(mine.travels(x, y, meshed * mesh((y, x)))) for x, y in points(((25.0, 7), (80.0, 11)))]
        off[meshed] = float(np.sqrt(np.mean([(place[2] - bed(*place[:2])) ** 2 for place in places])))
    assert off[True] < 0.4 * off[False], off
    assert off[True] < 1.5e3 * found.interval[1]
    # nothing but noise is left: no mesh
    flat = touched(TRUTH, Delta(), points(), noise)
    path.write_text(klipper(Delta(), flat))
    assert calibrate_printer(path, bed_mesh=True).mesh is None


def test_the_command(travels: np.ndarray, run: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "printer.cfg").write_text(klipper(Delta(), travels))
    answer = run("calibrate", "printer.cfg", "--out", "out", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "19 touches" in answer.stdout
    assert "not determined by these touches" in answer.stdout
    assert "heights tell it hardly, so measure a print" in answer.stdout
    assert "sigma of the touches alone  sigma with what they cannot tell" in answer.stdout
    ends = [Delta().travels(x, 0.0) for x in (-90.0, 90.0)]
    distance = [f"#*# distance0 = {float(np.linalg.norm(TRUTH.nozzle(ends[1]) - TRUTH.nozzle(ends[0]))):.4f}"]
    for k, end in enumerate(ends, start=1):
        distance.append(f"#*# distance0_pos{k} = {','.join(f'{value:.3f}' for value in end / MICROSTEP)}")
    (tmp_path / "measured.cfg").write_text(klipper(Delta(), travels, "\n".join(distance)))
    measured = run("calibrate", "measured.cfg", "--out", "measured", cwd=tmp_path).stdout
    assert "19 touches and 1 distances" in measured
    assert "measure a print" not in measured
    assert (tmp_path / "out" / "printer.cfg").is_file()
    assert run("calibrate", "printer.cfg", "--out", ".", cwd=tmp_path).returncode == 1


DAMAGES = (
    ("kinematics: delta", "kinematics: corexy", "expected delta"),
    ("delta_radius: 130.0", "", "delta_radius is missing"),
    ("delta_radius: 130.0", "delta_radius: wide", "expected a number, not 'wide'"),
    ("delta_radius: 130.0", "delta_radius: 1300", "does not close"),
    ("delta_radius: 130.0", "delta_radius: nan", "expected a number"),
    ("microsteps: 16", "", "microsteps is missing"),
    ("height3_pos = ", "height3_pos = 1,", "height3_pos: expected the steps of three drives"),
    ("height3_pos = ", "height3_pos = 1e30,1,1\nx = ", "height3_pos: expected the steps of three drives"),
    ("height0 = 0.0", "nothing = 0.0", "height0 is missing"),
    ("height4 = 0.0", "nothing = 0.0", "height4 is missing"),
    ("[printer]", "[machine]", "no delta printer"),
    ("rotation_distance: 40", "rotation_distance: 400", "no printer near these numbers"),
    ("[stepper_b]\nmicrosteps: 16", "[stepper_b]\nmicrosteps: 32", "no printer near .*sizes of steps"),
    ("rotation_distance: 40", "rotation_distance: 32", "end_stop_. would change by .*sizes of steps"),
)


@pytest.mark.parametrize(("old", "new", "words"), DAMAGES)
def test_damaged_files(travels: np.ndarray, tmp_path: Path, old: str, new: str, words: str) -> None:
    text = klipper(Delta(), travels)
    assert old in text
    (tmp_path / "printer.cfg").write_text(text.replace(old, new))
    with pytest.raises(PM3DofError, match=words):
        calibrate_printer(tmp_path / "printer.cfg")


def test_fewer_touches_than_parameters_are_refused(travels: np.ndarray, tmp_path: Path) -> None:
    (tmp_path / "printer.cfg").write_text(klipper(Delta(), travels[:5]))
    with pytest.raises(CalibrationRefusedError, match="5 touches for 6 parameters: touch at least 7"):
        calibrate_printer(tmp_path / "printer.cfg")
