"""Serial models of closed robots: masses and motions against the closed robot in MuJoCo, and files read back."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.capability.mapping_fit import fit_mapping
from pm3dof_pin.capability.serial_constants import serial_constants
from pm3dof_pin.capability.transmission import joint_driven, transmission
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export.serial import serial_tree, write_serial

Answer = Callable[..., Any]

_MACHINES = Path(__file__).parents[1] / "machines"
_ANKLE = ("--robot", str(_MACHINES / "ankle" / "ankle.xml"), "--joints", "pitch,roll")
_BOX = ("--over", "pitch", "-20", "20", "9", "--over", "roll", "-10", "10", "9")


def _full_mass(mujoco: Any, model: Any, data: Any) -> Any:
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass


def test_armature_makes_up_the_closed_robots_inertia(answer: Answer, tmp_path: Path) -> None:
    """In MuJoCo, both models have the same inertia about each joint alone where the constants are taken."""
    mujoco = pytest.importorskip("mujoco")
    answer("export", "serial", "8", "-5", *_ANKLE, *_BOX, "--out", str(tmp_path))
    robot = joint_driven(pm.load(_ANKLE[1]), ["pitch", "roll"])
    pose = robot.solve(np.radians([8.0, -5.0]))
    closed = mujoco.MjModel.from_xml_path(_ANKLE[1])
    data = mujoco.MjData(closed)
    for name in list(robot.model.names)[1:]:
        data.qpos[closed.joint(name).qposadr[0]] = robot.single_joint(name).coordinate(pose.q)
    mujoco.mj_forward(closed, data)
    expected = np.diag(_projected_mass(mujoco, closed, data))

    serial = mujoco.MjModel.from_xml_path(str(tmp_path / "ankle_serial.xml"))
    assert [serial.joint(k).name for k in range(serial.njnt)] == ["pitch", "roll"]
    data = mujoco.MjData(serial)
    data.qpos[:] = np.radians([8.0, -5.0])
    mujoco.mj_forward(serial, data)
    np.testing.assert_allclose(np.diag(_full_mass(mujoco, serial, data)), expected, rtol=1e-9)
    assert serial.body_subtreemass[0] == pytest.approx(closed.body_subtreemass[0], rel=1e-12)


def _projected_mass(mujoco: Any, model: Any, data: Any) -> Any:
    """The closed robot's inertia about pitch and roll."""
    rows = data.efc_J.reshape(data.nefc, model.nv)[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    null = np.linalg.svd(rows)[2][6:].T
    motions = null @ np.linalg.inv(null[[model.joint(name).dofadr[0] for name in ("pitch", "roll")]])
    return motions.T @ _full_mass(mujoco, model, data) @ motions


@pytest.fixture(scope="module")
def small_box(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Constants over 4 degrees to all sides; in MuJoCo the tree, the closed robot as exported, and as it was read."""
    mujoco = pytest.importorskip("mujoco")
    robot = joint_driven(pm.load(_ANKLE[1]), ["pitch", "roll"])
    box = transmission(robot, robot.grid(pitch=(-0.07, 0.07, 5), roll=(-0.07, 0.07, 5)))
    tree = serial_tree(pm.load(_ANKLE[1]), robot)
    constants, folder = serial_constants(box, pm.load(tree)), tmp_path_factory.mktemp("small_box")
    write_serial(pm.load(_ANKLE[1]), tree, constants, folder)
    files = [folder / "ankle_serial.xml", folder / "ankle_closed.xml", _ANKLE[1]]
    models = [mujoco.MjModel.from_xml_path(str(file)) for file in files]
    return mujoco, box, constants.accelerations, *models


def test_accelerations_differ_by_what_is_said(small_box: Any) -> None:
    """By MuJoCo's own masses over the box: of the serial model, and of the closed one within its constraints."""
    mujoco, box, said, serial, _, closed = small_box  # massless bodies have 10 mg in the exported one
    data, ratios = [mujoco.MjData(model) for model in (serial, closed)], []
    names = list(box.poses.robot.model.names)[1:]
    for values, q in zip(box.poses.coordinates.reshape(-1, 2), box.poses.q.reshape(-1, len(names)), strict=True):
        data[0].qpos[:] = values
        for name, value in zip(names, q, strict=True):
            data[1].qpos[closed.joint(name).qposadr[0]] = value
        for model, each in zip((serial, closed), data, strict=True):
            mujoco.mj_forward(model, each)
        masses = _full_mass(mujoco, serial, data[0]), _projected_mass(mujoco, closed, data[1])
        ratios.append(np.diag(np.linalg.inv(masses[0])) / np.diag(np.linalg.inv(masses[1])))
    np.testing.assert_allclose(said.least, np.min(ratios, axis=0), rtol=1e-9)
    np.testing.assert_allclose(said.greatest, np.max(ratios, axis=0), rtol=1e-9)


@pytest.mark.parametrize("joint", [0, 1])
def test_simulated_motions_differ_by_what_is_said(small_box: Any, joint: int) -> None:
    """Under the same torque, without gravity: 30 ms, up to some 3 degrees."""
    mujoco, _, said, *models, _ = small_box
    angles = []
    for model in models:
        model.opt.gravity[:] = 0.0
        data = mujoco.MjData(model)
        driven = model.joint(("pitch", "roll")[joint])
        for _ in range(60):
            data.qfrc_applied[driven.dofadr[0]] = 1.0
            mujoco.mj_step(model, data)
        angles.append(data.qpos[driven.qposadr[0]])
    assert np.radians(0.3) < angles[1] < np.radians(4.0)
    assert said.least[joint] < angles[0] / angles[1] < said.greatest[joint]
    assert said.greatest[joint] / said.least[joint] < 1.4


def test_files_are_read_back(answer: Answer, tmp_path: Path) -> None:
    limits = ("--effort", "40", "--speed", "12", "--gains", "50,2")
    result = answer("export", "serial", *_ANKLE, *_BOX, *limits, "--worst", "--out", str(tmp_path))
    for file in ("ankle_serial.xml", "urdf/ankle_serial.urdf"):
        robot = pm.load(tmp_path / file)
        assert not robot.closures
        assert robot.actuated_joints == ("pitch", "roll")
        for k, name in enumerate(("pitch", "roll")):
            joint = robot.description.joint(name)
            assert [joint.lower, joint.upper] == pytest.approx(np.radians([[-20, -10][k], [20, 10][k]]))
            if file.endswith(".urdf"):
                assert (joint.effort, joint.velocity) == (result["effort"]["value"][k], result["velocity"]["value"][k])
            else:
                (drive,) = (drive for drive in robot.description.drives if drive.joint == name)
                assert joint.armature == result["armature"]["value"][k] == result["armature"]["greatest"][k]
                assert (drive.proportional_gain, drive.derivative_gain) == (
                    result["kp"]["value"][k],
                    result["kd"]["value"][k],
                )
        assert "off by up to" in (tmp_path / file).read_text()
    assert json.loads((tmp_path / "ankle_serial.json").read_text())["joints"] == ["pitch", "roll"]
    assert len(pm.load(tmp_path / "ankle_closed.xml").closures) == 2


def test_all_joints_at_once_are_within_the_drives_limits(answer: Answer, tmp_path: Path) -> None:
    result = answer("export", "serial", *_ANKLE, *_BOX, "--effort", "40", "--worst", "--out", str(tmp_path))
    robot = joint_driven(pm.load(_ANKLE[1]), ["pitch", "roll"])
    grid = robot.grid(pitch=(-np.radians(20), np.radians(20), 9), roll=(-np.radians(10), np.radians(10), 9))
    G = pm.jacobian(robot, robot.solve(grid), of="commands", by="coordinates").values
    corners = np.array([[a, b] for a in (-1, 1) for b in (-1, 1)]) * result["effort"]["value"]
    drives = np.linalg.solve(G.swapaxes(-1, -2)[..., None, :, :], corners[..., None])[..., 0]
    assert 40.0 / np.abs(drives).max() == pytest.approx(result["together"]["effort"], rel=1e-9)


def test_one_leg_of_a_walker(answer: Answer, tmp_path: Path) -> None:
    """Other loops stay, and a second export opens those of the other leg."""
    robot = str(_MACHINES / "walker" / "walker.xml")
    for side in ("left", "right"):
        joints = [f"{side}_ankle_pitch", f"{side}_ankle_roll"]
        over = [word for joint in joints for word in ("--over", joint, "-8", "8", "5")]
        options = ["--subtree", f"{side}_shin", "--joints", ",".join(joints), *over, "--out", str(tmp_path / side)]
        answer("export", "serial", "--robot", robot, *options)
        robot = str(next((tmp_path / side).glob("*_serial.xml")))
        assert len(pm.load(robot).closures) == {"left": 2, "right": 0}[side]
    assert set(joints) < set(pm.load(robot).actuated_joints)


def test_polynomials_of_the_mapping() -> None:
    robot = joint_driven(pm.load(_ANKLE[1]), ["pitch", "roll"])
    grid = robot.grid(pitch=(-0.3, 0.3, 17), roll=(-0.15, 0.15, 17))
    box = transmission(robot, robot.solve(grid, on_failure="nan"), on_failure="nan")
    worst = [fit_mapping(box, degree).worst.max() for degree in (1, 3, 5)]
    assert worst[0] > 5.0 * worst[1] > 10.0 * worst[2]
    values = np.random.default_rng(3).uniform([-0.3, -0.15], [0.3, 0.15], (300, 2))
    fit = fit_mapping(box, 5)
    errors = np.abs(fit.commands(values) - robot.solve(values).commands).max(axis=0)
    assert (errors < 1.05 * fit.worst).all()
    with pytest.raises(InvalidValueError, match="degree"):
        fit_mapping(box, 0)


def test_the_mapping_is_written_as_functions(answer: Answer, run: Answer, tmp_path: Path) -> None:
    """By difference quotients of the functions: cranks of 35 mm, balls 55 mm behind and 45 mm beside the axes."""
    answer("export", "serial", *_ANKLE, *_BOX, "--to", "numpy,c", "--out", str(tmp_path))
    names = {file.name for file in (tmp_path / "functions").iterdir()}
    assert names == {"ankle_numpy.py", "ankle.c", "ankle.h", "ankle_parameters.h"}
    functions = runpy.run_path(str(tmp_path / "functions" / "ankle_numpy.py"))
    steps = 1e-6 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    moved = functions["commands"](steps)
    rates = np.stack([moved[0] - moved[1], moved[2] - moved[3]], axis=-1) / 2e-6
    expected = np.array([[55.0, 45.0], [55.0, -45.0]]) / 35.0
    np.testing.assert_allclose(rates, expected, rtol=1e-8)
    np.testing.assert_allclose(functions["jacobian"](np.zeros(2)), expected, rtol=1e-12)
    wrong = run("export", "serial", *_ANKLE, "--to", "fortran", "--out", str(tmp_path / "other"))
    assert wrong.returncode == 2
    assert "fortran" in wrong.stderr


def test_what_does_not_work_is_named(run: Answer, tmp_path: Path) -> None:
    out = ("--out", str(tmp_path))
    both = run("export", "serial", *_ANKLE, "--worst", "--least-wrong", *out)
    assert both.returncode == 2
    assert "one of --worst and --least-wrong" in both.stderr
    alone = run("export", "serial", "--robot", _ANKLE[1], "--joints", "pitch", "--effort", "40", *out)
    assert alone.returncode == 1
    assert "left_motor, right_motor can move with pitch at rest" in alone.stderr
    assert "--subtree LINK" in alone.stderr
    tool = run("export", "serial", "--robot", "linear_delta", *out)
    assert tool.returncode == 1
    assert "--joints" in tool.stderr
    ankle = joint_driven(pm.load(_ANKLE[1], tool_frame="sole"), ["left_motor", "right_motor"])
    with pytest.raises(InvalidValueError, match=r"sole.*pitch"):
        serial_tree(ankle, ankle)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("five_bar", "--joints left_motor,left_elbow, which carry pen"),  # the leg on which the pen hangs
        ("delta", "with 3 of platform_x_joint, platform_y_joint, platform_z_joint, platform_rx_joint,"),
    ],
)
def test_coordinates_that_are_no_joints_are_refused_with_joints_that_could_serve(
    run: Answer, answer: Answer, tmp_path: Path, name: str, said: str
) -> None:
    robot, out = ("--robot", str(_MACHINES / name)), ("--out", str(tmp_path))
    refused = run("export", "serial", *robot, *out)
    assert refused.returncode == 1
    assert said in refused.stderr
    if name == "five_bar":
        over = " ".join(f"--over {joint} {at - 5} {at + 5} 3" for joint, at in _five_bars_home().items()).split()
        found = answer("export", "serial", *robot, "--joints", ",".join(_five_bars_home()), *over, *out)
        assert found["joints"] == list(_five_bars_home())
    assert "takes if they are joints" in " ".join(run("export", "serial", "--help").stdout.split())


