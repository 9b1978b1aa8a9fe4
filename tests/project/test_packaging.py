"""The installed package: its data, its types, and its few imports."""

from __future__ import annotations

import importlib.metadata
import json
import re
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

import pm3dof_pin
from pm3dof_pin.description.robots import find_robot, robot_names, robots_directory

ROOT = Path(__file__).parents[2]
HEAVY = {
    "dask",
    "h5py",
    "matplotlib",
    "meshcat",
    "netCDF4",
    "numba",
    "numpy",
    "pinocchio",
    "scipy",
    "sklearn",
    "xarray",
    "yourdfpy",
}


def _heavy_after(code: str) -> set[str]:
    program = f"{code}\nimport json, sys\nprint(json.dumps(list(sys.modules)))"
    # started outside the checkout, so that the installed package is imported
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd="/")
    return HEAVY & set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_the_package_imports_nothing_heavy() -> None:
    assert not _heavy_after("import pm3dof_pin")


def test_the_help_of_the_command_imports_nothing_heavy() -> None:
    run = "from typer.testing import CliRunner; from pm3dof_pin.cli.app import app"
    assert not _heavy_after(f"{run}; assert CliRunner().invoke(app, ['--help']).exit_code == 0")


def test_every_public_name_can_be_imported() -> None:
    assert pm3dof_pin.__all__
    assert len(set(pm3dof_pin.__all__)) == len(pm3dof_pin.__all__)
    for name in pm3dof_pin.__all__:
        assert getattr(pm3dof_pin, name).__doc__, f"{name} has no docstring"
    assert set(pm3dof_pin.__all__) <= set(dir(pm3dof_pin))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = pm3dof_pin.no_such_name


def test_the_package_is_typed() -> None:
    assert files("pm3dof_pin").joinpath("py.typed").is_file()


def test_the_robots_are_found() -> None:
    assert "pm3dof" in robot_names()
    robot = find_robot("pm3dof")
    for path in (robot.urdf, robot.closures, robots_directory() / "pm3dof_description" / "config" / "pm3dof.yaml"):
        assert path.is_file(), path


def test_one_version_everywhere() -> None:
    version = pm3dof_pin.__version__
    assert importlib.metadata.version("pm3dof-pin") == version
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert version in headings or headings[0] == "Unreleased"


def test_the_command_is_installed() -> None:
    (entry,) = [e for e in importlib.metadata.entry_points(group="console_scripts") if e.name == "pm3dof"]
    assert callable(entry.load())
