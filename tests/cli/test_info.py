"""`pm3dof info` on unknown files: what is there, what is missing, and what to try."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from typer.testing import CliRunner

from pm3dof_pin.cli.app import app
from pm3dof_pin.description.robots import robots_directory
from pm3dof_pin.exceptions import DescriptionError

HINGE = """<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/>
<origin xyz="{}"/><axis xyz="{}"/>{}</joint>"""
LIMIT = '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>'
ZERO = '<limit lower="0" upper="0" effort="1" velocity="1"/>'


def info(*arguments: str | Path) -> dict[str, Any]:
    result = CliRunner().invoke(app, ["info", *map(str, arguments), "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)


def lines(*arguments: str | Path) -> str:
    return CliRunner().invoke(app, ["info", *map(str, arguments)], catch_exceptions=False).stdout


def test_llvm_is_not_loaded_to_say_which_engine_there_is() -> None:
    run = "app(['info', 'hexapod'], standalone_mode=False)"
    code = f"import sys; from pm3dof_pin.cli.app import app; {run}; sys.exit('llvmlite' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, timeout=120).returncode == 0


def links(*names: str, mass: float = 0.1) -> str:
    inertial = f'<inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    return "".join(f'<link name="{name}">{inertial if mass else ""}</link>' for name in names)


def hinge(name: str, parent: str, child: str, xyz: str = "0 0 0", axis: str = "0 1 0", limit: str = LIMIT) -> str:
    return HINGE.format(name, parent, child, xyz, axis, limit)


def delta(limit: str = LIMIT) -> str:
    """A delta robot's tree: three arms, each with a forearm on two hinges; the platform is attached to the first."""
    parts = [links("base", "platform", "tip2", "tip3", "socket2", "socket3")]
    for leg, yaw in ((1, 0.0), (2, 2.0943951), (3, -2.0943951)):
        parts.append(links(f"mount{leg}", f"arm{leg}", f"cross{leg}", f"forearm{leg}"))
        parts.append(
            f'<joint name="mount{leg}_fixed" type="fixed"><parent link="base"/><child link="mount{leg}"/>'
            f'<origin rpy="0 0 {yaw}"/></joint>'
        )
        parts.append(hinge(f"motor{leg}", f"mount{leg}", f"arm{leg}", "0.2 0 0", limit=limit))
        parts.append(hinge(f"elbow{leg}", f"arm{leg}", f"cross{leg}", "0.2 0 0", limit=limit))
        parts.append(hinge(f"swing{leg}", f"cross{leg}", f"forearm{leg}", axis="1 0 0", limit=limit))
    parts.append(hinge("wrist", "forearm1", "platform", "0 0 -0.4", limit=limit))
    for leg in (2, 3):
        for name, parent in ((f"tip{leg}", f"forearm{leg}"), (f"socket{leg}", "platform")):
            xyz = "0 0 -0.4" if parent != "platform" else "-0.3 0 0"
            parts.append(
                f'<joint name="{name}_fixed" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
                f'<origin xyz="{xyz}"/></joint>'
            )
    return f'<robot name="delta">{"".join(parts)}</robot>'


def test_a_delta_whose_urdf_is_all_there_is(tmp_path: Path) -> None:
    (tmp_path / "delta.urdf").write_text(delta())
    result = info("--robot", tmp_path / "delta.urdf")
    assert (result["name"], result["format"], result["closures_file"], result["closures"]) == (
        "delta",
        "urdf",
        None,
        [],
    )
    assert result["joints"] == result["joint_types"]["revolute"] == len(result["actuated_joints"]) == 10
    assert (result["mobility"], result["tool_mobility"], result["closure_residual"]) == (10, None, 0.0)
    assert any("no tool frame" in said for said in result["missing"])
    assert any("no springs" in said for said in result["missing"])
    with_tool = info("--robot", tmp_path / "delta.urdf", "--tool-frame", "platform")
    assert with_tool["tool_frame"] == "platform"
    assert not any("no tool frame" in said for said in with_tool["missing"])
    x, _, z = with_tool["home_tool_position_m"]
    assert (x, z) == pytest.approx((0.4, -0.4))


