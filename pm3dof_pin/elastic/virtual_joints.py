"""Virtual joints: single-DoF joints are inserted into the tree automatically where a body is elastic.

The tree is rebuilt as a Pinocchio model. Bodies keep their inertias, frames their names and indices, joints their
names, limits and constants, and with all virtual joints at zero the mechanism is the rigid one. A spring's joints
precede its joint or frame `at`, translations first, in the axes of `at`; several springs at one place are in series, in
the order of their list. An elastic loop closure gets virtual joints between its first frame and a new frame, which is
closed rigidly instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.elastic.springs import (
    AxialSpring,
    BeamSpring,
    CantileverSpring,
    ClosureSpring,
    JointLength,
    JointSpring,
    Spring,
)
from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import Indices

_JOINT_MODELS = {
    "x": pin.JointModelPX,
    "y": pin.JointModelPY,
    "z": pin.JointModelPZ,
    "rx": pin.JointModelRX,
    "ry": pin.JointModelRY,
    "rz": pin.JointModelRZ,
    "shear_x": pin.JointModelPX,
    "shear_y": pin.JointModelPY,
}
_POSITION_CONSTANTS = {"lowerPositionLimit": -np.inf, "upperPositionLimit": np.inf, "positionLimitMargin": 0.0}
"""With the values for virtual joints."""

_VELOCITY_CONSTANTS = (
    *("lowerEffortLimit", "upperEffortLimit", "lowerVelocityLimit", "upperVelocityLimit"),
    *("lowerDryFrictionLimit", "upperDryFrictionLimit", "damping", "armature", "rotorInertia", "rotorGearRatio"),
)
_RAYLEIGH = 33.0 / 140.0  # of a uniform cantilever's mass, moves with its tip in its first mode


@dataclass(frozen=True, eq=False)
class VirtualJoints:
    """A mechanism with virtual joints, and the indices of the rigid one's joints in it."""

    mechanism: Robot  #: the mechanism with virtual joints; it has no springs in its description
    joints: Mapping[str, tuple[str, ...]]  #: names of the virtual joints of each spring, in the order of its stiffness
    q_indices: Indices  #: index in its q of each entry of the rigid mechanism's q, shape=(nq,)
    v_indices: Indices  #: index in its v of each entry of the rigid mechanism's v, shape=(nv,)


def insert_virtual_joints(mechanism: Robot, springs: Sequence[Spring]) -> VirtualJoints:
    """Insert the virtual joints of springs into a copy of a mechanism. Joint springs need none.

    Raises:
        FrameNotFoundError: a spring refers to a joint or frame that the mechanism does not have.
        DescriptionError: a spring is at the root of the world, or at a closure that does not exist, has another size or
            already has a spring, or has the name of a frame or joint.
    """
    bodies = (spring for spring in springs if not isinstance(spring, JointSpring))
    return _Builder(mechanism, [chain for spring in bodies for chain in _chains(mechanism, spring)]).result()


@dataclass(frozen=True, eq=False)
class _Chain:
    """The virtual joints of one spring: before the frame or joint `place`, or from that frame to a closure's anchor.

    They are at `axes` in the place. A beam divided into elements has a chain for each, named `<spring>.<number>`.
    """

    spring: str
    name: str
    place: str
    motions: tuple[str, ...]
    axes: pin.SE3
    closure: int | None = None
    mass: float = 0.0  #: of the body before it, moves with its last joint [kg]
    moment: float = 0.0  #: of inertia across the beam, that this body keeps beyond the mass moved [kg m^2]

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(f"{self.name}.{motion}" for motion in self.motions)

    @property
    def anchor(self) -> str:
        return f"{self.name}.anchor"


