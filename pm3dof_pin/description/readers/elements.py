"""What all readers of XML dialects need: checked numbers, and elements that they do not know."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Set
from pathlib import Path
from typing import overload

from pm3dof_pin.description.description import Unread
from pm3dof_pin.description.physical_bounds import ANY, Bounds, parse_numbers
from pm3dof_pin.description.xml_file import Element

_ALIKE = 0.75  # likeness of a name to a known one, from 0 to 1, that makes it a typing error
_SHORT, _ALIKE_IF_SHORT = 3, 0.6  # letters of a name that is short, and the likeness there: of xyx to xyz 2/3
_LONGER = 2  # letters by which a typing error is longer or shorter
_CARRIES = ("joint", "loop", "constraint", "coupling", "gear", "mimic", "closure", "transmission", "actuator", "tendon")
_ENDS = frozenset({
    "parent", "child", "link", "link1", "link2", "predecessor", "successor", "body_a", "body_b", "joint1", "joint2",
})  # fmt: skip


class ElementReader:
    """Reads the elements of one file, and records what it reads over.

    Args:
        path: the file.
        lenient: whether elements that could carry a loop, a coupling or a drive, and are not understood, are read over
            like all others instead of being refused.
    """

    def __init__(self, path: Path | str, *, lenient: bool = False) -> None:
        self.path = path
        self.lenient = lenient
        self.unread: list[Unread] = []

    @overload
    def number(self, element: Element | None, key: str, bounds: Bounds, place: str, default: float) -> float: ...
    @overload
    def number(self, element: Element | None, key: str, bounds: Bounds, place: str, default: None) -> float | None: ...
    def number(
        self, element: Element | None, key: str, bounds: Bounds, place: str, default: float | None
    ) -> float | None:
        """Return an attribute that is one number, or the default if it is not given."""
        if element is None or key not in element.attrib:
            return default
        return self.numbers(element, key, 1, bounds, place)[0]

    def numbers(
        self,
        element: Element | None,
        key: str,
        count: int | None,
        bounds: Bounds = ANY,
        place: str = "",
        default: tuple[float, ...] | None = None,
    ) -> tuple[float, ...]:
        """Return an attribute of `count` numbers, or the default; DescriptionError if it is missing or malformed."""
        if element is None or key not in element.attrib:
            if default is not None:
                return default
            assert element is not None
            many = "one" if count == 1 else f"{count} numbers"
            raise element.origin.error(place, f"has no {key}, expected {many}")
        numbers, problem = parse_numbers(element.attrib[key], bounds, None if count == 1 else count)
        if count == 1 and len(numbers) != 1 and not (problem and numbers):
            problem = f"expected a number, not '{element.attrib[key]}'"
        if problem:
            raise element.origin.error(f"{place}: {key}" if place else key, problem)
        return numbers

    def read_over(self, element: Element, reason: str = "") -> None:
        """Record an element that has no meaning here."""
        self.unread.append(Unread(named(element), element.origin, reason))

    def refuse(self, element: Element, reason: str) -> None:
        """Refuse an element that could carry a loop, a coupling or a drive, unless the reader is lenient."""
        if not self.lenient:
            advice = "lenient=True, or --lenient, reads over it"
            raise element.origin.error(named(element), f"{reason}: {advice}")
        self.read_over(element, reason)

    def check_children(
        self, element: Element, known: Collection[str], passed: Collection[str] = (), attributes: Set[str] = frozenset()
    ) -> None:
        """Record the children and attributes that are neither known nor `passed`; refuse those that look like a slip.

        A child is refused whose name is nearly a known one, or which connects bodies or joints; an attribute, whose
        name is nearly a known one.
        """
        for child in element:
            if child.tag in known or not isinstance(child, Element):
                continue
            if child.tag in passed:
                self.read_over(child)
            elif slip := _nearest(child.tag, known):
                self.refuse(child, f"is unknown in <{element.tag}>, expected <{slip}>?")
            elif any(word in child.tag.lower() for word in _CARRIES) and _ENDS & {part.tag for part in child.iter()}:
                self.refuse(child, f"is unknown in <{element.tag}> and may connect bodies")
            else:
                self.read_over(child, "unknown")
        if attributes:
            for key in sorted(element.attrib.keys() - attributes):
                if slip := _nearest(key, attributes - element.attrib.keys()):
                    self.refuse(element, f"has an unknown attribute '{key}', expected '{slip}'?")
                elif not key.startswith(("xmlns", "xsi:", "xml:")):
                    self.unread.append(Unread(f"{named(element)} {key}", element.origin, "unknown attribute"))


def named(element: Element) -> str:
    """Return an element's tag with its name, as messages show it."""
    name = element.get("name")
    return f"<{element.tag} name='{name}'>" if name else f"<{element.tag}>"


def free_name(name: str, taken: Collection[str] | Mapping[str, object], suffix: str = "_") -> str:
    """Return a name that is not taken, by appending suffixes."""
    while name in taken:
        name += suffix
    return name


def _nearest(name: str, known: Collection[str]) -> str:
    alike = [word for word in known if abs(len(word) - len(name)) <= _LONGER]
    cutoff = _ALIKE if len(name) > _SHORT else _ALIKE_IF_SHORT
    return next(iter(difflib.get_close_matches(name.lower(), alike, n=1, cutoff=cutoff)), "")
