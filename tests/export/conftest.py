"""Shared by the tests of all tools: poses, cross-check values, and the forces that follow from a tool's own terms.

A tool provides the terms of its own equation of motion: mass matrix, bias forces, and for the loop closures the
relative velocity of the two frames of each, as a Jacobian, and its acceleration at constant rates. The holding forces
follow from these by plain linear algebra, independently of the package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import ArrayLike

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import joint_positions
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

Vector = np.ndarray
State = Callable[[Mapping[str, float], Mapping[str, float]], "Terms"]

ROBOTS = ("hexapod", "linear_delta", "pm3dof", "three_rps")
ACTUATED = ("slider1_joint", "slider2_joint", "slider3_joint")
COORDINATES = ("platform_x_joint", "platform_y_joint", "passive_slider_joint")


@dataclass
class Terms:
    """The terms of a tool's equation of motion at one state.

    Attributes:
        joints: names, in the order of the rows and columns.
        mass: mass matrix of the tree.
        bias: forces of the joints at zero acceleration: gravity, centrifugal and Coriolis forces.
        loops: Jacobian of the velocities between the frames of the closures.
        drift: accelerations between them at zero joint acceleration.
    """

    joints: Sequence[str]
    mass: Vector
    bias: Vector
    loops: Vector
    drift: Vector


@dataclass
class CrossCheck:
    """A pose, its motion, and results on which closed form, Pinocchio, MuJoCo, Drake and PyBullet agreed."""

    pose: tuple[float, float, float]
    rates: tuple[float, float, float]
    accelerations: tuple[float, float, float]
    forces: tuple[float, float, float]


STILL = (0.0, 0.0, 0.0)
TILTED = (np.radians(10.0), np.radians(-15.0), 0.5)
CROSS_CHECKS = {
    "level": CrossCheck((0.0, 0.0, 0.493), STILL, STILL, (6.026970609,) * 3),
    "tilted": CrossCheck(TILTED, STILL, STILL, (5.868999588679, 5.836388512736, 6.334937172705)),
    "moving": CrossCheck(TILTED, (0.5, -0.3, 0.1), (1.0, 2.0, -0.5), (5.406912927, 5.577558008, 6.068380455)),
}


@pytest.fixture(params=CROSS_CHECKS)
def cross_check(request: pytest.FixtureRequest) -> CrossCheck:
    return CROSS_CHECKS[request.param]


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="session")
def load() -> Callable[[str], Robot]:
    loaded = {name: Robot.load(name) for name in ROBOTS}
    return loaded.__getitem__


@pytest.fixture(scope="session")
def file_of() -> Callable[[str, str], Path]:
    """The committed file of a robot in a format."""
    from pm3dof_pin.description.robots import robots_directory

    suffixes = {"mjcf": "xml", "sdf": "sdf", "drake": "urdf", "urdf": "urdf"}

    def path(robot: str, kind: str) -> Path:
        return robots_directory() / f"{robot}_description" / kind / f"{robot}.{suffixes[kind]}"

    return path


@pytest.fixture(scope="session")
def ten_positions(tripod: Tripod, reachable_poses: Vector) -> list[dict[str, float]]:
    """Joint positions of the tripod at home and at nine poses all over its workspace, in closed form."""
    home = [0.0, 0.0, tripod.height_home]
    return [joint_positions(tripod, pose) for pose in [home, *reachable_poses[:9]]]


@pytest.fixture(scope="session")
def positions_at(tripod: Tripod) -> Callable[[Sequence[float]], dict[str, float]]:
    return lambda pose: joint_positions(tripod, np.array(pose))


@pytest.fixture(scope="session")
def named_positions(load: Callable[[str], Robot]) -> Callable[[str], dict[str, dict[str, float]]]:
    """Joint positions of a robot in its named configurations."""

    def positions(robot: str) -> dict[str, dict[str, float]]:
        mechanism = load(robot)
        names = list(mechanism.model.names)[1:]
        named = {key: mechanism.configuration(q) for key, q in mechanism.named_configurations.items()}
        return {key: {name: at.joint_position(name) for name in names} for key, at in named.items()}

    return positions


@pytest.fixture(scope="session")
def ten_poses(load: Callable[[str], Robot]) -> Callable[[str], list[Configuration]]:
    """Home and nine closed configurations of a robot, within all limits, at random actuator positions."""

    def poses(robot: str) -> list[Configuration]:
        mechanism, generator = load(robot), np.random.default_rng(11)
        indices = mechanism.actuated_indices
        strokes = (mechanism.upper_limits - mechanism.lower_limits)[indices]
        found = [mechanism.home]
        while len(found) < 10:
            travels = strokes * generator.uniform(-0.3, 0.3, len(strokes))
            pose = mechanism.assemble(joints=dict(zip(mechanism.actuated_joints, travels, strict=True)))
            if not pose.violated_limits():
                found.append(pose)
        return found

    return poses


@pytest.fixture(scope="session")
def assert_closed_and_held(
    ten_poses: Callable[[str], list[Configuration]], actuator_forces: Callable[..., Vector]
) -> Callable[..., None]:
    """Check a simulator's loops, and the forces of its own terms against ours, at ten poses and the named ones."""

    def check(robot: str, simulator: Any, *, closed: float) -> None:
        poses = ten_poses(robot)
        mechanism = poses[0].mechanism
        still = np.zeros(len(mechanism.motion_coordinates))
        for pose in [*poses, *map(mechanism.configuration, mechanism.named_configurations.values())]:
            positions = {name: pose.joint_position(name) for name in mechanism.q_names}
            simulator.place(positions)
            assert simulator.closure_error() < closed
            forces = actuator_forces(
                lambda at, rates: simulator.state(Terms, at, rates),
                positions,
                actuated=mechanism.actuated_joints,
                coordinates=mechanism.motion_coordinates,
                rates=still,
                accelerations=still,
            )
            np.testing.assert_allclose(forces, holding_forces(pose).actuator_forces, rtol=0, atol=1e-9)

    return check


