"""`pm3dof measure`, `calibrate` and `compensate`, one after the other, for every kind of robot."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.calibration import report
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.simulation.simulated_machine import Conditions, SimulatedMachine

MACHINES = Path(__file__).parents[1] / "machines"


pytestmark = pytest.mark.usefixtures("small_networks", "few_folds")

Run = Callable[..., Any]
Answer = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, answer: Answer) -> Path:
    """A folder with measurements m.csv and their calibration."""
    folder = tmp_path_factory.mktemp("calibration")
    measured = answer("measure", "--out", "m.csv", "--poses", "30", "--seed", "4", "--machine", "2", cwd=folder)
    assert measured["poses"] == 30
    options = ("--method", "lm+gp", "--out", "calibration", "--format", "png")
    with pytest.MonkeyPatch.context() as patch:  # pictures are files here, and painted in other tests
        patch.setattr(report, "html_image", lambda figure, text: f"<p>{text}</p>")
        patch.setattr("pm3dof_pin.figures.style._paint", lambda figure, path, *_: path.touch())
        calibrated = answer("calibrate", "m.csv", *options, cwd=folder)
    assert calibrated["directory"] == "calibration"
    pictures = {file.stem for file in (folder / "calibration").glob("*.png")}
    assert pictures == {"tip_error_held_out", "residuals", "workspace", "parameters"}
    assert calibrated["held_out"]["poses"] == 30
    return folder


def test_the_same_seed_gives_the_same_file(place: Path, answer: Answer) -> None:
    answer("measure", "--out", "again.csv", "--poses", "30", "--seed", "4", "--machine", "2", cwd=place)
    assert (place / "again.csv").read_bytes() == (place / "m.csv").read_bytes()
    answer("measure", "--out", "other.csv", "--poses", "30", "--seed", "5", "--machine", "2", cwd=place)
    assert (place / "other.csv").read_bytes() != (place / "m.csv").read_bytes()


def test_simulated_measurements_do_not_replace_a_file(run: Run, tmp_path: Path) -> None:
    (tmp_path / "real.csv").write_text("u1_m,x_m\n")
    options = ("measure", "--out", "real.csv", "--poses", "2")
    refused = run(*options, cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "real.csv" in refused.stderr
    assert "--force" in refused.stderr
    assert (tmp_path / "real.csv").read_text() == "u1_m,x_m\n"
    assert run(*options, "--force", cwd=tmp_path).returncode == 0
    assert len((tmp_path / "real.csv").read_text().splitlines()) == 3


def test_one_source_of_errors_and_loads(place: Path, run: Run, answer: Answer) -> None:
    answer("measure", "--out", "soft.csv", "--poses", "4", "--only", "elastic", "--load", "50", cwd=place)
    header, first, *_ = (place / "soft.csv").read_text().splitlines()
    assert header.endswith(",sigma_rz_rad,load_tool_N")
    assert 0.0 <= float(first.rsplit(",", 1)[1]) <= 50.0
    result = run("measure", "--world", "geometry", "--only", "thermal", cwd=place)
    assert (result.returncode, result.stdout) == (1, "")
    assert result.stderr == "Error: source = thermal: expected one that this machine has\n"


def test_poses_that_a_machine_cannot_take_are_left_out(place: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The three longest travels of its first drive."""
    travels = np.sort(np.loadtxt(place / "m.csv", delimiter=",", skiprows=1, usecols=0))
    longest, carried_out = travels[-4:-2].mean(), SimulatedMachine._carried_out

    def short(machine: SimulatedMachine, commands: np.ndarray, conditions: Conditions) -> np.ndarray:
        if (commands[:, 0] > longest).any():
            raise UnreachablePoseError("the loops do not close")
        return carried_out(machine, commands, conditions)

    monkeypatch.setattr(SimulatedMachine, "_carried_out", short)
    options = ("--poses", "30", "--seed", "4", "--machine", "2", "--only", "geometric")
    done = run("measure", "--out", "short.csv", *options, cwd=place)
    assert done.returncode == 0
    assert "3 of 30 poses are left out" in done.stderr
    kept = np.loadtxt(place / "short.csv", delimiter=",", skiprows=1, usecols=0)
    np.testing.assert_array_equal(np.sort(kept), travels[:-3])


