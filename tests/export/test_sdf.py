"""The SDF: valid for libsdformat, and, with its loops cut, the same tree as ours in Drake."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration


def _checker() -> str | None:
    """The command of libsdformat, if it is installed completely."""
    for tool in filter(shutil.which, ("gz", "ign")):
        if subprocess.run([tool, "sdf", "--versions"], capture_output=True, check=False).returncode == 0:
            return tool
    return None


CHECKER = _checker()


def _check(path: Path) -> None:
    done = subprocess.run([str(CHECKER), "sdf", "--check", str(path)], capture_output=True, text=True, check=False)
    assert "Valid." in done.stdout, done.stdout + done.stderr


def _loops(path: Path, mechanism: Robot) -> list[ElementTree.Element]:
    names = {f"{loop.frame_a}_{loop.frame_b}" for loop in mechanism.closures}
    return [joint for joint in ElementTree.parse(path).iter("joint") if joint.get("name") in names]


def _tree_in_drake(path: Path, mechanism: Robot) -> tuple[Any, Any]:
    pytest.importorskip("pydrake")
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    text = path.read_text()
    for loop in mechanism.closures:
        text, count = re.subn(rf'<joint name="{loop.frame_a}_{loop.frame_b}".*?</joint>', "", text, flags=re.DOTALL)
        assert count == 1
    text = re.sub(r"<(visual|collision).*?</\1>", "", text, flags=re.DOTALL)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.Finalize()
    return plant, plant.CreateDefaultContext()


def _assert_same_placements(plant: Any, context: Any, configuration: Configuration) -> None:
    for frame in configuration.mechanism.model.frames:
        if frame.type == pin.FrameType.BODY and frame.name != "world":
            theirs = plant.GetFrameByName(frame.name).CalcPoseInWorld(context).GetAsMatrix4()
            ours = configuration.frame_placement(frame.name).homogeneous
            np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-12, err_msg=frame.name)


@pytest.mark.skipif(CHECKER is None, reason="no libsdformat tools")
def test_it_is_valid(file_of: Callable[[str, str], Path], robot: str) -> None:
    _check(file_of(robot, "sdf"))


def test_every_loop_is_a_joint_between_the_frames_of_its_closure(
    file_of: Callable[[str, str], Path], robot: str, load: Callable[[str], Robot]
) -> None:
    mechanism = load(robot)
    loops = _loops(file_of(robot, "sdf"), mechanism)
    kinds = {"3d": "ball", "6d": "fixed"}
    assert [(loop.findtext("child"), loop.findtext("parent"), loop.get("type")) for loop in loops] == [
        (closure.frame_a, closure.frame_b, kinds[closure.type]) for closure in mechanism.closures
    ]


def test_the_tree_is_ours(file_of: Callable[[str, str], Path], robot: str, load: Callable[[str], Robot]) -> None:
    """Frames, mass matrix, limits and maximum forces, at joint positions with wide open loops."""
    mechanism = load(robot)
    plant, context = _tree_in_drake(file_of(robot, "sdf"), mechanism)
    joints = [plant.GetJointByName(name) for name in list(mechanism.model.names)[1:]]
    order = [joint.position_start() for joint in joints]
    ours = np.random.default_rng(3).uniform(-0.3, 0.3, mechanism.model.nq)
    theirs = np.empty_like(ours)
    theirs[order] = ours
    plant.SetPositions(context, theirs)
    _assert_same_placements(plant, context, mechanism.configuration(ours))
    mass = pin.crba(mechanism.model, mechanism.model.createData(), ours)
    np.testing.assert_allclose(plant.CalcMassMatrix(context)[np.ix_(order, order)], mass, rtol=0, atol=1e-12)
    assert [joint.position_lower_limits()[0] for joint in joints] == mechanism.lower_limits.tolist()
    assert [joint.position_upper_limits()[0] for joint in joints] == mechanism.upper_limits.tolist()
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    assert {actuator.joint().name() for actuator in actuators} == set(mechanism.actuated_joints)


def test_shapes_are_all_there(file_of: Callable[[str, str], Path], robot: str) -> None:
    urdf = ElementTree.parse(file_of(robot, "urdf")).getroot()
    sdf = ElementTree.parse(file_of(robot, "sdf")).getroot()
    for tag in ("visual", "collision"):
        names = [element.get("name") for element in sdf.iter(tag)]
        assert sorted(names) == sorted(element.get("name", "") for element in urdf.iter(tag))
        assert all(element.find("geometry/*") is not None for element in sdf.iter(tag))


def test_shapes_are_placed_in_their_links(file_of: Callable[[str, str], Path], robot: str) -> None:
    """The shapes of a massless frame belong to the link that carries it, placed relative to the frame."""
    urdf = ElementTree.parse(file_of(robot, "urdf")).getroot()
    sdf = ElementTree.parse(file_of(robot, "sdf")).getroot()
    where = {}
    for link in sdf.iter("link"):
        for shape in [*link.iter("visual"), *link.iter("collision")]:
            pose = shape.find("pose")
            frame, text = (pose.get("relative_to"), pose.text) if pose is not None else (None, None)
            where[shape.get("name")] = frame or link.get("name"), [float(x) for x in (text or "0 0 0 0 0 0").split()]
    for link in urdf.iter("link"):
        for shape in [*link.iter("visual"), *link.iter("collision")]:
            origin = shape.find("origin")
            assert origin is not None
            pose = [float(x) for x in f"{origin.get('xyz')} {origin.get('rpy')}".split()]
            assert where[shape.get("name")] == (link.get("name"), pose)


def test_a_robot_of_ones_own(four_bar: Path, tmp_path: Path) -> None:
    """Its home is not at zero: the file has it assembled, and measures joints from there."""
    (path, *_) = export_robot(four_bar, "sdf", tmp_path / "out")
    mechanism = Robot.load(four_bar)
    if CHECKER is not None:
        _check(path)
    home = mechanism.assemble(mechanism.home)
    plant, context = _tree_in_drake(path, mechanism)
    _assert_same_placements(plant, context, home)
    limit = plant.GetJointByName("rocker_joint").position_upper_limits()[0]
    assert limit == pytest.approx(3.0 - home.joint_position("rocker_joint"), abs=1e-12)
    moved = np.full(mechanism.model.nv, 0.1)
    for name in list(mechanism.model.names)[1:]:
        moved[plant.GetJointByName(name).position_start()] = 0.1
    plant.SetPositions(context, moved)
    q = pin.integrate(mechanism.model, np.array(home.q), np.full(mechanism.model.nv, 0.1))
    _assert_same_placements(plant, context, mechanism.configuration(q))
