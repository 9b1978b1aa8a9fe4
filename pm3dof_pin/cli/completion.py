"""Shell completion of values, read from the description files without loading a robot."""

from __future__ import annotations

import os
from xml.etree import ElementTree

import typer

from pm3dof_pin.exceptions import PM3DofError


def robots(incomplete: str) -> list[str]:
    """Complete the name of a robot that comes with the package, or else of example-robot-data."""
    from pm3dof_pin.description.robots import example_robot_names, robot_names

    own = [name for name in robot_names() if name.startswith(incomplete)]
    return own or [name for name in example_robot_names() if name.startswith(incomplete)]


def quantities(incomplete: str) -> list[str]:
    """Complete the name of a quantity that can be mapped."""
    from pm3dof_pin.maps.quantities import QUANTITIES

    return [name for name in QUANTITIES if name.startswith(incomplete)]


def configurations(context: typer.Context, incomplete: str) -> list[str]:
    """Complete the name of a configuration in the SRDF of `--robot`."""
    from pm3dof_pin.description.robots import find_robot

    try:
        srdf = find_robot(context.params.get("robot") or os.environ.get("PM3DOF_ROBOT") or "pm3dof").srdf
        states = [] if srdf is None else list(ElementTree.parse(srdf).iter("group_state"))
    except (PM3DofError, OSError, ElementTree.ParseError):
        return []
    names = sorted({"home", *(state.get("name", "") for state in states)})
    return [name for name in names if name.startswith(incomplete)]


def coordinates(context: typer.Context, incomplete: str) -> list[str]:
    """Complete the name of a coordinate that `--robot` declares."""
    from pm3dof_pin.description.closures import read_closures
    from pm3dof_pin.description.robots import find_robot

    try:
        closures = find_robot(context.params.get("robot") or os.environ.get("PM3DOF_ROBOT") or "pm3dof").closures
        declared = () if closures is None else read_closures(closures).coordinates
    except PM3DofError:
        return []
    return [coordinate.name for coordinate in declared if coordinate.name.startswith(incomplete)]
