"""The command `pm3dof` from outside: its output streams and exit status."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.cli.pictures import remove_former
from pm3dof_pin.cli.stiffness_map import JOB_PICTURES
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.maps import atlas

Run = Callable[..., Any]
Answer = Callable[..., dict[str, Any]]


def test_ik_known_pose(answer: Answer) -> None:
    """The travels from three simulators; negative numbers need no special syntax."""
    result = answer("ik", "10", "-15", "0.5")
    np.testing.assert_allclose(result["u_m"], [0.257110951586, 0.260246563859, 0.224483570293], atol=1e-12)
    assert result["within_limits"] is True
    assert result["violated"] == []


def test_fk_is_the_way_back(answer: Answer) -> None:
    u = answer("ik", "-7.5", "12.25", "0.48")["u_m"]
    pose = answer("fk", *(repr(travel) for travel in u))
    assert pose["theta_x_rad"] == pytest.approx(math.radians(-7.5), abs=1e-11)
    assert pose["theta_y_rad"] == pytest.approx(math.radians(12.25), abs=1e-11)
    assert pose["z_e_m"] == pytest.approx(0.48, abs=1e-11)
    assert pose["residual_m"] < 1e-13


def test_fk_all_assembly_modes(answer: Answer) -> None:
    modes = answer("fk", "0.257", "0.26", "0.2245", "--all")["assembly_modes"]
    assert len(modes) == 8
    assert all(mode["residual_m"] < 1e-12 for mode in modes)
    path = str(find_robot("pm3dof").path)
    assert answer("fk", "0.257", "0.26", "0.2245", "--all", "--robot", path)["assembly_modes"] == modes


def test_fk_where_only_other_assembly_modes_exist(answer: Answer, run: Run) -> None:
    result = answer("fk", "0.1", "0.1", "0.4", "--all", status=1)
    assert len(result["assembly_modes"]) == 4
    assert result["theta_x_rad"] is None
    assert result["within_limits"] is False
    none = run("fk", "1", "0", "0", "--all")
    assert none.returncode == 1
    assert none.stdout == ""
    assert none.stderr == "Error: no pose closes the loops at u = (1, 0, 0) m: there is no assembly mode\n"


def test_stiffness_of_the_chapter(answer: Answer) -> None:
    """T_z of a level platform by hand: 3 n_z^2 (k_t + k_a / c^2); the rest from E I, G J and L."""
    result = answer("stiffness", "0", "0", "0.493", "--model", "chapter")
    u = answer("ik", "0", "0", "0.493")["u_m"][0]
    h = (0.37425 - u * math.cos(math.radians(50)) - 0.075) / 0.353
    n_z = math.sqrt(1 - h * h)
    cosine = h * math.cos(math.radians(50)) + n_z * math.sin(math.radians(50))
    diagonal = result["diagonal"]
    assert diagonal["t_z"] == pytest.approx(3 * n_z**2 * (1.5177e10 + 9.5950e7 / cosine**2), rel=1e-12)
    length = 0.493 - 0.37917779060497586
    assert diagonal["t_x"] == pytest.approx(899.6698 / length**5, rel=1e-9)
    assert diagonal["t_x"] == diagonal["t_y"]
    assert diagonal["theta_z"] == pytest.approx(697.4185 / length**2, rel=1e-9)
    assert set(diagonal) == {"theta_x", "theta_y", "t_z", "t_x", "t_y", "theta_z"}
    assert result["global"] == pytest.approx(sum(diagonal.values()) / 6)


def test_stiffness_is_elastic_by_default(answer: Answer) -> None:
    result = answer("stiffness", "10", "-15", "0.5")
    matrix, inverse = np.array(result["K"]), np.array(result["C"])
    scale = np.sqrt(np.diag(matrix))
    np.testing.assert_allclose(matrix @ inverse / scale[:, None] * scale, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(matrix, matrix.T)
    assert len(result["eigenvalues"]) == 6
    assert set(result["units"]) <= set(result) | set(result["indices"])
    assert result["units"]["K"] == "N/m, N, N m/rad"
    for parts in result["spring_shares"].values():
        assert sum(parts.values()) == pytest.approx(1.0)


def test_stiffness_of_other_robots(answer: Answer) -> None:
    """The hexapod's published compliance, to its printed digits."""
    diagonal = np.diag(answer("stiffness", "--robot", "hexapod")["C"])
    assert [f"{value:.1e}" for value in diagonal] == ["4.7e-08", "4.7e-08", "2.1e-08", "5.2e-06", "5.2e-06", "1.7e-06"]


