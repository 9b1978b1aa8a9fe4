"""The committed URDF: read back, compared with the YAML, and used in Pinocchio."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
import yourdfpy
from numpy.typing import NDArray

from pm3dof_pin.description.robots import find_robot, robots_directory

LEGS = (1, 2, 3)
LEGS_ARE_AT = dict(zip(LEGS, (-30.0, 90.0, -150.0), strict=True))
ACTUATED = [f"slider{leg}_joint" for leg in LEGS]
COORDINATES = ["platform_x_joint", "platform_y_joint", "passive_slider_joint"]
MOVING = {
    "passive_leg",
    "passive_cross",
    "platform",
    *(f"{part}{i}" for part in ("slider", "cross", "link") for i in LEGS),
}
FRAMES = {"M", "P", "O_e", "link1_tip", "link2_tip", "link3_tip", *(f"{point}{i}" for point in "BDEFM" for i in LEGS)}
WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

# Closed form, Pinocchio, MuJoCo, Drake and PyBullet agreed on these to 1e-14 N: pose, u [m], holding forces [N].
CHECKED_POSES = [
    ((0.0, 0.0, 0.493), (0.24028054402,) * 3, (6.026970609,) * 3),
    (
        (math.radians(10.0), math.radians(-15.0), 0.5),
        (0.257110951586, 0.260246563859, 0.224483570293),
        (5.868999588679, 5.836388512736, 6.334937172705),
    ),
]


@pytest.fixture(scope="module")
def numbers() -> dict[str, Any]:
    """Values of the YAML file by "section.name", converted here: metres, radians, kilograms."""
    factors = {"mm": 1e-3, "deg": math.pi / 180.0}
    path = robots_directory() / "pm3dof_description" / "config" / "pm3dof.yaml"
    sections = {key: entries for key, entries in yaml.safe_load(path.read_text()).items() if isinstance(entries, dict)}
    return {
        f"{section}.{name}": np.asarray(entry["value"]) * factors.get(entry["unit"], 1.0)
        for section, entries in sections.items()
        for name, entry in entries.items()
    }


@pytest.fixture(scope="module")
def document() -> ElementTree.Element:
    return ElementTree.parse(find_robot("pm3dof").urdf).getroot()


@pytest.fixture(scope="module")
def tree() -> yourdfpy.URDF:
    """The URDF at q = 0, for its forward kinematics."""
    return yourdfpy.URDF.load(str(find_robot("pm3dof").urdf))


@pytest.fixture(scope="module")
def model() -> pin.Model:
    return pin.buildModelFromUrdf(str(find_robot("pm3dof").urdf))


def _place(tree: yourdfpy.URDF, frame: str, parent: str = "base") -> NDArray[np.float64]:
    return np.asarray(tree.get_transform(frame, parent))


def _point(tree: yourdfpy.URDF, frame: str, parent: str = "base") -> NDArray[np.float64]:
    return _place(tree, frame, parent)[:3, 3]


def _level_height(numbers: dict[str, Any], u: float) -> float:
    """z_e of the level platform: l^2 = horizontal^2 + vertical^2 of a link, legs in radial planes."""
    slope = numbers["geometry.guide_slope"]
    horizontal = numbers["geometry.base_radius"] - u * math.cos(slope) - numbers["geometry.platform_radius"]
    vertical = math.sqrt(numbers["geometry.link_length"] ** 2 - horizontal**2)
    return float(vertical + u * math.sin(slope) - numbers["geometry.platform_joint_height"])


# The file on its own


def test_the_bodies_and_frames_are_all_there(document: ElementTree.Element) -> None:
    names = {link.get("name") for link in document.findall("link")}
    assert names == {"base", "middle_platform"} | MOVING | FRAMES


def test_base_is_the_root(document: ElementTree.Element) -> None:
    children = [joint.find("child").get("link") for joint in document.findall("joint")]
    assert len(children) == len(set(children))
    assert {link.get("name") for link in document.findall("link")} - set(children) == {"base"}


def test_frames_hang_on_fixed_joints_and_weigh_nothing(document: ElementTree.Element) -> None:
    joints = {joint.find("child").get("link"): joint for joint in document.findall("joint")}
    for link in document.findall("link"):
        if (name := link.get("name")) in FRAMES:
            assert (joints[name].get("name"), joints[name].get("type")) == (f"{name}_fixed", "fixed")
            assert float(link.find("inertial/mass").get("value")) == 0.0
            assert {float(moment) for moment in link.find("inertial/inertia").attrib.values()} == {0.0}


def test_every_moving_body_has_mass_and_inertia(document: ElementTree.Element) -> None:
    for link in document.findall("link"):
        if link.get("name") in MOVING:
            assert float(link.find("inertial/mass").get("value")) >= 0.01
            moments = sorted(float(link.find("inertial/inertia").get(key)) for key in ("ixx", "iyy", "izz"))
            assert moments[0] > 0.0
            assert moments[2] <= moments[0] + moments[1], "no body has such moments"


def test_shapes_are_portable_and_coloured(document: ElementTree.Element) -> None:
    shapes = [next(iter(geometry)).tag for geometry in document.iter("geometry")]
    assert set(shapes) <= {"box", "cylinder", "sphere"}
    colours = {material.get("name") for material in document.findall("material")}
    for visual in document.iter("visual"):
        assert visual.find("material").get("name") in colours
    for name in {"base", "middle_platform"} | MOVING:
        link = next(link for link in document.findall("link") if link.get("name") == name)
        assert link.find("visual") is not None, name
        assert (link.find("collision") is not None) == ("cross" not in name), name


def test_numbers_are_tidy(document: ElementTree.Element) -> None:
    words = [word for element in document.iter() for text in element.attrib.values() for word in text.split()]
    assert "-0.0" not in words
    assert max(len(word) for word in words) > 17, "full precision needs that many characters"


def test_check_urdf_accepts_it() -> None:
    command = shutil.which("check_urdf", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if command is None:
        pytest.skip("check_urdf is not installed")
    result = subprocess.run([command, find_robot("pm3dof").urdf], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "root Link: base has 7 child(ren)" in result.stdout


# Compared with the YAML


def test_points_of_the_base(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    stroke, u_home = numbers["joints.slider_stroke"], numbers["joints.slider_home"]
    lowest, highest = (_level_height(numbers, u_home + end * stroke) for end in (-1, 1))
    clamp = lowest - numbers["geometry.clamp_depth_ratio"] * (highest - lowest)
    assert clamp == pytest.approx(0.379178, abs=1e-6)  # as recovered from Table 8.3
    np.testing.assert_allclose(_point(tree, "M"), [0.0, 0.0, clamp], atol=1e-14)
    for leg, degrees in LEGS_ARE_AT.items():
        alpha = math.radians(degrees)
        outward = np.array([math.cos(alpha), math.sin(alpha), 0.0])
        foot = _point(tree, f"B{leg}")
        np.testing.assert_allclose(foot, numbers["geometry.base_radius"] * outward, atol=1e-15)
        guideway = _point(tree, f"M{leg}") - foot
        rise = math.atan2(guideway[2], -guideway @ outward)
        assert rise == pytest.approx(numbers["geometry.guide_slope"], abs=1e-14)
        assert _point(tree, f"M{leg}")[2] == pytest.approx(clamp, abs=1e-14)
        assert guideway[:2] @ [outward[1], -outward[0]] == pytest.approx(0.0, abs=1e-15)


def test_sliders(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    slope = numbers["geometry.guide_slope"]
    for leg, degrees in LEGS_ARE_AT.items():
        alpha = math.radians(degrees)
        axis = [-math.cos(slope) * math.cos(alpha), -math.cos(slope) * math.sin(alpha), math.sin(slope)]
        joint = tree.joint_map[f"slider{leg}_joint"]
        np.testing.assert_allclose(_place(tree, f"slider{leg}")[:3, :3] @ joint.axis, axis, atol=1e-15)
        travel = _point(tree, f"D{leg}") - _point(tree, f"B{leg}")
        np.testing.assert_allclose(travel, numbers["joints.slider_home"] * np.array(axis), atol=1e-15)
        assert (joint.limit.lower, joint.limit.upper) == (-0.085, 0.085)
        assert joint.limit.effort == numbers["joints.slider_force_limit"]
        assert joint.limit.velocity == numbers["joints.slider_speed_limit"]


def test_links(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    length = numbers["geometry.link_length"]
    for leg in LEGS:
        start, end = _point(tree, f"D{leg}"), _point(tree, f"link{leg}_tip")
        assert np.linalg.norm(end - start) == pytest.approx(length, abs=1e-15)
        np.testing.assert_allclose(_point(tree, f"F{leg}"), (start + end) / 2, atol=1e-15)
        np.testing.assert_allclose(_place(tree, f"link{leg}_tip")[:3, 2], (end - start) / length, atol=1e-14)


def test_universal_joints(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    for leg in LEGS:
        first, second = (tree.joint_map[f"universal{leg}_{which}_joint"] for which in ("first", "second"))
        link = _place(tree, f"link{leg}")[:3, :3]
        np.testing.assert_array_equal([first.axis, second.axis], [[0, 1, 0], [1, 0, 0]])
        assert (link @ first.axis)[2] == pytest.approx(0.0, abs=1e-15), "the first axis is horizontal"
        np.testing.assert_allclose(_point(tree, f"cross{leg}"), _point(tree, f"D{leg}"), atol=1e-15)
    revolute = [joint for joint in tree.robot.joints if joint.type == "revolute"]
    assert len(revolute) == 8
    for joint in revolute:
        assert (joint.limit.lower, joint.limit.upper) == (-math.radians(50.0), math.radians(50.0))
        assert joint.limit.velocity == numbers["joints.passive_speed_limit"]


def test_moving_platform(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    for leg, degrees in LEGS_ARE_AT.items():
        beta, inclination = math.radians(degrees), numbers["joints.spherical_axis_inclination"]
        outward = np.array([math.cos(beta), math.sin(beta), 0.0])
        expected = numbers["geometry.platform_radius"] * outward + [0, 0, numbers["geometry.platform_joint_height"]]
        np.testing.assert_allclose(_point(tree, f"E{leg}", "O_e"), expected, atol=1e-15)
        axis = _place(tree, f"E{leg}", "O_e")[:3, 2]
        np.testing.assert_allclose(
            axis, math.cos(inclination) * np.array([0, 0, 1]) - math.sin(inclination) * outward, atol=1e-15
        )
    np.testing.assert_array_equal(_place(tree, "O_e", "platform"), np.eye(4))
    np.testing.assert_array_equal(_place(tree, "P"), _place(tree, "O_e"))


def test_passive_leg(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    u_home, stroke = numbers["joints.slider_home"], numbers["joints.slider_stroke"]
    lowest, home, highest = (_level_height(numbers, u_home + end * stroke) for end in (-1, 0, 1))
    assert (lowest, highest) == pytest.approx((0.397204, 0.577462), abs=5e-7)  # as recovered from Table 8.3
    np.testing.assert_allclose(_place(tree, "O_e"), np.eye(4) + np.eye(4)[:, [2]] * [0, 0, 0, home], atol=1e-15)
    joint = tree.joint_map["passive_slider_joint"]
    margin = numbers["joints.passive_slider_margin"] * (highest - lowest)
    np.testing.assert_array_equal(joint.axis, [0, 0, 1])
    assert joint.limit.lower == pytest.approx(lowest - margin - home, abs=1e-15)
    assert joint.limit.upper == pytest.approx(highest + margin - home, abs=1e-15)
    np.testing.assert_array_equal(tree.joint_map["platform_x_joint"].axis, [1, 0, 0])
    np.testing.assert_array_equal(tree.joint_map["platform_y_joint"].axis, [0, 1, 0])


def test_masses(tree: yourdfpy.URDF, numbers: dict[str, Any]) -> None:
    inertials = {link.name: link.inertial for link in tree.robot.links}
    mass = {name: inertial.mass for name, inertial in inertials.items()}
    assert mass["platform"] == numbers["inertia.platform_mass"]
    assert mass["passive_leg"] + mass["passive_cross"] == pytest.approx(numbers["inertia.passive_leg_mass"], abs=1e-15)
    for leg in LEGS:
        assert mass[f"link{leg}"] == numbers["inertia.link_mass"]
        assert mass[f"slider{leg}"] + mass[f"cross{leg}"] == pytest.approx(numbers["inertia.slider_mass"], abs=1e-15)
        np.testing.assert_array_equal(inertials[f"link{leg}"].inertia, np.diag(numbers["inertia.link_moments"]))
        np.testing.assert_array_equal(inertials[f"link{leg}"].origin[:3, 3], [0, 0, 0.353 / 2])
        np.testing.assert_array_equal(inertials[f"cross{leg}"].inertia, 1e-6 * np.eye(3))
    np.testing.assert_array_equal(inertials["platform"].inertia, np.diag(numbers["inertia.platform_moments"]))
    moving = sum(mass[name] for name in MOVING)
    assert moving == pytest.approx(3 * (0.3045 + 0.1945) + 0.2 + 0.38, abs=1e-14)
    assert sum(mass.values()) == pytest.approx(moving + numbers["inertia.base_mass"], abs=1e-13)


# Used in computations


def test_the_home_pose_closes(model: pin.Model) -> None:
    assert _closure_error(model, pin.neutral(model)) < 1e-14


@pytest.mark.parametrize(("pose", "u", "forces"), CHECKED_POSES)
def test_loops_close_and_holding_forces(
    model: pin.Model, tree: yourdfpy.URDF, pose: tuple[float, ...], u: tuple[float, ...], forces: tuple[float, ...]
) -> None:
    q = _closed_configuration(model, tree, pose)
    data = model.createData()
    assert _closure_error(model, q) < 1e-12
    sliders = [q[model.joints[model.getJointId(name)].idx_q] for name in ACTUATED]
    np.testing.assert_allclose(np.add(sliders, 0.240272), u, rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        _motor_forces(model, q, pin.computeGeneralizedGravity(model, data, q)), forces, rtol=0, atol=1e-9
    )


def test_motor_forces_in_motion(model: pin.Model, tree: yourdfpy.URDF) -> None:
    """Rates (0.5, -0.3, 0.1), accelerations (1, 2, -0.5) of the coordinates; forces agreed with MuJoCo and Drake."""
    q = _closed_configuration(model, tree, CHECKED_POSES[1][0])
    v = _dependent(model, q, np.array([0.5, -0.3, 0.1]), np.zeros(9))
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.updateFramePlacements(model, data)
    drift = np.concatenate(
        [
            pin.getFrameClassicalAcceleration(model, data, a, WORLD_AXES).linear
            - pin.getFrameClassicalAcceleration(model, data, b, WORLD_AXES).linear
            for a, b in _closures(model)
        ]
    )
    a = _dependent(model, q, np.array([1.0, 2.0, -0.5]), drift)
    forces = _motor_forces(model, q, pin.rnea(model, data, q, v, a))
    np.testing.assert_allclose(forces, [5.406912927, 5.577558008, 6.068380455], rtol=0, atol=1e-9)


def test_nothing_collides(model: pin.Model, tree: yourdfpy.URDF, reachable_poses: NDArray[np.float64]) -> None:
    robot = find_robot("pm3dof")
    bodies = pin.buildGeomFromUrdf(model, str(robot.urdf), pin.GeometryType.COLLISION)
    bodies.addAllCollisionPairs()
    pin.removeCollisionPairs(model, bodies, str(robot.srdf))
    assert len(bodies.collisionPairs) > 500
    data, shapes = model.createData(), pin.GeometryData(bodies)
    for pose in reachable_poses[:200]:
        q = _closed_configuration(model, tree, pose)
        pin.updateGeometryPlacements(model, data, bodies, shapes, q)
        pin.computeDistances(bodies, shapes)
        nearest = min(range(len(bodies.collisionPairs)), key=lambda i: shapes.distanceResults[i].min_distance)
        pair = bodies.collisionPairs[nearest]
        names = [bodies.geometryObjects[i].name for i in (pair.first, pair.second)]
        assert shapes.distanceResults[nearest].min_distance > 0.005, f"{names} at {pose}"


def test_named_configurations(model: pin.Model) -> None:
    robot = find_robot("pm3dof")
    states = ElementTree.parse(robot.srdf).getroot().findall("group_state")
    joints = set(model.names) - {"universe"}
    for state in states:
        assert {joint.get("name") for joint in state} == joints
    pin.loadReferenceConfigurations(model, str(robot.srdf))
    assert {state.get("name") for state in states} >= {"home", "lowest", "highest", "tilt_x", "tilt_y"}
    for state in states:
        q = model.referenceConfigurations[state.get("name")]
        assert _closure_error(model, q) < 1e-13
        assert np.all((q >= model.lowerPositionLimit) & (q <= model.upperPositionLimit))
    np.testing.assert_array_equal(model.referenceConfigurations["home"], np.zeros(12))
    for name, end in (("lowest", -0.085), ("highest", 0.085)):
        q = model.referenceConfigurations[name]
        assert [q[model.joints[model.getJointId(joint)].idx_q] for joint in ACTUATED] == [end] * 3


def test_srdf_names_exist(model: pin.Model, document: ElementTree.Element) -> None:
    srdf = ElementTree.parse(find_robot("pm3dof").srdf).getroot()
    links = {link.get("name") for link in document.findall("link")}
    for pair in srdf.findall("disable_collisions"):
        assert {pair.get("link1"), pair.get("link2")} <= links
        assert pair.get("reason")
    for chain in srdf.iter("chain"):
        assert {chain.get("base_link"), chain.get("tip_link")} <= links
    passive = {joint.get("name") for joint in srdf.findall("passive_joint")}
    assert passive == set(model.names) - {"universe"} - set(ACTUATED)


def _closed_configuration(model: pin.Model, tree: yourdfpy.URDF, pose: Any) -> NDArray[np.float64]:
    """Joint coordinates at a pose, from the URDF's own frames at home and the formulas of its README."""
    theta_x, theta_y, z_e = pose
    home = _point(tree, "O_e")
    rotation = pin.utils.rotate("x", theta_x) @ pin.utils.rotate("y", theta_y)
    q = {"platform_x_joint": theta_x, "platform_y_joint": theta_y, "passive_slider_joint": z_e - home[2]}
    for leg in LEGS:
        axis = np.asarray(tree.joint_map[f"slider{leg}_joint"].axis)
        end = np.array([0.0, 0.0, z_e]) + rotation @ (_point(tree, f"E{leg}") - home)
        offset = end - _point(tree, f"D{leg}")
        travel = offset @ axis - math.sqrt((offset @ axis) ** 2 - offset @ offset + 0.353**2)
        nu = _place(tree, f"link{leg}")[:3, :3].T @ (offset - travel * axis) / 0.353
        q[f"slider{leg}_joint"] = travel
        q[f"universal{leg}_first_joint"] = math.atan2(nu[0], nu[2])
        q[f"universal{leg}_second_joint"] = -math.asin(nu[1])
    return np.array([q[name] for name in list(model.names)[1:]])


