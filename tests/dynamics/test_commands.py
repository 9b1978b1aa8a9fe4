"""The commands `pm3dof statics` and `pm3dof modes`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.cli.app import app
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import InvalidValueError, UnknownRobotError, UnreachablePoseError


def _answer(*arguments: str, status: int = 0) -> dict[str, Any]:
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == status, result.output
    return json.loads(result.stdout)


def test_statics_at_a_pose_with_negative_numbers() -> None:
    result = _answer("statics", "10", "-15", "0.5")
    expected = [5.868999588679, 5.836388512736, 6.334937172705]
    np.testing.assert_allclose(result["force_N"], expected, rtol=0.0, atol=1e-9)
    assert np.shape(result["closure_force_N"]) == (3, 3)
    assert result["residual_N"] < 1e-12
    assert result["within_limits"] is True
    assert result["actuator_forces_unique"] is True
    assert "torque_N_m" not in result


def test_a_level_payload_is_borne_by_three_legs_alike() -> None:
    """Work on a vertical move: 3 f du = m g dz, du/dz of the level platform by differences of `ik`."""
    none = _answer("statics", "0", "0", "0.493")["force_N"]
    loaded = _answer("statics", "0", "0", "0.493", "--payload", "2")["force_N"]
    low, high = (_answer("ik", "0", "0", z)["u_m"][0] for z in ("0.4929", "0.4931"))
    expected = 2.0 * 9.81 / 3.0 / ((high - low) / 2e-4)
    np.testing.assert_allclose(np.subtract(loaded, none), expected, rtol=1e-6)


def test_statics_of_another_robot_at_a_named_configuration() -> None:
    """Each of six struts carries its share of the platform's weight."""
    result = _answer("statics", "--robot", "hexapod", "--configuration", "home")
    assert len(result["force_N"]) == 6
    np.testing.assert_allclose(result["force_N"], result["force_N"][0], rtol=1e-9)
    by_path = _answer("statics", "--robot", str(find_robot("hexapod").urdf))
    assert by_path["force_N"] == result["force_N"]


def test_statics_names_redundant_closures_and_their_moments() -> None:
    result = _answer("statics", "--robot", "three_rps")
    assert result["closure_forces_unique"] is False
    moments = [moment for moment in result["closure_moment_N_m"] if moment is not None]
    assert np.shape(moments) == (3, 3)
    text = CliRunner().invoke(app, ["statics", "--robot", "three_rps"]).stdout
    assert "redundant closures" in text


def test_an_actuated_joint_that_turns_has_a_torque(tmp_path: Path) -> None:
    """A pendulum, 2 kg at 0.3 m, level."""
    (tmp_path / "pendulum.urdf").write_text("""<robot name="pendulum"><link name="ground"/>
<link name="bob"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="revolute"><parent link="ground"/><child link="bob"/><axis xyz="0 -1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>""")
    (tmp_path / "pendulum.closures.yaml").write_text("closed_loop: []\ntype: []\nname_mot: [pivot]\ntool_frame: bob\n")
    result = _answer("statics", "--robot", str(tmp_path / "pendulum.urdf"))
    assert result["force_N"] == [None]
    assert result["torque_N_m"] == [pytest.approx(2.0 * 9.81 * 0.3)]
    text = CliRunner().invoke(app, ["statics", "--robot", str(tmp_path / "pendulum.urdf")]).stdout
    assert "5.886000000" in text
    assert "N m" in text


def test_modes_at_a_pose() -> None:
    result = _answer("modes", "10", "-15", "0.5")
    frequencies = np.array(result["frequency_Hz"])
    assert frequencies.shape == (6,)
    assert (np.diff(frequencies) > 0.0).all()
    assert np.shape(result["tool_twists"]) == (6, 6)
    assert result["free_tool_twists"] == []
    assert set(result["joint_motions"][0]) > {"slider1_joint", "platform_x_joint"}
    fewer = _answer("modes", "10", "-15", "0.5", "--count", "2", "--payload", "3")["frequency_Hz"]
    assert len(fewer) == 2
    assert (np.array(fewer) < frequencies[:2]).all()


