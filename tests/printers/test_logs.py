"""Logs as firmware and hosts print them: at each height that is read, the true printer's nozzle is at the bed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.printers.firmware import read_firmware
from tests.printers.test_printers import BASE, CIRCLE, TRUTH, Delta, points

ONE = Delta(130.0, tuple(BASE + np.radians([0.1, 0.0, 0.0])), stops=(244.8, 245.0, 244.5))
TWO = Delta(130.9, tuple(BASE + np.radians([0.2, -0.1, 0.0])), stops=(245.3, 244.3, 244.7))
PLACES = points(((50.0, 6), (95.0, 6))).round(2)
FEW = PLACES[:7] * 1.2


def height(believed: Delta, x: float, y: float, probe: tuple[float, float] = (0.0, 0.0), zero: float = 0.0) -> float:
    """Return what a probe beside the nozzle makes the printer report; zero: the height that it takes for 0."""
    at = x - probe[0], y - probe[1]
    return zero + scipy.optimize.brentq(lambda z: TRUTH.nozzle(believed.travels(*at, z))[2], -8.0, 8.0)


def numbers(printer: Delta, *, marlin: bool) -> list[str]:
    x, y, z = np.degrees(np.array(printer.angles) - BASE)
    top = min(printer.stops) if marlin else float(np.mean(printer.stops))
    stops = [(top - stop) * (1.0 if marlin else -1.0) for stop in printer.stops]
    return [
        f"M665 L270.00 R{printer.radius:.2f} H{top:.3f} X{x:.2f} Y{y:.2f} Z{z:.2f}",
        "M666 " + " ".join(f"{axis}{stop:.3f}" for axis, stop in zip("XYZ", stops, strict=True)),
    ]


def echo(printer: Delta) -> list[str]:
    return [f"echo:  {line}" for line in numbers(printer, marlin=True)]


def answers(printer: Delta) -> list[str]:
    """What RepRapFirmware answers to M665 and M666 without words."""
    x, y, z = np.degrees(np.array(printer.angles) - BASE)
    top = float(np.mean(printer.stops))
    a, b, c = (stop - top for stop in printer.stops)
    return [
        f"Diagonals 270.000:270.000:270.000, delta radius {printer.radius:.3f}, homed height {top:.3f}, "
        f"bed radius 99.0, X {x:.3f}°, Y {y:.3f}°, Z {z:.3f}°",
        f"Endstop adjustments X{a:.2f} Y{b:.2f} Z{c:.2f}, tilt X0.00% Y0.00%",
    ]


def calls(at: np.ndarray = PLACES) -> list[str]:
    return [f"G30 P{k} X{x} Y{y} H0 Z-99999" for k, (x, y) in enumerate(at)]


def heights(
    printer: Delta,
    at: np.ndarray = PLACES,
    failed: tuple[int, ...] = (),
    probe: tuple[float, float] = (0.0, 0.0),
    zero: float = 0.0,
) -> str:
    found = [height(printer, x, y, probe, zero) for x, y in at]
    words = ["probing failed" if k in failed else f"{value:.3f}" for k, value in enumerate(found)]
    return f"G32 bed probe heights: {' '.join(words)}, mean {np.mean(found):.3f}, deviation from mean 0.100"


def touched(printer: Delta, probe: tuple[float, float] = (0.0, 0.0), zero: float = 0.0) -> list[str]:
    return [f"Bed X: {x:.2f} Y: {y:.2f} Z: {height(printer, x, y, probe, zero):.3f}" for x, y in PLACES]


def settings(printer: Delta, label: str = ".             ") -> list[str]:
    top = min(printer.stops)
    ends = "".join(f"  E{axis}:{top - stop:+.2f}" for axis, stop in zip("xyz", printer.stops, strict=True))
    turned = np.degrees(np.array(printer.angles) - BASE)
    return [
        f".Height:{top:.2f}{ends}  Radius:{printer.radius:.2f}",
        label + "".join(f"  T{axis}:{turn:+.2f}" for axis, turn in zip("xyz", turned, strict=True)),
    ]


def results(printer: Delta, radius: float) -> list[str]:
    def at(r: float, angle: float) -> float:
        return height(printer, r * np.cos(np.radians(angle)), r * np.sin(np.radians(angle)))

    found = {name: at(radius, angle) for name, angle in CIRCLE.items()}
    found["c"] = float(np.mean([at(0.1 * radius, CIRCLE[tower]) for tower in "xyz"]))
    rows = [[f"  {name}:{found[name]:+.2f}" for name in names] for names in ("cxyz", ("yz", "zx", "xy"))]
    return [f".    {''.join(rows[0])}", f".             {''.join(rows[1])}"]


def dry(printer: Delta, radius: float, less: float = 0.0, *, fails: bool = False) -> list[str]:
    start = [f"G33 P3 V0 R{less:g}", "G33 Auto Calibrate", f"Checking... AC at radius:{radius:.2f} (DRY-RUN)"]
    end = ["Error:Probing Failed", "Correct delta settings with M665 and M666"]
    return [*start, *settings(printer), *(end if fails else [*results(printer, radius), "End DRY-RUN"])]


OLD, NEW = (numbers(printer, marlin=False) for printer in (ONE, TWO))
FACTORS = "Calibrated 6 factors using 13 points, (mean, deviation) before (0.012, 0.310) after (0.000, 0.034)"
TRIGGERED = "Error: G30: Probe already triggered at start of probing move"
M122 = ["M122", "Bed compensation in use: none", "Bed probe heights: 0.001 0.002 0.003 0.004 0.005"]
G31, BESIDE = "G31 P500 X-10 Y-18 Z2.1", (-10.0, -18.0)
AGAIN = replace(ONE, stops=tuple(np.mean(ONE.stops) + np.array([0.5, -0.2, -0.3])))
ITERATION = "Iteration : 01                                std dev:0.306"
G33 = ["G33 P3", "G33 Auto Calibrate", "Checking... AC at radius:90.00", *settings(ONE)]
END = ["Calibration OK                                std dev:0.010", *settings(TWO), "Save with M500"]
SLIDES = replace(ONE, stops=tuple(min(ONE.stops) - np.array([min(TWO.stops) - stop for stop in TWO.stops])))


@pytest.mark.parametrize(
    ("lines", "count"),
    [
        pytest.param([*OLD, *calls(), heights(ONE, failed=(4,))], 12, id="a point failed"),
        pytest.param([*OLD, *calls(), heights(ONE, failed=(0, 12))], 11, id="the first and last points failed"),
        pytest.param([*OLD, *calls()[:5], TRIGGERED, *calls(), heights(ONE)], 13, id="a first attempt was aborted"),
        pytest.param([*OLD, *calls()[:9], TRIGGERED, *calls(FEW), heights(ONE, FEW)], 7, id="then other points"),
        pytest.param([*OLD, *calls()[:4], TRIGGERED, *calls()[3:], heights(ONE)], 13, id="one point again"),
        pytest.param([*OLD, *calls(), heights(ONE), "G28", *calls(FEW), heights(ONE, FEW)], 20, id="twice"),
        pytest.param([*OLD, *calls(), heights(ONE), heights(ONE)], 13, id="one answer printed twice"),
        pytest.param([*OLD, *calls(), heights(ONE), *calls(), FACTORS], 13, id="calibrated afterwards"),
        pytest.param([*OLD, *calls(), FACTORS, *NEW, *calls(), heights(TWO)], 13, id="new numbers"),
        pytest.param(
            [*OLD, *calls(), FACTORS, "M665", answers(TWO)[0], "M666", answers(TWO)[1], *calls(), heights(TWO)],
            13,
            id="new numbers as answers",
        ),
        pytest.param([*OLD, *calls(), heights(ONE), "M666 X0.5 Y-0.2 Z-0.3"], 13, id="M666 afterwards"),
        pytest.param(
            [*OLD, *calls(), heights(ONE), "M666 X0.5 Y-0.2 Z-0.3", *calls(), heights(AGAIN)], 13, id="M666 between"
        ),
        pytest.param([*OLD, *calls(), heights(ONE), *M122], 13, id="diagnostics"),
        pytest.param([*OLD, *calls(FEW[:5]), heights(ONE, FEW[:5]), *M122], 5, id="diagnostics of five points"),
        pytest.param([*OLD, G31, *calls(), heights(ONE, probe=BESIDE)], 13, id="beside the nozzle"),
        pytest.param([*OLD, *calls(), heights(ONE, probe=BESIDE), G31], 13, id="G31 at the end"),
        pytest.param(
            [*OLD, G31, *calls(), heights(ONE, probe=BESIDE), "G31 X0 Y0", *calls(), heights(ONE)], 13, id="G31 between"
        ),
        pytest.param(
            [
                *OLD,
                G31,
                *calls(),
                heights(ONE, probe=BESIDE, zero=0.3),
                "G31 Z2.4",
                *calls(FEW),
                heights(ONE, FEW, (), BESIDE),
            ],
            7,
            id="the height of the probe between",
        ),
        pytest.param([*OLD, "G28", "G30", "G28", *calls(), heights(ONE)], 13, id="homed after G30"),
        pytest.param([f"11/27/2020, 9:53:19 PM\t{line}" for line in [*OLD, *calls(), heights(ONE)]], 13, id="times"),
        pytest.param([f"\x1b[1;32m{line}\x1b[0m" for line in [*OLD, *calls(), heights(ONE)]], 13, id="colours"),
        pytest.param([f"{line}\r" for line in [*OLD, *calls(), heights(ONE)]], 13, id="line ends of Windows"),
        pytest.param(
            [f"2021-03-03 12:00:00,123 - Recv: {line}" for line in [*echo(ONE), *touched(ONE)]], 13, id="host"
        ),
        pytest.param(
            [f"Send: N{k} {line}*55" for k, line in enumerate(numbers(ONE, marlin=True))] + touched(ONE),
            13,
            id="line numbers and checksums",
        ),
        pytest.param([*echo(ONE), *touched(ONE)[:5], "Error:Probing Failed", *touched(ONE)], 18, id="Marlin aborted"),
        pytest.param([*echo(ONE), *touched(ONE), "M666" + echo(TWO)[1][12:], *touched(SLIDES)], 13, id="Marlin's M666"),
        pytest.param([*echo(ONE), *touched(ONE), "M501", *echo(TWO), *touched(TWO)], 13, id="M501 with numbers"),
        pytest.param([*echo(ONE), *touched(ONE), "start", *echo(TWO), *touched(TWO)], 13, id="restarted"),
        pytest.param(
            [*echo(ONE), "echo:  M851 X-10.00 Y-18.00 Z-0.25", *touched(ONE, BESIDE)], 13, id="Marlin beside the nozzle"
        ),
        pytest.param(
            [*echo(ONE), "echo:  M851 X-10.00 Y-18.00 Z-0.25", *dry(ONE, 80.0)], 7, id="G33 puts the nozzle there"
        ),
        pytest.param(
            [*echo(ONE), "M851 X0 Y0 Z-0.25", *touched(ONE, zero=0.3), "M851 Z-0.55", *touched(ONE)],
            13,
            id="M851 Z between",
        ),
        pytest.param([*echo(ONE), "G30", *touched(ONE)], 13, id="G30 of Marlin sets nothing"),
        pytest.param(
            [*echo(ONE), *dry(ONE, 90.0, fails=True), *dry(ONE, 90.0), *dry(ONE, 60.0, 30.0)], 14, id="G33 failed"
        ),
        pytest.param(
            [*echo(ONE), *dry(ONE, 90.0), *dry(ONE, 70.0, 20.0, fails=True), *dry(ONE, 60.0, 30.0)],
            14,
            id="G33 failed in between",
        ),
        pytest.param([*echo(ONE), *dry(ONE, 90.0), *dry(ONE, 70.0, 20.0, fails=True)], 7, id="G33 failed at the end"),
        pytest.param(
            [
                *echo(ONE),
                *G33[:-2],
                *settings(ONE),
                *results(ONE, 90.0),
                ITERATION,
                *settings(TWO),
                *results(TWO, 90.0),
                *END,
            ],
            7,
            id="two iterations",
        ),
        pytest.param([*echo(ONE), *G33, ITERATION, *END, *touched(TWO)], 13, id="G30 after G33"),
        pytest.param(
            [*echo(ONE), *dry(ONE, 90.0), *G33, ITERATION, *END, *touched(TWO)], 13, id="G30 after G33 and G33"
        ),
        pytest.param(
            [*echo(ONE), *G33, "Correct delta settings with M665 and M666", *touched(ONE)], 13, id="G33 did nothing"
        ),
        pytest.param(
            [
                f"Recv: {line}"
                for line in [
                    numbers(ONE, marlin=True)[0] + " B80",
                    numbers(ONE, marlin=True)[1],
                    "G33 P3 V0 R10",
                    settings(ONE)[0],
                    settings(ONE, ".Tower angle :  ")[1],
                    *results(ONE, 80.0),
                ]
            ],
            7,
            id="a host's log of an old version, which ignores R",
        ),
    ],
)
def test_heights_that_are_read_belong_to_the_numbers(lines: list[str], count: int, tmp_path: Path) -> None:
    file = read_firmware(tmp_path / "printer.log", "\n".join(lines))
    touches = file.touches(file.printer())
    assert len(touches) == count
    off = [TRUTH.nozzle(-1e3 * row)[2] for row in touches.travels] - 1e3 * touches.heights
    assert np.abs(off).max() < 0.02  # what is printed has two or three digits, and another state is off by 0.1 or more


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (
            [*OLD, *calls(), FACTORS, *calls(), heights(TWO)],
            "line 30: .* line 16, 'Calibrated 6 .*expected M665 with L, R and H after it",
        ),
        (
            [*OLD, *calls(), FACTORS, NEW[0], *calls(), heights(TWO)],
            "line 31: .* line 16, 'Calibrated 6 .*expected M666 after",
        ),
        (
            [*OLD, FACTORS, "M665 L270", NEW[1], *calls(), heights(TWO)],
            "line 19: .* line 3, .*expected M665 with L, R and H",
        ),
        ([*OLD, *calls(), heights(ONE), FACTORS, heights(TWO)], "line 18: .* line 17, 'Calibrated 6"),
        ([*OLD, *calls(), heights(ONE), "M501", *calls(), heights(TWO)], "line 31: .* line 17, 'M501'"),
        ([*OLD, "G28", "G30", *calls(), heights(ONE, zero=0.4)], "line 18: .* line 4, 'G30', .*expected G28"),
        ([*OLD, "G92 Z0.4", *calls(), heights(ONE, zero=0.4)], "line 17: .* line 3, 'G92 Z0.4', .*expected G28"),
        ([*OLD, *calls(), "bed probe heights: 0.1 1e30, mean 0.1"], "line 16: .*1e30.*: expected numbers"),
        (["M665 L270 R130 H245 X1:30"], "line 1: 'M665 .* expected letters, each with a number"),
        ([*echo(ONE), "Bed X: 1.00 Y: 2.00 Z: 1:30"], "line 3: .*: expected numbers, as in Bed X"),
        ([*echo(ONE), "Bed X: 1.00 Y: 2.00 Z: \u0660.\u0661"], "line 3: .*: expected numbers, as in Bed X"),
        ([*OLD, *calls(), "bed probe heights: 0.1 0.2"], "line 16: 2 bed probe heights for 13 points"),
        ([*echo(ONE), *touched(ONE)[:5], "Send: M502", *touched(TWO)], "line 9: .* line 8, 'Send: M502'"),
        ([*echo(ONE), *touched(ONE)[:5], "Recv: start", *touched(TWO)], "line 9: .* line 8, 'Recv: start'"),
        ([*echo(ONE), "M666 X0.7", "?M666 offsets must be <= 0", *touched(ONE)], "line 5: .* line 4, '.M666 offsets"),
        (["G20 ; Units in inches", *echo(ONE), *touched(ONE)], "line 4: .* line 1, 'G20 .*expected G21"),
        ([*echo(ONE), *G33, ITERATION, "Error:Probing Failed", *touched(TWO)], "line 10: .* line 8, 'Iteration : 01"),
        ([*echo(ONE), *touched(ONE), *echo(ONE)], "line 16: no heights of the bed after M665"),
        (["Start printer", "===== Config file =====", "[printer]", "kinematics = delta"], "line 2: .* log of Klipper"),
    ],
)
def test_heights_in_doubt_are_refused(lines: list[str], words: str, tmp_path: Path) -> None:
    def read() -> None:
        file = read_firmware(tmp_path / "printer.log", "\n".join(lines))
        file.touches(file.printer())

    with pytest.raises(MeasurementError, match=words):
        read()
