"""The description of a robot: what its files say, in one typed, checked and immutable form.

Every reader makes a :class:`Description`, the mechanism is built from it, and every export writes it. Lengths are in
metres, angles in radians, masses in kilograms; a number that a file does not give is None. Bodies and joints form a
tree; :attr:`Description.closures` and :attr:`Description.couplings` make it a closed chain.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup, ToolComponent
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.inertia_checks import inertia_matrix
from pm3dof_pin.description.origin import NOWHERE, Origin
from pm3dof_pin.exceptions import JointNotFoundError
from pm3dof_pin.typing import Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.description.robots import RobotFiles

JointType: TypeAlias = Literal[
    "fixed", "revolute", "continuous", "prismatic", "spherical", "planar", "floating", "helical"
]
ShapeKind: TypeAlias = Literal["box", "cylinder", "sphere", "capsule", "ellipsoid", "mesh"]

WORLD = "world"
"""In MuJoCo, SDFormat and Drake, the body of this name is the world itself."""

MAX_BODIES = 10_000
"""Largest number of bodies."""

MAX_IN_A_ROW = 200
"""Longest chain of bodies, and most movable joints: Pinocchio's data take 60 bytes times their number cubed."""

_FREE = 6  # degrees of freedom of a free body
_PERPENDICULAR = 1e-6  # greatest cosine between the axis of a planar base's turn and its slides
_NEUTRAL: Mapping[str, tuple[float, ...]] = {
    "floating": (0.0,) * 6 + (1.0,),
    "spherical": (0.0, 0.0, 0.0, 1.0),
    "planar": (0.0, 0.0, 1.0, 0.0),
}
_MAX_FLOATING = 40  # free bodies, which need memory as their number cubed


