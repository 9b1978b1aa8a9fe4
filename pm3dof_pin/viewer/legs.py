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


class Legs:
    """Which springs colour each joint's body: those of its leg.

    A leg is a branch of the tree, from the base to the last body with a spring, and all its bodies have all its
    springs. A serial robot is one branch: there every body has its own.
    """

    def __init__(self, model: ElasticModel) -> None:
        at = {spring.name: spring_joint(model.rigid, spring) for spring in model.springs}
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
        """The names of the springs of each leg, in the order of the springs."""
        return list(dict.fromkeys(self._of_joint.values()))

    def number(self, joint: int) -> int:
        """Return the place in :attr:`springs` of the leg of a joint's body."""
        return self.springs.index(self._of_joint[joint])

    def shares(self, shares: Mapping[str, float]) -> dict[int, float]:
        """Return each body's share in a deflection, that of its leg, by joint, from the share of each spring."""
        return {joint: sum(shares[name] for name in names) for joint, names in self._of_joint.items()}


def _chain(mechanism: Robot, joint: int) -> list[int]:
    """Return a joint and those that carry it, down to the base, which is left out."""
    chain = []
    while joint > 0:
        chain.append(joint)
        joint = int(mechanism.model.parents[joint])
    return chain
