"""The stiffness of the free motions, against Gosselin's J^T k J of a planar 3-RPR and against K where it exists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.free_motions import free_motion_stiffness
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import RigidDirectionError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantities import QUANTITIES, select_quantities
from pm3dof_pin.maps.quantity import Evaluation, MappedRobot

MACHINES = Path(__file__).parents[1] / "machines"
BASE = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.9]])
PLATFORM = np.array([[-0.1, -0.06], [0.1, -0.06], [0.0, 0.12]])
SPRINGS = np.array([2.0e5, 3.0e5, 5.0e5])


def _three_rpr(
    coordinates: tuple[Coordinate, ...] = (), bases: np.ndarray = BASE, corners: np.ndarray = PLATFORM
) -> Robot:
    model = pin.Model()
    model.name = "three_rpr"
    joint = 0
    for name, kind in (("x", pin.JointModelPX()), ("y", pin.JointModelPY()), ("turn", pin.JointModelRZ())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), f"{name}_joint")
    model.addFrame(pin.Frame("tool", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    for leg, (base, point) in enumerate(zip(bases, corners, strict=True)):
        hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.append(base, 0.0)), f"hinge{leg}_joint")
        slide = model.addJoint(hinge, pin.JointModelPX(), pin.SE3.Identity(), f"slide{leg}_joint")
        model.addFrame(pin.Frame(f"tip{leg}", slide, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        place = pin.SE3(np.eye(3), np.append(point, 0.0))
        model.addFrame(pin.Frame(f"corner{leg}", joint, 0, place, pin.FrameType.OP_FRAME))
    return Robot(
        model,
        [LoopClosure(f"tip{leg}", f"corner{leg}", "3d") for leg in range(3)],
        actuated_joints=[f"slide{leg}_joint" for leg in range(3)],
        tool_frame="tool",
        coordinates=coordinates,
    )


def _elastic(robot: Robot) -> ElasticModel:
    drives = zip(robot.actuated_joints, SPRINGS, strict=True)
    return ElasticModel(robot, [JointSpring(name, name, stiffness, "N/m") for name, stiffness in drives])


def _legs(x: float, y: float, turn: float, bases: np.ndarray, platform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of the legs, and of the platform's corners from its centre, shape=(3, 2) each."""
    c, s = np.cos(turn), np.sin(turn)
    corners = platform @ np.array([[c, s], [-s, c]])
    return np.array([x, y]) + corners - bases, corners


def _joints(x: float, y: float, turn: float, bases: np.ndarray = BASE, platform: np.ndarray = PLATFORM) -> np.ndarray:
    legs, _ = _legs(x, y, turn, bases, platform)
    each = np.stack([np.arctan2(legs[:, 1], legs[:, 0]), np.linalg.norm(legs, axis=1)], axis=1)
    return np.concatenate([[x, y, turn], each.ravel()])


def _gosselin(x: float, y: float, turn: float, bases: np.ndarray = BASE, platform: np.ndarray = PLATFORM) -> np.ndarray:
    """J^T k J, C. Gosselin, IEEE Trans. Robotics and Automation 6 (1990), J the rates of the legs' lengths."""
    legs, corners = _legs(x, y, turn, bases, platform)
    along = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    jacobian = np.column_stack([along, corners[:, 0] * along[:, 1] - corners[:, 1] * along[:, 0]])
    return jacobian.T @ np.diag(SPRINGS) @ jacobian


