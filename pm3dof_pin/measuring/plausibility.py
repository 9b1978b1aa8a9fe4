"""Plausibility of measurements: mistakes that show when compared with the machine's description."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.errors.pose_error import rotation_of_quaternion, rotation_vector
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array

POSITION_COLUMNS = ("x_m", "y_m", "z_m")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
POINT_COLUMNS = ("px_m", "py_m", "pz_m")

_SAME = 1e-9
_FAR_OFF = 0.05  # of the distance from the base to the tool: more than any tolerance explains
_FAR_POINTS = 30.0  # times the machine's size
_TURNED = 0.1  # [rad], likewise
_THOUSANDFOLD = 300.0
_OWN_FRAME = "use --own-frame for an instrument with its own frame"


def warn_of_copies(table: CsvTable, places: Array, measured: Array) -> None:
    """Warn of rows that repeat others, entirely or in everything measured at other commands.

    `places` holds the numbers in which rows of different poses, points or instruments differ, `measured` full
    positions, with orientations if there are any, shape=(n, k) each, or (n, 0).
    """
    rows = table.matrix(list(table.columns))
    first: dict[bytes, int] = {}
    copies = [
        line for line, row in zip(table.lines, rows, strict=True) if first.setdefault(row.tobytes(), line) != line
    ]
    if copies:
        table.warn("copies of earlier lines; each copy counts", copies)
    if measured.size:
        _, origin, again = np.unique(np.round(measured / _SAME), axis=0, return_index=True, return_inverse=True)
        elsewhere = np.any(places != places[origin[again.reshape(-1)]], axis=1)
        if elsewhere.any():
            problem = "measurements repeat those of other lines to the last digit, at other commands: stale or copied?"
            table.warn(problem, table.lines_where(elsewhere))
    distinct = len(np.unique(np.round(places / _SAME), axis=0))
    if distinct < len(rows) - len(copies):
        table.warn(f"{len(rows)} rows at {distinct} different commands: the others repeat one")


def check_points(table: CsvTable, points: Array, size: float) -> None:
    """Reject points in tool axes, shape=(n, 3) [m], that seem to be in millimetres, given the machine's size [m]."""
    off = np.median(np.linalg.norm(points, axis=1))
    if off > _FAR_POINTS * size:
        problem = f"{','.join(POINT_COLUMNS)} are {off:.3g} m (median) from the tool point: millimetres?"
        raise MeasurementError(table.path, problem)


def check_extent(table: CsvTable, expected: Array, positions: Array) -> None:
    """Check for positions in millimetres, in an unknown frame.

    Raises:
        MeasurementError: they spread a thousand times as far as the machine moves.
    """
    seen, nominal = (np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)) for p in (positions, expected))
    if seen > _THOUSANDFOLD * nominal:
        problem = "look like millimetres: they spread a thousand times as far as the machine moves"
        raise MeasurementError(table.path, f"{','.join(POSITION_COLUMNS)} {problem}")


def check_positions(table: CsvTable, expected: Array, positions: Array) -> bool:
    """Check for positions out of the machine's reach, and tell whether most are within it.

    Raises:
        MeasurementError: they are in millimetres.
    """
    size = max(float(np.median(np.linalg.norm(expected, axis=1))), 1e-3)
    distances = np.linalg.norm(positions - expected, axis=1)
    if np.median(np.linalg.norm(1e-3 * positions - expected, axis=1)) < _FAR_OFF * size:
        problem = "look like millimetres: a thousandth of them is where the machine is"
        raise MeasurementError(table.path, f"{','.join(POSITION_COLUMNS)} {problem}")
    far = distances > _FAR_OFF * size
    if far.mean() > 0.5:
        table.warn(
            f"positions are {np.median(distances):.3g} m (median) from where the description has the machine: other "
            f"axes, another zero of the commands or another tool point? {_OWN_FRAME}"
        )
        return False
    if far.any():
        lines = table.lines_where(far)
        table.warn(f"positions are more than {_FAR_OFF * size:.2g} m from where the machine can be", lines)
    return True


def check_rotations(table: CsvTable, nominal: Poses, rotations: Array, *, refuse: bool) -> None:
    """Check for the usual mistakes: another order of the quaternion, the inverse rotation, other axes.

    Only refuse if everything else fits (`refuse`); otherwise something else is wrong.

    Raises:
        MeasurementError: one of these mistakes explains the measured rotations, shape=(n, 3, 3), at the nominal poses.
    """

    def angles(seen: Array) -> Array:
        return np.asarray(np.linalg.norm(rotation_vector(np.swapaxes(nominal.rotations, 1, 2) @ seen), axis=1))

    turned = angles(rotations)
    if np.median(turned) <= _TURNED:
        if (turned > _TURNED).any():
            lines = table.lines_where(turned > _TURNED)
            table.warn(f"orientations are more than {_TURNED:g} rad from where the machine can be", lines)
        return
    scalar_last = rotation_of_quaternion(np.roll(table.matrix(QUATERNION_COLUMNS), 1, axis=1))
    for seen, problem in (
        (scalar_last, "are in the order x, y, z, w"),
        (
            np.swapaxes(rotations, 1, 2),
            "are inverse rotations, of the base in the tool's axes: expected those of the tool in the base",
        ),
    ):
        if refuse and np.median(angles(seen)) < min(_TURNED, 0.1 * np.median(turned)):
            raise MeasurementError(table.path, f"{','.join(QUATERNION_COLUMNS)} {problem}")
    table.warn(
        f"orientations are {np.median(turned):.3g} rad (median) from where the description has the machine: "
        f"other axes of the base or of the tool? {_OWN_FRAME}"
    )
