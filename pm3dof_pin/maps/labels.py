"""Metadata of maps: attributes of datasets, coordinates and limits (CF conventions); units of entries."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import pm3dof_pin

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

BROKEN_LIMITS = "broken_limits"


def dataset_attributes(title: str, machine: str) -> dict[str, str]:
    """Return the attributes of a dataset of a machine."""
    source = f"pm3dof-pin {pm3dof_pin.__version__}"
    return {"Conventions": "CF-1.8", "title": title, "machine": machine, "source": source}


def coordinate_attributes(name: str, unit: str, machine: str) -> dict[str, str]:
    """Return the attributes of a coordinate of a machine."""
    return {"units": unit, "long_name": f"coordinate {name} of {machine}"}


def limit_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of the bits of :attr:`~pm3dof_pin.kinematics.robot.Poses.broken_limits`, in order."""
    return ("reach", *(group.name for group in robot.limit_groups))


def flag_type(names: tuple[str, ...]) -> np.dtype[Any]:
    """Return the smallest type of unsigned integers with a bit for each name."""
    return np.min_scalar_type((1 << len(names)) - 1)


def flag_attributes(names: tuple[str, ...], long_name: str) -> dict[str, object]:
    """Return the attributes of a variable that holds sums of flags, named from the lowest bit."""
    return {
        "long_name": long_name,
        "flag_masks": np.array([1 << bit for bit in range(len(names))], dtype=flag_type(names)),
        "flag_meanings": " ".join(names),
        "comment": "sum of the flags; zero within all limits",
    }


def unit_of_entry(units: str, entry: str) -> str:
    """Return an entry's unit from "N/m (x, y, z), N m/rad (rx, ry, rz)"; a common unit stays as it is."""
    for part in units.split("), "):
        unit, _, entries = part.rstrip(")").partition(" (")
        if entry in entries.split(", "):
            return unit
    return units