def test_modes_of_another_robot_and_as_a_table() -> None:
    result = _answer("modes", "--robot", "hexapod", "--count", "3")
    text = CliRunner().invoke(app, ["modes", "--robot", "hexapod", "--count", "3"]).stdout
    for frequency in result["frequency_Hz"]:
        assert f"{frequency:.4f}" in text
    assert "-0.0000" not in text


def test_a_free_motion_is_listed_and_has_no_frequency(tmp_path: Path) -> None:
    """A cart on a spring with a free one on it."""
    inertia = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = (
        '<joint name="{0}" type="prismatic"><parent link="{1}"/><child link="{2}"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    (tmp_path / "carts.urdf").write_text(
        f'<robot name="carts"><link name="ground"/><link name="low">{inertia}</link><link name="high">{inertia}</link>'
        + joint.format("first", "ground", "low")
        + joint.format("second", "low", "high")
        + "</robot>"
    )
    (tmp_path / "carts.closures.yaml").write_text(
        "closed_loop: []\ntype: []\nname_mot: [first]\ntool_frame: high\n"
        "springs: [{name: spring, type: joint, joint: first, stiffness: 800.0, unit: N/m}]\n"
    )
    result = _answer("modes", "--robot", str(tmp_path / "carts.urdf"))
    assert result["frequency_Hz"] == [pytest.approx(20.0 / (2.0 * np.pi))]
    assert len(result["free_tool_twists"]) == 1
    assert result["free_joint_motions"][0]["first"] == 0.0
    assert "free" in CliRunner().invoke(app, ["modes", "--robot", str(tmp_path / "carts.urdf")]).stdout


