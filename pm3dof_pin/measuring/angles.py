"""Columns of Euler angles, rotation vectors or quaternions, and their order."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import scipy

from pm3dof_pin.csv_table import CsvTable, usual_orders
from pm3dof_pin.errors.pose_error import rotation_of_quaternion
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.kinematics.pose_file import PLACEMENT
from pm3dof_pin.typing import Array

AngleOrder = Literal[
    "fixed xyz",
    "fixed xzy",
    "fixed yxz",
    "fixed yzx",
    "fixed zxy",
    "fixed zyx",
    "moving xyz",
    "moving xzy",
    "moving yxz",
    "moving yzx",
    "moving zxy",
    "moving zyx",
    "moving xyx",
    "moving xzx",
    "moving yxy",
    "moving yzy",
    "moving zxz",
    "moving zyz",
    "rotation vector",
]
"""Rotations about axes that stay fixed or move along, in this order; or a rotation vector."""

_ABOUT_AXES = ("rx_rad", "ry_rad", "rz_rad")
_NUMBERED = ("euler1_rad", "euler2_rad", "euler3_rad")
_QUATERNION = PLACEMENT[3:]


def angle_columns(table: CsvTable) -> tuple[str, ...]:
    """Return the columns of angles of a table, named after their axes or numbered in order; none with quaternions."""
    names = {*table.columns}
    found = (columns for columns in (_ABOUT_AXES, _NUMBERED) if {*columns} & names)
    return () if {*_QUATERNION} & names else next(found, ())


def other_orders(quaternions: Array) -> dict[str, Array]:
    """Return rotation matrices, shape=(n, 3, 3), by the order that columns w, x, y, z may really have, shape=(n, 4)."""
    return {
        ", ".join("wxyz"[k] for k in order): rotation_of_quaternion(quaternions[:, np.argsort(order)])
        for order in usual_orders(4)
    }


def orders_of(names: tuple[str, ...]) -> list[AngleOrder]:
    """Return the orders that columns can have: angles named after their axes are about three different ones."""
    return [order for order in get_args(AngleOrder) if names == _NUMBERED or len({*order.split()[1]}) > 2]


def quaternions_of_angles(angles: Array, order: AngleOrder, names: tuple[str, ...]) -> Array:
    """Return quaternions w, x, y, z of the angles in some columns, shape=(n, 3) [rad], as shape=(n, 4)."""
    if order == "rotation vector":
        turned = scipy.spatial.transform.Rotation.from_rotvec(angles)
    else:
        kind, axes = order.split()
        own = angles if names == _NUMBERED else angles[:, ["xyz".index(axis) for axis in axes]]
        turned = scipy.spatial.transform.Rotation.from_euler(axes if kind == "fixed" else axes.upper(), own)
    return np.asarray(turned.as_quat())[:, [3, 0, 1, 2]]


def replace_angles(table: CsvTable, order: AngleOrder) -> None:
    """Replace a table's columns of angles, if it has any, by quaternions.

    Raises:
        MeasurementError: one of three columns is missing, or they cannot be angles of this order.
    """
    if not (names := angle_columns(table)):
        return
    table.require(names, table.header_line)
    if order not in orders_of(names):
        problem = f"{','.join(names)} cannot be angles of order {order}: expected {','.join(_NUMBERED)}"
        raise MeasurementError(table.path, problem, [table.header_line])
    angles = table.matrix(names)
    given = np.isfinite(angles)
    found = np.full((len(table), 4), np.nan)
    found[given.all(axis=1)] = quaternions_of_angles(angles[given.all(axis=1)], order, names)
    found[given.any(axis=1) & ~given.all(axis=1), 0] = 1.0  # the others are missing: an incomplete row
    for name in names:
        del table.columns[name]
    table.columns |= zip(_QUATERNION, found.T, strict=True)
    table.header[:] = [*(name for name in table.header if name not in names), *_QUATERNION]
