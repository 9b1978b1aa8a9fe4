"""Thermal growth: of screws from their fixed bearings, and of members between joints, which may also bend."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.error_file import AXES
from pm3dof_pin.errors.error_parameters import GeometricParameter, axis_parameters
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Motion, Vector

STEEL_EXPANSION = 11.5e-6
"""Thermal expansion of steel [1/K]."""


@dataclass(frozen=True)
class Bending:
    """A member that bends with temperature."""

    #: temperature gradient in both directions across it, per kelvin of mean rise [1/m]
    gradients: tuple[float, float]
    #: vector from its start to its end, in axes of the body that it ends on [m]; from the previous joint by default
    along: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class ThermalGrowth:
    """Growth of screws from their fixed bearings, and of members between joints, which bend if it is uneven.

    The travel of a drive exceeds its nominal value by the growth of its screw from the fixed bearing to the nut,
    du = a * integral of the temperature rise from the bearing to u.

    A member of length L with a temperature gradient g across it, warmer on the side of the unit vector n, bends with
    the curvature a g: to first order its end moves by -a g L^2 / 2 n and turns by a g L n x t, with t along the member.
    """

    #: coordinate of each actuated joint at the fixed bearing of its screw, shape=(number of actuated joints,) [m]
    bearings: Vector
    #: temperature along each screw as multiples of the measured rise, at increasing distances from the bearing [m]:
    #: interpolated linearly, constant beyond the ends. Uniform by default
    profile: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    #: joints or frames whose distance from the previous joint grows, with their temperature rise relative to the
    #: measured one: 1 for links as warm as the screws, 0.2 for cooler ones
    members: Mapping[str, float] = field(default_factory=dict)
    expansion: float = STEEL_EXPANSION  #: a [1/K]
    #: members that bend, by the joint or frame at which they end
    bending: Mapping[str, Bending] = field(default_factory=dict)

    def travel_errors(self, travels: Array, temperature_rises: Array) -> Array:
        """Return the excess travel of drives, shape=(n, drives) [m], at coordinates [m] and temperature rises [K]."""
        distance = travels - finite_array("bearings", self.bearings, (travels.shape[1],))
        return self.expansion * temperature_rises * self._integral(distance)

    def growth(self, robot: Robot) -> tuple[list[GeometricParameter], Vector]:
        """Return the motions of member ends as error parameters, and their size per kelvin [m/K, rad/K]."""
        moved = self.growth_per_kelvin(robot)
        for place, member in self.bending.items():
            bent = self.expansion * bend_per_curvature(robot, place, member.along) @ member.gradients
            for name, amount in zip(displacement_names(place), bent, strict=True):
                moved[name] = moved.get(name, 0.0) + float(amount)
        parameters = displacement_errors(robot, {**self.members, **self.bending}, "thermal")
        return parameters, np.array([moved.get(parameter.name, 0.0) for parameter in parameters])

    def growth_per_kelvin(self, robot: Robot) -> dict[str, float]:
        """Return the motion of each member's end, by the names of :func:`displacement_names` [m/K]."""
        growth: dict[str, float] = {}
        for place, share in self.members.items():
            placement = _placement_on_body(robot, place)
            longer = self.expansion * share * (placement.rotation.T @ placement.translation)
            growth |= {f"{place}.t{axis}": float(amount) for axis, amount in zip(AXES, longer, strict=True)}
        return growth

    def _integral(self, distance: Array) -> Array:
        """Integrate the profile from the bearing to a distance."""
        places, shares = np.array(self.profile, dtype=float).T
        if np.any(np.diff(places) <= 0.0):
            raise InvalidValueError("profile", self.profile, "increasing distances from the bearing")
        # from the first point of the profile on, then back to the bearing
        knots = np.concatenate([[0.0], np.cumsum(0.5 * (shares[1:] + shares[:-1]) * np.diff(places))])

        def from_first(x: Array) -> Array:
            inner = np.clip(x, places[0], places[-1])
            k = np.clip(np.searchsorted(places, inner, side="right") - 1, 0, max(len(places) - 2, 0))
            share = np.interp(inner, places, shares)
            within = knots[k] + 0.5 * (shares[k] + share) * (inner - places[k])
            return np.asarray(within + (x - inner) * np.where(x < places[0], shares[0], shares[-1]))

        return from_first(distance) - from_first(np.zeros(1))


def displacement_names(place: str) -> list[str]:
    """Return the names of a place's displacements along its own axes, then about them."""
    return [f"{place}.{kind}{axis}" for kind in "tr" for axis in AXES]


def displacement_errors(
    robot: Robot, places: Iterable[str], group: str, motions: Sequence[Motion] = ("translation", "rotation")
) -> list[GeometricParameter]:
    """Return the displacements of joints or frames in their own axes as error parameters, with unit tolerances.

    Raises:
        FrameNotFoundError: the robot has no such joint or frame.
    """
    places = list(places)
    for place in places:
        _placement_on_body(robot, place)
    return [p for place in places for motion in motions for p in axis_parameters(place, motion, group, 1.0)]


def bend_per_curvature(robot: Robot, place: str, along: tuple[float, float, float] | None = None) -> Array:
    """Return the motion of a member's end as it bends, to first order, in the axes of the place where it ends.

    The warmer side is in one of two directions across the member: that of the body axis most nearly perpendicular to
    it, made perpendicular, and that perpendicular to both. For each, [translation; rotation vector], shape=(6, 2)
    [m^2, m]. The member lies `along` [m], in the axes of its body; from the previous joint by default.

    Raises:
        InvalidValueError: the member has no length.
    """
    placement = _placement_on_body(robot, place)
    arm = finite_array(f"member at {place}", placement.translation if along is None else along, (3,))
    length = float(np.linalg.norm(arm))
    if length == 0.0:
        raise InvalidValueError(f"member at {place}", "no length", "along_m, because it ends at the previous joint")
    tangent = arm / length
    first = np.cross(np.cross(tangent, np.eye(3)[int(np.argmin(np.abs(tangent).round(9)))]), tangent)
    first /= np.linalg.norm(first)
    sides = (first, np.cross(tangent, first))
    bends = [np.concatenate([-0.5 * length**2 * warm, length * np.cross(warm, tangent)]) for warm in sides]
    return np.asarray(np.kron(np.eye(2), placement.rotation.T) @ np.stack(bends, axis=1))


def _placement_on_body(robot: Robot, place: str) -> pin.SE3:
    model = robot.model
    if model.existJointName(place):
        return model.jointPlacements[model.getJointId(place)]
    return model.frames[robot.frame_id(place)].placement
