"""Maps, atlas and workspace of any robot from the command line."""

from __future__ import annotations

import contextlib
import csv
import os
import pty
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance

Answer = Callable[..., Any]
MACHINES = Path(__file__).parents[1] / "machines"
FIVE_BAR = str(MACHINES / "five_bar" / "five_bar.urdf")
FOUR_RRR = str(MACHINES / "four_rrr" / "four_rrr.urdf")


@pytest.mark.usefixtures("unpainted")
def test_map_of_a_hexapod(answer: Answer, tmp_path: Path) -> None:
    over = ["--over", "x", "-0.012", "0.012", "5", "--over", "rx", "-4", "4", "5", "--at", "z", "0.136"]
    result = answer("stiffness-map", "--robot", "hexapod", *over, "--out", str(tmp_path))
    assert result["dimensions"] == ["x", "rx"]
    assert result["fixed"]["z"] == 0.136
    names = {Path(file).name for file in result["files"]}
    assert {path.name for path in tmp_path.iterdir()} == names
    wanted = ("felt_stiffness_x", "translational_stiffness_least", "condition_number", "first_frequency")
    assert {f"stiffness_map_{name}.png" for name in wanted} < names
    with xr.open_dataset(tmp_path / "stiffness_map.nc") as dataset:
        assert dataset["rx"].values[0] == pytest.approx(np.radians(-4.0))
        model = ElasticModel.load("hexapod")
        pose = model.rigid.solve([dataset["x"].values[1], 0.0, 0.136, dataset["rx"].values[2], 0.0, 0.0])
        expected = 1.0 / cartesian_compliance(model, pose.configuration()).compliance.diagonal()
        np.testing.assert_allclose(dataset["felt_stiffness"].values[1, 2], expected, rtol=1e-9)
    with (tmp_path / "stiffness_map.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == result["poses"] == 25


def test_map_of_a_planar_robot_is_that_of_its_free_motions(answer: Answer, tmp_path: Path) -> None:
    result = answer("stiffness-map", "--robot", FIVE_BAR, "--points", "5", "--no-pictures", "--out", str(tmp_path))
    assert {"free_stiffness_x", "free_stiffness_y", "felt_stiffness_x", "first_frequency"} <= set(result["ranges"])
    assert "felt_stiffness_z" not in result["ranges"]
    assert result["ranges"]["free_stiffness_x"]["unit"] == "N/m"


def test_engines_agree(answer: Answer, tmp_path: Path) -> None:
    over = ["--over", "theta_x", "-20", "20", "3", "--over", "theta_y", "-20", "20", "3", "--no-pictures"]
    ranges = [
        answer("stiffness-map", "--robot", "pm3dof", *over, "--engine", engine, "--out", str(tmp_path / engine))[
            "ranges"
        ]
        for engine in ("program", "pinocchio")
    ]
    for name, entry in ranges[0].items():
        assert entry["least"] == pytest.approx(ranges[1][name]["least"], rel=1e-6), name


def test_atlas_over_ranges(answer: Answer, tmp_path: Path) -> None:
    ranges = ["--range", "z", "0.13", "0.14", "3", "--range", "x", "-0.01", "0.01", "4", "--at", "rx", "2"]
    out = str(tmp_path / "atlas.zarr")
    result = answer("atlas", "--robot", "hexapod", *ranges, "-q", "stiffness", "--no-pictures", "--out", out)
    assert result["dimensions"] == ["z", "x"]
    assert result["poses"] == 12
    with xr.open_zarr(out, consolidated=False) as dataset:
        assert dataset["stiffness"].shape == (3, 4, 6, 6)


def test_atlas_over_all_coordinates(answer: Answer, tmp_path: Path) -> None:
    out = str(tmp_path / "atlas.nc")
    result = answer(
        "atlas", "--robot", "three_rps", "--counts", "3,4,5", "-q", "commands", "--no-pictures", "--out", out
    )
    assert result["dimensions"] == ["z", "rx", "ry"]
    assert result["poses"] == 60


def test_workspace_over_chosen_coordinates(answer: Answer, tmp_path: Path) -> None:
    chosen = ["--coordinate", "rx", "--coordinate", "ry", "--coordinate", "z", "--heights", "3", "--directions", "8"]
    result = answer("workspace", "--robot", "hexapod", *chosen, "--no-picture", "--out", str(tmp_path))
    assert {"volume_rad2_m", "z_range_m", "rx_range_rad", "ry_range_rad", "limit_shares", "sections"} <= set(result)
    assert sum(result["limit_shares"].values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["atlas", "--robot", "hexapod", "--range", "w", "0", "1", "3"], 2, "hexapod has no coordinate 'w'"),
        (["atlas", "--robot", "hexapod", "--range", "x", "0", "1"], 2, "expected NAME FIRST LAST COUNT, not 'x 0 1'"),
        (["atlas", "--robot", "hexapod", "--range", "x", "1", "0", "3"], 2, "expected increasing values"),
        (["atlas", "--robot", "hexapod", "--range", "x", "-10", "500", "3"], 2, "looks like millimetres"),
        (["atlas", "--robot", "hexapod", "--range", "x", "0", "nan", "3"], 2, "nan is not a finite number"),
        (["atlas", "--robot", "hexapod", "--range", "rz", "-200", "200", "3"], 2, "expected -9 to 9 deg"),
        (["atlas", "--robot", FOUR_RRR, "--range", "rz", "-200", "200", "3"], 2, "expected at most a full turn"),
        (["atlas", "--robot", FOUR_RRR, "--range", "rz", "-400", "400", "3"], 2, "expected -360 to 360 deg"),
        (["atlas", "--robot", "hexapod", "--tilt", "20"], 2, "use --range"),
        (["atlas", "--robot", "hexapod", "--counts", "3,3"], 2, "expected one number, or 6 for hexapod"),
        (["atlas", "--robot", "hexapod", "-q", "chapter_global"], 1, "has no chapter_global"),
        (["atlas", "--range", "z_e", "0.8", "0.9", "3"], 1, "no pose of the atlas over z_e is within every limit"),
        (["stiffness-map", "--robot", "hexapod", "--over", "x", "0", "0.01", "3"], 2, "expected --over twice"),
        (["stiffness-map", "--robot", "hexapod", "--tilt", "10"], 2, "use --over and --at"),
        (["stiffness-map", "--robot", "hexapod", "--at", "z", "0.3"], 1, "no pose of the map over x and y of hexapod"),
        (
            [
                "workspace",
                "--robot",
                "hexapod",
                *(part for name in ("x", "y", "z", "rx") for part in ("--coordinate", name)),
            ],
            2,
            "two for the sections, and optionally one to stack them",
        ),
    ],
)
def test_wrong_usage(run: Any, arguments: list[str], status: int, words: str, tmp_path: Path) -> None:
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == status, result.stderr
    assert words in " ".join(result.stderr.split()).replace("│", "")
    assert "Traceback" not in result.stderr
    assert list(tmp_path.rglob("*.*")) == []