def _closures(model: pin.Model) -> list[tuple[int, int]]:
    return [(model.getFrameId(f"link{leg}_tip"), model.getFrameId(f"E{leg}")) for leg in LEGS]


def _closure_error(model: pin.Model, q: NDArray[np.float64]) -> float:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return max(float(np.linalg.norm(data.oMf[a].translation - data.oMf[b].translation)) for a, b in _closures(model))


def _constraint_jacobian(model: pin.Model, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tips minus sockets, shape=(9, 12)."""
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)

    def linear(frame: int) -> NDArray[np.float64]:
        return np.asarray(pin.getFrameJacobian(model, data, frame, WORLD_AXES)[:3])

    return np.vstack([linear(a) - linear(b) for a, b in _closures(model)])


def _dependent(
    model: pin.Model, q: NDArray[np.float64], coordinates: NDArray[np.float64], drift: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Complete rates (or accelerations) of the platform's coordinates: G x + drift = 0."""
    jacobian = _constraint_jacobian(model, q)
    chosen = _indices(model, COORDINATES)
    others = [i for i in range(model.nv) if i not in chosen]
    x = np.zeros(model.nv)
    x[chosen] = coordinates
    x[others] = -np.linalg.solve(jacobian[:, others], jacobian[:, chosen] @ coordinates + drift)
    return x


def _motor_forces(model: pin.Model, q: NDArray[np.float64], torques: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tree torques projected on the null space of the constraints, spanned by unit rates of the sliders."""
    jacobian = _constraint_jacobian(model, q)
    motors = _indices(model, ACTUATED)
    passive = [i for i in range(model.nv) if i not in motors]
    basis = np.zeros((model.nv, 3))
    basis[motors] = np.eye(3)
    basis[passive] = -np.linalg.solve(jacobian[:, passive], jacobian[:, motors])
    return basis.T @ torques


def _indices(model: pin.Model, joints: list[str]) -> list[int]:
    return [model.joints[model.getJointId(name)].idx_v for name in joints]
