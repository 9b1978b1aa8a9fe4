"""Transmissions against MuJoCo's mass matrix, linear programs, and lever arms that can be read off a drawing."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import linprog

import pm3dof_pin as pm
from pm3dof_pin.capability.mapping_fit import fit_mapping
from pm3dof_pin.capability.polytopes import Polytopes
from pm3dof_pin.capability.serial_model import serial_model
from pm3dof_pin.capability.transmission import Transmission, drive_values, held_outside, joint_driven, transmission
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import legs

_ANKLE = Path(__file__).parents[1] / "machines" / "ankle" / "ankle.xml"


@pytest.fixture(scope="module")
def ankle() -> Robot:
    return joint_driven(pm.load(_ANKLE), ["pitch", "roll"])


@pytest.fixture(scope="module")
def box(ankle: Robot) -> Transmission:
    grid = ankle.grid(pitch=(-0.35, 0.35, 21), roll=(-0.17, 0.17, 21))
    poses = ankle.solve(grid, on_failure="nan")
    return transmission(ankle, poses, effort=40.0, speed=[12.0, 10.0], on_failure="nan")


def test_lever_arms_at_the_neutral_pose(ankle: Robot) -> None:
    """Rods are vertical, cranks 35 mm long, and the heel's balls 55 mm behind and 45 mm beside the axes."""
    at = transmission(ankle, [0.0, 0.0])
    pitch, roll = 55.0 / 35.0, 45.0 / 35.0
    np.testing.assert_allclose(at.jacobian, [[pitch, roll], [pitch, -roll]], atol=1e-12)
    np.testing.assert_allclose(at.rotor_inertia, 0.004 * np.diag([2.0 * pitch**2, 2.0 * roll**2]), atol=1e-15)
    np.testing.assert_allclose(at.unit_pure_torques, [2.0 * pitch, 2.0 * roll], rtol=1e-12)