@pytest.mark.usefixtures("report_without_pictures")
def test_the_library_writes_what_the_command_writes(place: Path, tmp_path: Path) -> None:
    """From the file and the names alone."""
    folder = pm.calibrate(place / "m.csv", "pm3dof", validation=place / "m.csv").save(tmp_path / "c")
    again = pm.calibrate(place / "m.csv", pm.load("pm3dof"), "lm+gp")
    assert again.validation is None
    assert again.held_out is not None
    files = ["compensation.json", "measurements.csv", *(f"nominal/pm3dof.{e}" for e in ("urdf", "srdf", "errors.yaml"))]
    for name in files:
        assert (folder / name).read_bytes() == (place / "calibration" / name).read_bytes(), name
    summary = yaml.safe_load((place / "calibration" / "calibration.yaml").read_text())
    summary["measurements"]["warnings"] = []
    assert again.summary() == summary
    assert again.summary()["what_to_expect"] == again.expectation.text
    assert pm.read_compensation(folder).values is not None


@pytest.mark.usefixtures("report_without_pictures")
def test_a_frame_of_the_instruments_own(place: Path, run: Run, answer: Answer) -> None:
    """The tracker is upside down, two metres away."""
    header, *rows = (place / "m.csv").read_text().splitlines()
    names = header.split(",")
    x, y, z, w, i, j, k = (names.index(name) for name in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"))
    moved = []
    for row in rows:
        cells = row.split(",")
        numbers = [float(cell) for cell in cells]
        # half a turn about x: (x, -y, -z), and the quaternion (0, 1, 0, 0) times that of the tool
        cells[x], cells[y], cells[z] = (repr(v) for v in (numbers[x] + 2.0, -numbers[y], 0.5 - numbers[z]))
        cells[w], cells[i], cells[j], cells[k] = (repr(v) for v in (-numbers[i], numbers[w], -numbers[k], numbers[j]))
        moved.append(",".join(cells))
    (place / "tracker.csv").write_text("\n".join([header, *moved]) + "\n")
    assert run("calibrate", "tracker.csv", "--out", "no", cwd=place).returncode == 1
    found = answer("calibrate", "tracker.csv", "--method", "lm", "--own-frame", "--out", "own", cwd=place)
    base = found["measurements"]["base_in_instrument_frame"]
    np.testing.assert_allclose(base["position_m"], [2.0, 0.0, 0.5], atol=5e-3)
    np.testing.assert_allclose(np.abs(base["quaternion_wxyz"]), [0.0, 1.0, 0.0, 0.0], atol=1e-2)
    tips = [found["held_out"][f"tip_error_{when}_m"]["mean"] for when in ("floor", "after", "before")]
    assert tips == sorted(tips)  # each after a registration of its own
    assert tips[1] < 1.1 * tips[0]


@pytest.mark.usefixtures("report_without_pictures")
def test_a_validation_from_another_station(place: Path, run: Run, answer: Answer) -> None:
    """The tracker of `test_a_frame_of_the_instruments_own` has been moved a quarter of a turn and a metre."""

    def moved(name: str, turn: Rotation, shift: list[float], out: str) -> None:
        with (place / name).open() as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            x, y, z = turn.apply([float(row[k]) for k in ("x_m", "y_m", "z_m")]) + shift
            seen = turn * Rotation.from_quat([float(row[k]) for k in ("qx", "qy", "qz", "qw")])
            row |= dict(
                zip(
                    ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"),
                    map(repr, map(float, (x, y, z, *seen.as_quat()))),
                    strict=True,
                )
            )
        with (place / out).open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)

    answer("measure", "--out", "v.csv", "--poses", "12", "--seed", "6", "--machine", "2", cwd=place)
    first, second = Rotation.from_rotvec([0.1, 0.2, 1.0]), Rotation.from_rotvec([0.0, 0.0, -0.6])
    moved("m.csv", first, [2.0, 1.0, 0.3], "one.csv")
    moved("v.csv", second, [1.0, 1.0, 0.3], "two.csv")
    options = ("--method", "lm", "--own-frame", "--validation", "two.csv", "--out", "stations", "--json")
    done = run("calibrate", "one.csv", *options, cwd=place)
    assert done.returncode == 0, done.stderr
    assert "from another station" in done.stderr
    judged = json.loads(done.stdout)["validation"]
    assert judged["tip_error_after_m"]["mean"] < 0.6 * judged["tip_error_before_m"]["mean"]