@pytest.mark.parametrize("ends", [("0", "360"), ("-400", "400")])
def test_ranges_over_a_turn_or_as_declared(answer: Answer, tmp_path: Path, ends: tuple[str, str]) -> None:
    """A whole turn is one of any rotation of the tool; more, if the description declares it."""
    folder = shutil.copytree(MACHINES / "four_rrr", tmp_path / "four_rrr")
    coordinates = "coordinates:\n" + "".join(f"  - {{name: {n}, tool: {n}, unit: m}}\n" for n in "xy")
    limits = ", range: [-7, 7]" if ends[0] == "-400" else ""
    coordinates += f"  - {{name: rz, tool: rz, unit: rad{limits}}}\n"
    with (folder / "four_rrr.closures.yaml").open("a") as file:
        file.write(coordinates)
    command = ["atlas", "--robot", str(folder / "four_rrr.urdf"), "--range", "rz", *ends, "3", "-q", "branch"]
    answer(*command, "--no-pictures", "--out", str(tmp_path / "atlas.nc"))
    with xr.open_dataset(tmp_path / "atlas.nc") as dataset:
        np.testing.assert_allclose(np.degrees(dataset["rz"].values), np.linspace(*map(float, ends), 3), atol=1e-9)


def test_the_bar_on_a_terminal_says_that_a_program_is_compiled(tmp_path: Path) -> None:
    ours, terminal = pty.openpty()
    command = [sys.executable, "-m", "pm3dof_pin", "workspace", "--robot", "three_rps", "--no-picture"]
    command += ["--out", str(tmp_path / "space")]
    environment = os.environ | {"PM3DOF_CACHE_DIR": str(tmp_path / "cache")}
    with subprocess.Popen(command, stderr=terminal, stdout=subprocess.DEVNULL, env=environment) as process:
        os.close(terminal)
        shown = b""
        with contextlib.suppress(OSError):  # the end of a terminal
            while part := os.read(ours, 1 << 16):
                shown += part
    os.close(ours)
    assert process.returncode == 0
    assert b"workspace, recording a program" in shown
    assert re.search(rb"workspace, compiling \d[\d,]* operations", shown)