@pytest.fixture
def assert_forces_of_the_closed_form(
    cross_check: CrossCheck,
    positions_at: Callable[[Sequence[float]], dict[str, float]],
    actuator_forces: Callable[..., Vector],
) -> Callable[[Any], None]:
    """Check the forces of a simulator's own terms for the tripod, at rest and in motion, against the closed form's."""

    def check(simulator: Any) -> None:
        forces = actuator_forces(
            lambda positions, rates: simulator.state(Terms, positions, rates),
            positions_at(cross_check.pose),
            rates=cross_check.rates,
            accelerations=cross_check.accelerations,
        )
        np.testing.assert_allclose(forces, cross_check.forces, rtol=0, atol=1e-9)

    return check


@pytest.fixture(scope="session")
def actuator_forces() -> Callable[..., Vector]:
    """Solve a tool's equation of motion for the forces of actuators and closures, and return those of the actuators."""

    def solve(
        state: State,
        positions: Mapping[str, float],
        *,
        actuated: Sequence[str] = ACTUATED,
        coordinates: Sequence[str] = COORDINATES,
        rates: Sequence[float] = STILL,
        accelerations: Sequence[float] = STILL,
    ) -> Vector:
        at_rest = state(positions, dict.fromkeys(positions, 0.0))
        velocity = _closed_motion(at_rest, coordinates, rates, np.zeros(len(at_rest.drift)))
        terms = state(positions, dict(zip(at_rest.joints, velocity, strict=True)))
        acceleration = _closed_motion(terms, coordinates, accelerations, terms.drift)
        load = terms.mass @ acceleration + terms.bias
        held = np.vstack([_rows(terms, actuated), terms.loops]).T
        forces = np.linalg.lstsq(held, load, rcond=1e-12)[0]
        np.testing.assert_allclose(held @ forces, load, rtol=0, atol=1e-9 * np.abs(load).max())
        return np.asarray(forces[: len(actuated)])

    return solve


def _rows(terms: Terms, joints: Sequence[str]) -> Vector:
    return np.eye(len(terms.joints))[[list(terms.joints).index(joint) for joint in joints]]


def _closed_motion(terms: Terms, coordinates: Sequence[str], given: Sequence[float], drift: Vector) -> Vector:
    """Rates, or accelerations, of all joints that keep the loops closed."""
    matrix = np.vstack([_rows(terms, coordinates), terms.loops])
    wanted = np.concatenate([given, -drift])
    motion = np.linalg.lstsq(matrix, wanted, rcond=1e-12)[0]
    np.testing.assert_allclose(matrix @ motion, wanted, rtol=0, atol=1e-9)
    return np.asarray(motion)


@pytest.fixture(scope="session")
def settle() -> Callable[..., dict[str, Any]]:
    """Drive a simulated robot from home to a target by PID control of its actuators, and hold it there.

    Its `step(forces)` simulates one step and returns positions and rates of the actuators; its `closure_error()` is
    checked every ten steps, a hundredth of a second or less.
    """

    def run(
        simulator: Any,
        target: ArrayLike,
        *,
        time_step: float,
        duration: float,
        gains: tuple[float, float, float] = (4000.0, 20000.0, 80.0),
    ) -> dict[str, Any]:
        target = np.asarray(target)
        proportional, integral, derivative = gains
        forces, held, greatest = np.zeros(len(target)), np.zeros(len(target)), 0.0
        for number in range(round(duration / time_step)):
            positions, rates = simulator.step(forces)
            if number % 10 == 0:
                greatest = max(greatest, simulator.closure_error())
            part = min(number * time_step, 1.0)
            error = part * part * (3.0 - 2.0 * part) * target - positions
            held += time_step * integral * error
            forces = proportional * error - derivative * rates + held
        return {
            "forces": forces,
            "position_error": float(np.abs(error).max()),
            "rate": float(np.abs(rates).max()),
            "greatest_closure_error": greatest,
            "closure_error": simulator.closure_error(),
        }

    return run


