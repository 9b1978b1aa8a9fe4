"""PyBullet: closing the loops of a robot loaded from its URDF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import FrameNotFoundError
from pm3dof_pin.export.robot_document import read_robot
from pm3dof_pin.typing import Vector

_BASE = -1
_MAX_FORCE = 1e6
"""Maximum force of a constraint [N]. With PyBullet's default of 500 N, loops would open."""


def close_loops(client: int, body: int, robot: str | Path) -> tuple[int, ...]:
    """Close the loops of a robot in PyBullet, and release its joints; return its constraints.

    PyBullet reads no loops from files, measures the points of a constraint from the links' centres of mass, and gives
    every joint a motor, which would lock a closed mechanism. A 3d closure becomes a `JOINT_POINT2POINT`, a 6d closure a
    `JOINT_FIXED`, a hinge two `JOINT_POINT2POINT` on its axis. A fixed link without inertia in the URDF, such as a
    frame, is relieved of the 1 kg that PyBullet assumes. `client` and `body` are ids of `pybullet.connect` and
    `pybullet.loadURDF`, the latter with
    `useFixedBase=True` and `flags=pybullet.URDF_USE_INERTIA_FROM_FILE`, without merging fixed links.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: a file is malformed, or a closure or coupling is none of these.
        FrameNotFoundError: a closure names a link that the body does not have.
    """
    import pybullet

    document = read_robot(robot, meshes=False)
    for coupling in document.mechanism.couplings:
        raise document.refusal(coupling, "PyBullet")
    constraints: list[tuple[LoopClosure, tuple[Vector, Vector], int]] = []
    for index, loop in enumerate(document.closures):
        if loop.type == "6d":
            constraints.append((loop, (np.zeros(3), np.zeros(3)), pybullet.JOINT_FIXED))
        else:
            points = document.points_of(index, "PyBullet")
            constraints += [(loop, pair, pybullet.JOINT_POINT2POINT) for pair in points]
    massless = {link.name for link in document.description.bodies if link.inertial is None}
    names = {pybullet.getBodyInfo(body, physicsClientId=client)[0].decode(): _BASE}
    for joint in range(pybullet.getNumJoints(body, physicsClientId=client)):
        information = pybullet.getJointInfo(body, joint, physicsClientId=client)
        link = information[12].decode()
        names[link] = joint
        if link in massless and information[2] == pybullet.JOINT_FIXED:
            nothing = {"mass": 0.0, "localInertiaDiagonal": [0.0, 0.0, 0.0]}
            pybullet.changeDynamics(body, joint, physicsClientId=client, **nothing)
        pybullet.setJointMotorControl2(body, joint, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client)
    return tuple(_constraint(client, body, names, *constraint) for constraint in constraints)


def _constraint(
    client: int, body: int, names: dict[str, int], loop: LoopClosure, points: tuple[Vector, Vector], kind: int
) -> int:
    import pybullet

    links = []
    for frame in (loop.frame_a, loop.frame_b):
        if frame not in names:
            raise FrameNotFoundError(frame, "PyBullet's body", sorted(names))
        links.append(names[frame])
    frames = [_frame(client, body, link, point) for link, point in zip(links, points, strict=True)]
    constraint = pybullet.createConstraint(
        body,
        links[0],
        body,
        links[1],
        kind,
        jointAxis=[0.0, 0.0, 0.0],
        parentFramePosition=frames[0][0],
        childFramePosition=frames[1][0],
        parentFrameOrientation=frames[0][1],
        childFrameOrientation=frames[1][1],
        physicsClientId=client,
    )
    pybullet.changeConstraint(constraint, maxForce=_MAX_FORCE, physicsClientId=client)
    return int(constraint)


def _frame(client: int, body: int, link: int, point: Vector) -> tuple[list[float], list[float]]:
    """Placement of a link's axes at a point of it, relative to its centre of mass: position, quaternion x, y, z, w."""
    import pybullet

    dynamics = pybullet.getDynamicsInfo(body, link, physicsClientId=client)
    centre = pin.XYZQUATToSE3(np.concatenate(dynamics[3:5])).inverse()
    position, quaternion = np.split(pin.SE3ToXYZQUAT(centre * pin.SE3(np.eye(3), point)), [3])
    return position.tolist(), quaternion.tolist()