@dataclass(frozen=True)
class Placement:
    """A position [m] and a rotation, as a unit quaternion w, x, y, z."""

    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    #: roll, pitch, yaw of the file if it has them [rad], so that they can be written with the same digits
    angles: tuple[float, ...] | None = field(default=None, compare=False)

    @classmethod
    def from_angles(cls, position: tuple[float, ...], angles: tuple[float, ...]) -> Placement:
        """Return the placement with R = Rz(yaw) Ry(pitch) Rx(roll), of roll, pitch, yaw [rad]."""
        if not any(angles):
            return cls(position, angles=angles)
        (sr, sp, sy), (cr, cp, cy) = ([f(0.5 * angle) for angle in angles] for f in (math.sin, math.cos))
        return cls(
            position,
            _normalized(
                (
                    cr * cp * cy + sr * sp * sy,
                    sr * cp * cy - cr * sp * sy,
                    cr * sp * cy + sr * cp * sy,
                    cr * cp * sy - sr * sp * cy,
                )
            ),
            angles,
        )

    @classmethod
    def from_quaternion(cls, position: tuple[float, ...], quaternion: tuple[float, ...]) -> Placement:
        """Return the placement with a rotation w, x, y, z, which need not be of length 1."""
        return cls(position, _normalized(quaternion))

    @classmethod
    def from_se3(cls, placement: pin.SE3) -> Placement:
        """Return a placement of Pinocchio."""
        if np.array_equal(placement.rotation, np.eye(3)):
            return cls(_floats(placement.translation))
        turn = pin.Quaternion(placement.rotation).normalized()
        return cls(_floats(placement.translation), (float(turn.w), *_floats(turn.coeffs()[:3])))

    @cached_property
    def se3(self) -> pin.SE3:
        """The placement in Pinocchio, not to be modified."""
        return pin.SE3(self.rotation, np.array(self.position))

    @cached_property
    def rotation(self) -> Matrix:
        """The rotation matrix, shape=(3, 3)."""
        if not any(self.quaternion[1:]):
            return np.eye(3)
        w, x, y, z = self.quaternion
        return np.asarray(pin.Quaternion(w, x, y, z).toRotationMatrix())

    @property
    def roll_pitch_yaw(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw [rad]: those of the file, or of the rotation, accurate even at 90 degrees of pitch."""
        if self.angles is not None:
            roll, pitch, yaw = self.angles
            return roll, pitch, yaw
        r = self.rotation
        yaw, pitch = math.atan2(r[1, 0], r[0, 0]), math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
        s, c = math.sin(yaw), math.cos(yaw)
        return math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1]), pitch, yaw

    @property
    def is_identity(self) -> bool:
        """Whether it neither moves nor rotates."""
        return not any(self.position) and not any(self.quaternion[1:])

    def __mul__(self, other: Placement) -> Placement:
        if self.is_identity:
            return other
        return self if other.is_identity else Placement.from_se3(self.se3 * other.se3)

    def inverse(self) -> Placement:
        """Return the inverse placement."""
        return self if self.is_identity else Placement.from_se3(self.se3.inverse())


IDENTITY = Placement()


@dataclass(frozen=True)
class Inertial:
    """The inertia of a body."""

    mass: float  #: [kg]
    placement: Placement  #: centre of mass and axes of the moments, in the body
    moments: tuple[float, ...]  #: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass [kg m^2]

    @classmethod
    def from_inertia(cls, inertia: pin.Inertia) -> Inertial:
        """Return an inertia of Pinocchio."""
        i = inertia.inertia
        moments = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
        return cls(float(inertia.mass), Placement(_floats(inertia.lever)), _floats(moments))

    @cached_property
    def inertia(self) -> pin.Inertia:
        """The inertia in Pinocchio, in the axes of the body."""
        rotation = self.placement.rotation
        turned = rotation @ inertia_matrix(self.moments) @ rotation.T
        result = pin.Inertia.Zero()  # whose constructor refuses moments that rounding makes negative
        result.mass, result.lever, result.inertia = self.mass, np.array(self.placement.position), turned
        return result


@dataclass(frozen=True)
class Shape:
    """A shape of a body."""

    kind: ShapeKind
    #: edges of a box; radius and length of a cylinder or, without its ends, of a capsule; radius of a sphere; radii of
    #: an ellipsoid; scales of a mesh [m, 1]
    sizes: tuple[float, ...]
    placement: Placement = IDENTITY  #: in the body
    name: str = ""
    mesh: str = ""  #: file of a mesh, as the description names it
    colour: tuple[float, ...] | None = None  #: red, green, blue, alpha from 0 to 1


@dataclass(frozen=True)
class Body:
    """A rigid body."""

    name: str
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()
    origin: Origin = NOWHERE

    @property
    def mass(self) -> float:
        """Mass [kg], 0 if none is given."""
        return 0.0 if self.inertial is None else self.inertial.mass


@dataclass(frozen=True)
class Frame:
    """A named frame fixed to a body, such as a site of MJCF."""

    name: str
    body: str
    placement: Placement = IDENTITY  #: in the body
    origin: Origin = NOWHERE


@dataclass(frozen=True)
class Joint:
    """A joint of the tree. Limits, effort and velocity are None if there are none."""

    name: str
    type: JointType
    parent: str  #: body
    child: str  #: body
    placement: Placement = IDENTITY  #: of the joint frame in the parent, at coordinate `zero`
    child_placement: Placement = IDENTITY  #: of the child in the joint frame that moves
    axis: tuple[float, ...] = (1.0, 0.0, 0.0)  #: in the joint frame
    lower: float | None = None  #: least coordinate [m, rad]
    upper: float | None = None  #: greatest coordinate [m, rad]
    effort: float | None = None  #: greatest force or torque, either way [N, N m]
    velocity: float | None = None  #: greatest speed, either way [m/s, rad/s]
    damping: float = 0.0  #: [N s/m, N m s/rad]
    friction: float = 0.0  #: dry friction [N, N m]
    armature: float = 0.0  #: inertia of the drive, reflected to the joint [kg, kg m^2]
    stiffness: float = 0.0  #: of the joint's spring [N/m, N m/rad]
    rest: float = 0.0  #: coordinate at which that spring is relaxed [m, rad]
    zero: float = 0.0  #: coordinate of the placement [m, rad]
    pitch: float = 0.0  #: of a helical joint [m/rad]
    origin: Origin = NOWHERE

    @property
    def is_fixed(self) -> bool:
        """Whether it does not move."""
        return self.type == "fixed"

    @property
    def dof(self) -> int:
        """Number of degrees of freedom."""
        return {"fixed": 0, "spherical": 3, "planar": 3, "floating": 6}.get(self.type, 1)

    def motion(self, coordinate: float) -> pin.SE3:
        """Return the motion of a single-DoF joint by a coordinate [m, rad], in the joint frame."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        if self.type == "prismatic":
            return pin.SE3(np.eye(3), coordinate * axis)
        return pin.SE3(pin.AngleAxis(coordinate, axis).toRotationMatrix(), self.pitch * coordinate * axis)

    @property
    def nq(self) -> int:
        """Number of coordinates: a continuous joint has cosine and sine, others may have a quaternion."""
        return {"continuous": 2, "spherical": 4, "planar": 4, "floating": 7}.get(self.type, self.dof)

    @property
    def is_single(self) -> bool:
        """Whether it has one degree of freedom."""
        return self.dof == 1


@dataclass(frozen=True)
class Drive:
    """An actuator of a joint."""

    name: str
    joint: str
    gear: float = 1.0  #: actuator speed per joint speed
    rotor_inertia: float = 0.0  #: before the gear [kg, kg m^2]
    kind: str = "motor"  #: motor, position, velocity, or another kind of MJCF
    proportional_gain: float | None = None  #: force per position error [N/m, N m/rad]
    derivative_gain: float | None = None  #: force per speed [N s/m, N m s/rad]
    control_range: tuple[float, float] | None = None  #: of the control signal
    #: force per unit of the control signal [N, N m], if not 1 of a motor, or the gain of a servo
    control_gain: float | None = None
    force_range: tuple[float, float] | None = None  #: of the actuator [N, N m]
    origin: Origin = NOWHERE


@dataclass(frozen=True)
class Unread:
    """An element or attribute that was read over: it has no meaning here, or `lenient` passed it."""

    element: str  #: such as "<gazebo>"
    origin: Origin
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.origin}: {self.element}" + (f": {self.reason}" if self.reason else "")