def test_a_tool_that_is_rigid_in_some_directions_has_a_compliance_only(
    answer: Answer, run: Run, tmp_path: Path
) -> None:
    """Without the passive leg's spring, rigid bodies hold x, y and the rotation about z."""
    urdf = Path(answer("info")["urdf"])
    (tmp_path / "stiff.urdf").write_text(urdf.read_text())
    springs = urdf.with_name("pm3dof.closures.yaml").read_text().splitlines()
    (tmp_path / "stiff.closures.yaml").write_text("\n".join(line for line in springs if "cantilever" not in line))
    result = answer("stiffness", "--robot", str(tmp_path / "stiff.urdf"))
    assert result["K"] is None
    assert len(result["rigid_directions"]) == 3
    assert result["felt"]["x"] is None
    said = run("stiffness", "--robot", str(tmp_path / "stiff.urdf")).stderr
    assert "Rigid: translation along" in said
    assert "rotation about (0, 0, 1)" in said
    assert result["felt"]["z"] == pytest.approx(answer("stiffness", "--configuration", "home")["felt"]["z"])


def test_home_needs_no_name(answer: Answer, run: Run, tmp_path: Path) -> None:
    """A robot without an SRDF has a home too."""
    urdf = Path(answer("info")["urdf"])
    (tmp_path / "own robot.urdf").write_text(urdf.read_text())
    (tmp_path / "own robot.closures.yaml").write_text(urdf.with_name("pm3dof.closures.yaml").read_text())
    robot = ["--robot", str(tmp_path / "own robot.urdf")]
    home = answer("statics", "--robot", "pm3dof", "--configuration", "home")["force_N"]
    assert answer("statics", *robot, "--configuration", "home")["force_N"] == pytest.approx(home)
    wrong = run("statics", *robot, "--configuration", "nest")
    assert wrong.returncode == 1
    assert wrong.stderr == "Error: --configuration = nest: expected home, the only one there is\n"


def test_table_8_3(answer: Answer, run: Run) -> None:
    rows = answer("table-8-3")["rows"]
    assert len(rows) == 14
    for row in rows:
        expected = (row["computed"] - row["published"]) / row["published"]
        assert row["relative_difference"] == pytest.approx(expected)
        assert row["axis"] in {"theta_x", "theta_y", "t_z", "t_x", "theta_z", "global"}
        assert row["statistic"] in {"minimum", "maximum", "average"}
    text = run("table-8-3").stdout
    assert "contradicts its own table" in text


def test_info_of_every_robot(answer: Answer) -> None:
    robots = answer("info")["robots"]
    assert "pm3dof" in robots
    for robot in robots:
        result = answer("info", "--robot", robot)
        assert result["mobility"] >= 1
        assert result["home_closure_residual"] < 1e-12
    assert answer("info")["mobility"] == 3


def test_info_of_an_actuated_joint_without_limits(run: Run, tmp_path: Path) -> None:
    """A continuous joint has two coordinates, a cosine and a sine; both are those of an actuated joint."""
    tip = '<link name="tip"/><joint name="fix" type="fixed"><parent link="arm"/><child link="tip"/></joint>'
    hinge = '<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base"/><link name="arm"/>{hinge}{tip}</robot>')
    (tmp_path / "arm.closures.yaml").write_text("name_mot: [hinge]\ntool_frame: tip\n")
    lines = run("info", "--robot", "arm.urdf", cwd=tmp_path).stdout.splitlines()
    assert [line.split()[:2] for line in lines[-2:]] == [["hinge[0]", "actuated"], ["hinge[1]", "actuated"]]


