"""The springs and actuators of drawn bodies: colours of legs, and the page's texts about bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import AxialSpring, CantileverSpring, ClosureSpring, JointSpring, Spring
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import colours
from pm3dof_pin.viewer.bodies import DrawnBody
from pm3dof_pin.viewer.panel import numbers_with_unit
from pm3dof_pin.viewer.scene import Json


def _spring_joint(mechanism: Robot, spring: Spring) -> int:
    """Return the joint that moves the body represented by a spring.

    A joint spring represents the body moved by its joint, a spring before a frame or joint the body that carries it,
    one in a closure the body of the closure's first frame.
    """
    model = mechanism.model
    if isinstance(spring, JointSpring):
        return int(model.getJointId(spring.joint))
    if isinstance(spring, ClosureSpring):
        return int(model.frames[mechanism.frame_id(mechanism.closures[spring.closure].frame_a)].parentJoint)
    if model.existJointName(spring.at):
        return int(model.parents[model.getJointId(spring.at)])
    return int(model.frames[mechanism.frame_id(spring.at)].parentJoint)


class ColouredLegs:
    """The springs that colour each joint's body: those of its leg.

    A leg is a branch of the tree, from the base to the last body with a spring; all its bodies have all its springs. In
    a serial robot, which is one branch, each body has its own.
    """

    def __init__(self, model: ElasticModel) -> None:
        at = {spring.name: _spring_joint(model.rigid, spring) for spring in model.springs}
        chains = {name: _chain(model.rigid, joint) for name, joint in at.items()}
        branches: dict[int, list[str]] = {}
        for name, chain in chains.items():
            if chain:
                branches.setdefault(chain[-1], []).append(name)
        self._of_joint: dict[int, tuple[str, ...]] = {}
        if len(branches) < 2:
            for name, joint in at.items():
                self._of_joint[joint] = (*self._of_joint.get(joint, ()), name)
        else:
            self._of_joint = {joint: tuple(names) for names in branches.values() for n in names for joint in chains[n]}

    @property
    def springs(self) -> list[tuple[str, ...]]:
        """The names of the springs of each leg, in order of the springs."""
        return list(dict.fromkeys(self._of_joint.values()))

    def number(self, joint: int) -> int:
        """Return the index in :attr:`springs` of the leg of a joint's body."""
        return self.springs.index(self._of_joint[joint])

    def shares(self, shares: Mapping[str, float]) -> dict[int, float]:
        """Return the share of each body's leg in a deflection, by joint, from the share of each spring."""
        return {joint: sum(shares[name] for name in names) for joint, names in self._of_joint.items()}

    def paint(self, bodies: Iterable[DrawnBody], by_joint: Mapping[int, float]) -> list[Json]:
        """Return the parts that an entry paints: all drawn parts of legs in the colour of their share."""
        return [
            {
                "path": f"{body.parts_path}/{part.name}",
                "own": list(part.colour),
                "colour": colours.blend(colours.SHARE_STOPS, by_joint[body.joint]).tolist(),
                "leg": self.number(body.joint),
            }
            for body in bodies
            if body.joint in by_joint
            for part in body.parts
        ]


def _chain(mechanism: Robot, joint: int) -> list[int]:
    """Return a joint and its ancestors, without the base."""
    chain = []
    while joint > 0:
        chain.append(joint)
        joint = int(mechanism.model.parents[joint])
    return chain


def about_body(robot: Robot, body: DrawnBody, springs: Iterable[Spring]) -> Json:
    """Return the page's text about a body: its `name`, lines `about` it valid in every pose, and its `actuator`.

    The actuator is the index of the only one in the body's leg, or None. The springs named are those of this body.
    """
    model = robot.model
    joint = body.joint
    lines = []
    if joint:
        lines.append(f"moved by {model.names[joint]}")
        mass = float(model.inertias[joint].mass)
        if mass > 0.0:
            lines.append(f"{mass:.4g} kg")
        lines += [_spring_text(spring) for spring in springs if _spring_joint(robot, spring) == joint]
    return {"name": body.name, "about": lines, "actuator": _actuator(robot, joint)}


def _spring_text(spring: Spring) -> str:
    if isinstance(spring, JointSpring):
        return f"spring {spring.name}: {numbers_with_unit([spring.stiffness], spring.unit)}"
    if isinstance(spring, AxialSpring):
        return f"spring {spring.name}: {numbers_with_unit([spring.stiffness], 'N/m')}"
    if isinstance(spring, CantileverSpring):
        both = numbers_with_unit([spring.bending_stiffness, spring.torsional_stiffness], "N m\u00b2")
        return f"cantilever {spring.name}: EI · GJ {both}"
    return f"spring {spring.name}: a 6 \u00d7 6 matrix"


def _actuator(robot: Robot, joint: int) -> int | None:
    """Return the only actuator in the branch of the tree of a joint, or the joint itself."""
    if not joint:
        return None
    model = robot.model
    actuated = [int(model.getJointId(name)) for name in robot.actuated_joints]
    if joint in actuated:
        return actuated.index(joint)
    root = int(model.supports[joint][1])
    of_branch = [k for k, other in enumerate(actuated) if root in list(model.supports[other])]
    return of_branch[0] if len(of_branch) == 1 else None
