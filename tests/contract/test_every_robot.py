"""One contract for every robot and every dialect: whatever works for one works for all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.calibration import expectation

Run = Callable[..., Any]
Case = Any  # of conftest


NOT_CALIBRATED = {
    "walker": "its tool frame is named by an option that compensate does not have",
    "hexapod": "in tests/calibration/test_commands.py",
    "ur5": "in tests/calibration/test_commands.py",
}

_HOMES: dict[str, dict[str, float]] = {}


def _home(run: Run, case: Case) -> dict[str, float]:
    """Values of the coordinates at home, in the command line's units; computed once."""
    if case.name not in _HOMES:
        entries = run("info", *case.options, "--json").json["coordinates"]
        _HOMES[case.name] = {entry["name"]: _shown(entry["home"], entry["unit"]) for entry in entries}
    return _HOMES[case.name]


def _shown(value: float, unit: str) -> float:
    return float(np.degrees(value)) if unit == "rad" else value


def _ranges(run: Run, case: Case, option: str, count: int) -> list[object]:
    home, words = _home(run, case), list[object]()
    for name, reach in case.axes:
        words += [option, name, home[name] - reach, home[name] + reach, count]
    return words


def _require(case: Case, *, axes: int = 0, springs: bool = False) -> None:
    """Skip a test that a robot has no subject for."""
    if len(case.axes) < axes:
        pytest.skip(f"{case.name} has no {axes} coordinates for a grid")
    if springs and not case.springs:
        pytest.skip(f"the description of {case.name} has no springs")


def test_info_says_what_it_is(pm3dof: Run, case: Case) -> None:
    result = pm3dof("info", *case.options, "--json").json
    assert {"closure_residual", "mobility", "closures", "joints", "commands", "coordinates"} <= set(result)
    assert result["closure_residual"] < 1e-12
    assert all({"name", "unit"} <= set(entry) for entry in result["commands"] + result["coordinates"])


def test_commands_of_a_pose_give_the_pose_back(pm3dof: Run, case: Case) -> None:
    home = _home(pm3dof, case)
    moved = home | {name: home[name] + 0.3 * reach for name, reach in case.axes}
    pose = pm3dof("ik", *case.options, "--json", *moved.values()).json
    units = [command["unit"] for command in pose["commands"]]
    u = [_shown(value, unit) for value, unit in zip(pose["u"], units, strict=True)]
    back = pm3dof("fk", *case.options, "--json", *u).json
    np.testing.assert_allclose(list(back["pose"].values()), list(pose["pose"].values()), atol=1e-9)


@pytest.mark.parametrize("command", ["stiffness", "statics", "modes"])
def test_a_pose_is_analysed(pm3dof: Run, case: Case, command: str) -> None:
    if command != "statics" and not case.springs:
        assert "springs" in pm3dof(command, *case.options, status=1).err
    else:
        pm3dof(command, *case.options, "--json")


def _dataset(path: Path) -> Any:
    import xarray as xr

    with xr.open_dataset(path) as dataset:
        return dataset.load()


def test_a_map_over_two_coordinates(pm3dof: Run, case: Case) -> None:
    _require(case, axes=2, springs=True)
    pictures = () if case.name == "five_bar" else ("--no-pictures",)
    pm3dof("stiffness-map", *case.options, *_ranges(pm3dof, case, "--over", 5), "--out", "map", *pictures)
    assert list(Path("map").glob("*.nc"))
    assert list(Path("map").glob("*.csv"))
    assert bool(list(Path("map").glob("*.png"))) == (not pictures)


@pytest.mark.usefixtures("programs_for_few_poses")
def test_every_quantity_is_the_same_on_both_engines(pm3dof: Run, case: Case) -> None:
    """All that the robot has, by the list that the command prints; Pinocchio's values decide the scale."""
    _require(case, axes=1, springs=True)
    ranges = _ranges(pm3dof, case, "--range", 3)
    listed = pm3dof("atlas", *case.options, "--list", "--json").json["quantities"]
    words = [word for name in listed for word in ("--quantity", name)] + ["--precision", "double", "--no-pictures"]
    for engine in ("program", "pinocchio"):
        pm3dof("atlas", *case.options, *ranges, *words, "--engine", engine, "--out", f"{engine}.nc")
    program, pinocchio = _dataset(Path("program.nc")), _dataset(Path("pinocchio.nc"))
    assert set(program.data_vars) == set(pinocchio.data_vars)
    assert len(pinocchio.data_vars) > len(listed) - 2  # two have a second name
    for name, expected in pinocchio.data_vars.items():
        found = program[name]
        assert found.dims == expected.dims, name
        if not np.issubdtype(expected.dtype, np.floating):
            np.testing.assert_array_equal(found.values, expected.values, err_msg=name)
            continue
        size = np.abs(expected.values).max(initial=0.0, where=np.isfinite(expected.values))
        np.testing.assert_allclose(found.values, expected.values, rtol=1e-7, atol=1e-8 * size + 1e-17, err_msg=name)


def test_the_workspace_is_judged(pm3dof: Run, case: Case) -> None:
    _require(case, axes=1, springs=True)
    pictures = () if case.name == "five_bar" else ("--no-pictures",)
    words = ("evaluate", *case.options, *_ranges(pm3dof, case, "--range", 5), "--points", 3, "--out", "evaluated")
    result = pm3dof(*words, *pictures, "--json").json
    shares = {axis: sum(spring["mean_share"] for spring in springs) for axis, springs in result["springs"].items()}
    assert shares
    np.testing.assert_allclose(list(shares.values()), 1.0)
    assert 0.0 < result["global_indices"]["least_conditioning"] <= result["global_indices"]["conditioning"] <= 1.0


def test_errors_over_two_coordinates(pm3dof: Run, case: Case) -> None:
    _require(case, axes=2)
    pm3dof("error-map", *case.options, *_ranges(pm3dof, case, "--over", 5), "--out", "errors", "--no-pictures")
    assert list(Path("errors").glob("*.nc"))


@pytest.mark.usefixtures("few_folds")
def test_measured_calibrated_compensated(
    pm3dof: Run, case: Case, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    if case.name in NOT_CALIBRATED:
        pytest.skip(NOT_CALIBRATED[case.name])
    if case.name != "five_bar":  # one report with its pictures, and its numbers from many poses, is enough
        request.getfixturevalue("report_without_pictures")
        monkeypatch.setattr(expectation, "_POSES", 40)
    pm3dof("measure", "--out", "measured.csv", *case.options, "--poses", 12, "--seed", 1)
    few = ("--force",) if case.name == "delta" else ()  # 72 equations for its 204 error parameters
    pm3dof("calibrate", "measured.csv", *case.options, "--out", "calibrated", "--method", "lm", *few)
    home = _home(pm3dof, case)
    result = pm3dof("compensate", *case.options, "--calibration", "calibrated", "--json", *home.values()).json
    assert np.isfinite(result["u"]).all()


def test_exported(pm3dof: Run, case: Case) -> None:
    pm3dof("export", "urdf", *case.options[:2], "--out", "exported")
    assert any(Path("exported").rglob("*.urdf"))


def test_a_page_is_written(pm3dof: Run, case: Case) -> None:
    pm3dof("view", *case.options, "--html", "page.html")
    assert 100_000 < Path("page.html").stat().st_size < 2_500_000
