"""What the page says of a body under the pointer: its link and joint, its mass, its springs, its leg's actuator."""

from __future__ import annotations

from collections.abc import Iterable

from pm3dof_pin.elastic.springs import AxialSpring, CantileverSpring, JointSpring, Spring
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.bodies import Body
from pm3dof_pin.viewer.legs import spring_joint
from pm3dof_pin.viewer.panel import numbers_with_unit
from pm3dof_pin.viewer.scene import Json


def about_body(robot: Robot, body: Body, springs: Iterable[Spring]) -> Json:
    """Return what the page says of a body: its `name`, lines `about` it that hold in every pose, and its `actuator`.

    The actuator is the place of the only one in the body's leg, or None. Springs are named that give at this body.
    """
    model = robot.model
    joint = body.joint
    lines = []
    if joint:
        lines.append(f"moved by {model.names[joint]}")
        mass = float(model.inertias[joint].mass)
        if mass > 0.0:
            lines.append(f"{mass:.4g} kg")
        lines += [_spring_text(spring) for spring in springs if spring_joint(robot, spring) == joint]
    return {"name": body.name, "about": lines, "actuator": _actuator(robot, joint)}


def _spring_text(spring: Spring) -> str:
    if isinstance(spring, JointSpring):
        return f"spring {spring.name}: {numbers_with_unit([spring.stiffness], spring.unit)}"
    if isinstance(spring, AxialSpring):
        return f"spring {spring.name}: {numbers_with_unit([spring.stiffness], 'N/m')}"
    if isinstance(spring, CantileverSpring):
        both = numbers_with_unit([spring.bending_stiffness, spring.torsional_stiffness], "N m\u00b2")
        return f"cantilever {spring.name}: EI · GJ {both}"
    return f"spring {spring.name}: a matrix"


def _actuator(robot: Robot, joint: int) -> int | None:
    """Return the only actuator in the branch of the tree that a joint belongs to, or the joint itself."""
    if not joint:
        return None
    model = robot.model
    actuated = [int(model.getJointId(name)) for name in robot.actuated_joints]
    if joint in actuated:
        return actuated.index(joint)
    root = int(model.supports[joint][1])
    of_branch = [k for k, other in enumerate(actuated) if root in list(model.supports[other])]
    return of_branch[0] if len(of_branch) == 1 else None
