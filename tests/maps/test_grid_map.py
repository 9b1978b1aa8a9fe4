"""Maps of any robot over a grid of its coordinates: labels, limits, files."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.datasets import write_csv, write_netcdf
from pm3dof_pin.maps.grid_map import quantities_over, quantity_map
from pm3dof_pin.maps.quantity import MappedRobot


@pytest.fixture(scope="module")
def hexapod() -> Robot:
    return Robot.load("hexapod")


@pytest.fixture(scope="module")
def dataset(hexapod: Robot) -> xr.Dataset:
    grid = hexapod.grid(x=(-0.015, 0.015, 7), rx=(-0.1, 0.1, 5), z=0.14)
    return quantity_map(MappedRobot(hexapod), grid, ["felt_stiffness", "condition_number", "first_frequency"])


def test_labels(dataset: xr.Dataset) -> None:
    assert dataset["felt_stiffness"].dims == ("x", "rx", "axis")
    assert dataset["condition_number"].dims == ("x", "rx")
    assert list(dataset["axis"].values) == ["x", "y", "z", "rx", "ry", "rz"]
    assert dataset["rx"].attrs["units"] == "rad"
    assert float(dataset["z"]) == 0.14
    assert float(dataset["ry"]) == 0.0


def test_values_and_limits(dataset: xr.Dataset, hexapod: Robot) -> None:
    model = ElasticModel(hexapod)
    flags = dataset["broken_limits"]
    names = dict(zip(flags.attrs["flag_meanings"].split(), flags.attrs["flag_masks"], strict=True))
    assert (flags.values == 0).any()
    assert (flags.values != 0).any()
    for i, j in np.ndindex(7, 5):
        pose = hexapod.solve([float(dataset.x[i]), 0.0, 0.14, float(dataset.rx[j]), 0.0, 0.0])
        configuration = pose.configuration()
        broken = set(configuration.violated_limits())
        assert bool(flags.values[i, j]) == bool(broken)
        if broken:
            assert np.isnan(dataset["felt_stiffness"].values[i, j]).all()
            assert np.isnan(dataset["first_frequency"].values[i, j])
        else:
            expected = 1.0 / cartesian_compliance(model, configuration).compliance.diagonal()
            np.testing.assert_allclose(dataset["felt_stiffness"].values[i, j], expected, rtol=1e-9)
    assert "reach" in names


def test_files(dataset: xr.Dataset, tmp_path: Path) -> None:
    with xr.open_dataset(write_netcdf(dataset, tmp_path / "map.nc")) as stored:
        np.testing.assert_array_equal(stored["felt_stiffness"].values, dataset["felt_stiffness"].values)
    with write_csv(dataset, tmp_path / "map.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 35
    headings = ["x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg", "felt_stiffness_x_N_per_m"]
    assert list(rows[0])[:7] == headings
    assert "felt_stiffness_rx_N_m_per_rad" in rows[0]
    assert "condition_number" in rows[0]
    assert float(rows[4]["rx_deg"]) == pytest.approx(np.degrees(0.1))
    inside = [row for row in rows if row["within_limits"] == "TRUE"]
    assert inside
    assert all(float(row["first_frequency_Hz"]) > 100.0 for row in inside)
    assert all(row["condition_number"] == "" for row in rows if row["broken_limits"])


def test_points_between_the_poses_have_the_values_of_a_grid_there(hexapod: Robot) -> None:
    mapped = MappedRobot(hexapod)
    grid = mapped.robot.grid(x=(-0.02, 0.02, 3), ry=(-0.1, 0.1, 3), z=0.14)
    fine = mapped.robot.grid(x=(-0.02, 0.02, 5), ry=(-0.1, 0.1, 5), z=0.14)
    points = np.stack(np.meshgrid(*fine.axes.values(), indexing="ij"), axis=-1).reshape(-1, 2)
    found = quantities_over(mapped, grid, ("felt_stiffness",))(points)["felt_stiffness"]
    wanted = quantity_map(mapped, fine, ("felt_stiffness",)).felt_stiffness.values
    assert 0 < np.isfinite(wanted[..., 0]).sum() < 25
    np.testing.assert_allclose(found.reshape(5, 5, 6), wanted, rtol=1e-12)
