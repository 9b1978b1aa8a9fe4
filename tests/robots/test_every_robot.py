"""Properties of the description of every machine in robots/, read back from the committed files alone."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
import yourdfpy

from pm3dof_pin.description.closures import read_closures
from pm3dof_pin.description.parameters import read_quantities
from pm3dof_pin.description.robots import RobotFiles, find_robot, robot_names, robots_directory
from pm3dof_pin.kinematics.robot import Robot

FIXED_TO_THE_GROUND = {"base", "middle_platform"}


@pytest.fixture(scope="module", params=robot_names())
def robot(request: pytest.FixtureRequest) -> RobotFiles:
    return find_robot(request.param)


@pytest.fixture(scope="module")
def document(robot: RobotFiles) -> ElementTree.Element:
    return ElementTree.parse(robot.urdf).getroot()


@pytest.fixture(scope="module")
def mechanism(robot: RobotFiles) -> Robot:
    return Robot.load(robot.name)


def _folder(robot: RobotFiles) -> Path:
    return robots_directory() / f"{robot.name}_description"


def _joints(document: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """The joint above each link."""
    return {joint.find("child").get("link"): joint for joint in document.findall("joint")}


def _mass(link: ElementTree.Element) -> float:
    return float(link.find("inertial/mass").get("value"))


# The numbers


def test_every_number_has_its_origin(robot: RobotFiles) -> None:
    path = _folder(robot) / "config" / f"{robot.name}.yaml"
    for key, quantity in read_quantities(path).items():
        assert len(quantity.source) > 5, key
        assert quantity.status == "chosen" or not key.startswith("drawing."), key
    sections = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert sections["name"] == robot.name
    for entries in sections.values():
        assert isinstance(entries, str) or all("symbol" in entry for entry in entries.values())


@pytest.mark.parametrize("name", ["ankle_rus", "ankle_spu", "hexapod", "linear_delta", "three_rps"])
def test_every_number_is_used(name: str) -> None:
    robot = find_robot(name)
    folders = (_folder(robot), *(_folder(find_robot(other)) for other in ("pm3dof", "hexapod")))
    texts = "".join(file.read_text() for folder in folders for file in (folder / "xacro").rglob("*.xacro"))
    read = set(re.findall(r"si\('([\w.]+)'\)", texts))
    assert set(read_quantities(_folder(robot) / "config" / f"{name}.yaml")) <= read


# The tree


def test_the_tree_is_portable(document: ElementTree.Element, robot: RobotFiles) -> None:
    assert document.get("name") == robot.name
    children = [joint.find("child").get("link") for joint in document.findall("joint")]
    assert len(children) == len(set(children)), "a link with two parents crashes PyBullet"
    assert {link.get("name") for link in document.findall("link")} - set(children) == {"base"}
    assert {joint.get("type") for joint in document.findall("joint")} <= {"fixed", "prismatic", "revolute"}
    assert {next(iter(geometry)).tag for geometry in document.iter("geometry")} <= {"box", "cylinder", "sphere"}
    colours = {material.get("name") for material in document.findall("material")}
    assert {visual.find("material").get("name") for visual in document.iter("visual")} <= colours
    names = [shape.get("name") for kind in ("visual", "collision") for shape in document.iter(kind)]
    assert len(names) == len(set(names))


def test_bodies_have_mass_and_frames_have_none(document: ElementTree.Element) -> None:
    joints = _joints(document)
    for link in document.findall("link"):
        name = link.get("name")
        moments = sorted(float(link.find("inertial/inertia").get(key)) for key in ("ixx", "iyy", "izz"))
        moves = name in joints and joints[name].get("type") != "fixed"
        if moves or (link.find("visual") is not None and name not in FIXED_TO_THE_GROUND):
            assert _mass(link) >= 0.01, name
            assert moments[0] > 0.0, name
            assert moments[2] <= moments[0] + moments[1], f"no body has such moments: {name}"
        elif name not in FIXED_TO_THE_GROUND:
            assert joints[name].get("name") == f"{name}_fixed"
            assert (_mass(link), moments) == (0.0, [0.0, 0.0, 0.0]), name


def test_actuated_joints_have_a_transmission(document: ElementTree.Element, robot: RobotFiles) -> None:
    driven = [element.get("name") for element in document.findall("transmission/joint")]
    assert driven == list(read_closures(robot.closures).actuated_joints)
    joints = {joint.get("name"): joint for joint in document.findall("joint")}
    for name, joint in joints.items():
        if joint.get("type") != "fixed":
            assert (float(joint.find("limit").get("effort")) > 0.0) == (name in driven), name


def test_check_urdf_accepts_it(robot: RobotFiles) -> None:
    command = shutil.which("check_urdf", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if command is None:
        pytest.skip("check_urdf is not installed")
    result = subprocess.run([command, robot.urdf], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "root Link: base" in result.stdout


def test_pinocchio_and_yourdfpy_agree_on_the_frames(robot: RobotFiles) -> None:
    tree = yourdfpy.URDF.load(str(robot.urdf))
    model = pin.buildModelFromUrdf(str(robot.urdf))
    generator = np.random.default_rng(7)
    q = generator.uniform(model.lowerPositionLimit, model.upperPositionLimit)
    tree.update_cfg({name: q[joint.idx_q] for name, joint in zip(model.names[1:], model.joints[1:], strict=True)})
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for frame in model.frames[1:]:
        if frame.type == pin.FrameType.BODY:
            placement = data.oMf[model.getFrameId(frame.name)].homogeneous
            np.testing.assert_allclose(placement, tree.get_transform(frame.name, "base"), rtol=0, atol=1e-14)


# The closed mechanism


def test_zero_is_home_and_home_is_assembled(mechanism: Robot) -> None:
    np.testing.assert_array_equal(mechanism.home.q, np.zeros(mechanism.model.nq))
    assert mechanism.home.closure_residual < 1e-12
    assert not mechanism.home.violated_limits()


def test_named_configurations_close_within_all_limits(mechanism: Robot) -> None:
    assert len(mechanism.named_configurations) >= 7
    for name, q in mechanism.named_configurations.items():
        configuration = mechanism.configuration(q)
        assert configuration.closure_residual < 1e-12, name
        assert not configuration.violated_limits(), name


def test_nothing_collides_in_the_named_configurations(robot: RobotFiles, mechanism: Robot) -> None:
    model = mechanism.model
    bodies = pin.buildGeomFromUrdf(model, str(robot.urdf), pin.GeometryType.COLLISION)
    bodies.addAllCollisionPairs()
    pairs = len(bodies.collisionPairs)
    pin.removeCollisionPairs(model, bodies, str(robot.srdf))
    assert pairs / 2 < len(bodies.collisionPairs) < pairs
    data, shapes = model.createData(), pin.GeometryData(bodies)
    for name, q in mechanism.named_configurations.items():
        pin.updateGeometryPlacements(model, data, bodies, shapes, q)
        pin.computeDistances(bodies, shapes)
        for pair, result in zip(bodies.collisionPairs, shapes.distanceResults, strict=True):
            names = [bodies.geometryObjects[index].name for index in (pair.first, pair.second)]
            assert result.min_distance > 0.001, f"{names} in {name}"


def test_the_srdf_names_what_is_there(robot: RobotFiles, document: ElementTree.Element, mechanism: Robot) -> None:
    srdf = ElementTree.parse(robot.srdf).getroot()
    links = {link.get("name") for link in document.findall("link")}
    joints = set(mechanism.model.names) - {"universe"}
    assert srdf.get("name") == robot.name
    for pair in srdf.findall("disable_collisions"):
        assert {pair.get("link1"), pair.get("link2")} <= links
        assert pair.get("reason")
    for chain in srdf.iter("chain"):
        assert {chain.get("base_link"), chain.get("tip_link")} <= links
    groups = {group.get("name"): group for group in srdf.findall("group")}
    assert {member.get("name") for member in groups["mechanism"]} <= set(groups)
    assert [joint.get("name") for joint in groups["actuated"]] == list(mechanism.actuated_joints)
    assert {joint.get("name") for joint in srdf.findall("passive_joint")} == set(mechanism.passive_joints)
    for state in srdf.findall("group_state"):
        assert {joint.get("name") for joint in state} == joints


def test_the_weight_of_small_bodies_is_taken_out_of_their_neighbours(
    mechanism: Robot, numbers_of: Callable[[str], dict[str, Any]]
) -> None:
    """The platform and the carriers of its joints weigh together what the YAML says, with their centre in the plate."""
    if mechanism.name in ("pm3dof", "ankle_rus", "ankle_spu"):
        pytest.skip("its platform has no carriers")
    numbers, configuration = numbers_of(mechanism.name), mechanism.home
    tool = configuration.tool_placement.translation
    model = mechanism.model
    platform = [index for index, name in enumerate(model.names) if name.startswith("platform_")]
    masses = [model.inertias[index].mass for index in platform]
    heights = [
        configuration.frame_placement(model.names[index]).act(model.inertias[index].lever)[2] for index in platform
    ]
    total, plate = numbers["inertia.platform_mass"], numbers["drawing.platform_plate_drop"]
    assert len(platform) == 6
    assert sum(masses) == pytest.approx(total, rel=1e-14)
    assert np.dot(masses, heights) / total == pytest.approx(tool[2] - plate, rel=1e-13)


# Commands and coordinates


def test_every_drive_has_a_counter_and_every_number_a_range(robot: RobotFiles) -> None:
    closures = read_closures(robot.closures)
    assert [command.name for command in closures.commands] == [
        f"u{k + 1}" for k in range(len(closures.actuated_joints))
    ]
    assert [command.joint for command in closures.commands] == list(closures.actuated_joints)
    assert [coordinate.joint for coordinate in closures.coordinates] == list(closures.motion_coordinates)
    for coordinate in closures.coordinates:
        assert coordinate.lower < coordinate.offset < coordinate.upper, "home is in the range"


def test_ranges_go_about_as_far_as_the_drives(mechanism: Robot) -> None:
    """Along each coordinate alone half of the range breaks no limit, and twice the range breaks one."""
    home = mechanism.home_coordinates
    for index, coordinate in enumerate(mechanism.coordinates):
        for end in (coordinate.lower, coordinate.upper):
            values = np.repeat(home[None], 2, axis=0)
            values[:, index] += np.array([0.5, 2.0]) * (end - home[index])
            within = mechanism.solve(values, on_failure="nan").within_limits
            assert within.tolist() == [True, False], coordinate.name