def test_compensate(place: Path, answer: Answer) -> None:
    result = answer("compensate", "10", "-15", "0.5", "--calibration", "calibration", cwd=place)
    np.testing.assert_allclose(result["u_nominal_m"], [0.257110951586, 0.260246563859, 0.224483570293], atol=1e-12)
    difference = np.abs(np.array(result["u_m"]) - result["u_nominal_m"])
    assert np.all((difference > 1e-7) & (difference < 2e-3))
    assert 1e-6 < result["predicted_error_m"] < 1e-3


def test_conditions(place: Path, run: Run, answer: Answer) -> None:
    pose = ("0", "5", "0.49", "--calibration", "calibration")
    cold, warm = (
        answer("compensate", *pose, "--condition", f"temperature_screws_K={rise}", cwd=place)["u_m"] for rise in (0, 8)
    )
    # a screw of 0.24 m grows by 22 um: the command must be shorter
    assert np.all(np.array(cold) - warm > 5e-6)
    usual = run("compensate", *pose, cwd=place)
    assert "temperature_screws_K is not given" in usual.stderr
    kelvin = run("compensate", *pose, "--condition", "temperature_screws_K=293", "--json", cwd=place)
    assert "temperature_screws_K = 293 is outside the measured range" in kelvin.stderr
    assert json.loads(kelvin.stdout)["conditions"] == {"temperature_screws_K": 293.0}
    wrong = run("compensate", *pose, "--condition", "wind=3", cwd=place)
    assert wrong.returncode == 1
    assert "expected one of temperature_screws_K" in wrong.stderr
    assert run("compensate", *pose, "--condition", "warm", cwd=place).returncode == 2
    for values in (("nan",), ("inf",), ("1", "2")):
        words = [part for value in values for part in ("--condition", f"temperature_screws_K={value}")]
        refused = run("compensate", *pose, *words, cwd=place)
        assert refused.returncode == 2
        assert f"temperature_screws_K={values[-1]}" in refused.stderr
    (place / "warm.csv").write_text("theta_x_deg,theta_y_deg,z_e_m,temperature_screws_K\n0,5,0.49,3\n")
    files = ("--calibration", "calibration", "--poses", "warm.csv")
    assert run("compensate", *files, "--json", cwd=place).returncode == 0
    both = run("compensate", *files, "--condition", "temperature_screws_K=4", cwd=place)
    assert (both.returncode, both.stdout) == (2, "")
    assert "given twice, the second time by a column of warm.csv: temperature_screws_K" in " ".join(both.stderr.split())


def test_acceptance_plans_and_paths_have_conditions(place: Path, run: Run) -> None:
    """Lengths that grow with the temperature shift the commands of a test as those of a pose."""
    line = ("acceptance", "plan", "positioning", "--line", "0", "0", "0.48", "0", "0", "0.5", "--out", "line.csv")
    of = ("--calibration", "calibration")

    def planned(*words: str) -> tuple[Any, str]:
        done = run(*line, *of, *words, cwd=place)
        assert done.returncode == 0, done.stderr
        return np.loadtxt(place / "line.csv", delimiter=",", skiprows=1)[:, :3], done.stderr

    cold, warm = (planned("--condition", f"temperature_screws_K={rise}")[0] for rise in (0, 8))
    assert np.all(cold - warm > 5e-6)
    usual, said = planned()
    assert "temperature_screws_K is not given: using" in said
    assert np.all((cold > usual) & (usual > warm))
    assert run(*line, "--condition", "temperature_screws_K=1", cwd=place).returncode == 2
    (place / "up.csv").write_text("theta_x_deg,theta_y_deg,z_e_m\n0,0,0.49\n0,1,0.49\n")
    judged = run("path", "up.csv", *of, cwd=place)
    assert "temperature_screws_K is not given: using" in judged.stderr, judged.stderr