def _five_bars_home() -> dict[str, float]:
    home = pm.load(_MACHINES / "five_bar").home
    return {name: float(np.degrees(home.joint_position(name))) for name in ("left_motor", "left_elbow")}


_BODY = '<inertial pos="0.05 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
_HIP_AND_KNEE = f"""
<mujoco model="leg"><compiler angle="degree" autolimits="true"/><default><joint axis="0 1 0"/></default><worldbody>
<body name="torso"><body name="thigh"><joint name="hip" range="-60 60" armature="0.3" damping="0.7"/>{_BODY}
<body name="crank"><joint name="crank" range="20 160" armature="0.02" damping="0.4"/>{_BODY}
<body name="coupler" pos="0.1 0 0"><joint name="elbow"/>{_BODY}
<body name="leaf" pos="0.1 0 0"><joint name="flexure" stiffness="500"/>{_BODY}<site name="end" pos="0.2 0 0"/></body>
</body></body>
<body name="rocker" pos="0.3 0 0"><joint name="rocker" range="20 160" armature="0.05"/>{_BODY}
<site name="tip" pos="0.1 0 0"/></body></body></body></worldbody>
<equality><connect site1="end" site2="tip"/></equality>
<actuator><motor name="crank" joint="crank"/><motor name="hip" joint="hip"/></actuator></mujoco>"""