def test_a_folder_of_example_parallel_robots(tmp_path: Path) -> None:
    """Two balls at the ends of a rod in an arm of two: 2 + 1 + 3 - 3 degrees of freedom, one of them the rod's spin."""
    tree = (
        links("base", "crank", "rod", "rocker")
        + hinge("motor", "base", "crank", axis="0 0 1", limit=ZERO)
        + hinge("ball", "crank", "rod", "0.1 0 0", limit=ZERO)
        + hinge("knuckle", "base", "rocker", "0.5 0 0", limit=ZERO)
        + '<link name="loop_A"/><joint name="a" type="fixed"><parent link="rod"/><child link="loop_A"/>'
        + '<origin xyz="0.4 0.2 0"/></joint>'
        + '<link name="loop_B"/><joint name="b" type="fixed"><parent link="rocker"/><child link="loop_B"/>'
        + '<origin xyz="0 0.2 0"/></joint>'
    )
    (tmp_path / "robot.urdf").write_text(f'<robot name="onshape">{tree}</robot>')
    (tmp_path / "robot.yaml").write_text(
        "closed_loop: [['loop_A', 'loop_B']]\ntype: ['3D']\nname_mot: ['motor']\n"
        "joint_name: ['ball', 'knuckle']\njoint_type: ['SPHERICAL', 'UJOINT_XZ']\n"
    )
    result = info("--robot", tmp_path)
    assert result["joint_types"] == {"revolute": 3, "spherical": 1}
    assert (result["mobility"], result["closure_residual"]) == (1 + 3 + 2 - 3, 0.0)
    assert result["free_degrees_of_freedom"] == 2
    assert result["limits_given"] is False
    assert any("treated as unlimited" in said for said in result["missing"])
    assert [(c["name"], c["unit"], c["lower"], c["home"]) for c in result["commands"]] == [("motor", "rad", None, 0.0)]


def test_a_walker_in_mjcf(tmp_path: Path) -> None:
    leg = (
        '<body name="shin_{0}" pos="0 {1} 0"><joint name="knee_{0}" axis="0 1 0" range="-60 60"/>{2}'
        '<body name="foot_{0}" pos="0 0 -0.4"><joint name="pitch_{0}" axis="0 1 0"/>'
        '<joint name="roll_{0}" axis="1 0 0"/>'
        '{2}<site name="sole_{0}"/></body>'
        '<body name="crank_{0}" pos="-0.05 0 -0.1"><joint name="motor_{0}" axis="0 1 0"/>{2}'
        '<body name="rod_{0}" pos="-0.05 0 0"><joint name="ball_{0}" type="ball"/>{2}</body></body></body>'
    )
    loop = '<connect name="ankle_{0}" body1="rod_{0}" body2="foot_{0}" anchor="0 0 -0.3"/>'
    legs = "".join(leg.format(side, y, '<geom size="0.02" mass="0.5"/>') for side, y in (("l", 0.1), ("r", -0.1)))
    motors = "".join(
        f'<motor name="{name}_{side}" joint="{name}_{side}"/>' for side in "lr" for name in ("knee", "motor")
    )
    (tmp_path / "walker.xml").write_text(
        f'<mujoco model="walker"><worldbody><body name="pelvis"><freejoint/><geom size="0.1" mass="4"/>{legs}</body>'
        f"</worldbody><equality>{loop.format('l')}{loop.format('r')}</equality><actuator>{motors}</actuator></mujoco>"
    )
    result = info("--robot", tmp_path / "walker.xml", "--tool-frame", "sole_l")
    assert (result["name"], result["format"], result["urdf"]) == ("walker", "mjcf", None)
    assert result["joint_types"] == {"free": 1, "revolute": 8, "spherical": 2}
    assert result["mobility"] == 6 + 2 * (1 + 2 + 1 + 3 - 3)
    assert (result["tool_mobility"], result["idle_degrees_of_freedom"]) == (6, 4)
    assert [command["name"] for command in result["commands"]] == ["knee_l", "motor_l", "knee_r", "motor_r"]
    assert result["commands"][0]["upper"] == pytest.approx(1.0471975512)
    assert [c["type"] for c in result["closures"]] == ["3d", "3d"]
    assert all(c["residual"] < 1e-12 for c in result["closures"])
    assert "walker: 11 joints (1 free, 8 revolute, 2 spherical), 4 of them actuated" in lines(
        "--robot", tmp_path / "walker.xml"
    )


