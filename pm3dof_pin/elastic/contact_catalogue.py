"""Contacts of common machine elements by name, from `contacts.yaml` beside this file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from pm3dof_pin.description.schema import Positive, PositiveLength, Schema, checked
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.elastic.contact_laws import ContactLaw
from pm3dof_pin.elastic.hertz import ball_between_races, in_series, point_contact

_FILE = Path(__file__).with_name("contacts.yaml")
_BALLS = 1.5  # exponent of point contacts


class _Entry(Schema):
    of: str
    source: str
    ball: PositiveLength
    preload: Positive
    share: Positive


class _BallScrew(_Entry):
    kind: Literal["ball_screw"]
    diameter: PositiveLength
    lead: PositiveLength
    turns: Positive
    contact_angle: Positive
    conformity: Positive

    def coefficient(self) -> float:
        """C of the axial force on all balls, each pressed against both grooves at the contact angle."""
        angle = math.radians(self.contact_angle)
        helix = math.atan2(self.lead, math.pi * self.diameter)
        count = self.turns * math.pi * self.diameter / math.cos(helix) / self.ball
        inner, outer = (
            sign * 2.0 * math.cos(angle) / (self.diameter - sign * self.ball * math.cos(angle)) for sign in (1, -1)
        )
        one = ball_between_races(self.ball, self.conformity, inner, outer)
        return count * one * math.pow(math.sin(angle) * math.cos(helix), 1.0 + _BALLS)


class _GuideCarriage(_Entry):
    kind: Literal["guide_carriage"]
    balls: Positive
    contact_angle: Positive
    conformity: Positive

    def coefficient(self) -> float:
        """C of the force on two of four rows of balls, inclined by the contact angle; grooves are straight."""
        one = ball_between_races(self.ball, self.conformity, 0.0, 0.0)
        return 2.0 * self.balls * one * math.pow(math.sin(math.radians(self.contact_angle)), 1.0 + _BALLS)


class _SphericalJoint(_Entry):
    kind: Literal["spherical_joint"]
    diameter: PositiveLength
    balls: Positive

    def coefficient(self) -> float:
        """C of the law with the stiffness and the preload of balls spread evenly over a sphere.

        With N balls of force Q and stiffness q each, the preload of a hemisphere is N Q / 4 and the stiffness N q / 3.
        """
        inner, outer = 2.0 / self.ball + 2.0 / self.diameter, 2.0 / self.ball - 2.0 / (self.diameter + 2.0 * self.ball)
        one = in_series(point_contact((inner, inner)), point_contact((outer, outer)))
        force = 4.0 * self.preload / self.balls
        stiffness = self.balls / 3.0 * _stiffness(one, force)
        return math.pow(stiffness / (2.0 * _BALLS), _BALLS) / math.pow(self.preload, _BALLS - 1.0)


_Kind = _BallScrew | _GuideCarriage | _SphericalJoint
_KINDS: dict[str, type[_Kind]] = {
    "ball_screw": _BallScrew,
    "guide_carriage": _GuideCarriage,
    "spherical_joint": _SphericalJoint,
}


@dataclass(frozen=True)
class Contact:
    """A contact of the catalogue."""

    name: str  #: its name
    of: str  #: what it is
    source: str  #: where its numbers come from
    coefficient: float  #: C of one side, F = C d^(3/2) [N/m^1.5]
    preload: float  #: usual preload [N]
    share: float  #: of the stiffness that is left with the parts around the balls

    def spring(self, *, preload: float | None = None, play: float | None = None) -> tuple[float, ContactLaw]:
        """Return the stiffness [N/m] and the law of the contact under a preload [N], by default the usual one.

        With a play [m] to either side instead, the stiffness is that under a load of the usual preload.
        """
        force = self.preload if preload is None else preload
        # two opposed contacts share the work of a preload; with play only one bears
        sides = 2.0 if play is None else 1.0
        stiffness = sides * self.share * _stiffness(self.coefficient, force)
        law = ContactLaw(preload=force) if play is None else ContactLaw(play=play, load=force)
        return stiffness, law


@cache
def contacts() -> dict[str, Contact]:
    """Return the contacts of the catalogue by name."""
    found = {}
    for name, entry in read_mapping(_FILE).items():
        form = checked(entry, _KINDS[entry["kind"]], _FILE, name)
        found[name] = Contact(name, form.of, form.source, form.coefficient(), form.preload, form.share)
    return found


def _stiffness(coefficient: float, force: float) -> float:
    """Return the stiffness dF/dd of F = C d^n at a force."""
    return _BALLS * math.pow(coefficient, 1.0 / _BALLS) * math.pow(force, 1.0 - 1.0 / _BALLS)
