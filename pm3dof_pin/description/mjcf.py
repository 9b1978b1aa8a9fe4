"""MJCF files, rewritten into a form that Pinocchio reads faithfully, with what Pinocchio ignores.

Pinocchio's reader silently loses bodies if the world has several, if they are inside a `<frame>`, or if they share a
name with a site. It merges several joints of one body into one nameless joint, and drops fixed sites. Such files are
rewritten as equivalent ones: the world becomes a body, frames and sites become bodies without joints, and each joint
gets its own body.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from pm3dof_pin.description.mjcf_checks import check_mjcf
from pm3dof_pin.description.own_files import package_of, require_own
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError

WORLD = "world"
_TOOL_SITES = ("tool", "tool_frame", "tool0", "tcp", "ee", "eef", "end_effector", "attachment_site")

_POSE = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")
_NOT_READ = ("replicate", "attach", "composite", "flexcomp")
_MOST_INCLUDES = 20  # nested
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class EqualityConstraint:
    """A `<connect>` or `<weld>`."""

    name: str  #: its name, or its kind and position
    kind: str  #: "connect", two points coincide, or "weld", two frames do
    places: tuple[str, str]  #: the two bodies or sites
    by_sites: bool  #: whether the places are sites, which coincide
    anchor: tuple[float, ...]  #: the point, in the first body of a connect and in the second of a weld [m]
    #: position in the first body and quaternion (w, x, y, z) of a weld, or None for those of the initial configuration
    relative_pose: tuple[float, ...] | None


@dataclass(frozen=True)
class _JointSettings:
    """What Pinocchio ignores of a joint."""

    stiffness: float  #: of its spring [N/m or N m/rad]
    unlimited: bool  #: whether its range is ignored
    #: of a hinge or slide [rad, m], or None if not given. Pinocchio shifts it by `ref`, and reads that of a slide as
    #: degrees where angles are in degrees
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Mjcf:
    """A parsed MJCF file."""

    path: Path  #: the file
    name: str  #: name of the model
    text: str  #: the model as Pinocchio reads it
    joints: dict[str, _JointSettings] = field(default_factory=dict)  #: settings by joint
    equalities: tuple[EqualityConstraint, ...] = ()  #: its equality constraints
    #: name of the first actuator of each actuated joint, by joint
    actuators: dict[str, str] = field(default_factory=dict)
    gravity: tuple[float, ...] = (0.0, 0.0, -9.81)  #: acceleration of gravity [m/s^2]
    tool: str | None = None  #: a site with a customary tool name, or None


def read_mjcf(path: Path, own_folders: tuple[Path, ...] = ()) -> Mjcf:
    """Read an MJCF file and its includes from `own_folders`, by default those of its own package.

    Raises:
        DescriptionError: a file is unreadable or not XML, a number is malformed, or an element is not supported.
    """
    root = read_xml(path)
    _include(root, path, own_folders or (package_of(path),))
    check_mjcf(root, path)
    _order_sections(root)
    for tag in _NOT_READ:
        if root.find(f"worldbody//{tag}") is not None:
            raise DescriptionError(path, f"<{tag}>", "is not supported: expected the bodies written out")
    _drop_terrain(root)
    for directory in ("meshdir", "texturedir", "assetdir"):
        for compiler in root.iter("compiler"):
            if directory in compiler.attrib:
                compiler.set(directory, str(path.resolve().parent / compiler.attrib[directory]))
    if root.find("compiler[@meshdir]") is None and root.find("compiler[@assetdir]") is None:
        ElementTree.SubElement(root, "compiler", meshdir=str(path.resolve().parent))
    return _Reader(path, root).read()


def _order_sections(root: ElementTree.Element) -> None:
    """Merge the sections of defaults; put them and the assets first, since Pinocchio only finds earlier elements."""
    defaults = root.findall("default")
    for more in defaults[1:]:
        defaults[0].extend(more)
        root.remove(more)
    first = (*defaults[:1], *root.findall("asset"))
    for section in first:
        root.remove(section)
    root[:0] = first


def _drop_terrain(root: ElementTree.Element) -> None:
    """Remove height fields and skins, which are scenery and make Pinocchio refuse the file."""
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("hfield", "skin") or child.get("type") == "hfield" or child.get("hfield") is not None:
                parent.remove(child)


def _include(root: ElementTree.Element, path: Path, folders: tuple[Path, ...], within: tuple[Path, ...] = ()) -> None:
    """Replace <include> by the file's content; like MuJoCo, look next to the main file, then the including one."""
    for parent in list(root.iter()):
        for index, child in reversed(list(enumerate(parent))):
            if child.tag == "include":
                place = f"<include file='{child.get('file')}'>"
                candidates = [(file.parent / child.get("file", "")).resolve() for file in (path, *within[-1:])]
                included = next((candidate for candidate in candidates if candidate.is_file()), candidates[0])
                if included in within or len(within) > _MOST_INCLUDES:
                    raise DescriptionError(path, place, "includes itself")
                require_own(included, folders, path, place)
                content = read_xml(included)
                _include(content, path, folders, (*within, included))
                parent[index : index + 1] = list(content)


