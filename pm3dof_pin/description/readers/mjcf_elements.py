"""Elements of MJCF with the attributes of their default classes; poses and ranges in all of MJCF's forms."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.physical_bounds import ANY, LENGTH, Bounds
from pm3dof_pin.description.readers.elements import ElementReader, named
from pm3dof_pin.description.readers.mjcf_document import TIMES, MjcfDocument
from pm3dof_pin.description.xml_file import Element

STIFFNESS = Bounds("N/m or N m/rad", 1e18)
"""Bounds of the stiffness of joints and tendons, of which 0 means none."""


class MjcfElements(ElementReader):
    """Reads the elements of a document.

    Args:
        document: the document.
        lenient: as of :class:`~pm3dof_pin.description.readers.elements.ElementReader`.
    """

    def __init__(self, document: MjcfDocument, *, lenient: bool) -> None:
        super().__init__(document.path, lenient=lenient)
        self.document = document

    def resolved(self, element: Element, default_class: str, kind: str = "") -> Element:
        """Return an element with the attributes of its default class."""
        resolved = Element(element.tag, self.document.defaults.attributes(element, default_class, kind))
        resolved.path, resolved.line = element.path, element.line
        return resolved

    def limits(self, element: Element, key: str, place: str, unit: float) -> tuple[float | None, float | None]:
        """Return a range in SI units, None where it is not given."""
        if key not in element.attrib:
            return None, None
        lower, upper = self.numbers(element, key, 2, ANY, place)
        if lower > upper:
            raise element.origin.error(f"{place}: {key}", f"expected lower <= upper, not {lower:g} and {upper:g}")
        return unit * lower, unit * upper

    def is_limited(self, element: Element, given: Element, key: str) -> bool:
        """Tell whether a range holds; `given` is the element as it stands in the file."""
        value = element.get(key, "auto")
        if value == "auto":
            return self.document.compiler_of(given).get("autolimits", "true") != "false"
        return value == "true"

    def angle_unit(self, element: Element) -> float:
        """Return the unit of angles at an element [rad]."""
        return 1.0 if self.document.compiler_of(element).get("angle") == "radian" else math.radians(1.0)

    def pose(self, element: Element, given: Element | None = None) -> pin.SE3:
        """Return the position and orientation of an element, in any of MJCF's forms."""
        given = element if given is None else given
        place = named(given)
        position = np.array(self.numbers(element, "pos", 3, LENGTH, place, (0.0, 0.0, 0.0)))
        pose = pin.SE3(self._rotation(element, given, place), position)
        if TIMES not in element.attrib:
            return pose
        repeated = pin.SE3.Identity()
        for _ in range(int(element.attrib[TIMES])):
            repeated = repeated * pose
        return repeated

    def _rotation(self, element: Element, given: Element, place: str) -> np.ndarray:
        attributes = element.attrib
        if "quat" in attributes:
            w, x, y, z = self._direction(element, "quat", 4, place)
            return np.asarray(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())
        if "axisangle" in attributes:
            *axis, angle = self.numbers(element, "axisangle", 4, ANY, place)
            length = np.linalg.norm(axis)
            if not length:
                raise given.origin.error(f"{place}: axisangle", "expected a direction, not zero")
            turn = pin.AngleAxis(self.angle_unit(given) * angle, np.array(axis) / length)
            return np.asarray(turn.toRotationMatrix())
        if "xyaxes" in attributes:
            numbers = np.array(self.numbers(element, "xyaxes", 6, ANY, place))
            first, second = numbers[:3], numbers[3:]
            normal = np.cross(first, second)
            if not normal.any():
                raise given.origin.error(f"{place}: xyaxes", "expected two directions")
            columns = [first, np.cross(normal, first), normal]
            return np.stack([column / np.linalg.norm(column) for column in columns], axis=1)
        if "zaxis" in attributes:
            return least_turn_of_z(np.array(self._direction(element, "zaxis", 3, place)))
        if "euler" in attributes:
            angles = self.angle_unit(given) * np.array(self.numbers(element, "euler", 3, ANY, place))
            sequence = self.document.compiler_of(given).get("eulerseq", "xyz")
            if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
                raise given.origin.error(
                    "<compiler>: eulerseq", f"expected three of x, y, z, X, Y, Z, not '{sequence}'"
                )
            rotation = np.eye(3)
            for letter, angle in zip(sequence, angles, strict=True):
                turn = pin.AngleAxis(float(angle), np.eye(3)["xyz".index(letter.lower())]).toRotationMatrix()
                rotation = rotation @ turn if letter.islower() else turn @ rotation  # about turned, or fixed axes
            return np.asarray(rotation)
        return np.eye(3)

    def _direction(self, element: Element, key: str, count: int, place: str) -> tuple[float, ...]:
        numbers = self.numbers(element, key, count, ANY, place)
        if not any(numbers):
            raise element.origin.error(f"{place}: {key}", "expected a direction, not zero")
        return numbers


def least_turn_of_z(direction: np.ndarray) -> np.ndarray:
    """Return the least rotation that takes z to a direction, shape=(3, 3)."""
    length = np.linalg.norm(direction)
    if not length:
        return np.eye(3)
    return np.asarray(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction / length).toRotationMatrix())