@dataclass(frozen=True)
class Description:
    """A robot as its files describe it.

    Raises:
        DescriptionError: names are missing or duplicate, or bodies and joints are not one tree of moderate size.
    """

    name: str
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...] = ()
    frames: tuple[Frame, ...] = ()
    closures: tuple[LoopClosure, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    drives: tuple[Drive, ...] = ()
    actuated_joints: tuple[str, ...] = ()  #: those that a file declares as such, in its order
    commands: tuple[Command, ...] = ()
    motion_coordinates: tuple[str, ...] = ()
    coordinates: tuple[Coordinate, ...] = ()
    limit_groups: tuple[LimitGroup, ...] = ()
    tool_frame: str | None = None
    tool_motions: tuple[ToolComponent, ...] = ()
    closure_tolerance: float | None = None  #: largest closure error of closed loops [m, rad]; None for the usual one
    springs: tuple[Mapping[str, Any], ...] = ()  #: raw entries, not yet parsed
    #: joint coordinates by name of the configuration and joint; joints that are not named are at zero
    configurations: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)
    untouchable: tuple[tuple[str, str], ...] = ()  #: pairs of bodies that cannot collide
    gravity: tuple[float, ...] = (0.0, 0.0, -9.81)  #: [m/s^2]
    unread: tuple[Unread, ...] = ()  #: what was read over
    dialect: str = "urdf"
    origin: Origin = NOWHERE
    files: RobotFiles | None = None  #: the files it was read from, if any

    def __post_init__(self) -> None:
        """Check names and the tree."""
        if not self.bodies:
            raise self.origin.error("robot", "has no bodies, expected some")
        if len(self.bodies) > MAX_BODIES:
            raise self.origin.error("robot", f"has {len(self.bodies)} bodies, expected at most {MAX_BODIES}")
        for kind, parts in (("link", self.bodies), ("joint", self.joints), ("frame", self.frames)):
            names = Counter(part.name for part in parts)
            for part in parts:
                if not part.name:
                    raise part.origin.error(f"<{kind}>", "has no name, expected one")
                if names[part.name] > 1:
                    raise part.origin.error(f"{kind} '{part.name}'", "is defined twice, expected unique names")
        self._check_tree()

    def _check_tree(self) -> None:
        for joint in self.joints:
            for end, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in self.body_by_name:
                    expected = f"expected an existing link, not '{name}'" if name else "expected a link"
                    raise joint.origin.error(f"joint '{joint.name}': {end}", expected)
            if self.joint_above[joint.child] is not joint:
                raise joint.origin.error(
                    f"link '{joint.child}'", "is the child of two joints: close loops in a closures file"
                )
        roots = [body for body in self.bodies if body.name not in self.joint_above]
        if not roots:
            raise self.origin.error("robot", "every link is a child: expected one root link")
        if len(roots) > 1:
            listed = ", ".join(body.name for body in roots[:4]) + (" ..." if len(roots) > 4 else "")
            raise roots[1].origin.error("robot", f"has several root links, expected one: {listed}")
        moving = sum(not joint.is_fixed for joint in self.joints)
        if moving > MAX_IN_A_ROW:
            raise self.origin.error("robot", f"has {moving} movable joints, expected at most {MAX_IN_A_ROW}")
        floating = sum(joint.type == "floating" for joint in self.joints)
        if floating > _MAX_FLOATING:
            raise self.origin.error(
                "robot", f"has {floating} free bodies, expected at most {_MAX_FLOATING}: remove other objects"
            )
        depths = {roots[0].name: 1}
        for body in self.bodies:
            chain = [body.name]
            while chain[-1] not in depths:
                chain.append(self.joint_above[chain[-1]].parent)
                if len(chain) > len(self.bodies):
                    raise body.origin.error(f"link '{body.name}'", "is its own ancestor: expected a tree")
            for above, name in zip(chain[::-1], chain[-2::-1], strict=False):
                depths[name] = depths[above] + 1
            if depths[body.name] > MAX_IN_A_ROW:
                raise body.origin.error(
                    f"link '{body.name}'", f"is the end of a chain of more than {MAX_IN_A_ROW} links, the maximum"
                )

    @cached_property
    def body_by_name(self) -> Mapping[str, Body]:
        """The bodies by name."""
        return {body.name: body for body in self.bodies}

    @cached_property
    def joint_by_name(self) -> Mapping[str, Joint]:
        """The joints by name."""
        return {joint.name: joint for joint in self.joints}

    @cached_property
    def joint_above(self) -> Mapping[str, Joint]:
        """By body, the joint that carries it; the root has none."""
        above: dict[str, Joint] = {}
        for joint in self.joints:
            above.setdefault(joint.child, joint)
        return above

    @cached_property
    def joints_below(self) -> Mapping[str, tuple[Joint, ...]]:
        """By body, the joints that it carries, in the order of the file."""
        below: dict[str, list[Joint]] = {body.name: [] for body in self.bodies}
        for joint in self.joints:
            below[joint.parent].append(joint)
        return {name: tuple(joints) for name, joints in below.items()}

    @cached_property
    def root(self) -> Body:
        """The body that carries all others."""
        return next(body for body in self.bodies if body.name not in self.joint_above)

    @property
    def floating_base(self) -> tuple[Joint, ...]:
        """The joints, of six degrees of freedom or three in a plane, by which parts of the robot float in its root.

        For each part this is a floating or a planar joint, or slides and turns in a row with massless bodies between
        them. Not one that is driven, nor that of a part which closures join to another or by its limbs to the root.
        """
        return tuple(joint for chain in self._floating_chains for joint in chain)

    @property
    def floating_bodies(self) -> tuple[str, ...]:
        """The bodies that :attr:`floating_base` carries."""
        return tuple(chain[-1].child for chain in self._floating_chains)

    @property
    def _floating_chains(self) -> tuple[tuple[Joint, ...], ...]:
        driven = {*self.actuated_joints, *(drive.joint for drive in self.drives)}
        on_root = {body.name for body in self.fixed_to(self.root.name)}
        chains = (
            self._free_chain(joint, driven)
            for body in on_root
            for joint in self.joints_below[body]
            if not joint.is_fixed
        )
        ends = {frame.name: frame.body for frame in self.frames} | {joint.name: joint.child for joint in self.joints}
        loops = [{ends.get(name, name) for name in (loop.frame_a, loop.frame_b)} for loop in self.closures]
        floating = []
        for chain in chains:
            if chain:
                base = {body.name for body in self.fixed_to(chain[-1].child)}
                inside = {body.name for body in self.bodies if chain[-1] in self.joints_to(body.name)}
                if all(loop <= inside or not loop & inside or loop <= base | on_root for loop in loops):
                    floating.append(chain)
        return tuple(sorted(floating, key=lambda chain: self.joints.index(chain[0])))

    def _free_chain(self, joint: Joint, driven: set[str]) -> tuple[Joint, ...]:
        """Return the joints that let a body float, from one on the root on; none if it does not float."""
        chain: list[Joint] = []
        while joint.name not in driven:
            chain.append(joint)
            below = [other for other in self.joints_below[joint.child] if not other.is_fixed]
            if sum(member.dof for member in chain) >= _FREE or len(below) != 1 or self.body_by_name[joint.child].mass:
                break
            joint = below[0]
        if len(chain) <= 1:
            return tuple(chain) if chain and (chain[0].dof == _FREE or chain[0].type == "planar") else ()
        turns = [member for member in chain if member.type in ("revolute", "continuous", "spherical")]
        slides = [member for member in chain if member.type == "prismatic"]
        degrees = len(slides), sum(member.dof for member in turns)
        is_planar = degrees == (2, 1) and not any(
            abs(self.axis_in_root(slide) @ self.axis_in_root(turns[0])) > _PERPENDICULAR for slide in slides
        )
        is_whole = len(slides) + len(turns) == len(chain)
        return tuple(chain) if is_whole and (is_planar or degrees == (3, 3)) else ()

    def axis_in_root(self, joint: Joint) -> Vector:
        """Return the direction of a joint's axis in the root, where all joints are at their coordinate `zero`."""
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        return np.asarray(self.zero_placements[joint.parent].rotation @ joint.placement.se3.rotation @ axis)

    def with_base_held(self) -> Description:
        """Return the robot with its floating base, if it has one, held where home has it.

        Closures that then join bodies of which neither moves are left out, unless springs or limits name closures.
        """
        values = self.configurations.get("home", {})
        fixed = {}
        for base in self.floating_base:
            motion = _motion(base, values.get(base.name, _NEUTRAL.get(base.type, (0.0,))))
            placed = base.placement if motion.isIdentity(0.0) else Placement.from_se3(base.placement.se3 * motion)
            fixed[base.name] = replace(base, type="fixed", placement=placed, zero=0.0)
        if not fixed:
            return self
        configurations = {
            name: {joint: value for joint, value in values.items() if joint not in fixed}
            for name, values in self.configurations.items()
        }
        described = replace(self.with_joints(fixed), configurations=configurations)
        bodies = {frame.name: frame.body for frame in self.frames} | {joint.name: joint.child for joint in self.joints}
        if self.springs or any(group.closures for group in self.limit_groups):
            return described
        moving = tuple(
            loop
            for loop in self.closures
            if any(
                not all(joint.is_fixed for joint in described.joints_to(bodies.get(name, name)))
                for name in (loop.frame_a, loop.frame_b)
            )
        )
        return replace(described, closures=moving)

    def joint(self, name: str, where: str = "") -> Joint:
        """Return a joint by name; JointNotFoundError if there is none."""
        if name not in self.joint_by_name:
            raise JointNotFoundError(name, where or str(self.origin), [j.name for j in self.joints if not j.is_fixed])
        return self.joint_by_name[name]

    def joints_to(self, body: str) -> list[Joint]:
        """Return the joints from the root to a body, in this order."""
        joints = []
        while (joint := self.joint_above.get(body)) is not None:
            joints.append(joint)
            body = joint.parent
        return joints[::-1]

    @cached_property
    def zero_placements(self) -> Mapping[str, pin.SE3]:
        """The placements of the bodies in the root where all joints are at their coordinate `zero`."""
        placements = {self.root.name: pin.SE3.Identity()}
        pending = [self.root.name]
        while pending:
            parent = pending.pop()
            for joint in self.joints_below[parent]:
                placements[joint.child] = placements[parent] * joint.placement.se3 * joint.child_placement.se3
                pending.append(joint.child)
        return placements

    def fixed_to(self, body: str) -> Iterator[Body]:
        """Yield a body and all bodies that fixed joints attach to it, downwards."""
        yield self.body_by_name[body]
        for joint in self.joints_below[body]:
            if joint.is_fixed:
                yield from self.fixed_to(joint.child)

    def with_joints(self, joints: Mapping[str, Joint]) -> Description:
        """Return the description with joints replaced, by name."""
        return replace(self, joints=tuple(joints.get(joint.name, joint) for joint in self.joints))