def test_a_joint_that_is_a_drive_keeps_its_rotor_and_its_losses_once(answer: Answer, tmp_path: Path) -> None:
    """A hip driven directly, and a knee by a parallelogram with a rigid leaf spring, whose zero is beyond limits."""
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "leg.xml"
    file.write_text(_HIP_AND_KNEE, encoding="utf-8")
    options = ("--robot", str(file), "--joints", "hip,rocker", "--hold", "flexure")
    options = (*options, "--over", "hip", "-10", "10", "2", "--over", "rocker", "60", "120", "3")
    closed = answer("transmission", *options)
    at = [f"{np.degrees(value):.12g}" for value in closed["pose_rad"]]
    found = answer("export", "serial", *options, "--out", str(tmp_path / "out"), *at)
    np.testing.assert_allclose(found["damping"]["value"], [0.7, 0.4], rtol=1e-9)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "leg_serial.xml"))
    assert [model.joint(k).name for k in range(model.njnt)] == ["hip", "rocker"]
    np.testing.assert_allclose(model.dof_damping, [0.7, 0.4], rtol=1e-9)
    data = mujoco.MjData(model)
    data.qpos[:] = closed["pose_rad"]
    mujoco.mj_forward(model, data)
    mass = _full_mass(mujoco, model, data)
    np.testing.assert_allclose(np.diag(mass), np.diag(closed["inertia_kg_m2"]), rtol=1e-9)