def test_inertia_and_weight_are_those_of_mujoco(ankle: Robot, box: Transmission) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(_ANKLE))
    data = mujoco.MjData(model)
    names = list(ankle.model.names)[1:]
    places = [model.joint(name).qposadr[0] for name in names]
    columns = [model.joint(name).dofadr[0] for name in ("pitch", "roll")]
    for index in ((0, 0), (3, 17), (20, 20)):
        data.qpos[places] = box.poses.q[index]
        mujoco.mj_forward(model, data)
        rows = np.zeros((data.nefc, model.nv))
        assert not mujoco.mj_isSparse(model)
        rows[:] = data.efc_J.reshape(rows.shape)
        closures = rows[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        null = np.linalg.svd(closures)[2][np.linalg.matrix_rank(closures) :].T
        motions = null @ np.linalg.inv(null[columns])
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        np.testing.assert_allclose(box.inertia[index], motions.T @ mass @ motions, rtol=1e-9, atol=1e-12)
        data.qvel[:] = 0.0
        mujoco.mj_rne(model, data, 0, weight := np.zeros(model.nv))
        np.testing.assert_allclose(box.weight[index], motions.T @ weight, rtol=1e-9, atol=1e-12)


def test_torques_and_speeds_against_linear_programs(box: Transmission) -> None:
    for index in ((2, 5), (10, 10), (19, 1)):
        G = box.jacobian[index]
        for direction in ([1.0, 0.0], [0.0, -1.0], [0.6, 0.8]):
            # the greatest s with G^T tau - weight = s d
            system = np.hstack([G.T, -np.array(direction)[:, None]])
            found = linprog([0, 0, -1], A_eq=system, b_eq=box.weight[index], bounds=[(-40, 40), (-40, 40), (0, None)])
            np.testing.assert_allclose(box.torques.extent(direction)[index], found.x[2], rtol=1e-9)
            limits = np.array([12.0, 10.0])
            greatest = 1.0 / np.max(np.abs(G @ direction) / limits)
            np.testing.assert_allclose(box.speeds.extent(direction)[index], greatest, rtol=1e-12)


def test_gains_go_to_the_joints_and_back(box: Transmission) -> None:
    joints = box.joint_gains([50.0, 70.0])
    at = (4, 9)
    back = Transmission.drive_gains(_at(box, at), joints[at])
    np.testing.assert_allclose(back, np.diag([50.0, 70.0]), atol=1e-9)


def test_gains_of_the_joints_become_gains_of_the_drives(answer: Callable[..., Any], run: Callable[..., Any]) -> None:
    """With G = [[a, b], [a, -b]], the drives' gains are 1/4 (P / a^2 +- R / b^2); their diagonal couples nothing."""
    a, b, kp, kd = 55.0 / 35.0, 45.0 / 35.0, [120.0, 60.0], 2.0
    options = ["--robot", str(_ANKLE), "--joints", "pitch,roll", "--over", "pitch", "-5", "5", "3"]
    options += ["--over", "roll", "-5", "5", "3"]
    result = answer("transmission", "0", "0", *options, "--joint-kp", "pitch=120,roll=60", "--joint-kd", "2")
    same, other = ((kp[0] / a**2 + sign * kp[1] / b**2) / 4.0 for sign in (1.0, -1.0))
    np.testing.assert_allclose(result["drive_stiffness_N_m_rad"], [[same, other], [other, same]], rtol=1e-12)
    expected = 2.0 * same * np.diag([a**2, b**2])
    np.testing.assert_allclose(result["joint_stiffness_N_m_rad_of_diagonal"], expected, atol=1e-12)
    damping = kd * (1 / a**2 + 1 / b**2) / 4.0
    np.testing.assert_allclose(np.diag(result["drive_damping_N_m_s_rad"]), damping, rtol=1e-12)
    over = result["box"]["drive_damping_N_m_s_rad"]["left_motor"]
    assert over["least"] <= damping <= over["greatest"]
    for wrong in ("pitch=3", "-1", "pitch=1,roll=2,yaw=3"):
        refused = run("transmission", *options, "--joint-kp", wrong)
        assert refused.returncode == 2
        assert "each of pitch, roll" in " ".join(refused.stderr.split())


def _at(box: Transmission, index: tuple[int, int]) -> Transmission:
    return transmission(box.poses.robot, box.poses[index], effort=40.0)


def test_constants_of_a_serial_model(box: Transmission) -> None:
    model = serial_model(box, kp=50.0, kd=2.0)
    diagonal = np.einsum("...ii->...i", box.rotor_inertia).reshape(-1, 2)
    typed, error = model.armature.least_wrong, model.armature.error
    np.testing.assert_allclose(np.max(np.abs(typed - diagonal) / diagonal, axis=0), error, rtol=1e-12)
    for other in (0.97 * typed, 1.03 * typed):  # any other constant is more wrong somewhere
        assert (np.max(np.abs(other - diagonal) / diagonal, axis=0) > error).all()
    assert model.torque is not None
    assert (model.torque.chosen("worst") == np.nanmin(box.pure_torques.reshape(-1, 2), axis=0)).all()
    assert (model.armature.chosen("worst") == diagonal.max(axis=0)).all()
    np.testing.assert_allclose(model.gains["kp"].greatest / model.gains["kd"].greatest, 25.0)


def test_a_box_partly_out_of_reach(ankle: Robot) -> None:
    grid = ankle.grid(pitch=(-1.0, 1.0, 41), roll=(-0.3, 0.3, 7))
    poses = ankle.solve(grid, on_failure="nan")
    found = serial_model(transmission(ankle, grid, on_failure="nan"))
    assert 0.0 < found.unreached == pytest.approx(1.0 - poses.within_limits.mean())
    assert found.speed is None
    assert [found.lower.tolist(), found.upper.tolist()] == [[-1.0, -0.3], [1.0, 0.3]]
    box = transmission(ankle, poses, speed=3.0, on_failure="nan")
    far = ankle.solve(ankle.grid(pitch=(-1.0, 2.0, 7), roll=0.0), on_failure="nan").reshape(7, 1)
    with pytest.raises(InvalidValueError, match="no pose at a value of pitch"):
        serial_model(transmission(ankle, far, on_failure="nan"))
    for values in (box.pure_torques, box.torque_box, box.unit_pure_torques, box.pure_speeds):
        assert (np.isnan(values).all(axis=-1) == ~poses.solved).all()
    assert (np.isnan(box.torques.ball_radius) == ~poses.solved).all()
    inner = np.abs(np.linspace(-1.0, 1.0, 41)) <= found.reached_scale + 1e-9
    outer = np.abs(np.linspace(-1.0, 1.0, 7)) <= found.reached_scale + 1e-9
    assert poses.within_limits[np.ix_(inner, outer)].all()
    assert not poses.within_limits[inner].all() or not poses.within_limits.all()


def test_one_leg_of_a_walker_held_outside() -> None:
    """A part of a machine on a free base has the transmission that it has with the base held."""
    walker = pm.load(Path(__file__).parents[1] / "machines" / "walker" / "walker.xml")
    link = next(
        frame.name
        for frame in walker.model.frames
        if frame.parentJoint > 0 and 2 < sum(frame.parentJoint in s for s in walker.model.supports) < 8
    )
    part = held_outside(walker, link)
    assert 0 < part.model.njoints < walker.model.njoints
    assert part.home.closure_residual < 1e-9


_BODY = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
_SPRUNG_PARALLELOGRAM = f"""
<mujoco model="parallelogram"><compiler angle="degree" autolimits="true"/>
<default><joint axis="0 1 0"/></default><worldbody><body name="torso">
<body name="thigh"><joint name="hip" range="-60 60"/>{_BODY}
<body name="crank"><joint name="crank" range="20 160"/>{_BODY}
<body name="coupler" pos="0.1 0 0"><joint name="elbow"/>{_BODY}
<body name="leaf" pos="0.1 0 0"><joint name="flexure" stiffness="500"/>{_BODY}<site name="end" pos="0.2 0 0"/></body>
</body></body>
<body name="rocker" pos="0.3 0 0"><joint name="rocker" range="20 160"/>{_BODY}<site name="tip" pos="0.1 0 0"/></body>
</body></body></worldbody>
<equality><connect site1="end" site2="tip"/></equality>
<actuator><motor name="crank" joint="crank"/><motor name="hip" joint="hip"/></actuator></mujoco>"""


def test_a_sprung_linkage_whose_home_is_flat(answer: Callable[..., Any], tmp_path: Path) -> None:
    """At zero, beyond all limits, a parallelogram is singular; with its leaf spring rigid both cranks turn alike."""
    path = tmp_path / "parallelogram.xml"
    path.write_text(_SPRUNG_PARALLELOGRAM, encoding="utf-8")
    options = ("transmission", "--robot", str(path), "--hold", "flexure", "--over", "rocker", "40", "140", "3")
    leg = answer(*options, "--joints", "rocker", "--subtree", "thigh")
    assert leg["drives"] == ["crank"]
    np.testing.assert_allclose(leg["jacobian"], [[1.0]], rtol=1e-9)
    assert leg["box"]["share_out_of_reach"] == 0.0
    with_hip = answer(*options, "--joints", "rocker,hip", "--subtree", "thigh", "--over", "hip", "-5", "5", "2")
    assert with_hip["drives"] == ["crank", "hip"]
    np.testing.assert_allclose(with_hip["jacobian"], np.eye(2), atol=1e-9)


_LINK = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial></link>"""
_HINGE = """<joint name="{0}" type="continuous"><origin xyz="{3}"/><parent link="{1}"/><child link="{2}"/>
<axis xyz="0 1 0"/></joint>"""


def test_what_a_link_carries_where_a_joint_has_its_name(tmp_path: Path) -> None:
    """The joint `leg` is the knee below the link `leg`, which a prop holds from outside."""
    joints = [
        ("hip", "base", "leg", "0 0 0"),
        ("leg", "leg", "shin", "0 0 -0.4"),
        ("ankle", "shin", "foot", "0 0 -0.4"),
        ("prop_joint", "base", "prop", "0.2 0 0"),
    ]
    links = "".join(_LINK.format(name) for name in ("base", "leg", "shin", "foot", "prop"))
    text = f'<robot name="r">{links}{"".join(_HINGE.format(*joint) for joint in joints)}</robot>'
    (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
    closures = "closed_loop: [[leg, prop]]\ntype: [distance]\nclosure_lengths: [0.2]\nname_mot: [leg, ankle]\n"
    (tmp_path / "r.closures.yaml").write_text(closures, encoding="utf-8")
    part = held_outside(pm.load(tmp_path / "r.urdf"), "leg")
    assert list(part.model.names)[1:] == ["leg", "ankle"]
    assert part.closures == ()
    assert part.actuated_joints == ("leg", "ankle")


def test_what_does_not_work_is_named(ankle: Robot) -> None:
    at = transmission(ankle, [0.0, 0.0], effort={"left_motor": 40.0, "right_motor": 0.0})
    with pytest.raises(InvalidValueError, match=r"right_motor.*zero"):
        at.torques  # noqa: B018
    with pytest.raises(InvalidValueError, match=r"left_motor"):
        transmission(ankle, [0.0, 0.0], effort={"middle": 1.0})
    with pytest.raises(InvalidValueError, match="negative"):
        transmission(ankle, [0.0, 0.0], speed=-1.0)
    with pytest.raises(SingularConfigurationError, match=r"left_motor.*cannot determine pitch, roll"):
        transmission(joint_driven(ankle, ["pitch", "roll"], ["left_motor"]), [0.0, 0.0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--joints pitch,rol", "no joint 'rol'"),
        ("--joints pitch,pitch", "each joint once"),
        ("--joints pitch,roll --subtree nothing", "no frame 'nothing'"),
        ("--joints pitch,roll --effort 0", "positive"),
        ("--joints pitch,roll --effort nan", "not a finite number"),
        ("--joints pitch,roll --speed left_motor=-2", "positive"),
        ("--joints pitch,roll --effort left_motor=1,left_motor=2", "left_motor twice"),
        ("--joints pitch,roll --effort middle=1", "no drive 'middle'"),
        ("--joints pitch,roll --over pitch -2 2 0", "a COUNT of 2 or more"),
        ("--joints pitch,roll --over pitch 2 -2 3", "increasing values"),
        ("--joints pitch,roll --hold pitch", "one of --joints"),
        ("--joints pitch,roll --over yaw -2 2 3", "no coordinate 'yaw'"),
        ("--joints pitch,roll --over pitch -2 2 30000 --over roll -2 2 30000", "900,000,000 poses"),
        ("--joints pitch,roll --gains -1,2", "not negative"),
    ],
)
def test_wrong_usage_is_named(run: Callable[..., Any], options: str, words: str) -> None:
    result = run("transmission", "--robot", str(_ANKLE), *options.split())
    assert result.returncode == 2
    assert words in " ".join(result.stderr.split())
    assert result.stdout == ""


def test_too_many_drives_are_refused_before_work(run: Callable[..., Any], tmp_path: Path) -> None:
    """5 of 48 drives bound each pair of limits of six joints: 48! / (5! 43!)."""
    result = run("transmission", "--robot", str(legs(48).write(tmp_path)))
    assert result.returncode == 2
    words = " ".join(result.stderr.split())
    assert "48 drives move 6 joints together" in words
    assert "1,712,304 pairs" in words


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--joints pitch,roll --over pitch 100 140 5", "no pose of the box is within limits"),
        ("--joints pitch,roll --drives left_motor,left_motor", "each joint once"),
        ("--joints pitch,roll --drives left_motor", "cannot determine pitch, roll"),
        ("--joints pitch", "can move with pitch at rest"),
    ],
)
def test_what_the_machine_cannot_do_is_named(run: Callable[..., Any], options: str, words: str) -> None:
    result = run("transmission", "--robot", str(_ANKLE), *options.split())
    assert result.returncode == 1
    assert words in result.stderr


def test_efforts_are_those_of_the_described_actuators(tmp_path: Path) -> None:
    """A motor of MuJoCo gives its control, limited to both ranges, times its gear."""
    text = _ANKLE.read_text()
    for k, (old, new) in enumerate(
        [
            ('joint="left_motor" ctrlrange="-40 40"', 'joint="left_motor" gear="5" ctrlrange="-3 4"'),
            ('joint="right_motor" ctrlrange="-40 40" forcerange="-40 40"', 'joint="right_motor" ctrlrange="0 9"'),
        ]
    ):
        assert text.count(old) == 1, k
        text = text.replace(old, new)
    (tmp_path / "ankle.xml").write_text(text)
    assert drive_values(pm.load(_ANKLE), "effort").tolist() == [40.0, 40.0]
    assert drive_values(pm.load(tmp_path / "ankle.xml"), "effort").tolist() == [15.0, np.inf]


def test_joints_without_a_range_given_take_their_own(answer: Callable[..., Any]) -> None:
    box = answer("transmission", "--robot", str(_ANKLE), "--joints", "pitch,roll", "--over", "pitch", "-5", "5", "5")
    np.testing.assert_allclose(box["box"]["lower_rad"], [-np.radians(5), -0.35])
    np.testing.assert_allclose(box["box"]["upper_rad"], [np.radians(5), 0.35])


def test_limits_of_the_serial_model_are_reached(answer: Callable[..., Any], tmp_path: Path) -> None:
    """Also where the box reaches further to one side than to the other, in whichever order its joints are named."""
    over = ["--over", "roll", "-15", "15", "7", "--over", "pitch", "-60", "60", "25"]
    options = ["--robot", str(_ANKLE), "--joints", "pitch,roll", *over, "--out", str(tmp_path)]
    result = answer("export", "serial", *options)
    ankle = joint_driven(pm.load(_ANKLE), ["pitch", "roll"])
    np.testing.assert_allclose(result["box"], np.radians([[-60, -15], [60, 15]]), atol=1e-9)
    lower, upper = result["limits"]
    np.testing.assert_allclose(np.add(lower, upper), 0.0, atol=1e-9)  # about the centre of the box
    assert upper[0] > np.radians(20)
    grid = ankle.grid(pitch=(lower[0], upper[0], 9), roll=(lower[1], upper[1], 9))
    assert ankle.solve(grid, on_failure="nan").within_limits.all()
    answer("transmission", *options)
    rows = np.genfromtxt(tmp_path / "transmission.csv", delimiter=",", names=True)
    asked = np.radians(np.stack(np.meshgrid(np.linspace(-60, 60, 25), np.linspace(-15, 15, 7), indexing="ij"), -1))
    found = np.column_stack([rows["pitch_rad"], rows["roll_rad"]])
    np.testing.assert_allclose(found, asked.reshape(-1, 2), rtol=1e-11)
    assert np.isnan(rows["left_drive_rad"]).any()  # out of reach, but the joints are known
    with xr.open_dataset(tmp_path / "transmission.nc") as table:
        at = table.isel(pitch=12, roll=4)
        pose = ankle.solve([float(at["pitch"]), float(at["roll"])])
        np.testing.assert_allclose([float(at["pitch"]), float(at["roll"])], np.radians([0.0, 5.0]), atol=1e-9)
        expected = transmission(ankle, pose).jacobian[0, 0]
        np.testing.assert_allclose(float(at.jacobian_left_motor_pitch), expected, rtol=1e-12)


def test_many_joints_make_a_box_that_memory_holds(answer: Callable[..., Any]) -> None:
    """Six drives are their own coordinates; 21 values of each would be 86 million poses."""
    walker = str(_ANKLE.parents[1] / "walker" / "walker.xml")
    result = answer("transmission", "--robot", walker, "--hold-base")
    assert len(result["joints"]) >= 6


def test_all_joints_at_once(box: Transmission) -> None:
    """Every corner of the greatest box is within the drives' efforts, and some corner uses one up."""
    corners = np.array([[a, b] for a in (-1, 1) for b in (-1, 1)])[:, None, None] * box.torque_box
    drives = np.linalg.solve(box.jacobian.swapaxes(-1, -2), (corners + box.weight)[..., None])[..., 0]
    used = np.abs(drives).max(axis=(0, -1))[box.poses.within_limits]
    np.testing.assert_allclose(used, 40.0, rtol=1e-9)


def test_the_command(answer: Callable[..., Any], tmp_path: Path) -> None:
    options = ["--robot", str(_ANKLE), "--joints", "pitch,roll", "--over", "pitch", "-20", "20", "9"]
    options += ["--over", "roll", "-10", "10", "5", "--effort", "40", "--speed", "10", "--out", str(tmp_path)]
    result = answer("transmission", "5", "-3", *options)
    robot = joint_driven(pm.load(_ANKLE), ["pitch", "roll"])
    expected = transmission(robot, np.radians([5.0, -3.0]), effort=40.0)
    np.testing.assert_allclose(result["jacobian"], expected.jacobian, rtol=1e-12)
    assert result["joints"] == ["pitch", "roll"]
    assert len(result["torque_polytope_N_m"]) == 4
    assert set(result["greatest_pure_torque_N_m"]) == {"pitch", "roll"}
    sheet = (tmp_path / "transmission.csv").read_text().splitlines()
    assert len(sheet) == 46
    assert (tmp_path / "transmission.nc").stat().st_size > 1000


def test_the_page_and_pictures_say_what_to_type(answer: Callable[..., Any], tmp_path: Path) -> None:
    options = ["--robot", str(_ANKLE), "--joints", "pitch,roll", "--over", "pitch", "-20", "20", "5"]
    options += ["--over", "roll", "-10", "10", "5", "--effort", "40", "--speed", "10", "--out", str(tmp_path)]
    box = answer("transmission", *options, "--to", "numpy")["box"]
    page = (tmp_path / "report.html").read_text()
    (link,) = re.findall(r'href="(functions[^"]+)"', page)
    assert "def commands(" in (tmp_path / link).read_text()
    for joint in ("pitch", "roll"):
        effort, velocity = (box[key][joint]["least_wrong"] for key in ("effort_limit_N_m", "greatest_pure_speed_rad_s"))
        assert f"effort=&quot;{effort:.4g}&quot; velocity=&quot;{velocity:.4g}&quot;" in page
        assert f"armature=&quot;{box['rotor_inertia_kg_m2'][joint]['least_wrong']:.4g}&quot;" in page
    assert page.count("<img") == 4
    pictures = {file.stem for file in tmp_path.glob("*.png")}
    assert pictures == {"torque_polytopes", "speed_polytopes", "joint_maps", "drive_angles"}


@pytest.mark.parametrize(
    ("robot", "box", "drawn"),
    [
        (str(_ANKLE.parents[1] / "four_bar" / "four_bar.closures.yaml"), "--over crank_joint -20 20 5", 1),
        ("pm3dof", "--over theta_x -9 9 5 --over theta_y -9 9 5 --over z_e .45 .5 3", 2),
    ],
)
def test_pictures_of_one_joint_and_of_three(
    answer: Callable[..., Any], tmp_path: Path, robot: str, box: str, drawn: int
) -> None:
    answer("transmission", "--robot", robot, *box.split(), "--out", str(tmp_path))
    assert len(list(tmp_path.glob("*.png"))) == drawn
    assert (tmp_path / "report.html").read_text().count("<img") == drawn


def test_power_is_the_same_on_both_sides(ankle: Robot) -> None:
    """tau_drives . v_drives = tau_joints . v_joints at 10,000 poses, with mapped torques and rates."""
    generator = np.random.default_rng(5)
    values = generator.uniform([-0.35, -0.17], [0.35, 0.17], (10_000, 2))
    at = transmission(ankle, ankle.solve(values))
    torques, rates = generator.normal(size=(2, 10_000, 2))
    mapped_torques = np.einsum("nuj,nu->nj", at.jacobian, torques)
    mapped_rates = np.einsum("nuj,nj->nu", at.jacobian, rates)
    drives, joints = (np.einsum("nk,nk->n", *pair) for pair in ((torques, mapped_rates), (mapped_torques, rates)))
    assert np.abs(drives - joints).max() < 1e-12
    step = 1e-6
    for k in range(2):  # and the rates are those of the drives' positions
        moved = [ankle.solve(values[::50] + side * step * np.eye(2)[k]).commands for side in (1, -1)]
        np.testing.assert_allclose((moved[0] - moved[1]) / (2 * step), at.jacobian[::50, :, k], atol=1e-7)


def test_polytopes_of_an_arm_against_pycapacity() -> None:
    """The force polytope of a planar arm of three joints, vertex by vertex."""
    pycapacity = pytest.importorskip("pycapacity.robot")
    G = np.array([[-0.9, -0.5, -0.2], [0.7, 0.5, 0.1]])
    limits = np.array([8.0, 5.0, 3.0])
    ours = Polytopes.from_inequalities(G.T, -limits, limits)
    theirs = pycapacity.force_polytope(G, limits, -limits).vertices.T
    vertices = ours.vertices()
    assert len(vertices) == len(theirs)
    for vertex in theirs:
        assert np.linalg.norm(vertices - vertex, axis=1).min() < 1e-6
    fast = Polytopes.from_box(G, -limits, limits).vertices()
    theirs = pycapacity.velocity_polytope(G, limits, -limits).vertices.T
    for vertex in fast:
        assert np.linalg.norm(theirs - vertex, axis=1).min() < 1e-6


def test_an_effort_of_zero_in_a_description_stands_for_unknown(tmp_path: Path) -> None:
    text = _ANKLE.read_text().replace(' ctrlrange="-40 40" forcerange="-40 40"', "")
    (tmp_path / "ankle.xml").write_text(text)
    robot = joint_driven(pm.load(tmp_path / "ankle.xml"), ["pitch", "roll"])
    poses = robot.solve(robot.grid(pitch=(-0.1, 0.1, 3), roll=(-0.1, 0.1, 3)))
    model = serial_model(transmission(robot, poses))
    assert model.torque is None
    assert (model.unit_torque.least > 2.0).all()


def test_the_worst_error_of_a_mapping_may_be_between_the_poses_that_it_was_fitted_to() -> None:
    """Of a plane through the readings at four corners, at the middle; poses solved there."""
    robot = joint_driven(pm.load(_ANKLE, tool_frame="sole"), ["pitch", "roll"])
    fit = fit_mapping(transmission(robot, robot.grid(pitch=(-0.3, 0.3, 2), roll=(-0.15, 0.15, 2))), 1)
    middle = np.zeros((1, 2))
    errors = np.abs(fit.commands(middle) - robot.solve(middle).commands)[0]
    np.testing.assert_allclose(fit.worst, errors, rtol=1e-9)