def _chains(mechanism: Robot, spring: AxialSpring | CantileverSpring | BeamSpring | ClosureSpring) -> list[_Chain]:
    name = spring.name
    if isinstance(spring, AxialSpring):
        return [_Chain(name, name, spring.at, ("z",), _axes_with_z_along(spring.axis))]
    if isinstance(spring, CantileverSpring):
        motions, shares = spring.components, lumps(spring)
        axes, count = _axes_with_z_along(spring.axis), spring.elements
        if count == 1 or isinstance(spring.length, JointLength):
            return [_Chain(name, name, spring.at, motions, axes, mass=shares[0][0] * spring.mass)]
        ends = -spring.length * (1.0 - np.arange(1, count + 1) / count)  # along the beam, from its tip
        part, length = spring.mass / count, spring.length / count
        places = [axes * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])) for end in ends]
        return [
            _Chain(name, f"{name}.{k}", spring.at, motions, place, None, mass * part, moment * part * length**2)
            for k, (place, (mass, moment)) in enumerate(zip(places, shares, strict=True), start=1)
        ]
    if isinstance(spring, BeamSpring):
        return [_Chain(name, name, spring.at, TOOL_COMPONENTS, pin.SE3.Identity())]
    if spring.closure >= len(mechanism.closures):
        count = len(mechanism.closures)
        raise DescriptionError(
            mechanism.source, f"spring '{spring.name}': closure", f"is {spring.closure}, expected less than {count}"
        )
    closure = mechanism.closures[spring.closure]
    size, motions = closure.kind.size, closure.kind.components
    if not motions:
        raise DescriptionError(
            mechanism.source,
            f"spring '{spring.name}'",
            f"a {closure.type} closure takes none: expected a body with an axial spring and 3d closures instead",
        )
    if len(spring.matrix) != size:
        raise DescriptionError(
            mechanism.source,
            f"spring '{spring.name}': matrix",
            f"expected {size} x {size} for a {closure.type} closure",
        )
    axes = pin.SE3(closure.bases[0], np.zeros(3)) if closure.bases else pin.SE3.Identity()
    return [_Chain(name, name, closure.frame_a, motions, axes, spring.closure)]


def lumps(spring: CantileverSpring) -> list[tuple[float, float]]:
    """Return what moves with the end of each element of a beam in the tree, and the moment of inertia that does not.

    In masses of an element, and in these times its length squared: two halves at the ends of a uniform element turn
    harder than the element, by a sixth, so that the body which they are taken from keeps as much.
    """
    if spring.elements == 1:
        return [(_RAYLEIGH, 0.0)]
    return [(1.0, 1.0 / 6.0)] * (spring.elements - 1) + [(0.5, 1.0 / 6.0)]


def _axes_with_z_along(axis: tuple[float, float, float]) -> pin.SE3:
    z = np.array([0.0, 0.0, 1.0])
    if (np.array(axis) == z).all():
        return pin.SE3.Identity()
    return pin.SE3(pin.Quaternion.FromTwoVectors(z, np.array(axis)).toRotationMatrix(), np.zeros(3))


@dataclass(eq=False)
class _Piece:
    """Part of a rigid body of the tree: all of it, or what moves when a spring inside it deflects.

    `body` is the body's joint in the old tree, `joint` the joint in the new one that carries the piece, and `placement`
    the placement of that joint in the old body. A piece cut out of a body is attached by `chains`.
    """

    body: int
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    joint: int = 0
    chains: list[_Chain] = field(default_factory=list)
    inertia: pin.Inertia = field(default_factory=pin.Inertia.Zero)
    joints: list[int] = field(default_factory=list)
    cuts: list[_Piece] = field(default_factory=list)
    anchors: list[_Chain] = field(default_factory=list)


