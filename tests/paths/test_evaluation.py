"""Judged paths against poses solved one by one, differences in time, inverse dynamics, power and equilibrium."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError, UnreachablePoseError
from pm3dof_pin.paths.bounds import MotionLimits
from pm3dof_pin.paths.evaluation import PathEvaluation, PathOptions, evaluate_path
from pm3dof_pin.paths.follower import Follower, with_tool_length
from pm3dof_pin.paths.tool_path import ToolPath, read_path
from pm3dof_pin.paths.writing import write_path
from pm3dof_pin.typing import Array

MACHINES = Path(__file__).parents[1] / "machines"
SQUARE = "G21 G64 P0.1\nG0 X0 Y0 Z134\nG1 X6 F600\nG3 X0 Y6 I-6 J0 F900\nG1 X0 Y0 Z136\nM2\n"


def judged(robot: pm.Robot, folder: Path, text: str, options: PathOptions | None = None) -> PathEvaluation:
    options = options or PathOptions()
    file = folder / "part.ngc"
    file.write_text(text, encoding="utf-8")
    pointed = with_tool_length(robot, options.tool_length)
    return evaluate_path(robot, read_path(pointed, file), options)


def smooth(robot: pm.Robot, seconds: float = 2.0, count: int = 41, size: float = 0.02) -> ToolPath:
    """Return a path in time around home, all coordinates of which move."""
    t = np.linspace(0.0, seconds, count)
    home = robot.home_coordinates
    scale = np.array([size * (robot.characteristic_length if c.unit == "m" else 1.0) for c in robot.coordinates])
    phases = np.arange(len(home))
    values = home + scale * (np.sin(np.outer(t, 2.0 + 0.5 * phases) + phases) - np.sin(phases))
    return ToolPath(
        lines=np.arange(2, count + 1),
        start=values[:-1],
        end=values[1:],
        times=t,
        names=tuple(c.name for c in robot.coordinates),
    )


def command_columns(found: PathEvaluation, suffix: str = "") -> Array:
    units = [command.unit for command in found.robot.commands]
    per = {"": "", "_speed": "_s", "_acceleration": "_s2"}[suffix]
    return np.stack([found.columns[f"u{k}{suffix}_{unit}{per}"] for k, unit in enumerate(units, start=1)], axis=1)


def force_columns(found: PathEvaluation) -> Array:
    keys = [key for key in found.columns if key.startswith("u") and "_force_" in key]
    return np.stack([found.columns[key] for key in keys], axis=1)


@pytest.mark.parametrize("name", ["hexapod", "pm3dof", "three_rps", "five_bar"])
def test_commands_are_those_of_each_pose_alone(name: str, tmp_path: Path) -> None:
    robot = pm.load(str(MACHINES / name) if name == "five_bar" else name)
    found = evaluate_path(robot, smooth(robot, count=9), PathOptions(spacing=1.0))
    coordinates = np.stack([found.columns[f"{c.name}_{c.unit}"] for c in robot.coordinates], axis=1)
    for values, commands in zip(coordinates, command_columns(found), strict=True):
        alone = robot.solve(values, engine="pinocchio")
        np.testing.assert_allclose(commands, alone.commands, rtol=0.0, atol=1e-10)
    ends = np.flatnonzero(found.columns["share"] == 1.0)
    np.testing.assert_allclose(coordinates[ends], found.path.end, atol=1e-12)


def test_a_path_of_one_block_is_solved_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its columns take the motion that was solved for its speeds."""
    found = judged(pm.load("hexapod"), tmp_path, "G21\nG1 X5 Y-3 Z180 F600\nM2\n", PathOptions(spacing=1.0))

    def again(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(Follower, "_motion", again)
    assert np.isfinite(found.columns["time_s"]).all()


def test_program_places_the_tool_point(tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    text = "G21\nG1 X5 Y-3 Z180 A2 B1 C-4 F600\nM2\n"
    found = judged(robot, tmp_path, text, PathOptions(tool_length=0.05))
    commands = command_columns(found)[-1]
    pose = robot.forward(commands)
    angles = np.radians([2.0, 1.0, -4.0])
    point = pose.positions + pose.rotations @ [0.0, 0.0, 0.05]
    np.testing.assert_allclose(point, [0.005, -0.003, 0.18], atol=1e-10)
    turn = [pm.load("hexapod").solve([0.0, 0.0, 0.135, *angles]).rotations]
    np.testing.assert_allclose(pose.rotations, turn[0], atol=1e-10)


def test_speeds_and_accelerations_by_differences_in_time() -> None:
    robot = pm.load("hexapod")
    found = evaluate_path(robot, smooth(robot, count=401), PathOptions())
    at_rows = found.columns["share"] == 1.0
    commands, time = command_columns(found)[at_rows], found.columns["time_s"][at_rows]
    speeds = (commands[2:] - commands[:-2]) / (time[2:] - time[:-2])[:, None]
    step = time[1] - time[0]
    accelerations = (commands[2:] - 2.0 * commands[1:-1] + commands[:-2]) / step**2
    greatest = np.abs(speeds).max(), np.abs(accelerations).max()
    assert np.abs(command_columns(found, "_speed")[at_rows][1:-1] - speeds).max() < 1e-4 * greatest[0]
    assert np.abs(command_columns(found, "_acceleration")[at_rows][1:-1] - accelerations).max() < 1e-3 * greatest[1]


@pytest.mark.parametrize("name", ["hexapod", "pm3dof", "linear_delta"])
def test_forces_by_inverse_dynamics(name: str) -> None:
    robot = pm.load(name)
    found = evaluate_path(robot, smooth(robot, count=5), PathOptions(payload=1.5, force=[5.0, -3.0, 20.0]))
    frame = robot.frame_name()
    forces, commands = force_columns(found), command_columns(found)
    scales = np.array([command.scale for command in robot.commands])
    speeds, accelerations = (command_columns(found, name) / scales for name in ("_speed", "_acceleration"))
    for row in range(0, len(found), 3):
        motion = pm.inverse_dynamics(
            robot.forward(commands[row]).configuration(),
            speeds[row],
            accelerations[row],
            payloads={frame: 1.5},
            wrenches={frame: [5.0, -3.0, 20.0, 0.0, 0.0, 0.0]},
        )
        np.testing.assert_allclose(forces[row], motion.forces.actuator_forces, atol=1e-5)


def test_energy_is_what_lifting_and_cutting_take() -> None:
    robot = pm.load("pm3dof")
    home = robot.home_coordinates
    height, count = 0.03, 200
    t = np.linspace(0.0, 1.0, count + 1)
    values = np.tile(home, (count + 1, 1))
    values[:, 2] += height * (3.0 * t**2 - 2.0 * t**3)  # from rest to rest
    path = ToolPath(lines=np.arange(count), start=values[:-1], end=values[1:], times=t, names=("a", "b", "c"))
    found = evaluate_path(robot, path, PathOptions(force=[0.0, 0.0, -40.0], payload=2.0))
    first, last = (robot.solve(values[k]).configuration() for k in (0, -1))
    import pinocchio as pin

    data = robot.model.createData()
    lifted = [pin.computePotentialEnergy(robot.model, data, np.array(c.q)) for c in (first, last)]
    expected = lifted[1] - lifted[0] + (40.0 + 2.0 * 9.81) * height
    assert found.columns["energy_J"][-1] == pytest.approx(expected, rel=1e-4)
    power = sum(found.columns[f"u{k}_power_W"] for k in (1, 2, 3))
    assert np.trapezoid(power, found.columns["time_s"]) == pytest.approx(expected, rel=1e-4)


def test_drives_that_brake_give_nothing_back() -> None:
    """Energy of each drive: the integral of its power where that is positive."""
    found = evaluate_path(pm.load("linear_delta"), smooth(pm.load("linear_delta")), PathOptions(payload=0.3))
    time = found.columns["time_s"]
    for k, drive in enumerate(found.summary["drives"], start=1):
        power = found.columns[f"u{k}_power_W"]
        assert (power < -0.1 * power.max()).any()
        assert drive["driving_energy_J"] == pytest.approx(np.trapezoid(np.maximum(power, 0.0), time), rel=1e-2)


def test_deflection_is_that_of_the_equilibrium_under_load(tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    force = [30.0, -20.0, 60.0]
    linear = judged(robot, tmp_path, SQUARE, PathOptions(force=force, spacing=0.05))
    large = judged(robot, tmp_path, SQUARE, PathOptions(force=force, spacing=0.05, large=True))
    model = pm.ElasticModel.load("hexapod")
    names = [f"deflection_{c}_{u}" for c, u in zip(("x", "y", "z", "rx", "ry", "rz"), "mmm" + "rrr", strict=True)]
    names = [name if name.endswith("_m") else f"{name}ad" for name in names]
    commands = command_columns(linear)
    for row in (len(linear) // 2, len(linear) - 2):
        loads = pm.Loads(wrenches={"O_e": [*force, 0.0, 0.0, 0.0]})
        exact = pm.loaded_equilibrium(model, robot.forward(commands[row]).configuration(), loads).displacement()
        found = np.array([large.columns[name][row] for name in names])
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-15)
        approximate = np.array([linear.columns[name][row] for name in names])
        assert np.linalg.norm((approximate - exact)[:3]) < 0.01 * np.linalg.norm(exact[:3])
        assert np.linalg.norm((approximate - exact)[3:]) < 0.01 * np.linalg.norm(exact[3:])


@pytest.mark.parametrize("large", [False, True])
def test_compensated_commands_bring_the_loaded_tool_back(large: bool, tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    force = [300.0, -200.0, 600.0]
    found = judged(robot, tmp_path, SQUARE, PathOptions(force=force, spacing=0.05, large=large))
    model = pm.ElasticModel.load("hexapod")
    row = len(found) // 2
    commands = np.array([found.columns[f"compensated_u{k}_m"][row] for k in range(1, 7)])
    loads = pm.Loads(wrenches={"O_e": [*force, 0.0, 0.0, 0.0]})
    wanted = np.array([found.columns[f"tool_{axis}_m"][row] for axis in "xyz"])
    errors = []
    for tried in (command_columns(found)[row], commands):
        loaded = pm.loaded_equilibrium(model, robot.forward(tried).configuration(), loads)
        errors.append(np.linalg.norm(loaded.configuration.tool_placement.translation - wanted))
    assert errors[1] < (1e-5 if large else 2e-2) * errors[0]


# poses within the limits are not convex: ends found by a random search
@pytest.mark.parametrize(
    ("name", "start", "end"),
    [
        ("pm3dof", [0.5814, 0.1179, 0.5327], [0.2705, -0.3911, 0.5563]),
        (
            "hexapod",
            [0.00799, -0.00857, 0.13423, -0.00316, 0.03636, -0.03319],
            [0.00321, 0.00096, 0.12273, -0.0702, 0.00841, 0.02281],
        ),
        ("three_rps", [0.68331, -0.45696, 0.22537], [0.68104, 0.06136, -0.59068]),
        ("linear_delta", [0.11166, -0.01095, 0.31668], [0.07491, -0.11484, 0.32171]),
    ],
)
def test_move_whose_middle_breaks_a_limit_is_found(name: str, start: list[float], end: list[float]) -> None:
    robot, ends = pm.load(name), np.array([start, end])
    assert robot.solve(ends).within_limits.all()
    assert not robot.solve(ends.mean(axis=0), on_failure="nan").within_limits
    names = tuple(coordinate.name for coordinate in robot.coordinates)
    path = ToolPath(lines=np.array([2]), start=ends[:1], end=ends[1:], names=names)
    for options in (PathOptions(), PathOptions(tolerance=1.0, spacing=10.0)):
        found = evaluate_path(robot, path, options)
        within = found.columns["within_limits"] == 1.0
        assert within[[0, -1]].all()
        assert not within.all()
        assert not found.summary["within_limits"]
        assert found.summary["first_line_beyond_limits"] == 2


def test_points_follow_the_path_within_the_tolerance(tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    tolerance = 2e-6
    found = judged(robot, tmp_path, SQUARE, PathOptions(tolerance=tolerance, spacing=0.05))
    commands, shares, lines = command_columns(found), found.columns["share"], found.columns["line"]
    same = np.flatnonzero((lines[1:] == lines[:-1]) & (lines[1:] > 2))
    middles = robot.forward(0.5 * (commands[same] + commands[same + 1]))
    middle_shares = 0.5 * (shares[same] + shares[same + 1])
    moves = np.searchsorted(found.path.lines, lines[same])
    wanted = found.path.values(moves, middle_shares)[:, :3]
    assert np.linalg.norm(middles.positions - wanted, axis=1).max() < 1.5 * tolerance


def test_motion_in_time_keeps_its_limits(tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    limits = MotionLimits(acceleration=0.3, rapid=0.1, drive_acceleration=np.full(6, 0.4))
    found = judged(robot, tmp_path, SQUARE, PathOptions(limits=limits, spacing=0.001))
    columns = found.columns
    assert columns["feed_m_s"][[0, -1]].tolist() == [0.0, 0.0]
    assert (np.diff(columns["time_s"]) >= 0.0).all()
    for line, feed in ((3, 0.01), (4, 0.015), (5, 0.015)):
        assert columns["feed_m_s"][columns["line"] == line].max() == pytest.approx(feed)
    assert np.abs(command_columns(found, "_acceleration")).max() <= 0.4 * (1.0 + 1e-6)
    assert np.abs(command_columns(found, "_speed")).max() <= 0.05 * (1.0 + 1e-6)
    tool = np.stack([columns[f"tool_{axis}_m"] for axis in "xyz"], axis=1)
    steps = np.linalg.norm(np.diff(tool, axis=0), axis=1)
    v = columns["feed_m_s"]
    assert (np.abs(np.diff(v**2)) <= 2.0 * 0.3 * steps * (1.0 + 1e-3) + 1e-12).all()


def test_one_straight_move_takes_the_time_of_the_trapezoid(tmp_path: Path) -> None:
    robot = pm.load("linear_delta")
    z = 1e3 * robot.home.tool_placement.translation[2]
    text = f"G21 G61\nG0 X0 Y0 Z{z}\nG1 X20 F600\nG4 P0.5\nM2\n"
    for spacing in (0.05, 0.001):
        found = judged(robot, tmp_path, text, PathOptions(limits=MotionLimits(acceleration=0.1), spacing=spacing))
        # 20 mm at 10 mm/s and 0.1 m/s^2: 0.1 s up, 0.1 s down, 19 mm between; then a dwell of 0.5 s
        assert found.columns["time_s"][-1] == pytest.approx(0.2 + 1.9 + 0.5, rel=1e-6)


def test_table_moves_the_workpiece_of_a_tripod(tmp_path: Path) -> None:
    robot = pm.load("pm3dof")
    text = "G21 G0 X0 Y0 Z540\nG1 X10 Y-4 A5 B-3 F600\nM2\n"
    found = judged(robot, tmp_path, text, PathOptions(table=("x", "y"), tool_length=0.05))
    tool = np.array([found.columns[f"tool_{axis}_m"][-1] for axis in "xyz"])
    table = np.array([found.columns[f"table_{axis}_m"][-1] for axis in "xy"])
    np.testing.assert_allclose(tool[:2] - table, [0.01, -0.004], atol=1e-12)
    assert tool[2] == pytest.approx(0.54, abs=1e-10)
    with pytest.raises(UnreachablePoseError, match="line 2: pm3dof places its tool by z, rx, ry"):
        judged(robot, tmp_path, text, PathOptions(tool_length=0.05))
    with pytest.raises(InvalidValueError, match="table"):
        judged(pm.load("hexapod"), tmp_path, SQUARE, PathOptions(table=("x",)))


def test_table_of_poses_with_feed_force_and_unreachable_rows(tmp_path: Path) -> None:
    robot = pm.load("pm3dof")
    file = tmp_path / "path.csv"
    file.write_text(
        "theta_x_deg,theta_y_deg,z_e_mm,feed_mm_min,load_fz_N\n0,0,480,600,10\n2,0,480,600,30\n2,0,1480,600,30\n2,1,480,600,0\n"
    )
    found = evaluate_path(robot, read_path(robot, file), PathOptions())
    columns = found.columns
    assert columns["line"][[0, -1]].tolist() == [3.0, 5.0]
    ends = columns["share"] == 1.0
    np.testing.assert_allclose(columns["z_e_m"][ends], [0.48, 1.48, 0.48])
    assert np.isnan(columns["u1_m"][ends]).tolist() == [False, True, False]
    assert columns["force_z_N"][0] == 10.0
    assert not found.summary["within_limits"]
    assert found.summary["first_line_beyond_limits"] == 4
    file.write_text("theta_x_rad,theta_y_rad,z_e_m,time_s\n0.1,0,.48,1\n0,0,.48,1\n")
    with pytest.raises(MeasurementError, match="time_s does not increase"):
        read_path(robot, file)


def test_columns_of_a_table_that_are_not_used_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    robot, file = pm.load("pm3dof"), tmp_path / "path.csv"
    file.write_text("theta_x_rad,theta_y_rad,z_e_m,time_z,load_fz_N,load_fz\n0.1,0,.48,0,1,1\n0,0,.48,1,1,1\n")
    assert read_path(robot, file).times is None
    assert caplog.messages == [f"{file}: columns time_z, load_fz are not used"]


GANTRY = "".join(
    f'<body name="b{k}"><joint name="j{k}" type="{kind}" axis="{axis}"/><geom size=".1" mass="1"/>'
    for k, (kind, axis) in enumerate(itertools.product(("slide", "hinge"), ("1 0 0", "0 1 0", "0 0 1")))
)
GANTRY = (
    f'<mujoco model="gantry"><worldbody>{GANTRY}<site name="tool"/>{"</body>" * 6}</worldbody><actuator>'
    + "".join(f'<motor joint="j{k}" gear="2" forcerange="-{k + 40} {k + 40}"/>' for k in range(6))
    + "</actuator></mujoco>"
)


def test_turns_of_placements_go_on_from_row_to_row(tmp_path: Path) -> None:
    """Halfway between two rows the tool has turned half as far, over half turns and a pitch of 90 degrees too."""
    (tmp_path / "gantry.xml").write_text(GANTRY)
    robot = pm.load(tmp_path / "gantry.xml", tool_frame="tool")
    turned = [Rotation.from_euler(axis, np.arange(0.0, 400.0, 8.0)[:, None], degrees=True) for axis in "XYZ"]
    for rotations in turned:
        quaternions = rotations.as_quat()[:, [3, 0, 1, 2]]
        rows = "\n".join(",".join(map(str, (0, 0, 0, *row))) for row in quaternions)
        file = tmp_path / "path.csv"
        file.write_text(f"x_m,y_m,z_m,qw,qx,qy,qz\n{rows}\n")
        path = read_path(robot, file)
        moves = np.arange(len(path))
        halfway = Rotation.from_euler("XYZ", path.values(moves, np.full(len(moves), 0.5))[:, 3:])
        wanted = rotations[:-1] * (rotations[:-1].inv() * rotations[1:]) ** 0.5
        assert (halfway.inv() * wanted).magnitude().max() < 1e-9
    file.write_text("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n0,0,0,170,0,0\n0,0,0,190,0,0\n0,0,0,-170,0,0\n")
    np.testing.assert_allclose(np.degrees(read_path(robot, file).end[:, 3]), [190.0, -170.0])  # as written


def test_forces_of_the_actuators_of_mjcf_are_limits(tmp_path: Path) -> None:
    (tmp_path / "gantry.xml").write_text(GANTRY)
    robot = pm.load(tmp_path / "gantry.xml", tool_frame="tool")
    (tmp_path / "lift.ngc").write_text("G21 G1 Z1 F60\nM2\n")
    summary = evaluate_path(robot, read_path(robot, tmp_path / "lift.ngc"), PathOptions(payload=3.0)).summary
    limits = [drive["effort_limit_N" if k < 3 else "effort_limit_N_m"] for k, drive in enumerate(summary["drives"])]
    np.testing.assert_allclose(limits, 2.0 * (40.0 + np.arange(6)))
    weight = 9.81 * (4 * 1.0 + 3.0)  # of what the slide along z carries: 4 bodies and the payload
    assert summary["drives"][2]["rms_force_N"] == pytest.approx(weight, rel=1e-2)
    assert summary["points_beyond_drive_force"] == 0


def test_files_have_every_point_and_read_back(tmp_path: Path) -> None:
    import netCDF4

    robot = pm.load("hexapod")
    found = judged(robot, tmp_path, SQUARE)
    csv = write_path(found, tmp_path / "points.csv")
    again = read_path(robot, csv)
    assert len(again) == len(found) - 1
    np.testing.assert_allclose(again.end[-1], [0.0, 0.0, 0.136, 0.0, 0.0, 0.0], atol=1e-12)
    netcdf = write_path(found, tmp_path / "points.nc")
    with netCDF4.Dataset(netcdf) as file:
        np.testing.assert_array_equal(file["u3_m"][:], found.columns["u3_m"])


def test_blocks_are_like_the_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    robot = pm.load("pm3dof")
    path = smooth(robot, count=30)
    whole = evaluate_path(robot, path, PathOptions(force=[0.0, 0.0, 50.0]))
    monkeypatch.setattr("pm3dof_pin.paths.planning.BLOCK", 7)
    parts = evaluate_path(robot, path, PathOptions(force=[0.0, 0.0, 50.0]))
    assert len(parts) == len(whole)
    for name, column in whole.columns.items():
        np.testing.assert_allclose(parts.columns[name], column, rtol=1e-6, atol=1e-9, err_msg=name)
    assert parts.summary["greatest_deflection_m"] == pytest.approx(whole.summary["greatest_deflection_m"])


def test_jump_of_an_arm_to_its_other_elbow_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    links = "".join(
        f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="10" velocity="2"/></joint>'
        for joint, parent, child, x in (("shoulder", "base", "arm", 0.0), ("elbow", "arm", "forearm", 0.5))
    )
    links += (
        '<joint name="tip" type="fixed"><parent link="forearm"/><child link="tool"/><origin xyz="0.4 0 0"/></joint>'
    )
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    parts = "".join(f'<link name="{name}">{body}</link>' for name in ("base", "arm", "forearm", "tool"))
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="arm">{parts}{links}</robot>')
    arm = pm.load(file, tool_frame="tool").replace(actuated_joints=("shoulder", "elbow"))
    ends = np.array([[0.5, 1.0], [0.6, 1.2]])
    path = ToolPath(lines=np.array([1]), start=ends[:1], end=ends[1:], names=("shoulder", "elbow"))
    assert evaluate_path(arm, path).summary["points_off_branch"] == 0
    original = ToolPath.values

    def other_elbow(path: ToolPath, moves: Array, shares: Array) -> Array:
        """Return the other solution of the same positions after the middle of the move."""
        found = original(path, moves, shares)
        shoulder, elbow = found.T
        turned = shoulder + 2.0 * np.arctan2(0.4 * np.sin(elbow), 0.5 + 0.4 * np.cos(elbow))
        return np.where((shares > 0.5)[:, None], np.stack([turned, -elbow], axis=1), found)

    monkeypatch.setattr(ToolPath, "values", other_elbow)
    jumping = evaluate_path(arm, path)
    assert jumping.summary["points_off_branch"] == 1
    assert not jumping.summary["within_limits"]
