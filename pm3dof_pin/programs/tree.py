"""The tree of a mechanism on recorded numbers: placements of joints and frames, and screws of the joint Jacobian."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs.geometry import WORKING_AXES, Geometry
from pm3dof_pin.programs.graph import Graph, Scalar, is_zero
from pm3dof_pin.programs.joints import ChainJoint, Screw, Transform, chain, objects, placement_of
from pm3dof_pin.typing import Objects


class Tree:
    """Placements and screws of a mechanism at q, from Pinocchio's model.

    Inputs `q[0]`, `q[1]`, ... are added to the graph, and the geometry's parameters when used.

    Args:
        graph: the graph to record in.
        mechanism: the mechanism.
        samples: closed configurations, shape=(s, nq): about eight near home, not home alone, since a singular one
            misleads the choice of columns.
        frames: frames needed in addition to those of the closures and the tool.
        positions: numbers to use for q instead of new inputs, shape=(nq,).
        dense: whether every entry of the geometry is a parameter, see :mod:`pm3dof_pin.programs.geometry`.
        geometry: that of another tree of the mechanism in the same graph, whose axes are this one's too.
        in_working_axes: whether placements and screws are in the geometry's working axes instead of the world's.

    Attributes:
        graph: the graph.
        mechanism: the mechanism.
        q: the inputs, shape=(nq,).
        geometry: constants and parameters.
        screws: columns of the joint Jacobian, one for each entry of v.
        links: the chains of simple joints, joint by joint.

    Raises:
        ProgramError: the model has a joint of an unsupported type.
        InvalidValueError: the samples have the wrong shape.
    """

    def __init__(
        self,
        graph: Graph,
        mechanism: Mechanism,
        samples: ArrayLike,
        frames: Iterable[str] = (),
        *,
        positions: Objects | None = None,
        dense: bool = False,
        geometry: Geometry | None = None,
        in_working_axes: bool = False,
    ) -> None:
        model, rows = mechanism.model, np.array(samples, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != model.nq:
            raise ShapeError("samples", rows.shape, f"(s, {model.nq})")
        self.graph = graph
        self.mechanism = mechanism
        if positions is None:
            positions = objects([graph.input(f"q[{k}]", rows[:, k]) for k in range(model.nq)])
        self.q: Objects = positions
        self.geometry = geometry or Geometry(graph, mechanism, frames, dense=dense, in_working_axes=in_working_axes)
        self._axes = placement_of(self.geometry, WORKING_AXES) if self.geometry.in_working_axes else None
        self.links: list[ChainJoint] = []
        screws: dict[int, Screw] = {}
        self._bodies = [Transform(objects(np.eye(3).tolist()), objects([0.0, 0.0, 0.0]))]
        self._supports: list[tuple[int, ...]] = [()]
        for index in range(1, model.njoints):
            body, joint = self._bodies[model.parents[index]], model.joints[index]
            for link in chain(model, index, self.geometry):
                body = body * link.placement * link.joint.displacement(self._coordinates(link))
                screws |= enumerate(link.joint.screws(body), link.v_index)
                self.links.append(link)
            self._bodies.append(body)
            self._supports.append((*self._supports[model.parents[index]], *range(joint.idx_v, joint.idx_v + joint.nv)))
        self.screws = [screws[k] for k in range(model.nv)]

    @property
    def slides(self) -> list[int]:
        """The purely translational entries of v, which are measured in lengths."""
        return [k for k, screw in enumerate(self.screws) if all(map(is_zero, screw.angular))]

    def body(self, joint: int) -> Transform:
        """Return the placement of the body that a joint moves, by Pinocchio's index of the joint."""
        return self._bodies[joint]

    def frame(self, name: str) -> Transform:
        """Return the placement of a frame; FrameNotFoundError if the model has no such frame."""
        frame = self.mechanism.model.frames[self.mechanism.frame_id(name)]
        return self.body(frame.parentJoint) * placement_of(self.geometry, f"frame/{name}")

    def in_world(self, placement: Transform) -> Transform:
        """Return a placement in the world."""
        return placement if self._axes is None else self._axes * placement

    def turned_to_world(self, twist: Objects) -> Objects:
        """Return twists [v; omega] in the axes of the world, shape=(6,) or (6, n)."""
        if self._axes is None:
            return twist
        return np.concatenate([self._axes.rotation @ twist[:3], self._axes.rotation @ twist[3:]])

    def turned_from_world(self, vector: Objects) -> Objects:
        """Return a vector, shape=(3,), or the rows of some, shape=(n, 3), in the axes of the tree."""
        return vector if self._axes is None else objects(vector @ self._axes.rotation)

    def support(self, name: str) -> tuple[int, ...]:
        """Return the entries of v that move a frame, from the base to the frame."""
        joint: int = self.mechanism.model.frames[self.mechanism.frame_id(name)].parentJoint
        return self.carrying(joint)

    def carrying(self, joint: int) -> tuple[int, ...]:
        """Return the entries of v that move the body of a joint, from the base to the joint, by Pinocchio's index."""
        return self._supports[joint]

    def jacobian(self, name: str) -> Objects:
        """Return the Jacobian of a frame's origin, shape=(6, nv): twist [v; omega] in world axes."""
        columns = objects(np.zeros((6, len(self.screws))).tolist())
        point = self.frame(name).translation
        for k in self.support(name):
            columns[:3, k] = self.screws[k].velocity(point)
            columns[3:, k] = self.screws[k].angular
        return self.turned_to_world(columns)

    def local_jacobian(self, joint: int) -> Objects:
        """Return the Jacobian of the body that a joint moves, shape=(6, nv): twist [v; omega] in the joint's axes."""
        columns = objects(np.zeros((6, len(self.screws))).tolist())
        place = self.body(joint)
        for k in self.carrying(joint):
            columns[:3, k] = self.screws[k].velocity(place.translation) @ place.rotation
            columns[3:, k] = self.screws[k].angular @ place.rotation
        return columns

    def step(self, velocities: dict[int, Scalar]) -> Objects:
        """Move q along a tangent vector, given by index in v: equal to Pinocchio's `integrate` to first order."""
        moved = self.q.copy()
        for link in self.links:
            joint = link.joint
            v = objects([velocities.get(link.v_index + k, 0.0) for k in range(joint.nv)])
            if not all(is_zero(entry) for entry in v):
                moved[link.q_index : link.q_index + joint.nq] = joint.step(self._coordinates(link), v)
        return moved

    def rate(self, velocities: Objects) -> Objects:
        """Return dq/dt at velocities v, shape=(nq,)."""
        rates = objects([0.0] * len(self.q))
        for link in self.links:
            joint = link.joint
            v = velocities[link.v_index : link.v_index + joint.nv]
            rates[link.q_index : link.q_index + joint.nq] = joint.rate(self._coordinates(link), v)
        return rates

    def _coordinates(self, link: ChainJoint) -> Objects:
        return self.q[link.q_index : link.q_index + link.joint.nq]