@pytest.mark.parametrize("command", ["acceptance", "path", "compensate"])
def test_a_calibration_of_another_robot_is_refused(command: str, place: Path, run: Run) -> None:
    (place / "g.csv").write_text("x_m,y_m,z_m\n0,0,0.135\n0.001,0,0.135\n")
    words = {
        "acceptance": ("plan", "circular", "--circle", "0", "0", "0.135", "0.005", "--out", "circle.csv"),
        "path": ("g.csv",),
        "compensate": ("0", "5", "0.49"),
    }[command]
    refused = run(command, *words, "--robot", "linear_delta", "--calibration", "calibration", cwd=place)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "expected a calibration of linear_delta, not of pm3dof" in refused.stderr
    assert not (place / "circle.csv").exists()


def test_poses_beyond_limits_and_reach(place: Path, run: Run) -> None:
    tilted = run("compensate", "50", "0", "0.5", "--calibration", "calibration", "--json", cwd=place)
    assert tilted.returncode == 1
    assert "joint limit broken" in tilted.stderr
    far = run("compensate", "0", "0", "1.5", "--calibration", "calibration", cwd=place)
    assert far.returncode == 1
    assert far.stdout == ""
    assert far.stderr.startswith("Error: ")
    assert "Traceback" not in far.stderr


@pytest.mark.usefixtures("report_without_pictures")
def test_a_plan_is_measured_and_a_network_trained(place: Path, run: Run, answer: Answer) -> None:
    plan = ("calibration-plan", "--poses", "12", "--candidates", "60", "--out", "plan.csv")
    assert run(*plan, cwd=place).returncode == 0
    world = ("--world", "geometry", "--positions", "--noise", "1e-5")
    measured = answer("measure", "--plan", "plan.csv", *world, "--out", "p.csv", cwd=place)
    assert measured["measured"] == "position"
    assert measured["poses"] == 12
    result = run("calibrate", "p.csv", "--method", "nn", "--out", "positions", cwd=place)
    assert result.returncode == 0, result.stderr
    assert "shows 1 of the 3 motions of the drives" in result.stderr
    assert "no parameters identified" in result.stdout
    assert not (place / "positions" / "calibrated").exists()


@pytest.mark.usefixtures("report_without_pictures")
def test_bad_files_and_folders(place: Path, run: Run) -> None:
    text = (place / "m.csv").read_text().splitlines()
    cells = text[3].split(",")
    cells[3] = "nan"
    (place / "gap.csv").write_text("\n".join([*text[:3], ",".join(cells), *text[4:]]) + "\n")
    gap = run("calibrate", "gap.csv", "--method", "lm", "--out", "gap", cwd=place)
    assert gap.returncode == 0
    assert "pm3dof: warning: gap.csv: line 4: numbers are missing or not finite; left out" in gap.stderr
    assert "line 4" in (place / "gap" / "report.html").read_text()

    (place / "few.csv").write_text("\n".join(text[:3]) + "\n")
    few = run("calibrate", "few.csv", "--method", "gp", "--out", "few", cwd=place)
    assert few.returncode == 1
    assert "at least 4" in few.stderr
    assert not (place / "few").exists()

    missing = run("calibrate", "none.csv", "--out", "none", cwd=place)
    assert missing.returncode == 1
    assert "expected a readable file" in missing.stderr
    assert run("compensate", "0", "0", "0.49", "--calibration", "none", cwd=place).returncode == 1
    assert run("calibrate", "m.csv", "--method", "svm", "--out", "none", cwd=place).returncode == 2