@pytest.mark.parametrize("command", ["statics", "modes"])
def test_a_pose_beyond_a_limit_is_answered_and_named(command: str) -> None:
    result = CliRunner().invoke(app, [command, "60", "0", "0.5", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["within_limits"] is False
    assert "joint limit broken: spherical1" in result.stderr


@pytest.mark.parametrize("command", ["statics", "modes"])
@pytest.mark.parametrize(
    "arguments",
    [
        ["1", "2"],
        ["1", "2", "0.5", "--robot", "hexapod"],
        ["1", "2", "0.5", "--configuration", "home"],
        ["nan", "2", "0.5"],
        ["1", "2", "0.5", "--payload", "-1"],
        ["1", "2", "0.5", "--misspelt"],
    ],
)
def test_wrong_usage(command: str, arguments: list[str]) -> None:
    result = CliRunner().invoke(app, [command, *arguments])
    assert result.exit_code == 2
    assert result.stdout == ""


@pytest.mark.parametrize("command", ["statics", "modes"])
def test_what_does_not_exist_is_an_error_of_the_package(command: str) -> None:
    for arguments, cause in (
        (["--robot", "nix"], UnknownRobotError),
        (["--configuration", "nix"], InvalidValueError),
        (["1", "2", "9"], UnreachablePoseError),
    ):
        assert isinstance(CliRunner().invoke(app, [command, *arguments]).exception, cause)


def test_named_configurations_are_those_of_the_srdf(tripod: Tripod) -> None:
    """The pose of `tilt_x` in two ways."""
    model = pin.buildModelFromUrdf(str(find_robot("pm3dof").urdf))
    pin.loadReferenceConfigurations(model, str(find_robot("pm3dof").srdf), False)
    q = model.referenceConfigurations["tilt_x"]
    height = tripod.height_home + q[model.joints[model.getJointId("passive_slider_joint")].idx_q]
    angle = np.degrees(q[model.joints[model.getJointId("platform_x_joint")].idx_q])
    by_pose = _answer("statics", repr(float(angle)), "0", repr(float(height)))["force_N"]
    np.testing.assert_allclose(_answer("statics", "--configuration", "tilt_x")["force_N"], by_pose, rtol=1e-9)


def test_receptance_of_a_pose_and_of_a_file(tmp_path: Path) -> None:
    at = _answer("receptance", "10", "-15", "0.5", "--folder", str(tmp_path / "curves"))
    modes = _answer("modes", "10", "-15", "0.5")["frequency_Hz"]
    np.testing.assert_allclose(at["natural_frequency_Hz"][:6], modes, rtol=1e-9)
    felt = _answer("stiffness", "10", "-15", "0.5")["felt"]
    static = [pair["static_stiffness"] for pair in at["receptances"]]
    np.testing.assert_allclose(static, list(felt.values()), rtol=1e-9)
    assert {Path(file).name for file in at["files"]} == {"receptance.csv", "receptance.png"}
    (tmp_path / "poses.csv").write_text("theta_x_deg,theta_y_deg,z_e_m\n10,-15,0.5\n0,0,0.49\n")
    columns = _answer("receptance", "--poses", str(tmp_path / "poses.csv"), "--cutting", "kc=6e8,teeth=3")["columns"]
    least = [pair["dynamic_stiffness_minimum"] for pair in at["receptances"]]
    assert columns["dynamic_stiffness_x_N_per_m"][0] == pytest.approx(least[0], rel=1e-3)
    cut = _answer("receptance", "10", "-15", "0.5", "--cutting", "kc=6e8,teeth=3,ap=1e-5")["cutting"]
    assert cut["depth_limit_m"] == pytest.approx(columns["depth_limit_m"][0], rel=1e-9)
    assert all(cut["stable_at_speed"])


def test_receptance_between_points_of_other_robots() -> None:
    """Maxwell and Betti: the same either way."""
    there, back = _answer(
        *("receptance", "--robot", "hexapod", "--from", "tool:x", "--from", "strut1_joint"),
        *("--to", "tool:x", "--to", "strut1_joint", "--count", "5"),
    )["receptances"][1:3]
    np.testing.assert_allclose(there["real"], back["real"], rtol=1e-9)
    floor = _answer("receptance", "--robot", "linear_delta", "--from", "base:z", "--count", "5")["receptances"][0]
    assert (floor["to"], floor["unit"]) == ("tool:z", "m/(m/s^2)")


def test_directions_that_nothing_moves_are_rigid(tmp_path: Path) -> None:
    """One mass of 10 kg on a spring and a damper along x: G = 1 / (k - m w^2 + i c w); nothing gives along y."""
    (tmp_path / "one.urdf").write_text(
        '<robot name="one"><link name="ground"/><link name="mass">'
        '<inertial><mass value="10"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="slide" type="prismatic">'
        '<parent link="ground"/><child link="mass"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    (tmp_path / "one.closures.yaml").write_text(
        "{closed_loop: [], type: [], name_mot: [slide], tool_frame: mass, springs: [{name: k, type: joint, "
        "joint: slide, stiffness: 1.0e+6, unit: N/m, damping: 200.0, loss_factor: 0.0}]}"
    )
    found = _answer("receptance", "0", "--robot", str(tmp_path / "one.urdf"))
    along, across = found["receptances"][:2]
    omega = 2.0 * np.pi * np.array(found["frequency_Hz"])
    expected = 1.0 / (1e6 - 10.0 * omega**2 + 200j * omega)
    np.testing.assert_allclose(np.array(along["real"]) + 1j * np.array(along["imaginary"]), expected, rtol=1e-11)
    assert across["dynamic_stiffness_minimum"] is across["mode_shares"] is across["static_stiffness"] is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--cutting", "teeth=3"], "kc is missing"),
        (["--cutting", "kc=6e8,depth=2"], "depth=2"),
        (["--cutting", "kc=6e8,plane=zz"], "one of xy"),
        (["--speeds", "100", "10"], "increasing"),
        (["--servo-bandwidth", "passive=3"], "passive"),
        (["--from", "nothing:x"], "nothing"),
        (["--loss-factor", "-1"], "not negative"),
    ],
)
def test_wrong_receptances_are_refused(arguments: list[str], message: str) -> None:
    result = CliRunner().invoke(app, ["receptance", *arguments])
    assert result.exit_code in (1, 2)
    assert message in result.stderr + str(result.exception)
