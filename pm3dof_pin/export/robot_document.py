"""The source of all exports: a robot's URDF as a document, its closures, its SRDF, and the mechanism."""

from __future__ import annotations

import copy
import logging
import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Unpack
from xml.etree import ElementTree

import numpy as np

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.meshes import Meshes
from pm3dof_pin.export.urdf_document import Inertial, Joint, Link, Origin, UrdfDocument, read_urdf
from pm3dof_pin.kinematics.assembly import CLOSURE_TOLERANCE
from pm3dof_pin.kinematics.robot import LoadOptions, Robot
from pm3dof_pin.mechanism.as_urdf import NEGLIGIBLE_MASS, NEGLIGIBLE_MOMENT, as_urdf
from pm3dof_pin.mechanism.configuration import Configuration

_NEGLIGIBLE = Inertial(NEGLIGIBLE_MASS, Origin(), (*[NEGLIGIBLE_MOMENT] * 3, 0.0, 0.0, 0.0))
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class RobotDocument:
    """A checked robot: its tree, the same in Pinocchio with loop closures, and its mesh files."""

    files: RobotFiles
    urdf: UrdfDocument
    mechanism: Robot
    allowed_by_srdf: tuple[tuple[str, str], ...]  #: pairs of links that the SRDF keeps from colliding
    meshes: Meshes

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.urdf.name

    @property
    def file_name(self) -> str:
        """Name of the robot for file names: letters, digits, points, dashes and underscores."""
        return re.sub(r"[^\w.-]+", "_", self.name).strip("._") or self.files.name

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """The loop closures."""
        return self.mechanism.closures

    @cached_property
    def closure_links(self) -> tuple[tuple[str, str], ...]:
        """For each closure, the two links that its frames belong to."""
        return tuple(
            (self.urdf.link_of_frame(loop.frame_a), self.urdf.link_of_frame(loop.frame_b)) for loop in self.closures
        )

    @cached_property
    def untouchable(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links whose collisions are disabled: those of the SRDF, and links joined by a loop closure.

        All tools permit overlap of links joined by a joint of the tree, where shapes often meet, but not by closures.
        """
        known = {frozenset(pair) for pair in self.allowed_by_srdf}
        joined = [
            (one.name, other.name)
            for links in self.closure_links
            for one in self._rigid_body(links[0])
            for other in self._rigid_body(links[1])
            if one.collisions and other.collisions and frozenset((one.name, other.name)) not in known
        ]
        return (*self.allowed_by_srdf, *dict.fromkeys(joined))

    def _rigid_body(self, link: str) -> list[Link]:
        """Return the links that form one rigid body with a link."""
        while (above := self.urdf.above(link)) is not None and above.is_fixed:
            link = above.parent
        return list(self.urdf.fixed_to(link))

    @cached_property
    def home(self) -> Configuration:
        """The home configuration with its loops closed, for other tools; ConvergenceError if they do not close."""
        home = self.mechanism.home
        return home if home.closure_residual <= CLOSURE_TOLERANCE else self.mechanism.assemble(home)

    def home_position(self, joint: Joint) -> float:
        """Return the coordinate of a joint in the home configuration [m, rad]; 0 for a fixed joint."""
        return 0.0 if joint.is_fixed else self.home.joint_position(joint.name)

    def named_configurations(self) -> dict[str, Configuration]:
        """Return the named configurations of the SRDF, in order, and home with its loops closed."""
        named = {name: self.mechanism.configuration(q) for name, q in self.mechanism.named_configurations.items()}
        return {"home": self.home} | named | {"home": self.home}

    def with_moving_mass(self, tool: str) -> RobotDocument:
        """Return the robot with mass and inertia for all moving links, for a tool that needs them.

        A massless link between two joints, such as the cross of a universal joint, gets a negligible mass, and so does
        the end of a leg that a closure joins to another body.

        Raises:
            DescriptionError: a moving link at the end of a branch, with all links fixed to it, has none.
        """
        links, lightened = dict(self.urdf.links), []
        loops = zip(self.mechanism.closures, self.closure_links, strict=True)
        closed = {name for loop, pair in loops if loop.type == "6d" for name in pair}
        for joint in self.urdf.joints:
            rigid = list(self.urdf.fixed_to(joint.child))
            if joint.is_fixed or any(map(_is_massive, rigid)):
                continue
            carries = any(not below.is_fixed for link in rigid for below in self.urdf.below(link.name))
            if not carries and closed.isdisjoint(link.name for link in rigid):
                raise DescriptionError(
                    self.files.urdf,
                    f"link '{joint.child}'",
                    f"expected mass and inertia, which {tool} requires of all moving links",
                )
            links[joint.child] = replace(links[joint.child], inertial=_NEGLIGIBLE)
            lightened.append(joint.child)
        if not lightened:
            return self
        _logger.warning(
            "%s: %s kg and %s kg m^2 are assigned to the massless links %s: %s requires mass of all moving links",
            *(self.name, NEGLIGIBLE_MASS, NEGLIGIBLE_MOMENT, ", ".join(lightened), tool),
        )
        return replace(self, urdf=replace(self.urdf, links=links))

    def with_meshes_of(self, kinds: Collection[str]) -> RobotDocument:
        """Return the robot for a tool that reads only certain mesh suffixes; the others become OBJ files."""
        return replace(self, meshes=self.meshes.for_kinds(kinds))


def read_robot(
    name_or_path: str | Path,
    *,
    meshes: bool = True,
    **options: Unpack[LoadOptions],
) -> RobotDocument:
    """Read a robot for export, as a plain URDF if it is in another format or has joints that URDF lacks.

    Arguments as in :meth:`Robot.load <pm3dof_pin.kinematics.robot.Robot.load>`.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: a file is missing, unreadable or malformed.
        FrameNotFoundError: the closures file names a frame that the URDF does not have.
        JointNotFoundError: the closures file or the SRDF names a joint that the URDF does not have.
    """
    mechanism = Robot.load(name_or_path, **options)
    files = as_urdf(mechanism, floating=False)
    if files is not mechanism.files:
        mechanism = Robot.load(files.urdf, tool_frame=options.get("tool_frame"))
    urdf = _without_limits_that_are_none(read_urdf(files.urdf, meshes=meshes), mechanism)
    shapes = [shape for link in urdf.links.values() for shape in (*link.visuals, *link.collisions)]
    names = [shape.mesh for shape in shapes if shape.kind == "mesh"]
    found = Meshes.of_urdf(files, names)
    return RobotDocument(files, urdf, mechanism, _allowed_pairs(files.srdf, urdf), found)


def _without_limits_that_are_none(urdf: UrdfDocument, mechanism: Robot) -> UrdfDocument:
    """Remove the limits of joints treated as unlimited: URDF has 0 .. 0 if none are given."""
    joints, element = [], copy.deepcopy(urdf.element)
    for joint in urdf.joints:
        if joint.lower is not None and np.isinf(mechanism.upper_limits[mechanism.single_joint(joint.name).q_index]):
            joint = replace(joint, lower=None, upper=None)
            for limit in element.iterfind(f"joint[@name='{joint.name}']/limit"):
                limit.attrib.pop("lower", None)
                limit.attrib.pop("upper", None)
        joints.append(joint)
    return replace(urdf, element=element, joints=tuple(joints))


def _allowed_pairs(srdf: Path | None, urdf: UrdfDocument) -> tuple[tuple[str, str], ...]:
    if srdf is None:
        return ()
    elements = ElementTree.parse(srdf).getroot().iter("disable_collisions")
    pairs = [(element.get("link1", ""), element.get("link2", "")) for element in elements]
    return tuple(pair for pair in pairs if set(pair) <= set(urdf.links))


def _is_massive(link: Link) -> bool:
    return link.inertial is not None and link.mass > 0.0 and min(link.inertial.moments[:3]) > 0.0