def test_mobility_is_that_near_a_singular_home(tmp_path: Path) -> None:
    """A parallelogram of URDF+ folded flat: two degrees of freedom there, one anywhere else."""
    tree = links("base", "crank", "coupler", "rocker")
    tree += hinge("a", "base", "crank", axis="0 0 1") + hinge("b", "crank", "coupler", "0.1 0 0", axis="0 0 1")
    tree += hinge("c", "base", "rocker", "0.2 0 0", axis="0 0 1")
    ends = '<predecessor link="rocker"><origin xyz="0.1 0 0"/></predecessor>'
    ends += '<successor link="coupler"><origin xyz="0.2 0 0"/></successor><axis xyz="0 0 1"/>'
    (tmp_path / "bars.urdf").write_text(
        f'<robot name="bars">{tree}<loop name="l" type="revolute">{ends}</loop></robot>'
    )
    result = info("--robot", tmp_path / "bars.urdf")
    assert (result["mobility_at_home"], result["mobility"]) == (2, 1)
    asked = "name the driven ones with --drives"
    assert not any(asked in said for said in info("--robot", tmp_path / "bars.urdf", "--drives", "a")["missing"])
    with_two = info("--robot", tmp_path / "bars.urdf", "--drives", "a,c")["missing"]
    assert any(said.startswith("2 drives move 1 degree of freedom") and asked in said for said in with_two)


def test_what_was_read_over_and_springs_that_cannot_be_used(tmp_path: Path) -> None:
    """A spring that pushes is no spring; elements without a meaning here are listed with their lines."""
    extra = '\n<gazebo reference="forearm"/><jonit/><limits/>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="arm">{links("base", "forearm")}{hinge("elbow", "base", "forearm")}{extra}</robot>'
    )
    (tmp_path / "arm.closures.yaml").write_text(
        "name_mot: [elbow]\nsprings: [{name: k, type: joint, joint: elbow, stiffness: -3.0, unit: N m/rad}]\n"
    )
    with pytest.raises(DescriptionError, match="<jonit>: is unknown"):
        info("--robot", tmp_path / "arm.urdf")
    result = info("--robot", tmp_path / "arm.urdf", "--lenient")
    line = (tmp_path / "arm.urdf").read_text().partition("<jonit")[0].count("\n") + 1
    assert [(entry["element"], entry["line"]) for entry in result["read_over"]] == [
        ("<jonit>", line),
        ("<limits>", line),
        ("<gazebo>", line),
    ]
    assert result["springs"] == 0
    assert any("the springs cannot be used" in said and "'k'" in said for said in result["missing"])


def test_a_urdf_without_limits_and_masses(tmp_path: Path) -> None:
    tree = links("base", "forearm", mass=0.0) + links("hand") + hinge("elbow", "base", "forearm", limit="")
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{tree}{hinge("wrist", "forearm", "hand", limit="")}</robot>')
    result = info("--robot", tmp_path / "arm.urdf")
    assert (result["limits_given"], result["links_without_mass"]) == (False, ["forearm"])
    assert any("links without mass: forearm" in said for said in result["missing"])


