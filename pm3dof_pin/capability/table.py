"""A transmission over a grid of the joints as labelled arrays, and as a spreadsheet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.capability.transmission import Transmission
from pm3dof_pin.files import write_atomically, write_text_atomically
from pm3dof_pin.kinematics.pose_file import columns_text
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


def _columns(transmission: Transmission) -> dict[str, Array]:
    """Return the table of a transmission: a column for each number, shape=(n,), named with its unit."""
    joints, drives = transmission.joints, transmission.drives
    robot = transmission.poses.robot
    coordinates = transmission.asked.reshape(-1, len(joints))
    commands = transmission.poses.commands.reshape(-1, len(drives))
    found = {f"{c.name}_{c.unit}": column for c, column in zip(robot.coordinates, coordinates.T, strict=True)}
    found |= {f"{c.name}_{c.unit}": column for c, column in zip(robot.command_coordinates, commands.T, strict=True)}
    found["within_limits"] = transmission.poses.within_limits.ravel().astype(float)
    for name, rows, values in (
        ("jacobian", drives, transmission.jacobian),
        ("rotor_inertia_kg_m2", joints, transmission.rotor_inertia),
        ("inertia_kg_m2", joints, transmission.inertia),
    ):
        flat = values.reshape(-1, len(rows), len(joints))
        found |= {f"{name} {a} {b}": flat[:, i, j] for i, a in enumerate(rows) for j, b in enumerate(joints)}
    torques = {"holding_torque_N_m": transmission.weight, "unit_pure_torque": transmission.unit_pure_torques}
    if np.isfinite(transmission.effort).all():
        torques["pure_torque_N_m"] = transmission.pure_torques
    if np.isfinite(transmission.speed).all():
        torques["pure_speed_rad_s"] = transmission.pure_speeds
    for name, values in torques.items():
        found |= {f"{name} {joint}": values.reshape(-1, len(joints))[:, k] for k, joint in enumerate(joints)}
    found["distance_to_singularity"] = transmission.distance_to_singularity.ravel()
    return found


def _dataset(transmission: Transmission) -> xr.Dataset:
    """Return the table as labelled arrays over the joints."""
    import xarray as xr

    shape = transmission.poses.shape
    joints = transmission.joints
    axes = dict(zip(joints, transmission.axes, strict=True))
    arrays = {
        name.replace(" ", "_"): (joints, column.reshape(shape))
        for name, column in _columns(transmission).items()
        if name.rsplit("_", 1)[0] not in joints
    }
    return xr.Dataset(arrays, coords=axes, attrs={"robot": transmission.poses.robot.name})


def write_tables(transmission: Transmission, folder: Path) -> list[Path]:
    """Write `transmission.csv` and `transmission.nc`; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    sheet = write_text_atomically(folder / "transmission.csv", columns_text(_columns(transmission)))
    labelled = folder / "transmission.nc"
    with write_atomically(labelled) as path:
        _dataset(transmission).to_netcdf(path)
    return [sheet, labelled]
