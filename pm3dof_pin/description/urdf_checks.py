"""Checks of a URDF before it is parsed: what urdfdom would silently drop, and the physically impossible.

urdfdom drops the whole inertial of a link, or all its shapes, if one of their numbers is malformed: "0,1945", "nan", or
a number with a trailing space. It does not notice links in a cycle, and descends the tree recursively.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

from pm3dof_pin.description.inertia_checks import inertia_matrix, inertia_problem, is_reversed
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
    parse_number,
    parse_numbers,
)
from pm3dof_pin.exceptions import DescriptionError

MOST_LINKS = 10_000
"""Largest number of links."""

MOST_IN_A_ROW = 200
"""Longest chain of links, and most movable joints: Pinocchio's data take 60 bytes times their number cubed."""

_JOINT_TYPES = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_SIZES: dict[str, dict[str, tuple[int, Bounds]]] = {
    "box": {"size": (3, SIZE)},
    "cylinder": {"radius": (1, SIZE), "length": (1, SIZE)},
    "sphere": {"radius": (1, SIZE)},
    "mesh": {},
}
_JOINT_NUMBERS: dict[str, dict[str, Bounds]] = {
    "limit": {"effort": NOT_NEGATIVE, "velocity": NOT_NEGATIVE},
    "dynamics": {"damping": NOT_NEGATIVE, "friction": NOT_NEGATIVE},
    "mimic": {"multiplier": ANY, "offset": ANY},
    "safety_controller": {"soft_lower_limit": ANY, "soft_upper_limit": ANY, "k_position": ANY, "k_velocity": ANY},
    "calibration": {"rising": ANY, "falling": ANY},
}
_SHORTEST_AXIS = 1e-6
_logger = logging.getLogger(__name__)


def check_urdf(root: ElementTree.Element, path: Path | str) -> dict[str, str]:
    """Check all numbers and names of a URDF that Pinocchio and the exports read.

    Shapes unknown to URDF are removed from the tree with a warning, since urdfdom would also drop those after them.
    Spaces around numbers, which urdfdom does not accept, are removed. Returns, by link, problems of the moments of
    inertia that do not affect kinematics and statics.

    Raises:
        DescriptionError: an attribute is not a number, not finite, negative where it must not be, or physically
            impossible; a mass is missing; moments of inertia have a wrong sign; limits are not in order; an axis is
            zero; a name is missing, duplicate or unknown; or the links are not one tree of moderate size.
    """
    checks = _Checks(path)
    if not (root.get("name") or "").strip():
        raise DescriptionError(path, "<robot>", "has no name, expected one")
    links, joints = root.findall("link"), root.findall("joint")
    if len(links) > MOST_LINKS:
        raise DescriptionError(path, "<robot>", f"has {len(links)} links, expected at most {MOST_LINKS}")
    checks.names("link", links)
    checks.names("joint", joints)
    checks.names("material", root.findall("material"))
    impossible = {}
    for link in links:
        name = f"link '{link.get('name')}'"
        if problem := checks.link(link, name):
            impossible[str(link.get("name"))] = problem
    for joint in joints:
        checks.joint(joint, f"joint '{joint.get('name')}'")
    _check_tree(path, dict.fromkeys(str(link.get("name")) for link in links), joints)
    return impossible


