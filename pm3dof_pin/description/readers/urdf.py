"""URDF: links, joints, `mimic` and transmissions, and with :mod:`urdf_loops` what others add to close loops.

yourdfpy, which reads the same documents, keeps neither lines nor unknown elements, and no transmissions' reductions;
urdfdom drops a link's whole inertial, or all its shapes, if one of their numbers is malformed.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import (
    IDENTITY,
    WORLD,
    Body,
    Description,
    Drive,
    Inertial,
    Joint,
    JointType,
    Placement,
    Shape,
    ShapeKind,
    universal_hinges,
)
from pm3dof_pin.description.inertia_checks import MOMENTS, inertia_matrix, inertia_problem, is_reversed
from pm3dof_pin.description.physical_bounds import (
    ANGLE,
    ANY,
    LENGTH,
    MASS,
    MOMENT,
    NOT_NEGATIVE,
    PRODUCT,
    SIZE,
    Bounds,
)
from pm3dof_pin.description.readers.elements import ElementReader
from pm3dof_pin.description.readers.urdf_loops import LOOP_TAGS, UrdfLoops
from pm3dof_pin.description.xml_file import Element, child, children

_logger = logging.getLogger(__name__)

_JOINT_TYPES: tuple[JointType, ...] = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
_DRAKE_TYPES: dict[str, JointType] = {"ball": "spherical", "planar": "planar", "screw": "helical"}
_SIZES: dict[str, tuple[ShapeKind, tuple[tuple[str, int], ...]]] = {
    "box": ("box", (("size", 3),)),
    "cylinder": ("cylinder", (("radius", 1), ("length", 1))),
    "sphere": ("sphere", (("radius", 1),)),
    "mesh": ("mesh", ()),
}
_UNLIMITED_TYPES = ("floating", "planar")
_MIN_AXIS = 1e-6  # length of an axis that has a direction
_JOINT_NUMBERS: dict[str, dict[str, Bounds]] = {
    "limit": {"effort": NOT_NEGATIVE, "velocity": NOT_NEGATIVE},
    "dynamics": {"damping": NOT_NEGATIVE, "friction": NOT_NEGATIVE},
    "mimic": {"multiplier": ANY, "offset": ANY},
    "safety_controller": {"soft_lower_limit": ANY, "soft_upper_limit": ANY, "k_position": ANY, "k_velocity": ANY},
    "calibration": {"rising": ANY, "falling": ANY},
}
_CHILDREN = {
    "robot": ("link", "joint", "material", "transmission", "gazebo", "drake:joint", *LOOP_TAGS),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
}
_PASSED = {
    "robot": ("sensor", "mujoco", "ros2_control", "drake:collision_filter_group", "fixed_frame"),
    "link": ("sensor", "contact", "self_collision_checking", "drake:proximity_properties"),
    "joint": (),
    "inertial": (),
    "visual": ("verbose", "drake:proximity_properties"),
    "collision": ("verbose", "surface", "contact_coefficients", "material", "drake:proximity_properties"),
}
_ATTRIBUTES = {
    "robot": frozenset({"name", "version", "author"}),
    "link": frozenset({"name", "type", "drake_ignore"}),
    "joint": frozenset({"name", "type", "independent"}),
    "origin": frozenset({"xyz", "rpy", "quat_xyzw"}),
    "axis": frozenset({"xyz"}),
    "limit": frozenset({"lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"}),
    "dynamics": frozenset({"damping", "friction"}),
    "mimic": frozenset({"joint", "multiplier", "offset"}),
    "mass": frozenset({"value"}),
}


def read_urdf(root: Element, *, lenient: bool = False) -> Description:
    """Read a URDF from its root element.

    Raises:
        DescriptionError: a number is malformed, not finite, negative where it must not be, or physically impossible; a
            mass is missing; moments of inertia have a wrong sign; limits are not in order; an axis is zero; a name is
            missing, duplicate or unknown; the links are not one tree of moderate size; or an element that could carry
            a loop, a coupling or a drive is not understood.
    """
    return UrdfReader(root, lenient=lenient).read()


class UrdfReader(ElementReader):
    """Reads one URDF."""

    def __init__(self, root: Element, *, lenient: bool) -> None:
        super().__init__(root.path, lenient=lenient)
        self.root = root
        self.colours: dict[str, tuple[float, ...]] = {}
        self.couplings: list[Coupling] = []
        self.mimics: list[tuple[Element, Coupling]] = []
        self.extra_bodies: list[Body] = []
        self.impossible: dict[str, str] = {}

    def read(self) -> Description:
        """Read the whole document."""
        root = self.root
        if not (name := (root.get("name") or "").strip()):
            raise root.origin.error("<robot>", "has no name, expected one")
        self.check_children(root, _CHILDREN["robot"], _PASSED["robot"], _ATTRIBUTES["robot"])
        self._check_unique("material")
        for material in children(root, "material"):
            if colour := self._colour_of(material):
                self.colours[material.get("name", "")] = colour
        bodies = [self._body(element) for element in children(root, "link")]
        joints = [joint for element in children(root, "joint", "drake:joint") for joint in self._joint(element)]
        if all(body.name != WORLD for body in bodies) and any(joint.parent == WORLD for joint in joints):
            bodies.insert(0, Body(WORLD, origin=root.origin))  # Drake's, which needs no link
        by_name = {joint.name: joint for joint in joints}
        self._check_mimicked(by_name)
        drives = [drive for element in children(root, "transmission") for drive in self._drives(element, by_name)]
        description = Description(
            name,
            (*bodies, *self.extra_bodies),
            tuple(joints),
            couplings=tuple(self.couplings),
            drives=tuple(drives),
            origin=root.origin,
        )
        self._warn_of_impossible()
        description = UrdfLoops(self, description).read(root)
        return replace(description, unread=tuple(self.unread))

    def _check_unique(self, tag: str) -> None:
        names: set[str] = set()
        for element in children(self.root, tag):
            if not (name := element.get("name") or ""):
                raise element.origin.error(f"<{tag}>", "has no name, expected one")
            if name in names:
                raise element.origin.error(f"{tag} '{name}'", "is defined twice, expected unique names")
            names.add(name)

    def _warn_of_impossible(self) -> None:
        if self.impossible:
            link, problem = next(iter(self.impossible.items()))
            others = f"; likewise {len(self.impossible) - 1} more links" if len(self.impossible) > 1 else ""
            message = "%s: link '%s': inertial: %s%s; dynamics is not available if it moves"
            _logger.warning(message, self.path, link, problem, others)

    def _known(self, element: Element) -> None:
        tag = element.tag.removeprefix("drake:")
        if tag in _CHILDREN:
            self.check_children(element, _CHILDREN[tag], _PASSED[tag], _ATTRIBUTES.get(tag, frozenset()))
        elif tag in _ATTRIBUTES:
            self.check_children(element, (), (), _ATTRIBUTES[tag])

    # Links

    def _body(self, element: Element) -> Body:
        name = element.get("name") or ""
        if not name:
            raise element.origin.error("<link>", "has no name, expected one")
        place = f"link '{name}'"
        self._known(element)
        inertial = child(element, "inertial")
        return Body(
            name,
            None if inertial is None else self._inertial(inertial, name, f"{place}: inertial"),
            tuple(s for shape in children(element, "visual") if (s := self._shape(shape, f"{place}: visual"))),
            tuple(s for shape in children(element, "collision") if (s := self._shape(shape, f"{place}: collision"))),
            element.origin,
        )

    def _inertial(self, element: Element, link: str, place: str) -> Inertial:
        self._known(element)
        placement = self.placement(element, place)
        mass_element, inertia = child(element, "mass"), child(element, "inertia")
        if mass_element is None or inertia is None:
            missing = "mass" if mass_element is None else "inertia"
            raise element.origin.error(place, f"expected <{missing}> in it")
        mass = self.numbers(mass_element, "value", 1, MASS, f"{place}: mass")[0]
        place = f"{place}: inertia"
        moments = tuple(self.numbers(inertia, key, 1, PRODUCT, place)[0] for key in MOMENTS)
        matrix = inertia_matrix(moments)
        if is_reversed(mass, matrix):
            for key, moment in zip(MOMENTS[:3], moments, strict=False):
                if problem := MOMENT.problem(moment):
                    raise inertia.origin.error(f"{place}: {key}", problem)
            raise inertia.origin.error(place, inertia_problem(mass, matrix))
        if problem := inertia_problem(mass, matrix):
            self.impossible[link] = problem
        return Inertial(mass, placement, moments)

    def _shape(self, element: Element, place: str) -> Shape | None:
        self._known(element)
        geometry = child(element, "geometry")
        shapes = [] if geometry is None else children(geometry)
        kind = next((shape.tag for shape in shapes), "shape without geometry")
        if kind not in _SIZES:
            _logger.warning("%s: %s: unsupported %s is ignored", element.origin, place, kind)
            self.read_over(element, f"unsupported {kind}")
            return None
        placement, shape, place = self.placement(element, place), shapes[0], f"{place}: {kind}"
        tag, entries = _SIZES[kind]
        sizes = tuple(size for key, count in entries for size in self.numbers(shape, key, count, SIZE, place))
        if tag == "mesh":
            if not shape.get("filename"):
                raise shape.origin.error(place, "has no filename, expected one")
            sizes = self.numbers(shape, "scale", 3, ANY, place, (1.0, 1.0, 1.0))
        material = next(iter(children(element, "material")), None)  # several are only a matter of looks
        colour = self._colour_of(material) if material is not None else None
        if material is not None and colour is None:
            colour = self.colours.get(material.get("name", ""))
        return Shape(tag, sizes, placement, element.get("name", ""), shape.get("filename", ""), colour)

    def _colour_of(self, material: Element) -> tuple[float, ...] | None:
        colour = child(material, "color")
        if colour is None or "rgba" not in colour.attrib:
            return None
        return self.numbers(colour, "rgba", 4, ANY, f"material '{material.get('name', '')}': color")

    # Joints

    def _joint(self, element: Element) -> list[Joint]:
        name, kind = element.get("name") or "", element.get("type") or ""
        if not name:
            raise element.origin.error("<joint>", "has no name, expected one")
        place = f"joint '{name}'"
        self._known(element)
        is_drakes = element.tag == "drake:joint"
        known = (*_DRAKE_TYPES, "universal") if is_drakes else _JOINT_TYPES
        if kind not in known:
            given = repr(kind) if kind else "no type"
            raise element.origin.error(place, f"expected one of {', '.join(known)}, not {given}")
        for tag, entries in _JOINT_NUMBERS.items():
            if (part := child(element, tag)) is not None:
                self._known(part)
                if kind in _UNLIMITED_TYPES:  # limits and dynamics of no known meaning are ignored by all
                    continue
                for key, bounds in entries.items():
                    self.number(part, key, bounds, f"{place}: {tag}", 0.0)
        limit, dynamics = child(element, "limit"), child(element, "dynamics")
        if kind in _UNLIMITED_TYPES:
            limit = dynamics = None
        lower, upper = self._limits(limit, kind, place)
        joint = Joint(
            name,
            _DRAKE_TYPES.get(kind, "fixed") if is_drakes else self._type(kind),
            self._end(element, "parent"),
            self._end(element, "child"),
            self.placement(element, place),
            axis=(1.0, 0.0, 0.0) if kind in ("fixed", "floating", "ball") else self.axis(element, place),
            lower=lower,
            upper=upper,
            effort=self.number(limit, "effort", NOT_NEGATIVE, place, None),
            velocity=self.number(limit, "velocity", NOT_NEGATIVE, place, None),
            damping=self.number(dynamics, "damping", NOT_NEGATIVE, place, 0.0),
            friction=self.number(dynamics, "friction", NOT_NEGATIVE, place, 0.0),
            pitch=self.number(child(element, "drake:screw_thread_pitch"), "value", ANY, place, 0.0),
            origin=element.origin,
        )
        if kind == "planar" and (turn := _turn_from_z(joint.axis)) is not None:  # which is in its xy plane here
            placement = Placement.from_se3(joint.placement.se3 * turn)
            joint = replace(joint, placement=placement, child_placement=Placement.from_se3(turn.inverse()))
        self._mimic(element, joint)
        if is_drakes and kind == "universal":  # about x of the parent, then y of the child
            cross = Body(f"{joint.name}_cross", origin=joint.origin)
            self.extra_bodies.append(cross)
            return list(universal_hinges(joint, cross.name, "xy"))
        return [joint]

    @staticmethod
    def _type(kind: str) -> JointType:
        return next(known for known in _JOINT_TYPES if known == kind)

    def _limits(self, limit: Element | None, kind: str, place: str) -> tuple[float | None, float | None]:
        if limit is None or not {"lower", "upper"} & limit.attrib.keys():
            return None, None
        lower, upper = (self.number(limit, key, ANY, f"{place}: limit", 0.0) for key in ("lower", "upper"))
        if kind not in ("fixed", "floating") and lower > upper:
            raise limit.origin.error(f"{place}: limit", f"expected lower <= upper, not {lower:g} and {upper:g}")
        return (lower, upper) if kind in ("revolute", "prismatic") else (None, None)

    def _mimic(self, element: Element, joint: Joint) -> None:
        if (mimic := child(element, "mimic")) is None:
            return
        if not joint.is_single:
            self.read_over(mimic, f"joint '{joint.name}' is {joint.type}")
            return
        powers = (
            self.number(mimic, "offset", ANY, joint.name, 0.0),
            self.number(mimic, "multiplier", ANY, joint.name, 1.0),
        )
        other = mimic.get("joint", "")
        if not other or other == joint.name:
            raise mimic.origin.error(f"joint '{joint.name}': mimic", f"expected another joint, not '{other}'")
        self.mimics.append((mimic, Coupling.from_powers(joint.name, other, powers, mimic.origin)))

    def _check_mimicked(self, joints: Mapping[str, Joint]) -> None:
        """Take the couplings to existing joints of one degree of freedom; refuse the others."""
        for mimic, coupling in self.mimics:
            (name,) = coupling.joints
            if name in joints and joints[name].is_single:
                self.couplings.append(coupling)
            else:
                problem = f"it is {joints[name].type}" if name in joints else "there is none"
                self.refuse(mimic, f"joint '{coupling.joint}' follows '{name}', expected a single-DoF joint: {problem}")

    @staticmethod
    def _end(element: Element, tag: str) -> str:
        end = child(element, tag)
        return "" if end is None else end.get("link", "")

    def placement(self, element: Element, place: str, tag: str = "origin") -> Placement:
        """Return the `<origin>` of an element; identity if it has none."""
        if (origin := child(element, tag)) is None:
            return IDENTITY
        self._known(origin)
        place, zero = f"{place}: origin", (0.0, 0.0, 0.0)
        position = self.numbers(origin, "xyz", 3, LENGTH, place, zero)
        if "quat_xyzw" in origin.attrib:
            x, y, z, w = self.numbers(origin, "quat_xyzw", 4, ANY, place)
            if not (x or y or z or w):
                raise origin.origin.error(f"{place}: quat_xyzw", "expected a quaternion, not zero")
            return Placement.from_quaternion(position, (w, x, y, z))
        return Placement.from_angles(position, self.numbers(origin, "rpy", 3, ANGLE, place, zero))

    def axis(self, element: Element, place: str, tag: str = "axis") -> tuple[float, ...]:
        """Return the `<axis>` of an element; x if it has none."""
        if (axis := child(element, tag)) is None:
            return (1.0, 0.0, 0.0)
        self._known(axis)
        xyz = self.numbers(axis, "xyz", 3, ANY, f"{place}: {tag}")
        if max(map(abs, xyz)) < _MIN_AXIS:
            raise axis.origin.error(f"{place}: {tag}", f"expected a direction, not '{axis.get('xyz')}'")
        return xyz

    def _drives(self, element: Element, joints_of_tree: Mapping[str, Joint]) -> list[Drive]:
        joints, actuators = children(element, "joint"), children(element, "actuator")
        if (kind := child(element, "type")) is not None and "Simple" not in (kind.text or "Simple"):
            self.read_over(element, "its joints are taken as driven directly")
        drives = []
        for index, joint in enumerate(joints):
            actuator = actuators[index] if index < len(actuators) else None
            name = joint.get("name", "")
            if name not in joints_of_tree:
                self.read_over(element, f"no joint '{name}'")
                continue
            if not joints_of_tree[name].is_single:
                self.read_over(element, f"joint '{name}' is {joints_of_tree[name].type}")
                continue
            place = f"transmission '{element.get('name', '')}'"
            reduction = child(actuator, "mechanicalReduction")
            if reduction is None:
                reduction = child(joint, "mechanicalReduction")
            gear = 1.0
            if reduction is not None and (reduction.text or "").strip():
                reduction.set("value", (reduction.text or "").strip())
                gear = self.numbers(reduction, "value", 1, ANY, f"{place}: mechanicalReduction")[0] or 1.0
            gear = self.number(child(actuator, "drake:gear_ratio"), "value", ANY, place, gear)
            rotor = self.number(child(actuator, "drake:rotor_inertia"), "value", NOT_NEGATIVE, place, 0.0)
            actuator_name = name if actuator is None else actuator.get("name", name)
            drives.append(Drive(actuator_name, name, gear, rotor, origin=element.origin))
        return drives


def _turn_from_z(axis: tuple[float, ...]) -> pin.SE3 | None:
    """Return the turn from z to an axis; None if it is z."""
    direction = np.array(axis) / np.linalg.norm(axis)
    if np.array_equal(direction, [0.0, 0.0, 1.0]):
        return None
    return pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).matrix(), np.zeros(3))