ROBOTS = {
    "hexapod": ("hexapod", "lm", 20),
    "five_bar": (str(MACHINES / "five_bar"), "lm+gp", 20),
    "ur5": ("ur5", "lm", 20),
}


@pytest.mark.usefixtures("report_without_pictures")
@pytest.mark.parametrize("name", ROBOTS)
def test_other_robots(name: str, tmp_path: Path, run: Run, answer: Answer) -> None:
    """Measured, calibrated and commanded: at the coordinates of home, and at a file of poses.

    The arm has no error file beside its description, and is given one.
    """
    robot, method, count = ROBOTS[name]
    options: tuple[str, ...] = ("--robot", robot)
    if name == "ur5":
        options += ("--tool-frame", "tool0")
        answer("error-parameters", *options, "--out", "my.yaml", cwd=tmp_path)
        options += ("--errors", "my.yaml")
    measured = answer("measure", *options, "--poses", str(count), "--out", "m.csv", cwd=tmp_path)
    assert measured["poses"] == count
    result = answer("calibrate", "m.csv", *options, "--method", method, "--out", "c", cwd=tmp_path)
    held_out = result["held_out"]
    if name == "ur5":
        assert len(result["identification"]["parameters"]) == 4 * 6 + 6  # of a serial arm of revolute joints
    if name == "hexapod":
        assert held_out["tip_error_after_m"]["mean"] < 0.3 * held_out["tip_error_before_m"]["mean"]
    assert held_out["tip_error_after_m"]["mean"] < held_out["tip_error_before_m"]["mean"]
    assert math.isfinite(result["noise_factor"])
    commanded = answer("compensate", "--calibration", "c", "--configuration", "home", cwd=tmp_path)
    assert len(commanded["u"]) == len(commanded["commands"]) > 0
    difference = np.abs(np.array(commanded["u"]) - commanded["u_nominal"])
    # the arm's home is stretched: a millimetre less reach takes 0.1 rad of the elbow, as 0.2 m (1 - cos) tells
    assert 1e-8 < difference.max() < (0.2 if name == "ur5" else 1e-2)
    poses = Robot.load(robot, tool_frame="tool0" if name == "ur5" else None)
    near_home = poses.home.commands + 1e-3 * np.arange(3)[:, None]
    columns = poses.forward(near_home).coordinates
    text = [",".join(f"{c.name}_{c.unit}" for c in poses.coordinates)]
    text += [",".join(map(repr, row)) for row in columns.tolist()]
    (tmp_path / "poses.csv").write_text("\n".join(text) + "\n")
    done = run("compensate", "--calibration", "c", "--poses", "poses.csv", "--out", "u.csv", cwd=tmp_path)
    assert (tmp_path / "u.csv").is_file(), done.stderr
    assert len((tmp_path / "u.csv").read_text().splitlines()) == 4


def test_a_batch_is_its_poses_one_by_one(place: Path, run: Run, answer: Answer) -> None:
    """By coordinates and by placements; an unreachable pose is NaN and named."""
    pose = ("5", "-8", "0.49", "--condition", "temperature_screws_K=3")
    alone = answer("compensate", *pose, "--calibration", "calibration", cwd=place)
    (place / "p.csv").write_text("theta_x_deg,theta_y_deg,z_e_m,temperature_screws_K\n5,-8,0.49,3\n0,0,1.5,3\n")
    done = run("compensate", "--calibration", "calibration", "--poses", "p.csv", "--out", "u.csv", cwd=place)
    assert done.returncode == 1
    assert "1 of 2 poses break a limit" in done.stderr
    first, second = csv.DictReader((place / "u.csv").read_text().splitlines())
    np.testing.assert_allclose([float(first[f"u{k}_m"]) for k in (1, 2, 3)], alone["u_m"], atol=1e-12)
    assert float(first["predicted_error_m"]) == pytest.approx(alone["predicted_error_m"], rel=1e-9)
    assert (second["u1_m"], second["broken_limits"]) == ("nan", "reach")

    wanted = Robot.load("pm3dof").solve([np.radians(5.0), np.radians(-8.0), 0.49])
    x, y, z, w = Rotation.from_matrix(wanted.rotations).as_quat()
    row = ",".join(repr(float(number)) for number in (*wanted.positions, w, x, y, z, 3.0))
    (place / "q.csv").write_text(f"x_m,y_m,z_m,qw,qx,qy,qz,temperature_screws_K\n{row}\n")
    placed = answer("compensate", "--calibration", "calibration", "--poses", "q.csv", cwd=place)["columns"]
    np.testing.assert_allclose([placed[f"u{k}_m"][0] for k in (1, 2, 3)], alone["u_m"], atol=1e-9)


