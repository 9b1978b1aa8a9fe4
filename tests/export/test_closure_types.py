"""Every type of closure, and couplings, in every format: the same constraints in the tool, or a refusal by name."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml

from pm3dof_pin.description.closure_types import CLOSURE_TYPES
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.export.robot_document import read_robot
from pm3dof_pin.export.ros import ros_files
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from compatibility_table import closures_table, robots_table, write_chain

_SAYS = {
    "mjcf": {"3d", "6d", "hinge", "distance"},
    "drake": {"3d", "6d", "hinge"},
    "sdf": {"3d", "6d", "hinge", "universal", "prismatic"},
    "gepetto": {"3d", "6d"},
    "urdf": set(CLOSURE_TYPES),
    "ros": set(CLOSURE_TYPES),
}
"""Types that a format says itself; the others are written as joints of their own."""

_BUILT = [(form, kind) for form, says in _SAYS.items() for kind in CLOSURE_TYPES if kind not in says]


def _closed(robot: Robot) -> list[Configuration]:
    commands = np.random.default_rng(0).uniform(-0.03, 0.03, (3, len(robot.actuated_joints)))
    poses = robot.with_engine("pinocchio").forward(commands)
    return [poses[k].configuration() for k in range(3)]


def _motions(jacobian: Array) -> Array:
    """An orthonormal basis of the null space of a Jacobian, as a projector, shape=(nv, nv)."""
    _, values, right = np.linalg.svd(jacobian)
    kept = right[np.sum(values > 1e-7) :]
    return np.asarray(kept.T @ kept)


def _read_back(path: Path, form: str, folder: Path) -> Robot:
    files = export_robot(path, form, folder)
    return Robot.load(next((file for file in files if file.suffix == ".yaml"), files[0]))


@pytest.mark.parametrize(("form", "kind"), [(form, kind) for form in ("urdf", "ros") for kind in CLOSURE_TYPES])
def test_a_urdf_with_its_closures_file_says_every_type(tmp_path: Path, form: str, kind: str) -> None:
    path = write_chain(tmp_path, kind)
    files = export_robot(path, form, tmp_path / "out")
    again = Robot.load(next(file for file in files if file.suffix == ".urdf"))
    assert again.closures == Robot.load(path).closures


@pytest.mark.parametrize(("form", "kind"), _BUILT)
def test_a_type_that_a_format_cannot_say_is_built_of_joints(tmp_path: Path, form: str, kind: str) -> None:
    """The file read back closes where the robot does, and its chain has the same motions there."""
    path = write_chain(tmp_path, kind)
    robot, again = Robot.load(path), _read_back(path, form, tmp_path / "out")
    names = [f"joint{k}" for k in range(9)]
    zeros = robot.home.q if form == "sdf" else np.zeros(9)  # there, coordinates are measured from home
    rng = np.random.default_rng(1)
    for _ in range(3):
        configuration = robot.assemble(robot.configuration(robot.home.q + rng.uniform(-0.1, 0.1, 9)))
        given = dict(zip(names, configuration.q - zeros, strict=True))
        read = again.assemble(joints=given)
        assert read.closure_residual < 1e-9
        for k, name in enumerate(names):
            frames = configuration.frame_placement(f"link{k}"), read.frame_placement(f"link{k}")
            np.testing.assert_allclose(frames[0].homogeneous, frames[1].homogeneous, atol=1e-9, err_msg=name)
        jacobian = read.constraint_jacobian
        columns = again.velocity_indices(names)
        others = np.setdiff1d(np.arange(again.model.nv), columns)
        left = np.linalg.svd(jacobian[:, others])
        free = left.U[:, np.sum(left.S > 1e-7) :].T  # constraints on the chain once the added joints are eliminated
        np.testing.assert_allclose(
            _motions(free @ jacobian[:, columns]), _motions(configuration.constraint_jacobian), atol=1e-7
        )


@pytest.mark.parametrize("kind", sorted(set(CLOSURE_TYPES) - _SAYS["mjcf"]))
def test_mujoco_closes_what_is_built_of_joints(tmp_path: Path, kind: str) -> None:
    path = write_chain(tmp_path, kind)
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    rows = data.efc_J.reshape(-1, model.nv)[: data.ne]
    np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-9)
    assert model.nv - np.linalg.matrix_rank(rows, tol=1e-7) == 9 - CLOSURE_TYPES[kind].size  # Gruebler


@pytest.mark.parametrize("kind", sorted(_SAYS["mjcf"]))
def test_mujoco_permits_the_same_motions(tmp_path: Path, kind: str) -> None:
    path = write_chain(tmp_path, kind)
    robot = Robot.load(path)
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for configuration in _closed(robot):
        data.qpos[:] = configuration.q
        mujoco.mj_forward(model, data)
        rows = data.efc_J.reshape(-1, model.nv)[: data.ne]
        np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-9)
        np.testing.assert_allclose(_motions(rows), _motions(configuration.constraint_jacobian), atol=1e-7)


@pytest.mark.parametrize("kind", sorted(_SAYS["drake"]))
def test_points_for_drake_permit_the_same_motions(tmp_path: Path, kind: str) -> None:
    path = write_chain(tmp_path, kind)
    (file,) = export_robot(path, "drake", tmp_path / "out")
    again, robot = Robot.load(file), Robot.load(path)
    for configuration in _closed(robot):
        read = again.configuration(configuration.q)
        assert read.closure_residual < 1e-9
        np.testing.assert_allclose(
            _motions(read.constraint_jacobian), _motions(configuration.constraint_jacobian), atol=1e-7
        )


@pytest.mark.parametrize("kind", sorted(_SAYS["sdf"]))
def test_sdformat_accepts_the_joints(tmp_path: Path, kind: str) -> None:
    (file,) = export_robot(write_chain(tmp_path, kind), "sdf", tmp_path / "out")
    joint = ElementTree.parse(file).find(".//joint[@name='seat_tip']")
    assert joint is not None
    assert joint.get("type") == {"3d": "ball", "6d": "fixed", "hinge": "revolute"}.get(kind, kind)
    try:
        done = subprocess.run(["ign", "sdf", "--check", str(file)], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("sdformat is not installed")
    assert "Valid" in done.stdout, done.stdout + done.stderr


_COUPLING = {"joint": "joint1", "of": {"joint0": 0.5}, "offset": 0.1}
_SUM = {"joint": "joint1", "of": {"joint0": 0.5, "joint2": -1.0}, "offset": 0.0}
_POLYNOMIAL = {"joint": "joint1", "of": {"joint0": [0.5, 0.3, -0.2, 0.1]}, "offset": 0.0}


@pytest.mark.parametrize("coupling", [_COUPLING, _SUM, _POLYNOMIAL])
def test_mujoco_couples_the_same_joints(tmp_path: Path, coupling: dict[str, object]) -> None:
    path = write_chain(tmp_path, "3d", (coupling | {"offset": 0.0},))
    robot = Robot.load(path)
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(3):
        data.qpos[:] = q = rng.uniform(-0.5, 0.5, 9)
        mujoco.mj_forward(model, data)
        configuration = robot.configuration(q)
        assert data.efc_pos[data.ne - 1] == pytest.approx(configuration.closure_error[-1], abs=1e-12)
        row = data.efc_J.reshape(-1, model.nv)[data.ne - 1]
        np.testing.assert_allclose(row, configuration.constraint_jacobian[-1], atol=1e-12)


def test_drake_reads_a_linear_coupling(tmp_path: Path) -> None:
    path = write_chain(tmp_path, "3d", (_COUPLING,))
    (file,) = export_robot(path, "drake", tmp_path / "out")
    assert Robot.load(file).couplings == Robot.load(path).couplings


@pytest.mark.parametrize(
    ("form", "coupling"),
    [("drake", _SUM), ("drake", _POLYNOMIAL), ("sdf", _POLYNOMIAL), ("gepetto", _COUPLING)],
)
def test_couplings_that_a_format_cannot_say_are_named(tmp_path: Path, form: str, coupling: dict[str, object]) -> None:
    path = write_chain(tmp_path, "3d", (coupling,))
    with pytest.raises(DescriptionError, match=r"coupling joint1 = f\(joint0.*cannot be expressed"):
        export_robot(path, form, tmp_path / "out")


def test_sdformat_mimics_between_coordinates_from_home(tmp_path: Path) -> None:
    path = write_chain(tmp_path, "3d", (_COUPLING,))
    (file,) = export_robot(path, "sdf", tmp_path / "out")
    mimic = ElementTree.parse(file).find(".//joint[@name='joint1']/axis/mimic")
    assert mimic is not None
    home = Robot.load(path).home
    follower, leader = home.joint_position("joint1"), home.joint_position("joint0")
    assert mimic.get("joint") == "joint0"
    assert float(mimic.findtext("multiplier", "")) == 0.5
    assert float(mimic.findtext("offset", "")) == pytest.approx(0.5 * leader + 0.1 - follower, abs=1e-15)


@pytest.mark.parametrize("kind", CLOSURE_TYPES)
def test_the_description_itself_says_everything(tmp_path: Path, kind: str) -> None:
    path = write_chain(tmp_path, kind, (_POLYNOMIAL,))
    export_robot(path, "urdf", tmp_path / "out")
    again, robot = Robot.load(tmp_path / "out" / "chain.urdf"), Robot.load(path)
    assert (again.closures, again.couplings) == (robot.closures, robot.couplings)


def test_gears_and_rotors_reach_mujoco(tmp_path: Path) -> None:
    path = write_chain(tmp_path, "3d")
    transmission = """<transmission name="t"><type>SimpleTransmission</type><joint name="joint0"/>
    <actuator name="m"><mechanicalReduction>50</mechanicalReduction></actuator></transmission></robot>"""
    path.write_text(path.read_text().replace("</robot>", transmission))
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.actuator("joint0").gear[0] == 50.0
    np.testing.assert_allclose(model.actuator("joint0").ctrlrange, [-0.2, 0.2])  # 10 N m at the joint


def test_names_that_yaml_would_misread_are_quoted(tmp_path: Path) -> None:
    path = write_chain(tmp_path, "3d")
    for name in ("yes: {", "~", "a # b"):
        text = path.read_text()
        path.write_text(text.replace('"base"', f'"{name}"'))
        view = yaml.safe_load(ros_files(read_robot(path))["rviz/display.rviz"])
        assert view["Visualization Manager"]["Global Options"]["Fixed Frame"] == name
        path.write_text(text)


@pytest.mark.parametrize(("name", "table"), [("compatibility", closures_table), ("robots_in_dialects", robots_table)])
def test_the_tables_of_the_documentation_are_up_to_date(name: str, table: Callable[[], str]) -> None:
    assert (Path(__file__).parents[2] / "docs" / "tables" / f"{name}.txt").read_text(encoding="utf-8") == table()


def test_a_rod_of_another_length_than_at_zero_keeps_it_in_mujoco(tmp_path: Path) -> None:
    """MuJoCo's own error of the constraint is the distance less the length, wherever the joints are."""
    path = write_chain(tmp_path, "distance")
    start = float(Robot.load(path).closures[0].length or 0.0)
    (closures,) = tmp_path.glob("*.closures.yaml")
    entries = yaml.safe_load(closures.read_text(encoding="utf-8"))
    closures.write_text(yaml.safe_dump({**entries, "closure_lengths": [start + 0.01]}), encoding="utf-8")
    robot = Robot.load(path)
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for q in np.random.default_rng(4).uniform(-0.1, 0.1, (3, 9)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        a, b = (robot.configuration(q).frame_placement(frame).translation for frame in _ends(robot))
        np.testing.assert_allclose(data.efc_pos[0], np.linalg.norm(b - a) - start - 0.01, atol=1e-9)


def _ends(robot: Robot) -> tuple[str, str]:
    return robot.closures[0].frame_a, robot.closures[0].frame_b


def test_mujoco_says_distances_and_sums_so_that_they_are_read_back(tmp_path: Path) -> None:
    path = write_chain(tmp_path, "distance", (_SUM,))
    (file,) = export_robot(path, "mjcf", tmp_path / "out")
    again, robot = Robot.load(file), Robot.load(path)
    for q in np.random.default_rng(2).uniform(-0.5, 0.5, (3, 9)):
        read, configuration = again.configuration(q), robot.configuration(q)
        np.testing.assert_allclose(read.closure_error, configuration.closure_error, atol=1e-12)
        np.testing.assert_allclose(read.constraint_jacobian, configuration.constraint_jacobian, atol=1e-12)
