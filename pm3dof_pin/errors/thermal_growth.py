"""Thermal growth: of screws from their fixed bearings, and of members between joints, which may also bend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.error_file import AXES
from pm3dof_pin.errors.error_parameters import (
    GeometricErrors,
    GeometricParameter,
    displacement_errors,
    placement_on_body,
)
from pm3dof_pin.errors.expansion_field import carrying_frame
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Vector

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

    The travel of a sliding drive exceeds its nominal value by the growth of its screw from the fixed bearing to the
    nut, du = a * integral of the temperature rise from the bearing to u.

    Every length that a material fills grows once. A member reaches from the previous joint, or from another member
    on the same body that carries it, to its own place; at a sliding drive only to the fixed bearing, since from there
    on the length is the screw's. With all members and screws at the same rise, the machine scales.

    A member of length L with a temperature gradient g across it, warmer on the side of the unit vector n, bends with
    the curvature a g: to first order its end moves by -a g L^2 / 2 n and turns by a g L n x t, with t along the member.
    """

    #: coordinate of each actuated joint at the fixed bearing of its screw, shape=(number of actuated joints,) [m]
    bearings: Vector
    #: temperature along each screw as multiples of the measured rise, at increasing distances from the bearing [m]:
    #: interpolated linearly, constant beyond the ends. Uniform by default
    profile: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    #: joints or frames at which a growing member ends, with their temperature rise relative to the measured one: 1 for
    #: links as warm as the screws, 0.2 for cooler ones
    members: Mapping[str, float] = field(default_factory=dict)
    expansion: float = STEEL_EXPANSION  #: a [1/K]
    #: members that bend, by the joint or frame at which they end
    bending: Mapping[str, Bending] = field(default_factory=dict)
    #: rods that are closures of type "distance", by the closure's name, with their temperature rise like members
    rods: Mapping[str, float] = field(default_factory=dict)

    def travel_errors(self, travels: Array, temperature_rises: Array) -> Array:
        """Return the excess travel of drives, shape=(n, drives) [m], at coordinates [m] and temperature rises [K]."""
        distance = travels - finite_array("bearings", self.bearings, (travels.shape[1],))
        return self.expansion * temperature_rises * self._integral(distance)

    def growth(self, robot: Robot) -> tuple[list[GeometricParameter], Vector]:
        """Return the motions of member ends as error parameters, and their size per kelvin [m/K, rad/K]."""
        moved = self.growth_per_kelvin(robot)
        for place in self.bending:
            for bend in self.bends(robot, place):
                moved |= {name: moved.get(name, 0.0) + self.expansion * amount for name, amount in bend.items()}
        parameters = displacement_errors(robot, {**self.members, **self.bending}, "thermal")
        return parameters, np.array([moved.get(parameter.name, 0.0) for parameter in parameters])

    def grown(self, robot: Robot, rise: float) -> Robot:
        """Return a robot with its members at a temperature rise [K]; its screws grow by :meth:`travel_errors`."""
        parameters, per_kelvin = self.growth(robot)
        return self.with_rods(GeometricErrors(robot, parameters).apply(rise * per_kelvin), rise)

    def with_rods(self, robot: Robot, rise: float) -> Robot:
        """Return a robot with its rods alone at a temperature rise [K]."""
        strains = {name: self.expansion * share * rise for name, share in self.rods.items()}
        if not any(strains.values()):
            return robot
        return robot.replace(
            closures=[
                replace(loop, length=loop.length * (1.0 + strains.get(loop.name, 0.0))) if loop.length else loop
                for loop in robot.closures
            ]
        )

    def growth_per_kelvin(self, robot: Robot) -> dict[str, float]:
        """Return the motion of each member's end along its own axes, by the names of error parameters [m/K]."""
        growth: dict[str, float] = {}
        for place, share in self.members.items():
            placement = placement_on_body(robot, place)
            carrier = carrying_frame(robot, place, self.members)
            start = np.zeros(3) if carrier is None else placement_on_body(robot, carrier).translation
            length = placement.rotation.T @ (placement.translation - start)
            if place in robot.actuated_joints and robot.single_joint(place).translates:
                length += self.bearings[robot.actuated_joints.index(place)] * robot.joint_axis(place)
            growth |= {
                f"{place}.t{axis}": self.expansion * share * float(x) for axis, x in zip(AXES, length, strict=True)
            }
        return growth

    def bends(self, robot: Robot, place: str) -> list[dict[str, float]]:
        """Return the motion of a member's end as it bends, over its expansion, for both directions across it.

        The warmer side is in one of two directions: that of the body axis most nearly perpendicular to the member, made
        perpendicular, and that perpendicular to both. Motions are along and about the axes of the place where it ends,
        by the names of error parameters, to first order [m, rad].

        Raises:
            InvalidValueError: the member has no length.
        """
        placement, member = placement_on_body(robot, place), self.bending[place]
        arm = finite_array(f"member at {place}", placement.translation if member.along is None else member.along, (3,))
        length = float(np.linalg.norm(arm))
        if length == 0.0:
            raise InvalidValueError(
                f"member at {place}", problem="has no length", expected="along_m, because it ends at the previous joint"
            )
        tangent = arm / length
        first = np.cross(np.cross(tangent, np.eye(3)[int(np.argmin(np.abs(tangent).round(9)))]), tangent)
        first /= np.linalg.norm(first)
        bends = []
        for warm, gradient in zip((first, np.cross(tangent, first)), member.gradients, strict=True):
            motion = (-0.5 * length**2 * warm, length * np.cross(warm, tangent))
            local = np.concatenate([placement.rotation.T @ part for part in motion]) * gradient
            names = (f"{place}.{kind}{axis}" for kind in "tr" for axis in AXES)
            bends.append({name: float(amount) for name, amount in zip(names, local, strict=True) if amount})
        return bends

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
