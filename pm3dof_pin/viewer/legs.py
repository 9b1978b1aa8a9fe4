"""Which drawn bodies belong to which springs: the colours of a mechanism's legs."""

from __future__ import annotations

from collections.abc import Mapping

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import ClosureSpring, JointSpring, Spring
from pm3dof_pin.kinematics.robot import Robot


def spring_joint(mechanism: Robot, spring: Spring) -> int:
    """Return the joint that moves the body a spring stands for.

    A joint spring stands for the body behind its joint, a spring before a frame or joint for the body that carries it,
    one in a closure for the body of the closure's first frame.
    """
    model = mechanism.model
    if isinstance(spring, JointSpring):
        return int(model.getJointId(spring.joint))
    if isinstance(spring, ClosureSpring):
        return int(model.frames[mechanism.frame_id(mechanism.closures[spring.closure].frame_a)].parentJoint)
    if model.existJointName(spring.at):
        return int(model.parents[model.getJointId(spring.at)])
    return int(model.frames[mechanism.frame_id(spring.at)].parentJoint)


def legs(model: ElasticModel) -> dict[int, tuple[str, ...]]:
    """Return the names of the springs that colour each joint's body, by Pinocchio's index of the joint.

    A leg is a branch of the tree, from the base to the last body with a spring, and all its bodies have all its
    springs. A serial robot is one branch: there every body has its own.
    """
    mechanism = model.rigid
    at = {spring.name: spring_joint(mechanism, spring) for spring in model.springs}
    chains = {name: _chain(mechanism, joint) for name, joint in at.items()}
    branches: dict[int, list[str]] = {}
    for name, chain in chains.items():
        if chain:
            branches.setdefault(chain[-1], []).append(name)
    if len(branches) < 2:
        own: dict[int, tuple[str, ...]] = {}
        for name, joint in at.items():
            own[joint] = (*own.get(joint, ()), name)
        return own
    return {joint: tuple(names) for names in branches.values() for name in names for joint in chains[name]}


def leg_shares(model: ElasticModel, shares: Mapping[str, float]) -> dict[int, float]:
    """Return each body's share in a deflection, that of its leg, from the share of each spring, by name."""
    return {joint: sum(shares[name] for name in names) for joint, names in legs(model).items()}


def leg_springs(model: ElasticModel) -> list[tuple[str, ...]]:
    """Return the names of the springs of each leg, in the order of the springs."""
    return list(dict.fromkeys(legs(model).values()))


def leg_of_joints(model: ElasticModel) -> dict[int, int]:
    """Return a number for the leg of each joint's body, its place in :func:`leg_springs`."""
    order = leg_springs(model)
    return {joint: order.index(springs) for joint, springs in legs(model).items()}


def _chain(mechanism: Robot, joint: int) -> list[int]:
    """Return a joint and those that carry it, down to the base, which is left out."""
    chain = []
    while joint > 0:
        chain.append(joint)
        joint = int(mechanism.model.parents[joint])
    return chain