def universal_hinges(joint: Joint, cross: str, axes: str) -> tuple[Joint, Joint]:
    """Return the two hinges that a universal joint consists of, about two of X, Y, Z, with a body between them."""
    common = replace(joint, type="revolute", lower=None, upper=None, effort=None, velocity=None)
    first, second = (tuple(float(letter == axis.upper()) for letter in "XYZ") for axis in axes)
    return (
        replace(common, name=f"{joint.name}_{axes[0]}", child=cross, axis=first, child_placement=IDENTITY),
        replace(common, name=f"{joint.name}_{axes[1]}", parent=cross, axis=second, placement=IDENTITY),
    )


def _motion(joint: Joint, numbers: tuple[float, ...]) -> pin.SE3:
    """Return the motion of a joint, in its frame, from where it is placed."""
    match joint.type:
        case "floating":
            return pin.XYZQUATToSE3(numbers)
        case "spherical":
            return pin.XYZQUATToSE3((0.0, 0.0, 0.0, *numbers))
        case "planar":
            x, y, cosine, sine = numbers
            turn = pin.AngleAxis(math.atan2(sine, cosine), np.array([0.0, 0.0, 1.0]))
            return pin.SE3(turn.toRotationMatrix(), np.array([x, y, 0.0]))
        case _:
            return joint.motion(numbers[0] - joint.zero)


def _floats(numbers: Any) -> tuple[float, ...]:
    return tuple(float(number) for number in numbers)


def _normalized(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    w, x, y, z = quaternion
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return w / length, x / length, y / length, z / length