def test_the_robot_may_be_named(place: Path, run: Run) -> None:
    pose = ("5", "-8", "0.49", "--calibration", "calibration", "--robot")
    assert run("compensate", *pose, "pm3dof", cwd=place).returncode == 0
    other = run("compensate", *pose, "hexapod", cwd=place)
    assert other.returncode == 1
    assert "expected a calibration of hexapod, not of pm3dof" in other.stderr


def test_another_robot_of_the_same_name_is_refused(place: Path, run: Run, tmp_path: Path) -> None:
    """Its guideways are 10 mm lower: its drives have different positions at home."""
    folder = Path(shutil.copytree(find_robot("pm3dof").urdf.parent, tmp_path / "urdf"))
    closures = folder / "pm3dof.closures.yaml"
    changed = closures.read_text().replace("0.240272", "0.250272")
    assert changed != closures.read_text()
    closures.write_text(changed)
    pose = ("5", "-8", "0.49", "--calibration", "calibration", "--robot", str(folder))
    other = run("compensate", *pose, cwd=place)
    assert other.returncode == 1
    assert "expected a calibration of pm3dof, not of another pm3dof" in other.stderr


def test_parameters_with_which_loops_cannot_close_are_named(place: Path, run: Run) -> None:
    machine = str(MACHINES / "five_bar")
    plan = ("--robot", machine, "--poses", "4", "--candidates", "30", "--strategy", "random", "--out", "five.csv")
    planned = run("calibration-plan", *plan, cwd=place)
    assert planned.returncode == 0, planned.stderr
    crowded = run("calibration-plan", *plan, "--distance", "1.0", cwd=place)
    assert crowded.returncode == 1
    assert "at least 1 of the ranges from each other" in crowded.stderr
    assert "parameters are left out because the loops cannot close with them: left_motor" in planned.stderr


def test_corrected_commands_are_a_plan(answer: Answer, run: Run, tmp_path: Path) -> None:
    """Of a robot whose commands are its joints, given by commands: only the corrected ones are written."""
    robot = ("--robot", str(MACHINES / "five_bar"))
    answer("measure", *robot, "--poses", "12", "--world", "geometry", "--out", "m.csv", cwd=tmp_path)
    answer("calibrate", "m.csv", *robot, "--method", "lm", "--out", "found", cwd=tmp_path)
    poses = pm.reachable_poses(pm.load(MACHINES / "five_bar"), 5, np.random.default_rng(0), margin=0.2)
    rows = "\n".join(f"{first!r},{second!r}" for first, second in poses.commands.tolist())
    (tmp_path / "wanted.csv").write_text(f"u1_rad,u2_rad\n{rows}\n")
    done = run("compensate", "--calibration", "found", "--poses", "wanted.csv", "--out", "plan.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    header = (tmp_path / "plan.csv").read_text().splitlines()[0].split(",")
    assert header[:2] == ["left_motor_deg", "right_motor_deg"]
    assert not {"u1_rad", "u2_rad"} & set(header)
    measured = answer("measure", *robot, "--plan", "plan.csv", "--out", "again.csv", cwd=tmp_path)
    assert measured["poses"] == 5
