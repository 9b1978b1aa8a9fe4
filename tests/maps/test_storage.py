"""Maps on disk: they round-trip, and nothing remains of one that cannot be written."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import Limit
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.maps.chapter_section import stiffness_section
from pm3dof_pin.maps.chapter_workspace import tripod_space
from pm3dof_pin.maps.datasets import write_csv, write_netcdf
from pm3dof_pin.maps.workspace import workspace

UNIT_OF_HEADING = {
    "theta_x_deg": ("theta_x", np.degrees),
    "theta_y_deg": ("theta_y", np.degrees),
    "z_e_m": ("z_e", np.asarray),
    "stiffness_theta_x_N_m_per_rad": ("stiffness_theta_x", np.asarray),
    "stiffness_theta_y_N_m_per_rad": ("stiffness_theta_y", np.asarray),
    "stiffness_t_z_N_per_m": ("stiffness_t_z", np.asarray),
    "stiffness_t_x_N_per_m": ("stiffness_t_x", np.asarray),
    "stiffness_t_y_N_per_m": ("stiffness_t_y", np.asarray),
    "stiffness_theta_z_N_m_per_rad": ("stiffness_theta_z", np.asarray),
    "stiffness_global_mixed": ("stiffness_global", np.asarray),
}


GRID = RectangularGrid(shape=(11, 9))


@pytest.fixture(params=[[0.487333], [0.487333, 0.55]], ids=["one height", "two heights"])
def section(request: pytest.FixtureRequest, tripod: Tripod) -> xr.Dataset:
    sections = [stiffness_section(tripod, GRID, z_e).dataset() for z_e in request.param]
    return sections[0] if len(sections) == 1 else xr.concat(sections, "z_e", combine_attrs="override")


def test_netcdf_comes_back(tmp_path: Path, section: xr.Dataset) -> None:
    path = write_netcdf(section, tmp_path / "deep" / "section.nc")
    with xr.open_dataset(path) as stored:
        xr.testing.assert_identical(stored.load(), section)
        assert stored.broken_limits.dtype == np.uint8


def test_equal_maps_give_equal_bytes(tripod: Tripod, tmp_path: Path) -> None:
    files = [write_netcdf(stiffness_section(tripod), tmp_path / name).read_bytes() for name in ("one.nc", "another.nc")]
    assert files[0] == files[1]


def test_spreadsheet(tmp_path: Path, section: xr.Dataset) -> None:
    path = write_csv(section, tmp_path / "section.csv")
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == section.broken_limits.size
    assert sorted(rows[0]) == sorted([*UNIT_OF_HEADING, "within_limits", "broken_limits"])
    for heading, (name, convert) in UNIT_OF_HEADING.items():
        stored = section[name].broadcast_like(section.broken_limits).transpose(*section.broken_limits.dims).values
        read = np.array([float(row[heading]) if row[heading] else np.nan for row in rows])
        np.testing.assert_allclose(read, convert(stored).ravel(), rtol=1e-11, atol=1e-13)
    for row, flags in zip(rows, section.broken_limits.values.ravel(), strict=True):
        assert row["within_limits"] == ("FALSE" if flags else "TRUE")
        named = Limit.NONE
        for word in row["broken_limits"].split():
            named |= Limit[word.upper()]
        assert named == flags
    assert any(row["broken_limits"] for row in rows), "no pose breaks a limit: not much of a test"


def test_boundary_of_the_workspace(tripod: Tripod, tmp_path: Path) -> None:
    reachable = workspace(tripod_space(tripod), [0.42, 0.487333, 0.55], 40)
    boundary = reachable.boundary().dataset()
    counts = [len(section.points) for section in reachable.sections]
    assert min(counts) > 20
    np.testing.assert_array_equal(boundary.z_e, np.repeat([0.42, 0.487333, 0.55], counts))
    middle = slice(counts[0], counts[0] + counts[1])
    np.testing.assert_array_equal(boundary.theta_y[middle], reachable.sections[1].points[:, 1])
    with write_csv(boundary, tmp_path / "boundary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["theta_x_deg", "theta_y_deg", "z_e_m", "binding_limits"]
    assert {row["binding_limits"] for row in rows[middle]} == {"spherical"}
    path = write_netcdf(boundary, tmp_path / "boundary.nc")
    with xr.open_dataset(path) as stored:
        xr.testing.assert_identical(stored.load(), boundary)


@pytest.mark.parametrize("write", [write_netcdf, write_csv])
def test_a_folder_that_cannot_be_written(
    tripod: Tripod, tmp_path: Path, write: Callable[[xr.Dataset, Path], Path]
) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="section"):
        write(stiffness_section(tripod, RectangularGrid(shape=(3, 3))), tmp_path / "file" / "section")
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]


def test_a_disk_that_is_full(tripod: Tripod, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object, **keywords: object) -> None:
        raise RuntimeError("NetCDF: HDF error")

    target = tmp_path / "section.nc"
    target.write_text("the old file")
    monkeypatch.setattr("netCDF4.Dataset", fail)
    with pytest.raises(OutputError, match="HDF error"):
        write_netcdf(stiffness_section(tripod, RectangularGrid(shape=(3, 3))), target)
    assert [path.name for path in tmp_path.iterdir()] == ["section.nc"]
    assert target.read_text() == "the old file"
