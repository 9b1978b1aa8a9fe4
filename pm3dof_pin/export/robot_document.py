"""The source of all exports: a robot's description as a tree of simple joints, and the mechanism that it describes."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Unpack, assert_never

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import Body, Description, Joint, Shape
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.description.simple_joints import (
    NEGLIGIBLE,
    NEGLIGIBLE_MASS,
    NEGLIGIBLE_MOMENT,
    Floating,
    with_frames_as_bodies,
    with_simple_joints,
)
from pm3dof_pin.description.unique_names import shared_joint_names, with_joint_names
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.meshes import Meshes
from pm3dof_pin.kinematics.robot import LoadOptions, Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Vector

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class RobotDocument:
    """A checked robot: its tree, the same in Pinocchio with loop closures, and its mesh files."""

    files: RobotFiles
    #: bodies on fixed, revolute, continuous, prismatic and perhaps floating joints; its frames are bodies too
    description: Description
    described: Description  #: as it was read
    mechanism: Robot
    meshes: Meshes
    floating: Floating = "none"  #: which floating joints it keeps
    renamed: Mapping[str, str] = field(default_factory=dict)  #: names of joints that were changed, by the old ones

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.description.name

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
        """For each closure, the two bodies that its frames are."""
        return tuple((self.body_of_frame(loop.frame_a), self.body_of_frame(loop.frame_b)) for loop in self.closures)

    def body_of_frame(self, frame: str) -> str:
        """Return the body of a frame, given by the name of the body or of the joint that carries it."""
        return frame if frame in self.description.body_by_name else self.description.joint(frame).child

    def points_of(self, index: int, tool: str) -> list[tuple[Vector, Vector]]:
        """Return pairs of points of a closure's frames, in their axes, whose coincidence closes it [m].

        Those of a hinge are on its axis, as far apart as the robot is large; three points close a weld.

        Raises:
            DescriptionError: the closure is not equivalent to coincident points.
        """
        loop = self.closures[index]
        arm = float(f"{self.mechanism.characteristic_length:.1g}")  # a round number of the size of the robot
        match loop.type:
            case "3d":
                arms = [(0.0, 0.0, 0.0)]
            case "6d":
                arms = [(0.0, 0.0, 0.0), (arm, 0.0, 0.0), (0.0, arm, 0.0)]
            case "hinge":
                arms = [(0.0, 0.0, 0.0), (0.0, 0.0, arm)]
            case "universal" | "prismatic" | "cylindrical" | "planar" | "distance":
                raise self.refusal(loop, tool)
            case _:
                assert_never(loop.type)
        bases = loop.bases or (np.eye(3), np.eye(3))
        return [(bases[0] @ np.array(point), bases[1] @ np.array(point)) for point in arms]

    def refusal(self, constraint: LoopClosure | Coupling, tool: str) -> DescriptionError:
        """Return the error that a tool has nothing for a closure or coupling."""
        if isinstance(constraint, Coupling):
            return DescriptionError(self.files.source, f"coupling {constraint.name}", f"cannot be expressed in {tool}")
        place = f"closure {constraint.name}"
        return DescriptionError(self.files.source, place, f"of type {constraint.type} cannot be expressed in {tool}")

    def mimicked(self, tool: str) -> dict[str, tuple[str, float, float]]:
        """Return the couplings by the joint that follows: the other joint, ratio and offset [m, rad].

        Raises:
            DescriptionError: one is not linear or has several other joints, or a joint follows twice.
        """
        found: dict[str, tuple[str, float, float]] = {}
        for coupling in self.mechanism.couplings:
            if not coupling.is_linear or len(coupling.joints) > 1 or coupling.joint in found:
                raise self.refusal(coupling, tool)
            found[coupling.joint] = coupling.joints[0], coupling.coefficients[0][0], coupling.offset
        return found

    @cached_property
    def untouchable(self) -> tuple[tuple[str, str], ...]:
        """Pairs of bodies whose collisions are disabled: those of the SRDF, and bodies joined by a loop closure.

        All tools permit overlap of bodies joined by a joint of the tree, where shapes often meet, but not by closures.
        """
        known = {frozenset(pair) for pair in self.description.untouchable}
        joined = [
            (one.name, other.name)
            for links in self.closure_links
            for one in self._rigid_body(links[0])
            for other in self._rigid_body(links[1])
            if one.collisions and other.collisions and frozenset((one.name, other.name)) not in known
        ]
        return (*self.description.untouchable, *dict.fromkeys(joined))

    def _rigid_body(self, body: str) -> list[Body]:
        """Return the bodies that are fixed to a body, with itself."""
        while (above := self.description.joint_above.get(body)) is not None and above.is_fixed:
            body = above.parent
        return list(self.description.fixed_to(body))

    @cached_property
    def home(self) -> Configuration:
        """The home configuration with its loops closed, for other tools; ConvergenceError if they do not close."""
        home = self.mechanism.home
        return home if home.closure_residual <= self.mechanism.closure_tolerance else self.mechanism.assemble()

    def home_position(self, joint: Joint) -> float:
        """Return the coordinate of a joint in the home configuration [m, rad]; 0 for a fixed or floating joint."""
        return 0.0 if not joint.is_single else self.home.joint_position(joint.name)

    def named_configurations(self) -> dict[str, Configuration]:
        """Return the named configurations of the SRDF, in order, and home with its loops closed."""
        named = {name: self.mechanism.configuration(q) for name, q in self.mechanism.named_configurations.items()}
        return {"home": self.home} | named | {"home": self.home}

    def with_moving_mass(self, tool: str) -> RobotDocument:
        """Return the robot with mass and inertia for all moving bodies, for a tool that needs them.

        A massless body between two joints, such as the cross of a universal joint, gets a negligible mass, and so does
        the end of a leg that a closure joins to another body.

        Raises:
            DescriptionError: a moving body at the end of a branch, with all bodies fixed to it, has none.
        """
        description, lightened = self.description, []
        loops = zip(self.closures, self.closure_links, strict=True)
        closed = {name for loop, pair in loops if len(loop.kind.rotations) > 1 for name in pair}
        for joint in description.joints:
            rigid = list(description.fixed_to(joint.child))
            if joint.is_fixed or any(map(_is_massive, rigid)):
                continue
            carries = any(not below.is_fixed for body in rigid for below in description.joints_below[body.name])
            if not carries and closed.isdisjoint(body.name for body in rigid):
                raise DescriptionError(
                    self.files.path,
                    f"link '{joint.child}'",
                    f"expected mass and inertia, which {tool} requires of all moving links",
                )
            lightened.append(joint.child)
        if not lightened:
            return self
        _logger.warning(
            "%s: %s kg and %s kg m^2 are assigned to the massless links %s: %s requires mass of all moving links",
            *(self.name, NEGLIGIBLE_MASS, NEGLIGIBLE_MOMENT, ", ".join(lightened), tool),
        )
        bodies = [replace(b, inertial=NEGLIGIBLE) if b.name in lightened else b for b in description.bodies]
        return replace(self, description=replace(description, bodies=tuple(bodies)))

    def with_meshes_of(self, kinds: Collection[str]) -> RobotDocument:
        """Return the robot for a tool that reads only certain mesh suffixes; the others become OBJ files."""
        return replace(self, meshes=self.meshes.for_kinds(kinds))


def unit_axis(joint: Joint) -> NDArray[np.float64]:
    """Return the axis of a joint as a unit vector, shape=(3,)."""
    axis = np.array(joint.axis)
    return np.asarray(axis / np.linalg.norm(axis))


def read_robot(
    name_or_path: str | Path,
    *,
    meshes: bool = True,
    unique_names: bool = False,
    floating: Floating = "none",
    **options: Unpack[LoadOptions],
) -> RobotDocument:
    """Read a robot for export, as a plain URDF if it is in another format or has joints that URDF lacks.

    With `unique_names`, joints whose names bodies have too get others; free joints that are not among `floating` become
    slides and turns. Other arguments as in
    :meth:`Robot.load <pm3dof_pin.kinematics.robot.Robot.load>`.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: a file is missing, unreadable or malformed.
        FrameNotFoundError: the closures file names a frame that the URDF does not have.
        JointNotFoundError: the closures file or the SRDF names a joint that the URDF does not have.
    """
    robot = Robot.load(name_or_path, **options)
    if robot.files is None:
        raise DescriptionError(robot.source, "files", "expected a robot that was read from files")
    return document_of(robot, robot.files, meshes=meshes, unique_names=unique_names, floating=floating)


def document_of(
    robot: Robot,
    files: RobotFiles,
    *,
    meshes: bool = True,
    unique_names: bool = False,
    floating: Floating = "none",
) -> RobotDocument:
    """Prepare a robot for export, see :func:`read_robot`; `files` are those that name its meshes.

    Raises:
        DescriptionError: a mesh file is missing.
    """
    own = {name: getattr(robot, name) for name in ("actuated_joints", "commands", "springs", "tool_frame")}
    described = replace(robot.description, **own)
    simple = with_simple_joints(described, floating=floating)
    names = shared_joint_names(simple) if unique_names else {}
    if names:
        described, simple = with_joint_names(described, names), with_joint_names(simple, names)
    mechanism = robot if simple is described and not names else Robot.load(simple)
    description = with_frames_as_bodies(simple)
    joints = {j.name: replace(j, velocity=j.velocity or None) for j in description.joints}  # 0 stands for unknown
    description = description.with_joints(joints)
    if description.dialect == "urdf":
        drives = tuple(replace(drive, name=drive.joint) for drive in description.drives)
        description = replace(description, drives=drives)
    if not meshes:
        description = replace(description, bodies=tuple(map(_without_meshes, description.bodies)))
    shapes = [shape for body in description.bodies for shape in (*body.visuals, *body.collisions)]
    found = Meshes.from_urdf(files, [shape.mesh for shape in shapes if shape.kind == "mesh"])
    return RobotDocument(files, description, described, mechanism, found, floating, names)


def joint_numbers(configuration: Configuration, joint: Joint) -> tuple[float, ...]:
    """Return the coordinates of a joint: one [m, rad], or the position and quaternion x, y, z, w of a free body."""
    if joint.is_single:
        return (configuration.joint_position(joint.name),)
    model = configuration.mechanism.model
    start, count = ((numbers[model.getJointId(joint.name)]) for numbers in (model.idx_qs, model.nqs))
    return tuple(configuration.q[start : start + count].tolist())


def _without_meshes(body: Body) -> Body:
    def kept(shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
        return tuple(shape for shape in shapes if shape.kind != "mesh")

    return replace(body, visuals=kept(body.visuals), collisions=kept(body.collisions))


def _is_massive(body: Body) -> bool:
    return body.inertial is not None and body.mass > 0.0 and min(body.inertial.moments[:3]) > 0.0