class _Checks:
    def __init__(self, path: Path | str) -> None:
        self._path = path

    def names(self, kind: str, elements: list[ElementTree.Element]) -> None:
        names = [element.get("name") or "" for element in elements]
        if "" in names:
            self._fail(f"<{kind}>", "has no name, expected one")
        if twice := next((name for name, count in Counter(names).items() if count > 1), None):
            self._fail(f"{kind} '{twice}'", "is defined twice, expected unique names")

    def link(self, link: ElementTree.Element, place: str) -> str:
        for shape in (*link.findall("visual"), *link.findall("collision")):
            kind = next((child.tag for child in shape.findall("geometry/*")), "shape without geometry")
            if kind not in _SIZES:
                _logger.warning("%s: %s: %s: unsupported %s is ignored", self._path, place, shape.tag, kind)
                link.remove(shape)
            else:
                self._shape(shape, f"{place}: {shape.tag}")
        inertial = link.find("inertial")
        return "" if inertial is None else self._inertial(inertial, f"{place}: inertial")

    def joint(self, joint: ElementTree.Element, place: str) -> None:
        kind = joint.get("type")
        if kind not in _JOINT_TYPES:
            expected = f"expected one of {', '.join(_JOINT_TYPES)}"
            self._fail(place, f"{expected}, not {'no type' if kind is None else repr(kind)}")
        self._origin(joint, place)
        for tag, attributes in _JOINT_NUMBERS.items():
            if (element := joint.find(tag)) is not None:
                for key, bounds in attributes.items():
                    if key in element.attrib:
                        self._number(element, key, bounds, f"{place}: {tag}")
        if kind not in ("fixed", "floating"):
            self._axis(joint, place)
        if (limit := joint.find("limit")) is not None:
            ends = [
                self._number(limit, key, ANY, f"{place}: limit") if key in limit.attrib else 0.0
                for key in ("lower", "upper")
            ]
            if kind not in ("fixed", "floating") and ends[0] > ends[1]:
                self._fail(f"{place}: limit", f"expected lower <= upper, not {ends[0]:g} and {ends[1]:g}")

    def _inertial(self, inertial: ElementTree.Element, place: str) -> str:
        self._origin(inertial, place)
        mass_element, inertia = inertial.find("mass"), inertial.find("inertia")
        if mass_element is None or inertia is None:
            self._fail(place, f"expected <{'mass' if mass_element is None else 'inertia'}> in it")
        mass = self._number(mass_element, "value", MASS, f"{place}: mass")
        place = f"{place}: inertia"
        moments = [self._number(inertia, key, PRODUCT, place) for key in MOMENTS]
        matrix = inertia_matrix(moments)
        if is_reversed(mass, matrix):
            for key, moment in zip(MOMENTS[:3], moments, strict=False):
                if problem := MOMENT.problem(moment):
                    self._fail(f"{place}: {key}", problem)
            self._fail(place, inertia_problem(mass, matrix))
        return inertia_problem(mass, matrix)

    def _shape(self, element: ElementTree.Element, place: str) -> None:
        self._origin(element, place)
        shape = element.findall("geometry/*")[0]
        place = f"{place}: {shape.tag}"
        for key, (count, bounds) in _SIZES[shape.tag].items():
            self._numbers(shape, key, bounds, count, place)
        if shape.tag == "mesh":
            if not shape.get("filename"):
                self._fail(place, "has no filename, expected one")
            if "scale" in shape.attrib:
                self._numbers(shape, "scale", ANY, 3, place)
        colour = element.find("material/color")
        if colour is not None and "rgba" in colour.attrib:
            self._numbers(colour, "rgba", ANY, 4, f"{place}: color")

    def _origin(self, element: ElementTree.Element, place: str) -> None:
        if (origin := element.find("origin")) is not None:
            for key, bounds in (("xyz", LENGTH), ("rpy", ANGLE)):
                if key in origin.attrib:
                    self._numbers(origin, key, bounds, 3, f"{place}: origin")

    def _axis(self, joint: ElementTree.Element, place: str) -> None:
        if (axis := joint.find("axis")) is not None:
            xyz = self._numbers(axis, "xyz", ANY, 3, f"{place}: axis")
            if max(map(abs, xyz)) < _SHORTEST_AXIS:
                self._fail(f"{place}: axis", f"expected a direction, not '{axis.get('xyz')}'")

    def _number(self, element: ElementTree.Element, key: str, bounds: Bounds, place: str) -> float:
        if key not in element.attrib:
            self._fail(place, f"has no {key}, expected one")
        number, problem = parse_number(element.attrib[key], bounds)
        if problem:
            self._fail(f"{place}: {key}", problem)
        element.set(key, element.attrib[key].strip())  # a trailing space makes urdfdom fail
        return number

    def _numbers(
        self, element: ElementTree.Element, key: str, bounds: Bounds, count: int, place: str
    ) -> tuple[float, ...]:
        if key not in element.attrib:
            self._fail(place, f"has no {key}, expected {count} number{'s' if count > 1 else ''}")
        numbers, problem = parse_numbers(element.attrib[key], bounds, count)
        if problem:
            self._fail(f"{place}: {key}", problem)
        element.set(key, " ".join(element.attrib[key].split()))
        return numbers

    def _fail(self, place: str, expected: str) -> NoReturn:
        raise DescriptionError(self._path, place, expected)


def _check_tree(path: Path | str, links: Collection[str], joints: list[ElementTree.Element]) -> None:
    """Check that the joints connect the links to one tree of moderate depth."""
    if not links:
        raise DescriptionError(path, "<robot>", "has no links, expected some")
    parents: dict[str, str] = {}
    for joint in joints:
        place = f"joint '{joint.get('name')}'"
        ends = {tag: _end(joint, tag) for tag in ("parent", "child")}
        for tag, link in ends.items():
            if link not in links:
                expected = f"expected an existing link, not '{link}'" if link else "expected a link"
                raise DescriptionError(path, f"{place}: {tag}", expected)
        if ends["child"] in parents:
            raise DescriptionError(
                path, f"link '{ends['child']}'", "is the child of two joints: close loops in a closures file"
            )
        parents[ends["child"]] = ends["parent"]
    _check_roots(path, links, parents)
    moving = sum(joint.get("type") != "fixed" for joint in joints)
    if moving > MOST_IN_A_ROW:
        raise DescriptionError(path, "<robot>", f"has {moving} movable joints, expected at most {MOST_IN_A_ROW}")
    depths: dict[str, int] = {}
    for link in links:
        chain = [link]
        while chain[-1] in parents and chain[-1] not in depths:
            chain.append(parents[chain[-1]])
            if len(chain) > len(links):
                raise DescriptionError(path, f"link '{link}'", "is its own ancestor: expected a tree")
        for member in reversed(chain):
            depths.setdefault(member, depths[parents[member]] + 1 if member in parents else 1)
        if depths[link] > MOST_IN_A_ROW:
            raise DescriptionError(
                path, f"link '{link}'", f"is the end of a chain of more than {MOST_IN_A_ROW} links, the maximum"
            )


def _check_roots(path: Path | str, links: Collection[str], parents: Mapping[str, str]) -> None:
    roots = [link for link in links if link not in parents]
    if not roots:
        raise DescriptionError(path, "<robot>", "every link is a child: expected one root link")
    if len(roots) > 1:
        listed = ", ".join(roots[:4]) + (" ..." if len(roots) > 4 else "")
        raise DescriptionError(path, "<robot>", f"has several root links, expected one: {listed}")


def _end(joint: ElementTree.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
