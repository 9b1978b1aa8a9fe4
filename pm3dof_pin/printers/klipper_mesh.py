"""Points of a bed mesh that Klipper probed and saved, `[bed_mesh NAME]`.

A height is that of the bed where the printer, by the numbers that it had, took z = 0 to be: with the nozzle at this
height, beside the point by the offsets of the probe, the probe would touch. Rows are along x, the first at min_y. On a
round bed (mesh_radius) the corners of the grid were not probed: Klipper repeats the outermost points of each row there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.typing import Array

_ROUNDING = 1e-6  # of the radius


def probed_points(path: Path, name: str, options: Mapping[str, str], *, is_round: bool) -> Array:
    """Return places of the probe and heights of a mesh, shape=(points, 3) [mm].

    Args:
        path: the file, for messages.
        name: of the section.
        options: of the section.
        is_round: whether the bed is round.

    Raises:
        MeasurementError: the mesh is of another version, or a number or a row is missing.
    """

    def number(option: str) -> float:
        try:
            value = float(options.get(option, ""))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise MeasurementError(path, f"[{name}] {option} is '{options.get(option, '')}': expected a number")
        return value

    if options.get("version") != "1":
        raise MeasurementError(path, f"[{name}] version is '{options.get('version', '')}': expected 1")
    shape = number("y_count"), number("x_count")
    try:
        rows = [list(map(float, row.split(","))) for row in re.split(r"\s*\n\s*", options.get("points", "").strip())]
        heights = np.array(rows)
    except ValueError:  # also of rows that differ in length
        heights = np.empty(0)
    if heights.shape != shape or min(shape) < 2.0 or not np.isfinite(heights).all():
        raise MeasurementError(path, f"[{name}] points: expected {shape[0]:g} rows of {shape[1]:g} heights")
    x, y = (
        np.linspace(number(f"min_{axis}"), number(f"max_{axis}"), count)
        for axis, count in zip("xy", heights.T.shape, strict=True)
    )
    points = np.column_stack([*(grid.ravel() for grid in np.meshgrid(x, y)), heights.ravel()])
    if not is_round:
        return points
    radius = 0.5 * (x[-1] - x[0])
    far = np.hypot(points[:, 0] - 0.5 * (x[0] + x[-1]), points[:, 1] - 0.5 * (y[0] + y[-1]))
    return np.asarray(points[far <= (1.0 + _ROUNDING) * radius])
