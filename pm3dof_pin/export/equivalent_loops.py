"""Closures that a dialect cannot say, as joints of a chain from one frame and a closure at its end that it can.

Frame b of a universal joint is reached from frame a by turns about x and y; of the others by slides along, and a turn
about, their axis; of a rod by turns about two axes across it. The last turn is the closure itself if the dialect knows
hinges; otherwise a weld, or for the rod a ball, ends the chain. The new joints are at zero where the robot is at home.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closure_types import ClosureTypeName
from pm3dof_pin.description.closures import Axis, LoopClosure
from pm3dof_pin.description.description import Body, Joint, JointType, Placement
from pm3dof_pin.description.readers.elements import free_name
from pm3dof_pin.description.simple_joints import NEGLIGIBLE
from pm3dof_pin.export.robot_document import RobotDocument, joint_numbers
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_CHAINS: dict[ClosureTypeName, tuple[tuple[JointType, Axis], ...]] = {
    "hinge": (("revolute", _Z),),
    "universal": (("revolute", _X), ("revolute", _Y)),
    "prismatic": (("prismatic", _Z),),
    "cylindrical": (("prismatic", _Z), ("revolute", _Z)),
    "planar": (("prismatic", _X), ("prismatic", _Y), ("revolute", _Z)),
    "distance": (("revolute", _Z), ("revolute", _Y)),
}


def with_closures_of(robot: RobotDocument, types: Collection[ClosureTypeName]) -> RobotDocument:
    """Return a robot whose closures are of some types, "3d" and "6d" among them; the same one if they are so already.

    Raises:
        ConvergenceError: the loops do not close near the home configuration.
    """
    if all(loop.type in types for loop in robot.closures):
        return robot
    builder = _Builder(robot, types)
    closures = tuple(
        loop if loop.type in types else builder.chain(loop, *links)
        for loop, links in zip(robot.closures, robot.closure_links, strict=True)
    )
    description = replace(
        robot.description,
        bodies=(*robot.description.bodies, *builder.bodies),
        joints=(*robot.description.joints, *builder.joints),
        closures=closures,
        configurations=builder.values,
        springs=(),
    )
    return replace(robot, description=description, described=description, mechanism=Robot.load(description))


class _Builder:
    def __init__(self, robot: RobotDocument, types: Collection[ClosureTypeName]) -> None:
        self.robot = robot
        self.types = types
        self.bodies: list[Body] = []
        self.joints: list[Joint] = []
        self.places: dict[str, Configuration] = robot.named_configurations()
        moving = [joint for joint in robot.description.joints if not joint.is_fixed]
        #: joint coordinates by configuration
        self.values: dict[str, dict[str, tuple[float, ...]]] = {
            name: {joint.name: joint_numbers(place, joint) for joint in moving} for name, place in self.places.items()
        }

    def chain(self, loop: LoopClosure, first: str, second: str) -> LoopClosure:
        """Add the joints that stand for a closure between two bodies; return the closure at their end."""
        name = f"{first}_{second}"
        bases = [pin.SE3(basis, np.zeros(3)) for basis in loop.bases or (np.eye(3), np.eye(3))]
        start = bases[0]
        if loop.kind.is_distance:  # x along the rod
            rod = self._relative(self.robot.home, loop, bases).translation
            turn = pin.Quaternion.FromTwoVectors(np.array(_X), rod / np.linalg.norm(rod)).toRotationMatrix()
            start = pin.SE3(turn, np.zeros(3))
        ends = [start, bases[1]]
        home = _coordinates(loop, self._relative(self.robot.home, loop, ends))
        parts = list(zip(_CHAINS[loop.type], home, strict=True))
        is_hinge = not loop.kind.is_distance and parts[-1][0][0] == "revolute" and "hinge" in self.types
        placement, body = start, first
        for k, ((kind, axis), number) in enumerate(parts[:-1] if is_hinge else parts):
            joint = Joint(self._free(f"{name}_{k + 1}"), kind, body, self._free(f"{name}_link{k + 1}"), axis=axis)
            placed = Placement.from_se3(placement * joint.motion(number))
            self._add(replace(joint, placement=placed), Body(joint.child, NEGLIGIBLE, origin=loop.origin))
            for key, place in self.places.items():
                now = _coordinates(loop, self._relative(place, loop, ends))[k]
                self.values[key][joint.name] = (now - number,)
            placement, body = pin.SE3.Identity(), joint.child
        if loop.kind.is_distance:
            end = self._fixed(f"{name}_end", body, pin.SE3(np.eye(3), np.array([loop.length, 0.0, 0.0])))
            return LoopClosure(end, second, "3d", origin=loop.origin)
        if is_hinge:
            axis = parts[-1][0][1]
            first_axis, second_axis = (_axis(pose.rotation @ np.array(axis)) for pose in (placement, bases[1]))
            return LoopClosure(body, second, "hinge", axis=first_axis, axis_b=second_axis, origin=loop.origin)
        seat = second if loop.bases is None else self._fixed(f"{name}_seat", second, bases[1])
        return LoopClosure(body, seat, "6d", origin=loop.origin)

    def _relative(self, place: Configuration, loop: LoopClosure, ends: list[pin.SE3]) -> pin.SE3:
        a, b = (
            place.frame_placement(frame) * end for frame, end in zip((loop.frame_a, loop.frame_b), ends, strict=True)
        )
        return a.actInv(b)

    def _free(self, name: str) -> str:
        bodies = {body.name for body in (*self.robot.description.bodies, *self.bodies)}
        joints = {joint.name for joint in (*self.robot.description.joints, *self.joints)}
        return free_name(name, bodies | joints)

    def _add(self, joint: Joint, body: Body) -> None:
        self.joints.append(joint)
        self.bodies.append(body)

    def _fixed(self, name: str, parent: str, placement: pin.SE3) -> str:
        child = self._free(name)
        joint = Joint(self._free(f"{name}_fixed"), "fixed", parent, child, Placement.from_se3(placement))
        self._add(joint, Body(child))
        return child


def _coordinates(loop: LoopClosure, relative: pin.SE3) -> tuple[float, ...]:
    """Return the coordinates of a closure's chain [m, rad] by which frame b is placed in frame a."""
    x, y, z = (float(number) for number in relative.translation)
    rotation = relative.rotation
    turn = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    match loop.type:
        case "hinge":
            return (turn,)
        case "universal":
            about_x = float(np.arctan2(rotation[2, 1], rotation[1, 1]))
            rest = pin.utils.rotate("x", -about_x) @ rotation
            return about_x, float(np.arctan2(rest[0, 2], rest[2, 2]))
        case "prismatic":
            return (z,)
        case "cylindrical":
            return z, turn
        case "planar":
            return x, y, turn
        case _:
            return float(np.arctan2(y, x)), -float(np.arctan2(z, np.hypot(x, y)))


def _axis(vector: np.ndarray) -> Axis:
    x, y, z = (float(number) for number in vector)
    return x, y, z