@pytest.fixture(scope="session")
def terms() -> type[Terms]:
    """The class, for tests to fill."""
    return Terms


# A user's robot, with everything that the package's robots do not have: a root called world, a zero that is not
# assembled, a continuous joint, products of inertia in turned axes, closures on bodies with mass and
# shapes, meshes, no SRDF.

_INERTIAL = """<inertial><origin xyz="{xyz}" rpy="0.4 -0.3 0.2"/><mass value="{mass}"/>
<inertia ixx="0.003" iyy="0.004" izz="0.005" ixy="0.0002" ixz="-0.0003" iyz="0.0004"/></inertial>"""
_MASSLESS = '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
_MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
_SURFACE = '<collision><geometry><mesh filename="{}"/></geometry></collision>'
_BALL = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
_HINGE = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 -1 0"/>{limit}</joint>"""
_LIMIT = '<limit lower="-3" upper="3" effort="20" velocity="5"/>'
_FIXED = """<joint name="{child}_fixed" type="fixed"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="0.3 0.2 -0.1"/></joint>"""
_TETRAHEDRON = "v 0 0 0\nv 0.02 0 0\nv 0 0.02 0\nv 0 0 0.02\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def _four_bar(kind: str) -> str:
    """A four-bar linkage in the plane of x and z; for a weld, its rocker is cut in the middle."""
    links = {
        "base": _INERTIAL.format(xyz="0 0 0", mass=1.0),
        "crank": _INERTIAL.format(xyz="0.05 0 0.01", mass=0.2) + _MESH.format("package://shapes/arm.obj"),
        "coupler": _INERTIAL.format(xyz="0.1 0.02 0", mass=0.4) + _MESH.format("more/arm.obj"),
        "rocker": _INERTIAL.format(xyz="0 0 0.1", mass=0.3)
        + _MESH.format("more/arm.dae")
        + _SURFACE.format("more/arm.stl"),
        "tip": _INERTIAL.format(xyz="0.01 0.02 0.03", mass=0.05) + _BALL,
    }
    joints = [
        '<link name="world"/>',
        f'<link name="rocker_tip">{_MASSLESS}{_BALL}</link>',  # the shapes of both tips overlap
        f'<link name="tool">{_BALL}</link>',  # PyBullet assumes 1 kg for a link without an explicit mass
        _FIXED.format(parent="world", child="base", xyz="0 0 0.1"),
        _HINGE.format(
            name="crank_joint",
            kind="continuous",
            parent="base",
            child="crank",
            xyz="0 0 0",
            rpy="0 0 0",
            limit='<dynamics damping="0.01" friction="0"/>',
        ),
        _HINGE.format(
            name="coupler_joint",
            kind="revolute",
            parent="crank",
            child="coupler",
            xyz="0.1 0 0",
            rpy="0 0.1 0",
            limit=_LIMIT,
        ),
        _HINGE.format(
            name="rocker_joint",
            kind="revolute",
            parent="base",
            child="rocker",
            xyz="0.25 0 0",
            rpy="0 0 0",
            limit=_LIMIT,
        ),
        _FIXED.format(parent="coupler", child="tool", xyz="0.1 0 0.05"),
        _FIXED.format(parent="rocker", child="rocker_tip", xyz="0 0 0.2"),
    ]
    if kind == "3d":
        joints.append(_FIXED.format(parent="coupler", child="tip", xyz="0.25 0 0"))
    else:
        joints.append(
            _HINGE.format(
                name="pin_joint",
                kind="revolute",
                parent="coupler",
                child="half",
                xyz="0.25 0 0",
                rpy="0 0 0",
                limit=_LIMIT,
            )
        )
        links["half"] = _INERTIAL.format(xyz="0 0 -0.05", mass=0.1)
        joints.append(_FIXED.format(parent="half", child="tip", xyz="0 0 0"))
    bodies = [f'<link name="{name}">{content}</link>' for name, content in links.items()]
    return "\n".join(['<robot name="four bar">', *bodies, *joints, "</robot>\n"])


@pytest.fixture(params=["3d", "6d"])
def four_bar(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The path of its URDF."""
    folder = tmp_path / "shapes" / "urdf"
    (folder / "more").mkdir(parents=True)
    for mesh in (folder.parent / "arm.obj", folder / "more" / "arm.obj"):
        mesh.write_text(_TETRAHEDRON)
    for suffix in ("dae", "stl"):
        trimesh.load_mesh(folder.parent / "arm.obj").export(folder / "more" / f"arm.{suffix}")
    (folder / "linkage.urdf").write_text(_four_bar(request.param))
    closures = (
        f"closed_loop: [[tip, rocker_tip]]\ntype: ['{request.param}']\nname_mot: [crank_joint]\ntool_frame: tool\n"
    )
    (folder / "linkage.closures.yaml").write_text(closures)
    return folder / "linkage.urdf"
