"""The closures file as text, generated from a robot's xacro."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import yaml

from pm3dof_pin.elastic.springs import RIGID
from pm3dof_pin.exceptions import DescriptionError

_HEADER = """\
# Loop closures, which a URDF, being a tree, cannot describe. Generated from the YAML in config/: edit that instead.
# The first five keys are those of the robot.yaml files of example-parallel-robots.

# Loop closures: the origins of the two frames coincide ('3d', a spherical joint), or the frames do ('6d', a weld).
"""
_TOOL = "\n# Tool frame\n"
_COUNTING = "# Components of its twist that make up its motion\n"
_MOTIONS = "\n# Joints whose rates are the platform's independent motions\n"
_COMMANDS = """
# Counter readings of the drives: scale (default 1) times the joint coordinate plus offset (default 0)
"""
_COORDINATES = """
# Coordinates of the tool: a joint coordinate, scaled and shifted in the same way, or a component (tool:) of
# the tool's pose in the base, x, y, z, rx, ry, rz with R = Rx(rx) Ry(ry) Rz(rz)
"""
_GROUPS = "\n# Named groups of limits: joints, and closures as frame_a-frame_b\n"
_LIMITS = "\n# Maximum angle between the z axes of the two frames of a closure [rad]\n"
_SPRINGS = "\n# Springs, in m, N, rad; matrices in the order x, y, z, rx, ry, rz, in the axes of `at`\n"
_TAGS = ("closure", "actuated", "tool", "motion", "coordinate", "limits", "spring")
_NAMES = {"name", "type", "joint", "at", "unit", "frame", "frame_a", "frame_b", "command", "tool", "limits"}


def closures_text(xacro: Path, expanded: str) -> str:
    """Write the expanded xacro of a closures file as YAML.

    Its root element contains, in any order: `<closure frame_a= frame_b= type=>` for each loop, with `swing_rad=` if
    there is such a limit and `limits=` if it belongs to a limit group; `<actuated joint=>`, with `command=`, the name
    of its counter reading, and `unit=`, `offset=`, `scale=` of that; `<tool frame=>`, with `motions=` unless all six
    components of its twist are its motion; `<motion joint=>`; `<coordinate>` with its keys as attributes, and its range
    as `lower=` and `upper=`; `<limits name= joint=>` for a joint in a limit group; `<spring>` with the keys of its type
    as attributes (a matrix as its numbers, row by row) or, if they are mappings, as children.

    Raises:
        DescriptionError: an element is malformed.
    """
    root = ElementTree.fromstring(expanded)
    try:
        return _text(root)
    except _FormError as error:
        raise DescriptionError(xacro, error.element, error.expected) from error


class _FormError(Exception):
    """An element is malformed."""

    def __init__(self, element: ElementTree.Element, expected: str) -> None:
        name = f" name='{element.get('name')}'" if "name" in element.attrib else ""
        self.element = f"<{element.tag}{name}>"
        self.expected = expected
        super().__init__(expected)


def _text(root: ElementTree.Element) -> str:
    for element in root:
        if element.tag not in _TAGS:
            raise _FormError(element, f"expected {', '.join(_TAGS[:-1])} or {_TAGS[-1]}")
    loops = root.findall("closure")
    text = _HEADER
    text += f"closed_loop: {_list(_list([_entry(loop, 'frame_a'), _entry(loop, 'frame_b')]) for loop in loops)}\n"
    text += f"type: {_list(repr(_entry(loop, 'type')) for loop in loops)}\n"
    text += f"name_mot: {_list(_entry(element, 'joint') for element in root.findall('actuated'))}\n"
    text += "joint_name: []\njoint_type: []\n"
    for tool in root.findall("tool"):
        text += f"{_TOOL}tool_frame: {_entry(tool, 'frame')}\n"
        if counting := tool.get("motions", "").split():
            text += f"{_COUNTING}tool_motions: {_list(counting)}\n"
    if motions := [_entry(element, "joint") for element in root.findall("motion")]:
        text += f"{_MOTIONS}motion_coordinates: {_list(motions)}\n"
    if commands := [element for element in root.findall("actuated") if "command" in element.attrib]:
        text += _COMMANDS + _block("commands", map(_command, commands))
    if coordinates := root.findall("coordinate"):
        text += _COORDINATES + _block("coordinates", map(_coordinate, coordinates))
    if groups := _limit_groups(root):
        text += f"{_GROUPS}limit_groups:\n" + "".join(f"  {name}: {_list(of)}\n" for name, of in groups.items())
    if any("swing_rad" in loop.attrib for loop in loops):
        text += _LIMITS + _block("closure_limits", map(_limit, loops))
    if springs := root.findall("spring"):
        text += _SPRINGS + _block("springs", map(_spring, springs))
    return text


def _block(key: str, entries: Iterable[str]) -> str:
    return f"{key}:\n" + "".join(f"  - {entry}\n" for entry in entries)


def _command(drive: ElementTree.Element) -> str:
    keys = ("command", "joint", "unit", *(key for key in ("offset", "scale") if key in drive.attrib))
    return _mapping({"name" if key == "command" else key: _entry(drive, key) for key in keys})


def _coordinate(element: ElementTree.Element) -> str:
    entries = {key: _entry(element, key) for key in element.attrib if key not in ("lower", "upper")}
    if {"lower", "upper"} & set(element.attrib):
        entries["range"] = _list([_entry(element, "lower"), _entry(element, "upper")])
    return _mapping(entries)


def _limit_groups(root: ElementTree.Element) -> dict[str, list[str]]:
    groups: dict[str, list[str]] = {}
    for element in root:
        if element.tag == "limits":
            groups.setdefault(_entry(element, "name"), []).append(_entry(element, "joint"))
        elif "limits" in element.attrib:
            closure = f"{_entry(element, 'frame_a')}-{_entry(element, 'frame_b')}"
            groups.setdefault(_entry(element, "limits"), []).append(closure)
    return groups


def _limit(loop: ElementTree.Element) -> str:
    return f"{{swing_rad: {_entry(loop, 'swing_rad')}}}" if "swing_rad" in loop.attrib else "null"


def _spring(spring: ElementTree.Element) -> str:
    entries = {key: _entry(spring, key) for key in spring.attrib if key != "matrix"}
    entries |= {child.tag: _mapping({key: _entry(child, key) for key in child.attrib}) for child in spring}
    return _mapping(entries | ({"matrix": _matrix(spring)} if "matrix" in spring.attrib else {}))


def _matrix(spring: ElementTree.Element) -> str:
    numbers = _numbers(spring, "matrix")
    size = math.isqrt(len(numbers))
    if size**2 != len(numbers):
        raise _FormError(spring, f"matrix: expected a square one, not {len(numbers)} numbers")
    rows = ",\n".join(f"       {_list(numbers[size * row : size * (row + 1)])}" for row in range(size))
    return f"[\n{rows}]"


def _entry(element: ElementTree.Element, key: str) -> str:
    """Write an attribute as YAML: a name, the index of a closure, or one or more numbers."""
    if key in _NAMES:
        if name := element.get(key):
            return name if yaml.safe_load(name) == name else repr(name)
        raise _FormError(element, f"expected the attribute '{key}'")
    if key == "closure":
        return element.attrib[key]
    if key not in element.attrib:
        raise _FormError(element, f"expected the attribute '{key}'")
    if element.attrib[key] == RIGID:
        return RIGID
    numbers = _numbers(element, key)
    return numbers[0] if len(numbers) == 1 else _list(numbers)


def _numbers(element: ElementTree.Element, key: str) -> list[str]:
    text = element.attrib[key]
    try:
        numbers = [repr(float(word)) for word in text.split()]
    except ValueError as error:
        raise _FormError(element, f"{key}: expected numbers, not '{text}'") from error
    if not numbers:
        raise _FormError(element, f"{key}: expected numbers, not '{text}'")
    # YAML 1.1 requires a point before the exponent
    return [number if "." in number else number.replace("e", ".0e") for number in numbers]


def _list(entries: Iterable[str]) -> str:
    return f"[{', '.join(entries)}]"


def _mapping(entries: Mapping[str, str]) -> str:
    return f"{{{', '.join(f'{key}: {entry}' for key, entry in entries.items())}}}"
