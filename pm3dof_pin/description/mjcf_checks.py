"""Checks of the numbers of an MJCF file before it is parsed."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from pm3dof_pin.description.description import MAX_IN_A_ROW
from pm3dof_pin.description.inertia_checks import inertia_matrix, inertia_problem, is_reversed
from pm3dof_pin.description.physical_bounds import ANY, LENGTH, MASS, MOMENT, NOT_NEGATIVE, SIZE, Bounds, parse_numbers
from pm3dof_pin.description.xml_file import MOST_DEPTH
from pm3dof_pin.exceptions import DescriptionError

_NUMBERS: dict[str, tuple[Bounds, tuple[int, ...]]] = {
    "pos": (LENGTH, (3,)),
    "quat": (ANY, (4,)),
    "axis": (ANY, (3,)),
    "axisangle": (ANY, (4,)),
    "xyaxes": (ANY, (6,)),
    "zaxis": (ANY, (3,)),
    "euler": (ANY, (3,)),
    "fromto": (LENGTH, (6,)),
    "anchor": (LENGTH, (3,)),
    "relpose": (ANY, (7,)),
    "mass": (MASS, (1,)),
    "density": (NOT_NEGATIVE, (1,)),
    "diaginertia": (MOMENT, (3,)),
    "fullinertia": (ANY, (6,)),
    "armature": (NOT_NEGATIVE, (1,)),
    "gravity": (ANY, (3,)),
    "qpos": (ANY, ()),
    "qpos0": (ANY, ()),
    "ref": (ANY, (1,)),
    "springref": (ANY, (1,)),
}
"""Bounds of the numbers of an attribute and their permitted counts; any count if none is given."""

_JOINT_NUMBERS: dict[str, tuple[Bounds, tuple[int, ...]]] = {
    "stiffness": (Bounds("N/m or N m/rad", 1e18), ()),
    "damping": (NOT_NEGATIVE, ()),
    "frictionloss": (NOT_NEGATIVE, (1,)),
    "range": (ANY, (2,)),
}
_SHAPE_NUMBERS: dict[str, tuple[Bounds, tuple[int, ...]]] = {"size": (SIZE, (1, 2, 3))}
_MOST_FREE = 40  # free joints: the memory of Pinocchio's reader grows with their fourth power, a gigabyte for 50
_DIRECTIONS = ("quat", "axis", "zaxis")
_SECTIONS = ("worldbody", "default", "equality", "keyframe", "option")


def check_mjcf(root: ElementTree.Element, path: Path) -> None:
    """Check the size of an MJCF file and the numbers that Pinocchio reads, in included files too.

    Raises:
        DescriptionError: an attribute is not a number, not finite, negative where it must not be, or physically
            impossible; a direction is zero; moments of inertia have a wrong sign; a range is not in order; or there are
            too many joints, free bodies or nested bodies.
    """
    for section in (element for tag in _SECTIONS for element in root.findall(tag)):
        for element in section.iter():
            _check_element(element, path)
    classes = {"main", *(default.get("class") for default in root.iter("default"))}
    elements = [*root.findall("worldbody"), *root.findall("worldbody//*")]
    for element in elements:
        if unknown := {element.get("class", "main"), element.get("childclass", "main")} - classes:
            raise DescriptionError(path, f"<{element.tag}>", f"no default class '{unknown.pop()}' in <default>")
    joints = sum(element.tag.endswith("joint") for element in elements)
    if joints > MAX_IN_A_ROW:
        raise DescriptionError(path, "<worldbody>", f"has {joints} joints, expected at most {MAX_IN_A_ROW}")
    free = sum(element.tag == "freejoint" or element.get("type") == "free" for element in elements)
    if free > _MOST_FREE:
        raise DescriptionError(
            path, "<worldbody>", f"has {free} free bodies, expected at most {_MOST_FREE}: remove other objects"
        )
    for world in root.findall("worldbody"):
        if _depth(world) > MOST_DEPTH:
            raise DescriptionError(path, "<worldbody>", f"expected bodies at most {MOST_DEPTH} deep")


def _check_element(element: ElementTree.Element, path: Path) -> None:
    name = f" name='{element.get('name')}'" if "name" in element.attrib else ""
    place = f"<{element.tag}{name}>"
    rules = dict(_NUMBERS)
    if element.tag in ("joint", "freejoint"):
        rules |= _JOINT_NUMBERS
    if element.tag in ("geom", "site"):
        rules |= _SHAPE_NUMBERS
    values: dict[str, tuple[float, ...]] = {}
    for key, (bounds, counts) in rules.items():
        if key not in element.attrib or element.tag == "flag" or (key == "ref" and element.tag != "joint"):
            continue
        values[key], problem = parse_numbers(element.attrib[key], bounds)
        if not problem and counts and len(values[key]) not in counts:
            problem = f"expected {' or '.join(map(str, counts))} numbers, not '{element.attrib[key]}'"
        if not problem and key in _DIRECTIONS and not any(values[key]):
            problem = "expected a direction, not zero"
        if problem:
            raise DescriptionError(path, f"{place}: {key}", problem)
    if (ends := values.get("range")) and ends[0] > ends[1]:
        raise DescriptionError(path, f"{place}: range", f"expected lower <= upper, not {ends[0]:g} and {ends[1]:g}")
    if element.tag == "inertial":
        _check_inertia(values, path, place)


def _check_inertia(values: dict[str, tuple[float, ...]], path: Path, place: str) -> None:
    if "mass" not in values:
        raise DescriptionError(path, place, "has no mass, expected one")
    mass, moments = values["mass"][0], values.get("fullinertia") or (*values.get("diaginertia", (0.0,) * 3), 0, 0, 0)
    matrix = inertia_matrix(moments)
    if is_reversed(mass, matrix):
        raise DescriptionError(path, f"{place}: inertia", inertia_problem(mass, matrix))


def _depth(element: ElementTree.Element) -> int:
    deepest, level = 0, [element]
    while level:
        deepest, level = deepest + 1, [child for parent in level for child in parent]
    return deepest