class _Reader:
    """Rewrites one file and records what Pinocchio would lose."""

    def __init__(self, path: Path, root: ElementTree.Element) -> None:
        self.path = path
        self.root = root
        self.sites: dict[str, str] = {}
        self.joints: dict[str, _JointSettings] = {}
        self.limited_balls: list[str] = []
        self.defaults = {name: settings for tree in root.findall("default") for name, settings in _classes(tree, {})}
        self.taken: set[str] = set()
        self.degrees = all(compiler.get("angle") != "radian" for compiler in root.iter("compiler"))
        self.autolimits = all(compiler.get("autolimits") != "false" for compiler in root.iter("compiler"))

    def read(self) -> Mjcf:
        worlds = self.root.findall("worldbody")
        bodies = self.root.findall("worldbody//body")
        for index, body in enumerate(bodies):
            body.attrib.setdefault("name", f"body{index + 1}")
        self.taken = {WORLD} | {body.attrib["name"] for body in bodies}
        root = ElementTree.Element("body", name=WORLD)
        for world in worlds:
            for child in list(world):
                if child.tag in ("body", "frame", "site"):
                    world.remove(child)
                    root.append(child)
        self._rewrite(root, next(iter(self.defaults), "main"))
        if self.limited_balls:
            _logger.warning("%s: the ranges of ball joints are ignored: %s", self.path, ", ".join(self.limited_balls))
        meshes = [body.attrib["name"] for body in root.iter("body") if body.find("geom[@mesh]") is not None]
        if unknown := [name for name in meshes if root.find(f".//body[@name='{name}']/inertial") is None]:
            _logger.warning(
                "%s: masses of meshes are not computed: Pinocchio assumes 1 kg for each of %s; give their mass and "
                "inertia by <inertial>",
                self.path,
                ", ".join(unknown),
            )
        for extra in worlds[1:]:
            self.root.remove(extra)
        (worlds[0] if worlds else ElementTree.SubElement(self.root, "worldbody")).append(root)
        for index, key in enumerate(self.root.findall("keyframe/key")):
            key.attrib.setdefault("name", f"key{index}")
        equalities, actuators = tuple(self._equalities()), self._actuators()
        for tag in ("equality", "actuator", "sensor", "contact", "tendon"):  # these use old names of bodies and sites
            for section in self.root.findall(tag):
                self.root.remove(section)
        return Mjcf(
            path=self.path,
            name=self.root.get("model") or self.path.stem,
            text=ElementTree.tostring(self.root, encoding="unicode"),
            joints=self.joints,
            equalities=equalities,
            actuators=actuators,
            gravity=self._gravity(),
            tool=next((self.sites[name] for name in _TOOL_SITES if name in self.sites), None),
        )

    def _rewrite(self, body: ElementTree.Element, default_class: str) -> None:
        """Rewrite the children of a body: frames and sites become bodies, and joints after the first get their own."""
        default_class = body.get("childclass", default_class)
        for index, child in enumerate(list(body)):
            if child.tag == "frame":
                if child.find("joint") is not None or child.find("freejoint") is not None:
                    raise DescriptionError(self.path, "<frame>", "joints in it are not supported: put them in the body")
                child.tag = "body"
                child.set("name", self._free_name(f"{body.get('name')}_frame{index}"))
            elif child.tag == "site" and "name" in child.attrib:
                name = self.sites[child.attrib["name"]] = self._free_name(child.attrib["name"], "_site")
                pose = {key: child.attrib[key] for key in _POSE if key in child.attrib}
                body[list(body).index(child)] = ElementTree.Element("body", {"name": name} | pose)
                continue
            if child.tag == "body":
                body[list(body).index(child)] = self._with_one_joint_a_body(child, default_class)

    def _with_one_joint_a_body(self, body: ElementTree.Element, default_class: str) -> ElementTree.Element:
        joints = [child for child in body if child.tag in ("joint", "freejoint")]
        for index, joint in enumerate(joints):
            joint.attrib.setdefault("name", f"{body.get('name')}_joint{index if len(joints) > 1 else ''}")
            self._note(joint, body.get("childclass", default_class))
        self._rewrite(body, default_class)
        outer = body
        for joint in reversed(joints[:-1]):
            body.remove(joint)
            carrier = ElementTree.Element("body", outer.attrib | {"name": self._free_name(f"{joint.get('name')}_body")})
            for key in (*_POSE, "childclass"):
                outer.attrib.pop(key, None)
            carrier.extend([joint, outer])
            outer = carrier
        return outer

    def _note(self, joint: ElementTree.Element, default_class: str) -> None:
        settings = self.defaults.get(joint.get("class", default_class), {}) | joint.attrib
        settings = {} if joint.tag == "freejoint" else settings
        limited = settings.get("limited", "auto")
        unlimited = limited == "false" or (limited == "auto" and not self.autolimits)
        (stiffness, *_) = self._numbers(joint, settings.get("stiffness", "0"))
        if stiffness and settings.get("type", "hinge") not in ("hinge", "slide"):
            _logger.warning("%s: the spring of joint '%s' is ignored", self.path, joint.get("name"))
            stiffness = 0.0
        kind, ends = settings.get("type", "hinge"), self._numbers(joint, settings.get("range", ""))
        limits = None
        if kind in ("hinge", "slide") and ends:
            unit = math.radians(1.0) if kind == "hinge" and self.degrees else 1.0
            limits = (unit * ends[0], unit * ends[-1])
        elif kind == "ball" and any(ends) and not unlimited:
            self.limited_balls.append(joint.attrib["name"])
        self.joints[joint.attrib["name"]] = _JointSettings(stiffness, unlimited, limits)

    def _equalities(self) -> Iterator[EqualityConstraint]:
        for index, element in enumerate(self.root.findall("equality/*")):
            name = element.get("name") or f"{element.tag}{index + 1}"
            if element.get("active") == "false":
                continue
            if element.tag not in ("connect", "weld"):
                _logger.warning("%s: equality '%s', a <%s>, is ignored", self.path, name, element.tag)
                continue
            by_sites = "site1" in element.attrib
            if by_sites:
                places = tuple(self.sites.get(element.get(key, ""), "") for key in ("site1", "site2"))
            else:
                places = (element.get("body1", WORLD), element.get("body2", WORLD))
            if not all(places):
                raise DescriptionError(self.path, f"<{element.tag} name='{name}'>", "expected existing sites")
            pose = tuple(self._numbers(element, element.get("relpose", "0 1 0 0 0 0 0")))
            yield EqualityConstraint(
                name=name,
                kind=element.tag,
                places=(places[0], places[1]),
                by_sites=by_sites,
                anchor=tuple(self._numbers(element, element.get("anchor", "0 0 0"))),
                relative_pose=pose if any(pose[3:]) else None,
            )

    def _actuators(self) -> dict[str, str]:
        actuators: dict[str, str] = {}
        for element in self.root.findall("actuator/*"):
            joint = element.get("joint") or element.get("jointinparent")
            if joint is None:
                name = f" '{element.get('name')}'" if "name" in element.attrib else ""
                _logger.warning("%s: actuator%s drives no joint and is ignored", self.path, name)
            else:
                actuators.setdefault(joint, element.get("name", joint))
        return actuators

    def _gravity(self) -> tuple[float, ...]:
        gravity: tuple[float, ...] = (0.0, 0.0, -9.81)
        for option in self.root.iter("option"):
            gravity = tuple(self._numbers(option, option.get("gravity", "0 0 -9.81")))
        disabled = any(flag.get("gravity") == "disable" for flag in self.root.iter("flag"))
        return (0.0, 0.0, 0.0) if disabled else gravity

    def _numbers(self, element: ElementTree.Element, text: str) -> list[float]:
        try:
            return [float(word) for word in text.split()]
        except ValueError as error:
            name = f" name='{element.get('name')}'" if "name" in element.attrib else ""
            raise DescriptionError(self.path, f"<{element.tag}{name}>", f"expected numbers, not '{text}'") from error

    def _free_name(self, name: str, suffix: str = "_") -> str:
        while name in self.taken:
            name += suffix
        self.taken.add(name)
        return name


def _classes(default: ElementTree.Element, inherited: dict[str, str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the joint settings of a default class and of its subclasses."""
    settings = dict(inherited)
    for joint in default.findall("joint"):
        settings |= joint.attrib
    yield default.get("class", "main"), settings
    for child in default.findall("default"):
        yield from _classes(child, settings)
