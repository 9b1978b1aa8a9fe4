"""Calibrations of real delta printers against textbook fits, on touches held out.

Each printer.cfg of Klipper, or height map of RepRapFirmware beside its config.g, is read, fitted and validated twice:
by the package, and here, by readers of a few lines, trilateration and SciPy's least squares with the firmware's 6, 7
and 9 parameters, each touch or tenth left out in turn. Both use the distances measured on a print that a file has.

    python scripts/studies/real_printers.py FOLDER   # of files named *.cfg and heightmap.csv, at any depth
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
import scipy.optimize

from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.printers.printer_calibration import calibrate_printer
from pm3dof_pin.typing import Array

COUNTS = (6, 7, 9)
NOISE, CALIPER = 0.025, 0.05  # [mm]
SIZES = np.array([3.0, 5.0, 5.0, 5.0, 1.15, 1.15, 1.0, 1.0, 1.0])  # tolerances [mm, degrees]
ANGLES = (210.0, 330.0, 90.0)


Data = tuple[Array, Array, Array, Array, Array]


def read(text: str) -> Data:
    """Return radius, end stops, angles and arms, shape=(10,), travels, heights, distances and travels at their ends."""
    options: dict[str, str] = {}
    section = ""
    for line in text.splitlines():
        words = line.removeprefix("#*#").split("#")[0].strip()
        if words.startswith("["):
            section = words.strip("[]").lower()
        elif found := re.match(r"(\w+)\s*[:=]\s*(.+)", words):
            options[f"{section} {found[1].lower()}"] = found[2]

    def number(axis: str, option: str, default: float | None = None) -> float:
        word = options.get(f"stepper_{axis} {option}", options.get(f"stepper_a {option}"))
        if word is None and default is None:
            raise KeyError(option)
        return float(word) if word is not None else float(default or 0.0)

    stops, arms = ([number(axis, name) for axis in "abc"] for name in ("position_endstop", "arm_length"))
    angles = [float(options.get(f"stepper_{axis} angle", ANGLES[k])) for k, axis in enumerate("abc")]
    steps = []
    for axis in "abc":
        ratio = np.prod([float(np.divide(*map(float, p.split(":")))) for p in _gears(options, axis)])
        turn = number(axis, "full_steps_per_rotation", 200.0) * number(axis, "microsteps", 0.0) * ratio
        steps.append(number(axis, "rotation_distance") / turn if turn else number(axis, "step_distance"))
    count = sum(bool(re.fullmatch(r"delta_calibrate height\d+", name)) for name in options)
    places = [options[f"delta_calibrate height{k}_pos"].split(",") for k in range(count)]
    heights = np.array([float(options[f"delta_calibrate height{k}"]) for k in range(count)])
    far = sum(bool(re.fullmatch(r"delta_calibrate distance\d+", name)) for name in options)
    ends = [[options[f"delta_calibrate distance{k}_pos{i}"].split(",") for i in (1, 2)] for k in range(far)]
    return (
        np.array([float(options["printer delta_radius"]), *stops, *angles, *arms]),
        -np.array(places, dtype=float) * steps,
        heights,
        np.array([float(options[f"delta_calibrate distance{k}"]) for k in range(far)]),
        -np.array(ends, dtype=float).reshape(-1, 2, 3) * steps,
    )


def read_map(path: Path) -> Data:
    """Return the same from a heightmap.csv: travels are those to the probed points, the bed is at 0."""
    words = path.with_name("config.g").read_text(encoding="utf-8-sig")
    if re.search(r"^\s*M501", words, re.MULTILINE) and path.with_name("config-override.g").exists():
        words += path.with_name("config-override.g").read_text(encoding="utf-8-sig")
    numbers: dict[str, str] = {}
    for command, options in re.findall(r"^\s*(M665|M666|G31)\b([^;\n]*)", words, re.MULTILINE):
        numbers |= {f"{command} {letter}": value for letter, value in re.findall(r"([A-Z])\s*([-\d.:]+)", options)}
    arms = np.resize([float(word) for word in numbers["M665 L"].split(":")][:3], 3)
    stops = [float(numbers["M665 H"]) + float(numbers.get(f"M666 {letter}", 0.0)) for letter in "XYZ"]
    turned = [angle + float(numbers.get(f"M665 {axis}", 0.0)) for angle, axis in zip(ANGLES, "XYZ", strict=True)]
    start = np.array([float(numbers["M665 R"]), *stops, *turned, *arms])

    _, labels, values, *rows = path.read_text(encoding="utf-8-sig").splitlines()
    grid = dict(zip(labels.split(","), values.split(","), strict=True))
    x, y = (float(grid.get(f"{a}min", grid.get(f"min{k}", ""))) for k, a in enumerate("xy"))
    across, along = (float(grid.get(f"{a}spacing", grid.get(f"spacing{k}", ""))) for k, a in enumerate("xy"))
    probed = [
        (x + k * across, y + i * along, float(cell))
        for i, row in enumerate(rows)
        for k, cell in enumerate(row.rstrip(",").split(","))
        if cell.strip() != "0"
    ]
    nozzle = np.array(probed) - [float(numbers.get("G31 X", 0.0)), float(numbers.get("G31 Y", 0.0)), 0.0]
    towers = start[0] * np.column_stack([np.cos(np.radians(turned)), np.sin(np.radians(turned))])
    rise = np.sqrt(arms**2 - np.sum((nozzle[:, None, :2] - towers) ** 2, axis=-1))
    travels = nozzle[:, 2:] + rise - np.sqrt(arms**2 - start[0] ** 2) - stops
    return start, travels, np.zeros(len(nozzle)), np.zeros(0), np.zeros((0, 2, 3))


def _gears(options: dict[str, str], axis: str) -> list[str]:
    return [pair for pair in options.get(f"stepper_{axis} gear_ratio", "").split(",") if pair.strip()]


def nozzle(printer: Array, travels: Array) -> Array:
    """Return places of the nozzle, shape=(n, 3) [mm]; carriages rise with travels, from end stops at 0."""
    radius, stops, angles, arms = printer[0], printer[1:4], np.radians(printer[4:7]), printer[7:]
    up = stops + np.sqrt(arms**2 - radius**2) + travels
    xy = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    # differences of the three spheres are two planes: (x, y) = p + q z
    sides = 2.0 * (xy[1:] - xy[0])
    size = np.sum(xy**2, axis=1) + up**2 - arms**2
    p = np.linalg.solve(sides, (size[:, 1:] - size[:, :1]).T).T
    q = np.linalg.solve(sides, -2.0 * (up[:, 1:] - up[:, :1]).T).T
    a = np.sum(q**2, axis=1) + 1.0
    b = np.sum((p - xy[0]) * q, axis=1) - up[:, 0]
    c = np.sum((p - xy[0]) ** 2, axis=1) + up[:, 0] ** 2 - arms[0] ** 2
    z = (-b - np.sqrt(b**2 - a * c)) / a
    return np.column_stack([p + q * z[:, None], z])


def fitted(data: Data, chosen: Array, count: int) -> Array:
    """Return the printer with its 6, 7 or 9 parameters fitted to some touches and all distances, weakly held."""
    start, travels, heights, distances, ends = data

    def printer(x: Array) -> Array:
        return start + np.concatenate([x[:6], [0.0], np.resize(x[6:], 3) if count > 6 else np.zeros(3)])

    def left(x: Array) -> Array:
        own = printer(x)
        far = np.linalg.norm(nozzle(own, ends[:, 1]) - nozzle(own, ends[:, 0]), axis=1) - distances
        near = nozzle(own, travels[chosen])[:, 2] - heights[chosen]
        return np.concatenate([near / NOISE, far / CALIPER, x / SIZES[:count]])

    found = scipy.optimize.least_squares(left, np.zeros(count), x_scale=SIZES[:count], xtol=1e-12, ftol=1e-12)
    return np.asarray(printer(found.x))


def textbook(data: Data) -> dict[int, float]:
    """Return rms errors of touches left out [um], by number of parameters."""
    _, travels, heights, _, _ = data
    folds = np.random.default_rng(1).permutation(np.arange(len(travels)) % min(10, len(travels)))
    found = {}
    for count in COUNTS:
        left = np.empty(len(travels))
        for fold in range(folds.max() + 1):
            own, out = folds != fold, folds == fold
            left[out] = nozzle(fitted(data, own, count), travels[out])[:, 2] - heights[out]
        found[count] = float(1e3 * np.sqrt(np.mean(left**2)))
    return found


def main() -> None:
    """Print a line for each file, and how the errors compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    to_best, to_same, lines = [], [], 0
    folder = parser.parse_args().folder
    for path in sorted([*folder.rglob("*.cfg"), *folder.rglob("heightmap.csv")]):
        try:
            ours = calibrate_printer(path, on_refusal="keep")
            is_map = path.suffix == ".csv"
            data = read_map(path) if is_map else read(path.read_text(encoding="utf-8-sig"))
        except (PM3DofError, KeyError) as error:
            print(f"{path}: {error!r}")
            continue
        other = textbook(data)
        own = {choice.count: 1e6 * np.sqrt(choice.mean_square) for choice in ours.choices}
        chosen = own[ours.chosen.count]
        to_best.append(chosen / min(other.values()))
        to_same.append(chosen / other[ours.chosen.count])
        lines += 1
        before = 1e6 * np.sqrt(np.mean(ours.heights_before**2))
        print(
            f"{path.parent.name}: {len(data[1])} touches, {len(data[3])} distances, before {before:.0f}, "
            + ", ".join(f"{count}: {own[count]:.1f} ({other[count]:.1f})" for count in COUNTS)
            + f" um, chosen {ours.chosen.count}, gain {ours.gain:.2f}",
            flush=True,
        )
    for name, ratios in (("as many parameters", to_same), ("the best", to_best)):
        low, middle, high = np.quantile(ratios, [0.0, 0.5, 1.0])
        print(f"{lines} files: error over the textbook's with {name}: median {middle:.3f}, {low:.3f} to {high:.3f}")


if __name__ == "__main__":
    main()