def test_a_planar_3_rpr_has_gosselins_stiffness() -> None:
    model = _elastic(_three_rpr())
    generator = np.random.default_rng(3)
    for pose in generator.uniform([0.3, 0.15, -0.6], [0.7, 0.5, 0.6], (200, 3)):
        free = free_motion_stiffness(model, model.rigid.configuration(_joints(*pose)))
        assert free.names == ("x", "y", "rz")
        assert free.units == ("m", "m", "rad")
        expected = _gosselin(*pose)
        np.testing.assert_allclose(free.stiffness, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_declared_coordinates_give_their_names_scales_and_order() -> None:
    """phi negated and first, x with an offset."""
    coordinates = (
        Coordinate("phi", "rad", joint="turn_joint", scale=-1.0),
        Coordinate("x", "m", joint="x_joint", offset=3.0),
        Coordinate("y", "m", tool="y"),
    )
    model = _elastic(_three_rpr(coordinates))
    free = free_motion_stiffness(model, model.rigid.configuration(_joints(0.4, 0.3, 0.2)))
    change = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    assert free.names == ("phi", "x", "y")
    np.testing.assert_allclose(free.stiffness, change.T @ _gosselin(0.4, 0.3, 0.2) @ change, rtol=1e-11)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps"])
def test_where_k_exists_it_is_its_restriction(name: str) -> None:
    model = ElasticModel.load(name)
    free = free_motion_stiffness(model, model.rigid.home)
    stiffness = cartesian_compliance(model, model.rigid.home).stiffness
    expected = free.twists.T @ stiffness @ free.twists
    np.testing.assert_allclose(free.stiffness, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_motion_that_the_springs_do_not_allow_is_refused() -> None:
    model = _elastic(_three_rpr())
    tool = cartesian_compliance(model, model.rigid.configuration(_joints(0.4, 0.3, 0.2)))
    with pytest.raises(RigidDirectionError, match="translation along"):
        tool.stiffness_over(np.eye(6))


@pytest.mark.parametrize("is_declared", [True, False])
def test_a_map_of_a_machine_that_is_singular_at_home(is_declared: bool) -> None:
    """Base and platform are similar triangles with one centre: at home the legs meet there, and elsewhere not."""
    angles = np.deg2rad([90.0, 210.0, 330.0])
    corners = np.column_stack([np.cos(angles), np.sin(angles)])
    robot = _three_rpr((), 0.5 * corners, 0.12 * corners)
    coordinates = tuple(
        Coordinate(name, "rad" if name == "turn" else "m", joint=f"{name}_joint") for name in ("x", "y", "turn")
    )
    robot = robot.replace(coordinates=coordinates if is_declared else ())
    mapped = MappedRobot(_elastic(robot))
    assert select_quantities(["free_stiffness"], mapped)
    poses = np.array([[0.02, -0.03, turn] for turn in (-0.5, -0.2, 0.3, 0.6)])
    q = np.array([_joints(*pose, 0.5 * corners, 0.12 * corners) for pose in (*poses, (0.0, 0.0, 0.0))])
    found = QUANTITIES["free_stiffness"].compute(Evaluation(mapped, robot.at(q)))
    for matrix, pose in zip(found, poses, strict=False):
        expected = _gosselin(*pose, 0.5 * corners, 0.12 * corners)
        np.testing.assert_allclose(matrix, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    at_home = _gosselin(0.0, 0.0, 0.0, 0.5 * corners, 0.12 * corners)
    # the motions are independent there, and one of them has no stiffness
    np.testing.assert_allclose(found[-1], at_home, rtol=0, atol=1e-11 * np.abs(at_home).max())


def test_a_spherical_wrist_has_the_stiffness_of_its_rotations() -> None:
    """An Agile Eye (Gosselin and Angeles, 1989): drive i turns at (w_i x v_i) . omega / (w_i x v_i) . u_i.

    u_i are axes of the base, v_i axes of the platform, and w_i is orthogonal to both. The drives' springs are
    1000 N m/rad; the tool is a camera off the centre, whose translation follows the rotation.
    """
    mapped = MappedRobot(ElasticModel.load(MACHINES / "agile_eye"))
    poses = mapped.robot.forward(np.random.default_rng(5).uniform(-0.4, 0.4, (20, 3)))
    expected = []
    for rotation in poses.rotations:
        platform = rotation[:, [2, 0, 1]].T
        middle = np.cross(np.eye(3), platform)
        forces = np.cross(middle, platform)
        rows = forces / np.diag(forces)[:, None]
        expected.append(1000.0 * rows.T @ rows)
    found = QUANTITIES["free_stiffness"].compute(Evaluation(mapped, poses))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.max(expected))
    for pose, matrix in zip(poses, expected, strict=True):
        free = free_motion_stiffness(mapped.elastic, pose)
        assert free.names == ("rx", "ry", "rz")
        np.testing.assert_allclose(free.stiffness, matrix, rtol=0, atol=1e-8 * np.max(matrix))
        np.testing.assert_allclose(free.twists[:3], np.cross(np.eye(3), pose.tool_placement.translation).T, atol=1e-12)
