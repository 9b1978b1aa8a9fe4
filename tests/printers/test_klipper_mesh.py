"""Bed meshes of Klipper, probed by a machine of three spheres in the order and on the grids of bed_mesh.py."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.printers.firmware import read_firmware
from pm3dof_pin.printers.printer_calibration import calibrate_printer
from tests.printers.test_logs import ONE, height
from tests.printers.test_printers import TRUTH, klipper

Grid = list[list[tuple[float, float]]]
LEVER = (-10.0, 18.0)  # of the probe


def round_grid(radius: float, count: int, origin: tuple[float, float]) -> Grid:
    """Rows of the points that are probed on a round bed."""
    step = math.floor(2.0 * radius / (count - 1) * 100.0) / 100.0
    side = [(k - count // 2) * step for k in range(count)]
    rows = [[(origin[0] + x, origin[1] + y) for x in side if math.hypot(x, y) <= radius] for y in side]
    return [row for row in rows if row]


def mesh(grid: Grid, probe: tuple[float, float] = (0.0, 0.0), noise: float = 0.0, zero: float = 0.0) -> str:
    """Return the saved section; rows of a round bed are filled up with their outermost points."""
    generator, count = np.random.default_rng(4), max(map(len, grid))
    rows = []
    for row in grid:
        found = [height(ONE, x, y, probe) - zero + generator.normal(0.0, noise) for x, y in row]
        more = (count - len(row)) // 2
        rows.append([*found[:1] * more, *found, *found[-1:] * more])
    x, y = np.array([point for row in grid for point in row]).T
    numbers = {
        "x_count": count,
        "y_count": len(rows),
        "mesh_x_pps": 2,
        "mesh_y_pps": 2,
        "algo": "bicubic",
        "tension": 0.2,
    }
    numbers |= {"min_x": x.min(), "max_x": x.max(), "min_y": y.min(), "max_y": y.max()}
    return "\n".join(
        [
            "#*# [bed_mesh default]",
            "#*# version = 1",
            "#*# points =",
            *(f"#*# \t  {', '.join(f'{value:.6f}' for value in row)}" for row in rows),
            *(f"#*# {name} = {value}" for name, value in numbers.items()),
        ]
    )


def config(saved: str, options: str = "", more: str = "") -> str:
    text = klipper(ONE, np.zeros((0, 3)), saved)
    return text.replace("#*# [delta_calibrate]\n", "").replace("[bed_mesh]\n", f"{more}\n[bed_mesh]\n{options}\n")


ROUND = round_grid(95.0, 7, (0.0, 0.0))
SQUARE: Grid = [[(float(x), float(y)) for x in np.linspace(-70.0, 80.0, 5)] for y in np.linspace(-60.0, 75.0, 6)]
PROBE = "[bltouch]\nx_offset: -10\ny_offset: 18\nz_offset: 1.2"


@pytest.mark.parametrize(
    ("grid", "options", "more", "probe"),
    [
        (ROUND, "mesh_radius: 95", "", (0.0, 0.0)),
        (round_grid(80.0, 9, (5.0, -8.0)), "mesh_radius: 80\nmesh_origin: 5,-8", "", (0.0, 0.0)),
        (SQUARE, "mesh_min: -70,-60\nmesh_max: 80,75", PROBE, LEVER),
    ],
)
def test_the_nozzle_is_at_the_bed_at_every_point(
    grid: Grid, options: str, more: str, probe: tuple[float, float], tmp_path: Path
) -> None:
    file = read_firmware(tmp_path / "printer.cfg", config(mesh(grid, probe), options, more))
    touches = file.touches(file.printer())
    assert len(touches) == sum(map(len, grid))  # and not what a round bed is filled up with
    assert not touches.heights.any()
    assert np.abs([TRUTH.nozzle(-1e3 * row)[2] for row in touches.travels]).max() < 2e-6
    assert np.ptp([height(ONE, *point, probe) for row in grid for point in row]) > 0.2
    (note,) = file.notes
    assert "points of [bed_mesh default]" in note


def test_a_printer_is_calibrated_by_its_mesh(run: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "printer.cfg"
    path.write_text(config(mesh(ROUND, noise=0.01), "mesh_radius: 95"))
    found = calibrate_printer(path)
    assert found.chosen.count == 6
    assert found.after.radius == pytest.approx(1e-3 * TRUTH.radius, abs=1e-4)
    np.testing.assert_allclose(1e3 * np.array(found.after.end_stops), TRUTH.stops, atol=0.05)
    assert found.summary()["meshes_to_be_probed_again"] == ["default"]
    answer = run("calibrate", "printer.cfg", "--out", "out", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "warning: the touches are the points of [bed_mesh default]" in answer.stderr
    # the mesh is not of the new numbers, and so not there to be read with them
    again = run("calibrate", "out/printer.cfg", "--out", "again", cwd=tmp_path)
    assert again.returncode == 1
    assert "no touches of the bed" in again.stderr


def test_heights_from_a_reference_do_not_tell_the_height_of_the_nozzle(tmp_path: Path) -> None:
    """All end stops are off by the height of the reference, and all else is found."""
    zero = height(ONE, 0.0, 0.0)
    path = tmp_path / "printer.cfg"
    path.write_text(config(mesh(ROUND, zero=zero), "mesh_radius: 95\nzero_reference_position: 0,0"))
    found = calibrate_printer(path)
    assert abs(zero) > 0.1
    np.testing.assert_allclose(1e3 * np.array(found.after.end_stops) - TRUTH.stops, zero, atol=0.02)
    assert found.after.radius == pytest.approx(1e-3 * TRUTH.radius, abs=5e-5)
    assert "zero_reference_position" in found.file.notes[1]


def test_saved_touches_go_before_meshes(tmp_path: Path) -> None:
    rows = np.array([TRUTH.travels(x, y) for row in ROUND[:3] for x, y in row])
    file = read_firmware(tmp_path / "printer.cfg", klipper(ONE, rows, mesh(ROUND)))
    assert file.notes == ()
    np.testing.assert_allclose(file.touches(file.printer()).travels, -1e-3 * rows, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 1", "version = 2", r"\[bed_mesh default\] version is '2': expected 1"),
        ("x_count = 7", "x_count = 6", "points: expected 7 rows of 6 heights"),
        ("x_count = 7", "", "x_count is '': expected a number"),
        ("min_x = -9", "min_x = x9", "min_x is 'x9.*expected a number"),
        ("\n#*# \t", "\n#*# \t  0.1,", "points: expected 7 rows of 7 heights"),
        ("[bed_mesh default]", "[bed_mesh a]\n#*# version = 1\n#*# [bed_mesh b]", r"several bed meshes \(a, b\)"),
        ("[bed_mesh default]", "[other]", r"no touches of the bed .*or a \[bed_mesh"),
    ],
)
def test_damaged_meshes(old: str, new: str, words: str, tmp_path: Path) -> None:
    text = config(mesh(ROUND), "mesh_radius: 95")
    assert old in text
    file = read_firmware(tmp_path / "printer.cfg", re.sub(re.escape(old), lambda _: new, text, count=1))
    with pytest.raises(MeasurementError, match=words):
        file.touches(file.printer())