@pytest.mark.usefixtures("unpainted")
def test_main_job_writes_everything_and_says_where(run: Run, tmp_path: Path) -> None:
    result = run("stiffness-map", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    written = {path.name for path in (tmp_path / "results").iterdir()}
    pictures = {"figure_8_3a_theta_x.png", "figure_8_3b_theta_y.png", "figure_8_3c_t_z.png", "figure_8_4_global.png"}
    assert written == {"stiffness_map.nc", "stiffness_map.csv"} | pictures
    assert all(f"wrote {Path('results') / name}" in result.stderr for name in written)
    assert "theta_y average" in result.stdout
    assert "\x1b" not in result.stderr  # no progress bar in a pipe


def test_main_job_with_another_section(answer: Answer, tmp_path: Path) -> None:
    arguments = [
        "--height",
        "0.5",
        "--tilt",
        "20",
        "--points",
        "21",
        "--no-pictures",
        "--out",
        str(tmp_path / "a" / "b"),
    ]
    result = answer("stiffness-map", *arguments)
    assert result["z_e_m"] == 0.5
    assert result["poses"] == result["poses_within_limits"] == 441
    assert sorted(Path(file).name for file in result["files"]) == ["stiffness_map.csv", "stiffness_map.nc"]
    with xr.open_dataset(tmp_path / "a" / "b" / "stiffness_map.nc") as section:
        for name, entry in result["ranges"].items():
            values = section[name].values
            expected = (values.min(), values.max(), values.mean())
            assert (entry["least"], entry["greatest"], entry["mean"]) == pytest.approx(expected)


def test_pictures_of_a_former_run_do_not_stay(tmp_path: Path) -> None:
    mine, former = tmp_path / "figure_8_4_global.pdf", tmp_path / "stiffness_map_condition_number.png"
    others = [tmp_path / "stiffness_map.nc", tmp_path / "workspace.png", tmp_path / "figure_8_4_global.txt"]
    for path in (mine, former, *others):
        path.write_text("")
    remove_former(tmp_path, JOB_PICTURES, [mine])
    assert sorted(tmp_path.iterdir()) == sorted([mine, *others])


def test_workspace(answer: Answer, tmp_path: Path, tripod: Tripod) -> None:
    arguments = ["--heights", "5", "--directions", "24", "--no-picture", "--out", str(tmp_path)]
    result = answer("workspace", *arguments)
    np.testing.assert_allclose(result["z_e_range_m"], [tripod.height_min, tripod.height_max], atol=1e-8)
    assert len(result["sections"]) == 5
    assert result["limit_shares"]["stroke"] > 0
    assert any("printed" in text for text in result["printed_ranges"])


@pytest.mark.usefixtures("unpainted")
def test_atlas(answer: Answer, tmp_path: Path) -> None:
    arguments = ["--points", "9", "9", "5", "-q", "K", "-q", "slider_travel"]
    result = answer("atlas", *arguments, "--out", str(tmp_path / "atlas.nc"))
    assert result["poses"] == 9 * 9 * 5
    pictures = [f"slider_travel_{leg}" for leg in (1, 2, 3)]
    expected = {"atlas.nc", *(f"atlas_{name}.png" for name in pictures)}
    assert {path.name for path in tmp_path.iterdir()} == {Path(file).name for file in result["files"]} == expected


def test_atlas_says_how_it_goes_on_after_an_interrupt(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C as Python raises it, between two blocks; tests/maps sends signals to a real run."""
    compute, calls = atlas._compute_block, itertools.count()

    def interrupted_at_the_second(*arguments: Any) -> Any:
        if next(calls) == 1:
            raise KeyboardInterrupt
        return compute(*arguments)

    monkeypatch.setattr(atlas, "_compute_block", interrupted_at_the_second)
    monkeypatch.setattr(atlas, "_BLOCK_POSES", 200)
    target = tmp_path / "atlas.zarr"
    words = ("atlas", "-q", "slider_travel", "--points", "9", "9", "9", "--threads", "1", "--out", str(target))
    result = run(*words)
    assert f"finished blocks are kept in {target}.parts; run the same command again" in result.stderr
    assert result.returncode == 130
    assert not target.exists()
    assert list((tmp_path / "atlas.zarr.parts" / "broken_limits").glob("c.*"))


@pytest.mark.parametrize("command", ["ik", "stiffness"])
def test_broken_limit_is_answered_named_and_fails(run: Run, command: str) -> None:
    result = run(command, "0", "0", "0.59", "--json")
    assert result.returncode == 1
    assert re.search(r"joint limit broken: slider1_joint at 0\.33\d\d m, outside 0\.1553 \.\. 0\.3253 m", result.stderr)
    assert json.loads(result.stdout)
    if command == "ik":
        values = json.loads(result.stdout)
        assert values["within_limits"] is False
        assert values["violated"] == ["slider1_joint", "slider2_joint", "slider3_joint"]


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["ik", "0", "0", "0.9"], 1, "out of reach"),
        (["ik", "nan", "0", "0.5"], 2, "nan is not a finite number"),
        (["ik"], 2, "expected a pose: pm3dof takes theta_x"),
        (["ik", "0", "0", "500"], 2, "z_e = 500 m looks like millimetres: expected metres (0.5)"),
        (["ik", "573", "0", "0.5"], 2, "theta_x = 573 deg is more than a full turn"),
        (["ik", "0", "0", "0.5", "--configuration", "home"], 2, "POSE and --configuration"),
        (["ik", "0", "0", "0.5", "--out", "x.csv"], 2, "--out requires --poses"),
        (["ik", "--poses", "nowhere.csv"], 1, "nowhere.csv: expected a readable file"),
        (["fk", "--all", "--robot", "hexapod", "--poses", "x.csv"], 2, "--all is for commands on the command line"),
        (["stiffness", "--robot", "hexapod", "--model", "chapter"], 2, "machine of chapter 8"),
        (
            ["ik", "0", "0"],
            2,
            "theta_y -40 .. 40 [deg], z_e 0.3972 .. 0.5775 [m], not 2 numbers",
        ),
        (["ik", "0", "0", "half"], 2, "half is not a number"),
        (["measure", "--poses", "plan.csv"], 2, "'--poses': plan.csv is not a whole number"),
        (["measure", "--load", "heavy"], 2, "'--load': heavy is not a number"),
        (["ik", "--jsn", "0", "0", "0.5"], 2, "--jsn is neither a number nor an option"),
        (["fk", "0.24", "inf", "0.24"], 2, "inf is not a finite number"),
        (["stiffness-map", "--height", "nan"], 2, "'--height': nan is not a finite number"),
        (["stiffness-map", "--tilt", "-40"], 2, "'--tilt': -40 is not an angle"),
        (["atlas", "--points", "5", "1", "5"], 2, "--points 5 1 5: expected at least 2 each"),
        (["atlas", "--heights", "0.5", "0.4"], 2, "--heights 0.5 0.4: expected two finite, increasing"),
        (["atlas", "--points", "90000", "90000", "90000"], 1, "GB of disk space"),
        (["atlas", "--tilt", "nan"], 2, "'--tilt': nan is not a finite number"),
        (["fk", "0.1", "0.2", "0.9"], 1, "u1 ranges from 0.1553 to 0.3253 m, u3 ranges from 0.1553 to 0.3253 m"),
        (["stiffness-map", "--height", "0.9"], 1, "no pose of the map at z_e = 0.9 m is within every joint limit"),
        (["stiffness-map", "--height", "0.577"], 1, "too few to draw"),
        (["stiffness-map", "--points", "2000000"], 1, "not enough memory"),
        (["ik", "0", "0", "0.5", "--jsn"], 2, "--jsn"),
        (["fk", "0.24", "0.24"], 2, "takes u1 0.1553 .. 0.3253 [m], u2"),
        (["fk", "-2", "0.24", "3"], 1, "u1 = -2 m, u2 = 0.24 m, u3 = 3 m is out of reach"),
        (["stiffness", "0", "0", "0.5", "--model", "magic"], 2, "magic"),
        (["stiffness", "0", "0", "0.35"], 1, "'passive_slider_joint' is too low"),
        (["info", "--robot", "nobody"], 1, "no robot 'nobody'"),
        (["atlas", "-q", "colour"], 2, "no quantity 'colour'"),
        (["atlas", "--out", "atlas.txt"], 2, "ending in .nc or .zarr"),
        (["stiffness-map", "--points", "1"], 2, "--points"),
        (["unknown"], 2, "unknown"),
    ],
)
def test_bad_input_gives_one_clear_message(
    run: Run, arguments: list[str], status: int, words: str, tmp_path: Path
) -> None:
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == status, result.stderr
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_number_missing_from_the_yaml(answer: Answer, run: Run, tmp_path: Path) -> None:
    config = tmp_path / "machine.yaml"
    shipped = answer("info")["urdf"]
    text = (Path(shipped).parents[1] / "config" / "pm3dof.yaml").read_text()
    config.write_text("\n".join(line for line in text.splitlines() if "link_length:" not in line))
    for command in (["ik", "0", "0", "0.5"], ["table-8-3"], ["stiffness-map"], ["workspace"], ["atlas"]):
        result = run(*command, "--config", str(config), cwd=tmp_path)
        assert result.returncode == 1
        assert result.stderr.strip().startswith(f"Error: {config}: geometry.link_length: is missing")
    assert list(tmp_path.iterdir()) == [config]


@pytest.mark.parametrize("command", ["stiffness-map", "workspace", "atlas"])
def test_unwritable_folder(run: Run, command: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    target = tmp_path / "file" / ("atlas.nc" if command == "atlas" else "results")
    few = ["--heights", "3", "--directions", "12"] if command == "workspace" else []
    result = run(command, *few, "--out", str(target))
    assert result.returncode == 1
    assert "cannot write" in result.stderr
    assert "Traceback" not in result.stderr
    assert (tmp_path / "file").read_text() == "kept"


HEAVY = [
    "numpy",
    "numba",
    "scipy",
    "pinocchio",
    "xarray",
    "matplotlib",
    "zarr",
    "meshcat",
    "dask",
    "llvmlite",
    "pydantic",
]


@pytest.mark.parametrize(
    ("words", "needed"),
    [
        (["--help"], set()),
        (["ik", "0", "0", "0.5"], {"numpy", "pinocchio"}),
        (["stiffness-map", "--no-pictures"], {"numpy", "pinocchio"}),
    ],
)
def test_quick_commands_load_little(words: list[str], needed: set[str], tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from pm3dof_pin.cli import app\n"
        f"sys.argv = {['pm3dof', *words]}\n"
        "try:\n    app.main()\n"
        f"finally:\n    print([name for name in {HEAVY} if name in sys.modules])\n"
    )
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert result.stdout.splitlines()[-1] == str([name for name in HEAVY if name in needed])


def test_help_and_version(run: Run) -> None:
    assert "stiffness-map" in run("--help").stdout
    assert run("--version").stdout.startswith("pm3dof ")
    for command in ("ik", "fk", "stiffness", "stiffness-map", "table-8-3", "workspace", "atlas", "info"):
        text = run(command, "--help").stdout
        assert "Usage: " in text


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("words", [["table-8-3"], ["--version"]])
def test_full_disk_behind_standard_output(words: list[str], unbuffered: str) -> None:
    command = [sys.executable, "-c", "from pm3dof_pin.cli.app import main; main()", *words]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    assert result.returncode == 1
    assert result.stderr == "Error: [Errno 28] No space left on device\n"


def test_a_reader_that_leaves_early_is_no_error() -> None:
    command = f"{sys.executable} -c 'from pm3dof_pin.cli.app import main; main()' table-8-3 | head -1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False, env=os.environ)
    assert "Traceback" not in result.stderr


def test_measure_takes_poses_or_a_plan(run: Run, tmp_path: Path) -> None:
    done = run("measure", "--plan", "plan.csv", "--poses", "3", cwd=tmp_path)
    assert done.returncode == 2
    assert "not both" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("info",),
        ("ik", "0", "0", "0.5"),
        ("ik", "--poses", "poses.csv"),
        ("fk", "0.24", "0.24", "0.24"),
        ("stiffness",),
        ("stiffness", "0", "0", "0.5", "--model", "chapter"),
        ("statics",),
        ("modes",),
        ("error-parameters",),
        ("measure", "--poses", "6", "--only", "geometric", "--out", "m.csv"),
        ("atlas", "--list"),
        ("evaluate", "--points", "3", "--no-pictures"),
        ("error-map", "--samples", "3", "--no-pictures"),
    ],
)
def test_an_answer_without_robot_says_which_it_is_about(
    run: Run, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "poses.csv").write_text("theta_x_deg,theta_y_deg,z_e_m\n0,0,0.5\n")
    notice = "no --robot: this is about pm3dof"
    monkeypatch.delenv("PM3DOF_ROBOT")
    silent = run(*words, "--json", cwd=tmp_path)
    assert notice in silent.stderr
    assert json.loads(silent.stdout)["robot"] == "pm3dof"
    again = ("--force",) if words[0] == "measure" else ()
    assert notice not in run(*words, *again, "--robot", "pm3dof", cwd=tmp_path).stderr
    if words[0] == "info":
        monkeypatch.setenv("PM3DOF_ROBOT", "hexapod")
        assert json.loads(run("info", "--json").stdout)["robot"] == "hexapod"
        assert json.loads(run("info", "three_rps", "--json").stdout)["robot"] == "three_rps"


@pytest.mark.parametrize("words", [("stiffness-map", "--no-pictures", "--points", "9"), ("table-8-3",), ("workspace",)])
def test_answers_about_the_chapter_name_its_robot(answer: Answer, words: tuple[str, ...], tmp_path: Path) -> None:
    assert answer(*words, cwd=tmp_path)["robot"] == "pm3dof"