class _Builder:
    """Cuts the bodies of a tree into pieces, and builds the new tree from them, depth first."""

    def __init__(self, mechanism: Robot, chains: Sequence[_Chain]) -> None:
        self._mechanism = mechanism
        self._old: pin.Model = mechanism.model
        self._new = pin.Model()
        self._chains = chains
        self._joint_chains: dict[int, list[_Chain]] = {}
        self._bodies = [_Piece(body) for body in range(self._old.njoints)]
        self._cuts: dict[int, _Piece] = {}
        self._anchor_frames: list[pin.Frame] = []
        parents, joint = list(self._old.parents), pin.FrameType.JOINT
        self._frames: list[pin.Frame] = list(self._old.frames)
        self._is_joint = [frame.type == joint for frame in self._frames]
        #: the body that carries each frame; for the frame of a movable joint, the body before the joint
        self._carriers: list[int] = [
            parents[frame.parentJoint] if moves else frame.parentJoint
            for frame, moves in zip(self._frames, self._is_joint, strict=True)
        ]
        #: the parent frame of each frame, if known and on the same body
        self._above: list[int | None] = [
            above
            if (above := frame.parentFrame) != index and self._frames[above].parentJoint == self._carriers[index]
            else None
            for index, frame in enumerate(self._frames)
        ]

    def result(self) -> VirtualJoints:
        self._check_names()
        for chain in self._chains:
            self._place(chain)
        self._share_out_inertias()
        self._share_out_what_hangs_on_pieces()
        self._grow(self._bodies[0])
        self._copy_frames()
        q_indices, v_indices = self._copy_constants()
        joints: dict[str, tuple[str, ...]] = {}
        for chain in self._chains:
            joints[chain.spring] = joints.get(chain.spring, ()) + chain.joints
        return VirtualJoints(self._mechanism_of_new_tree(), joints, q_indices, v_indices)

    def _check_names(self) -> None:
        closures = [chain.closure for chain in self._chains if chain.closure is not None]
        for chain in self._chains:
            for name in (*chain.joints, chain.anchor):
                if self._old.existFrame(name) or self._old.existJointName(name):
                    raise self._error(chain, f"'{name}' is already a frame or joint, expected another name")
            if chain.closure is not None and closures.count(chain.closure) > 1:
                raise self._error(chain, f"closure {chain.closure} has two springs, expected one")

    def _place(self, chain: _Chain) -> None:
        """Find the joint that a chain precedes, or cut a body at the frame it precedes."""
        frame = self._frame_of(chain)
        if chain.closure is not None:
            return
        if frame is None:
            self._joint_chains.setdefault(self._old.getJointId(chain.place), []).append(chain)
            return
        if frame == 0:
            raise self._error(chain, "is at the root of the world, expected a joint or frame attached to it")
        cut = self._cuts.setdefault(frame, _Piece(self._frames[frame].parentJoint, self._frames[frame].placement))
        cut.chains.append(chain)

    def _frame_of(self, chain: _Chain) -> int | None:
        """Return the frame that a chain precedes, or None if it precedes a movable joint."""
        try:
            index = self._mechanism.frame_id(chain.place)
        except FrameNotFoundError as error:
            if self._old.existJointName(chain.place):
                return None
            element = f"{self._mechanism.source}: spring '{chain.spring}'"
            raise FrameNotFoundError(chain.place, element, error.known) from error
        frame, above = self._frames[index], self._above[index]
        if frame.type == pin.FrameType.JOINT:
            return None
        if frame.type == pin.FrameType.BODY and above is not None and above > 0:
            # a link on a fixed joint: Pinocchio keeps its inertia in the frame of that joint
            fixed = self._frames[above]
            if fixed.type == pin.FrameType.FIXED_JOINT and fixed.placement == frame.placement:
                return above
        return index

    def _piece(self, index: int) -> _Piece:
        """Return the piece that carries a frame, or that starts at it."""
        above: int | None = index
        while above is not None:
            if above in self._cuts:
                return self._cuts[above]
            above = self._above[above]
            if above is not None and self._is_joint[above]:
                break
        return self._bodies[self._carriers[index]]

    def _piece_above(self, index: int) -> _Piece:
        """Return the piece in which a cut is made."""
        above = self._above[index]
        if above is None or self._is_joint[above]:
            return self._bodies[self._carriers[index]]
        return self._piece(above)

    def _share_out_inertias(self) -> None:
        """Give each piece the inertias of its frames, and the rest of a body to the piece of the link on its joint."""
        rest = list(self._old.inertias)
        links: dict[int, _Piece] = {}
        for index, frame in enumerate(self._frames):
            if self._is_joint[index]:
                continue
            piece, above = self._piece(index), self._above[index]
            if frame.inertia.mass > 0.0:
                inertia = frame.placement.act(frame.inertia)
                piece.inertia = piece.inertia + inertia
                rest[piece.body] = rest[piece.body] - inertia
            if frame.type == pin.FrameType.BODY and above is not None:
                links.setdefault(piece.body, piece)
        for body in range(1, self._old.njoints):
            if rest[body].mass > ROUNDING:
                piece = links.get(body, self._bodies[body])
                piece.inertia = piece.inertia + rest[body]

    def _share_out_what_hangs_on_pieces(self) -> None:
        for index, cut in self._cuts.items():
            piece = self._piece_above(index)
            piece.cuts.append(cut)
            self._take_masses(piece, cut.chains, cut.placement)
        frames = {frame.parentJoint: index for index, frame in enumerate(self._frames) if self._is_joint[index]}
        for joint in range(1, self._old.njoints):
            known = joint in frames
            piece = self._piece(frames[joint]) if known else self._bodies[self._old.parents[joint]]
            piece.joints.append(joint)
            self._take_masses(piece, self._joint_chains.get(joint, []), self._old.jointPlacements[joint])
        for chain in self._chains:
            if chain.closure is not None:
                self._piece(self._mechanism.frame_id(chain.place)).anchors.append(chain)

    def _take_masses(self, piece: _Piece, chains: Sequence[_Chain], placement: pin.SE3) -> None:
        """Take the masses that chains at a placement in the body carry out of the piece before them."""
        for chain in chains:
            if chain.mass and piece.body:  # what is fixed to the ground has no inertia
                if chain.mass > piece.inertia.mass:
                    raise self._error(chain, f"mass: the body before it has only {piece.inertia.mass:.4g} kg")
                place = placement * chain.axes
                across = np.eye(3) - np.outer(place.rotation[:, 2], place.rotation[:, 2])
                left = piece.inertia - pin.Inertia(chain.mass, place.translation, np.zeros((3, 3)))
                piece.inertia = left + pin.Inertia(0.0, left.lever, chain.moment * across)

    def _grow(self, piece: _Piece) -> None:
        """Add everything attached to a piece, depth first, as Pinocchio's algorithms require."""
        if piece.joint > 0:
            inertia = piece.placement.actInv(piece.inertia)
            self._new.appendBodyToJoint(piece.joint, inertia, pin.SE3.Identity())
        for joint in piece.joints:
            placement = piece.placement.actInv(self._old.jointPlacements[joint])
            parent, placement = self._add(self._joint_chains.get(joint, []), piece.joint, placement)
            body = self._bodies[joint]
            body.joint = self._new.addJoint(parent, self._old.joints[joint], placement, self._old.names[joint])
            self._grow(body)
        for cut in piece.cuts:
            cut.joint, end = self._add(cut.chains, piece.joint, piece.placement.actInv(cut.placement))
            cut.placement = cut.placement * end.inverse()
            self._grow(cut)
        for chain in piece.anchors:
            frame = self._frames[self._mechanism.frame_id(chain.place)]
            joint, end = self._add([chain], piece.joint, piece.placement.actInv(frame.placement))
            self._anchor_frames.append(pin.Frame(chain.anchor, joint, end, pin.FrameType.OP_FRAME))

    def _add(self, chains: Sequence[_Chain], parent: int, placement: pin.SE3) -> tuple[int, pin.SE3]:
        """Add virtual joints; return the last one, and the placement of their load in it."""
        for chain in chains:
            placement = placement * chain.axes
            for name, motion in zip(chain.joints, chain.motions, strict=True):
                parent = self._new.addJoint(parent, _JOINT_MODELS[motion](), placement, name)
                placement = pin.SE3.Identity()
            if chain.mass:
                self._new.appendBodyToJoint(
                    parent, pin.Inertia(chain.mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity()
                )
            placement = chain.axes.inverse()
        return parent, placement

    def _copy_frames(self) -> None:
        """Add all frames under their old indices, to which parent frames refer, and then the anchors."""
        for index, frame in list(enumerate(self._frames))[1:]:
            copy = pin.Frame(frame)
            if self._is_joint[index]:
                copy.parentJoint = self._bodies[frame.parentJoint].joint
            else:
                piece = self._piece(index)
                copy.parentJoint, copy.placement = piece.joint, piece.placement.actInv(frame.placement)
            self._new.addFrame(copy, False)
        for anchor in self._anchor_frames:
            self._new.addFrame(anchor, False)

    def _copy_constants(self) -> tuple[Indices, Indices]:
        """Copy per-joint data; return the indices of the old entries of q and v in the new ones."""
        q_indices, v_indices = np.empty(self._old.nq, dtype=np.intp), np.empty(self._old.nv, dtype=np.intp)
        for body in self._bodies[1:]:
            old, new = self._old.joints[body.body], self._new.joints[body.joint]
            q_indices[old.idx_q : old.idx_q + old.nq] = np.arange(new.idx_q, new.idx_q + new.nq)
            v_indices[old.idx_v : old.idx_v + old.nv] = np.arange(new.idx_v, new.idx_v + new.nv)
        for name in _VELOCITY_CONSTANTS:
            self._set(name, v_indices, getattr(self._old, name), getattr(self._new, name))
        for name, unlimited in _POSITION_CONSTANTS.items():
            self._set(name, q_indices, getattr(self._old, name), np.full(self._new.nq, unlimited))
        for entry in self._old.referenceConfigurations:
            positions = pin.neutral(self._new)
            positions[q_indices] = entry.data()
            self._new.referenceConfigurations[entry.key()] = positions
        self._new.gravity = self._old.gravity
        self._new.name = self._old.name
        return q_indices, v_indices

    def _set(self, name: str, indices: Indices, old: ArrayLike, values: ArrayLike) -> None:
        numbers = np.array(values)
        numbers[indices] = old
        setattr(self._new, name, numbers)

    def _mechanism_of_new_tree(self) -> Robot:
        rigid = self._mechanism
        anchors = {chain.closure: chain.anchor for chain in self._chains}
        closures = [
            replace(closure, frame_a=anchors.get(index, closure.frame_a))
            for index, closure in enumerate(rigid.closures)
        ]
        return rigid.replace(model=self._new, closures=closures, springs=())

    def _error(self, chain: _Chain, expected: str) -> DescriptionError:
        return DescriptionError(self._mechanism.source, f"spring '{chain.spring}'", expected)