def test_which_loop_is_open_and_by_how_much(tmp_path: Path) -> None:
    """A bar of 0.1 m cannot reach the frame 0.5 m away; the other loop is closed."""
    tip = '<joint name="{0}_fixed" type="fixed"><parent link="{1}"/><child link="{0}"/><origin xyz="{2} 0 0"/></joint>'
    tree = links("base", "bar", "tip", "far", "pin") + hinge("motor", "base", "bar", axis="0 0 1")
    tree += tip.format("tip", "bar", 0.1) + tip.format("far", "base", 0.5) + tip.format("pin", "base", 0.1)
    (tmp_path / "bar.urdf").write_text(f'<robot name="bar">{tree}</robot>')
    (tmp_path / "bar.closures.yaml").write_text("closed_loop: [[tip, far]]\ntype: ['3d']\nname_mot: [motor]\n")
    result = info("--robot", tmp_path / "bar.closures.yaml")
    assert (result["mobility"], result["closure_residual"]) == (None, pytest.approx(0.4))
    assert result["closures"] == [{"frame_a": "tip", "frame_b": "far", "type": "3d", "residual": pytest.approx(0.4)}]
    (said,) = (said for said in result["missing"] if "open" in said)
    assert "tip-far by 0.4 m or rad" in said
    assert "define a configuration 'home'" in said


def test_the_packages_own_robot_lacks_nothing() -> None:
    result = info()
    assert result["missing"] == []
    assert [(c["name"], c["unit"], c["home"]) for c in result["commands"]] == [
        (f"u{leg}", "m", pytest.approx(0.240272)) for leg in (1, 2, 3)
    ]
    assert [c["name"] for c in result["coordinates"]] == ["theta_x", "theta_y", "z_e"]
    assert result["coordinates"][0]["upper"] == pytest.approx(0.6981317)
    text = lines()
    assert "theta_x  coordinate       -40        40         0   deg" in text
    assert "u1          command  0.155272  0.325272  0.240272     m" in text


@pytest.mark.parametrize("kind", ["closures", "errors", "parameters"])
def test_schemas_for_editors(kind: str) -> None:
    """They accept the files of all robots, and refuse a misspelt key."""
    schema = info("--schema", kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    pattern = "*/config/pm3dof.yaml" if kind == "parameters" else f"*/urdf/*.{kind}.yaml"
    files = [yaml.safe_load(path.read_text()) for path in robots_directory().glob(pattern)]
    assert files
    for data in files:
        jsonschema.validate(data, schema)
    place = files[0]["geometry"]["link_length"] if kind == "parameters" else files[0]
    place["colour"] = "red"
    with pytest.raises(jsonschema.ValidationError, match="'colour' was unexpected"):
        jsonschema.validate(files[0], schema)


def test_it_says_what_solves_many_poses(tmp_path: Path) -> None:
    """By programs; or by Pinocchio, and why: tips that no joint brings together have no closed pose to start from."""
    assert info("--robot", "hexapod")["engine"] == "program"
    urdf = tmp_path / "apart.urdf"
    joint = '<joint name="{0}_joint" type="continuous"><parent link="base"/><child link="{0}"/>{1}</joint>'
    arm = '<link name="{0}"/>' + joint
    urdf.write_text(
        '<robot name="apart"><link name="base"/>'
        + arm.format("left", '<origin xyz="0 0 0"/>')
        + arm.format("right", '<origin xyz="5 0 0"/>')
        + "</robot>"
    )
    urdf.with_suffix(".closures.yaml").write_text(
        "closed_loop: [[left, right]]\ntype: ['3d']\nname_mot: [left_joint]\n"
    )
    result = info("--robot", urdf)
    assert result["engine"] == "pinocchio"
    assert "did not converge" in result["engine_reason"]


def test_a_stretched_arm_is_called_singular(tmp_path: Path) -> None:
    """Its point loses the motion along the arm, and the drives can move with the point at rest: serial."""
    tip = '<joint name="tip_fixed" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0.2 0 0"/></joint>'
    joints = hinge("first", "base", "upper") + hinge("second", "upper", "fore", "0.3 0 0") + tip
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links("base", "upper", "fore", "tip")}{joints}</robot>')
    (tmp_path / "arm.closures.yaml").write_text("tool_frame: tip\ntool_motions: [x, z]\n")
    distances = info("--robot", tmp_path / "arm.urdf")["singularity_distances"]
    assert {kind: entry["singular"] for kind, entry in distances.items()} == {
        "parallel": False,
        "serial": True,
        "passive": False,
    }
    assert "serial 0 (SINGULAR)" in lines("--robot", tmp_path / "arm.urdf")
