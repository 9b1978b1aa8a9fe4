"""PyBullet: closing the loops of a robot loaded from its URDF."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure, read_closures
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import FrameNotFoundError

_BASE = -1
_GREATEST_FORCE = 1e6
"""Maximum force of a constraint [N]. With PyBullet's default of 500 N, loops would open."""


def close_loops(client: int, body: int, robot: str | Path) -> tuple[int, ...]:
    """Close the loops of a robot in PyBullet, and release its joints; return the constraint of each closure.

    PyBullet reads no loops from files, measures the points of a constraint from the links' centres of mass, and gives
    every joint a motor, which would lock a closed mechanism. A 3d closure becomes a `JOINT_POINT2POINT`, a 6d closure a
    `JOINT_FIXED`. A fixed link without inertia in the URDF, such as a frame, is relieved of the 1 kg that PyBullet
    assumes. `client` and `body` are ids of `pybullet.connect` and `pybullet.loadURDF`, the latter with
    `useFixedBase=True` and `flags=pybullet.URDF_USE_INERTIA_FROM_FILE`, without merging fixed links.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: the closures file is malformed.
        FrameNotFoundError: a closure names a link that the body does not have.
    """
    import pybullet

    found = find_robot(robot)
    closures = read_closures(found.closures).closures if found.closures is not None else ()
    massless = _links_without_inertia(found.urdf)
    names = {pybullet.getBodyInfo(body, physicsClientId=client)[0].decode(): _BASE}
    for joint in range(pybullet.getNumJoints(body, physicsClientId=client)):
        information = pybullet.getJointInfo(body, joint, physicsClientId=client)
        link = information[12].decode()
        names[link] = joint
        if link in massless and information[2] == pybullet.JOINT_FIXED:
            nothing = {"mass": 0.0, "localInertiaDiagonal": [0.0, 0.0, 0.0]}
            pybullet.changeDynamics(body, joint, physicsClientId=client, **nothing)
        pybullet.setJointMotorControl2(body, joint, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client)
    return tuple(_constraint(client, body, loop, names) for loop in closures)


def _links_without_inertia(urdf: Path) -> set[str]:
    links = ElementTree.parse(urdf).getroot().iter("link")
    return {link.get("name", "") for link in links if link.find("inertial") is None}


def _constraint(client: int, body: int, loop: LoopClosure, names: dict[str, int]) -> int:
    import pybullet

    links = []
    for frame in (loop.frame_a, loop.frame_b):
        if frame not in names:
            raise FrameNotFoundError(frame, "PyBullet's body", sorted(names))
        links.append(names[frame])
    frames = [_frame(client, body, link) for link in links]
    kind = pybullet.JOINT_POINT2POINT if loop.type == "3d" else pybullet.JOINT_FIXED
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
    pybullet.changeConstraint(constraint, maxForce=_GREATEST_FORCE, physicsClientId=client)
    return int(constraint)


def _frame(client: int, body: int, link: int) -> tuple[list[float], list[float]]:
    """Placement of a link frame relative to the link's centre of mass: position, quaternion x, y, z, w."""
    import pybullet

    dynamics = pybullet.getDynamicsInfo(body, link, physicsClientId=client)
    centre = pin.XYZQUATToSE3(np.concatenate(dynamics[3:5])).inverse()
    position, quaternion = np.split(pin.SE3ToXYZQUAT(centre), [3])
    return position.tolist(), quaternion.tolist()
