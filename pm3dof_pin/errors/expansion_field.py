r"""Thermal expansion of a body by a strain that varies linearly in it, and the robot whose bodies expand so.

At a place r from its joint, a body of expansion alpha and temperature rise T + g r has the strain e + h r, with
e = alpha T and h = alpha g, in all directions. A linear temperature field strains no simply connected body of one
material (B. A. Boley and J. H. Weiner, Theory of Thermal Stresses, 1960, section 3.3): held at its joint, it moves by

    u = e r + (h r) r - h r^2 / 2    and turns by    h x r

there: along h it grows as its mean strain says, and across h it bends towards the colder side.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from pm3dof_pin.errors.error_parameters import GeometricErrors, displacement_errors, placement_on_body
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Matrix, Vector


@dataclass(frozen=True, eq=False)
class ExpansionField:
    """The thermal strain of a body, linear in the axes of the joint that carries it."""

    strain: float = 0.0  #: at the joint
    gradient: Vector = field(default_factory=lambda: np.zeros(3))  #: per length [1/m]

    def motion(self, place: Vector) -> pin.SE3:
        """Return the motion of the body at a place, in the axes of the joint: a small rotation, and a translation."""
        along = self.strain + self.gradient @ place
        shift = along * place - 0.5 * (place @ place) * self.gradient
        return pin.SE3(pin.exp3(np.cross(self.gradient, place)), shift)


def linear_field(places: Matrix, values: Vector, gradient: Vector | None = None) -> tuple[float, Vector]:
    """Return the flattest linear function with values at places, as that at the origin and its gradient.

    Too many values are met by least squares; with a `gradient`, they tell the mean only.

    Args:
        places: shape=(n, 3) [m].
        values: shape=(n,).
        gradient: shape=(3,) [1/m].
    """
    middle, mean = places.mean(axis=0), float(values.mean())
    if gradient is None:
        gradient = np.linalg.lstsq(places - middle, values - mean, rcond=_COINCIDENT)[0]
    return mean - float(gradient @ middle), gradient


_COINCIDENT = 1e-6
"""Distances of sensors, relative to the greatest, below which they do not tell a gradient."""


def expanded(robot: Robot, fields: Mapping[str, ExpansionField], bearings: Vector) -> Robot:
    """Return a robot whose joints, closures and frames are where the bodies that they are on expand to.

    Args:
        robot: the robot.
        fields: strain of the body at whose end each joint or frame is, by the name of the latter.
        bearings: coordinate of each actuated joint at which its body ends, for those that slide, whose screws expand
            by themselves from there.
    """
    moved = {place: _moved(robot, place, strain, bearings) for place, strain in fields.items()}
    errors = GeometricErrors(robot, displacement_errors(robot, moved, "thermal"))
    values: dict[str, float] = {}
    for place, target in moved.items():
        start = placement_on_body(robot, place)
        if (carrier := carrying_frame(robot, place, moved)) is not None:  # by which it is moved already
            start = moved[carrier] * placement_on_body(robot, carrier).inverse() * start
        motion = start.inverse() * target
        parts = (motion.translation, pin.log3(motion.rotation))
        values |= {
            f"{place}.{kind}{axis}": float(value)
            for kind, part in zip("tr", parts, strict=True)
            for axis, value in zip("xyz", part, strict=True)
        }
    return errors.apply(values)


def carrying_frame(robot: Robot, place: str, places: Iterable[str]) -> str | None:
    """Return the nearest frame among some places that carries a place on the same body, or None."""
    frames = robot.model.frames
    if not robot.model.existFrame(place):  # a joint may have none
        return None
    entry = frames[robot.frame_id(place)]
    body = robot.model.parents[entry.parentJoint] if robot.model.existJointName(place) else entry.parentJoint
    above = frames[entry.parentFrame]
    while above.parentJoint == body and above.parentFrame > 0:
        if above.name in places and not robot.model.existJointName(above.name):
            return str(above.name)
        above = frames[above.parentFrame]
    return None


def _moved(robot: Robot, place: str, strain: ExpansionField, bearings: Vector) -> pin.SE3:
    """Return the placement of a joint or frame on its expanded body."""
    start = placement_on_body(robot, place)
    end: Array = np.array(start.translation)
    if place in robot.actuated_joints and robot.single_joint(place).translates:
        end += start.rotation @ robot.joint_axis(place) * bearings[robot.actuated_joints.index(place)]
    about = pin.SE3(np.eye(3), end)
    return about * strain.motion(end) * about.inverse() * start
