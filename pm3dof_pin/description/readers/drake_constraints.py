"""The constraints that Drake adds to URDF and SDF: two points that coincide or keep a distance, and tendons."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

from pm3dof_pin.description.closure_types import ClosureTypeName
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import Joint, Placement
from pm3dof_pin.description.physical_bounds import ANY, LENGTH
from pm3dof_pin.description.readers.elements import ElementReader, named
from pm3dof_pin.description.xml_file import Element, children

POINT_CONSTRAINTS = ("drake:ball_constraint", "drake:distance_constraint")
TENDON_CONSTRAINT = "drake:tendon_constraint"


class PointConstraint(NamedTuple):
    """Two points of two bodies."""

    kind: ClosureTypeName
    bodies: tuple[str, str]
    points: tuple[Placement, Placement]
    length: float | None  #: distance that they keep [m]


def point_constraint(reader: ElementReader, element: Element) -> PointConstraint:
    """Read a `<drake:ball_constraint>` or `<drake:distance_constraint>`; a finite stiffness is read over."""
    part = _parts(element)
    bodies = ["", ""]
    points = [Placement(), Placement()]
    for index, (body, point) in enumerate((("body_A", "p_AP"), ("body_B", "p_BQ"))):
        end = part[body]
        bodies[index] = "" if end is None else end.get("name", "")
        points[index] = Placement(_triple(reader.numbers(part[point], "value", 3, LENGTH, named(element), (0.0,) * 3)))
    is_distance = element.tag == POINT_CONSTRAINTS[1]
    if (stiffness := part["stiffness"]) is not None and stiffness.get("value", "inf") not in ("inf", ".inf"):
        reader.read_over(stiffness, "the constraint is taken as rigid")
    length = None
    if is_distance:
        if part["distance"] is None:
            raise element.origin.error(named(element), "has no drake:distance_constraint_distance, expected one")
        (length,) = reader.numbers(part["distance"], "value", 1, LENGTH, f"{named(element)}: distance")
    return PointConstraint("distance" if is_distance else "3d", (bodies[0], bodies[1]), (points[0], points[1]), length)


def tendon_coupling(
    reader: ElementReader,
    element: Element,
    joints: Mapping[str, Joint],
    leading: Collection[str],
    followed: Collection[str],
    scope: str = "",
) -> Coupling | None:
    """Read a `<drake:tendon_constraint>` whose two limits are one; others, which are limits or springs, are refused.

    The sum of the joints' coordinates, each times its `a`, plus the offset is the limit. The joint that follows is the
    last that is neither `leading` nor `followed`.
    """
    part = _parts(element)
    factors: dict[str, float] = {}
    for entry in children(element, f"{TENDON_CONSTRAINT}_joint"):
        name = f"{scope}{entry.get('name', '')}"
        if name not in joints or not joints[name].is_single or name in factors:
            reader.refuse(element, f"expected existing single-DoF joints, each once, not '{name}'")
            return None
        (factors[name],) = reader.numbers(entry, "a", 1, ANY, named(element))
    offset, lower, upper = (
        reader.number(part[tag], "value", ANY, f"{named(element)}: {tag}", default)
        for tag, default in (("offset", 0.0), ("lower_limit", float("-inf")), ("upper_limit", float("inf")))
    )
    stiffness = part["stiffness"]
    if lower != upper or (stiffness is not None and stiffness.get("value", "inf") not in ("inf", ".inf")):
        reader.refuse(element, "expected equal limits and no stiffness: one that is slack or elastic is not supported")
        return None
    free = [name for name, factor in factors.items() if factor and name not in followed]
    name = next((name for name in reversed(free) if name not in leading), next(reversed(free), ""))
    others = [other for other in factors if other != name]
    if not name or not others:
        reader.refuse(element, "expected two joints or more, one of which follows no other")
        return None
    powers = tuple((-factors[other] / factors[name],) for other in others)
    return Coupling(name, tuple(others), powers, (lower - offset) / factors[name], element.origin)


class _Parts(dict[str, "Element | None"]):
    def __missing__(self, key: str) -> None:
        return None


def _parts(element: Element) -> _Parts:
    """Return the children by the end of their tags; a text, as SDF has it, becomes their value and name."""
    found = _Parts()
    for part in children(element):
        text = (part.text or "").strip()
        if text and "value" not in part.attrib:
            part.set("value", text)
            part.attrib.setdefault("name", text)
        found[part.tag.removeprefix(f"{element.tag}_")] = part
    return found


def _triple(numbers: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z
