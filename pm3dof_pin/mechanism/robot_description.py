"""The content of a robot's files, or a robot of another library, as arguments of a mechanism."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pinocchio as pin

from pm3dof_pin.description import reading
from pm3dof_pin.description.description import Description
from pm3dof_pin.description.readers.mujoco_model import describe_mujoco
from pm3dof_pin.description.readers.pinocchio_model import closures_of_constraints
from pm3dof_pin.description.readers.urdf import read_urdf
from pm3dof_pin.description.robots import find_robot, path_of_module
from pm3dof_pin.description.xml_file import parse_xml
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.mechanism.model import UNLIMITED, build_model

_logger = logging.getLogger(__name__)


def read_source(
    source: object,
    *,
    tool_frame: str | None = None,
    package_paths: Iterable[str | Path] = (),
    xacro_args: Mapping[str, str] | None = None,
    lenient: bool = False,
    hold_base: bool = False,
    closures: Iterable[Any] = (),
) -> dict[str, Any]:
    """Read what :func:`pm3dof_pin.load` takes into the arguments of a mechanism.

    With `hold_base`, a floating base is fixed where the configuration `home` has it.

    Raises:
        InvalidValueError: it is none of these, or options of files are given for what is not read from one.
        DescriptionError, JointNotFoundError: as :func:`read_description`.
    """
    if isinstance(source, ModuleType):
        source = path_of_module(source)
    closures = tuple(closures)
    if closures and not isinstance(source, pin.Model):
        problem = "are for a pinocchio.Model; those of a description are part of it"
        raise InvalidValueError("closures", problem=problem)
    if isinstance(source, (str, Path)):
        files = find_robot(source, package_paths, xacro_args)
        return _arguments_of(reading.read_description(files, lenient=lenient), tool_frame, hold_base)
    if given := [name for name, value in (("package_paths", package_paths), ("xacro_args", xacro_args)) if value]:
        problem = f"are for descriptions in files, not for a {type(source).__name__}"
        raise InvalidValueError(given[0], problem=problem)
    if isinstance(source, Description):
        return _arguments_of(source, tool_frame, hold_base)
    if isinstance(source, pin.Model):
        model = source.copy()
        _free_joints_without_limits(model, (), source.name)
        return {"model": model, "closures": closures_of_constraints(model, closures), "tool_frame": tool_frame}
    libraries = {kind.__module__.partition(".")[0] for kind in type(source).__mro__}
    description: Description | None = None
    if "yourdfpy" in libraries:
        document: Any = source
        description = read_urdf(parse_xml(document.write_xml_string(), document.robot.name), lenient=lenient)
    elif "mujoco" in libraries and hasattr(source, "compile"):
        description = describe_mujoco(source.compile())
    elif "mujoco" in libraries and hasattr(source, "nbody"):
        description = describe_mujoco(source)
    if description is None:
        raise InvalidValueError(
            "robot",
            problem=f"is of type {type(source).__name__}",
            expected="the name of a robot, the path of its description, a pinocchio.Model, a yourdfpy.URDF, a "
            "mujoco.MjModel or MjSpec, or a module of robot_descriptions",
        )
    return _arguments_of(description, tool_frame, hold_base)


def _arguments_of(description: Description, tool_frame: str | None, hold_base: bool) -> dict[str, Any]:
    """Return a description, with another tool frame if one is given, as the arguments of a mechanism."""
    if tool_frame:
        description = replace(description, tool_frame=tool_frame)
    if hold_base:
        for body in description.floating_bodies:
            _logger.warning("%s: its base '%s' floats, and is held as at home", description.name, body)
        description = description.with_base_held()
    names = (
        *("closures", "couplings", "actuated_joints", "commands", "motion_coordinates", "coordinates", "limit_groups"),
        *("tool_frame", "tool_motions", "springs", "files", "closure_tolerance"),
    )
    given = {name: getattr(description, name) for name in names}
    return {"model": build_model(description), "description": description, **given}


def _free_joints_without_limits(model: pin.Model, actuated_joints: Sequence[str], path: Path | str) -> None:
    """Treat limits 0 .. 0 of all actuated joints as not given."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    joints = list(zip(model.names, model.joints, strict=True))[1:]
    single = {name: joint.idx_q for name, joint in joints if joint.nq == joint.nv == 1}
    blocked = {name for name, index in single.items() if lower[index] == upper[index] == 0.0}
    if blocked and blocked >= (set(actuated_joints) & single.keys() or single.keys()):
        _logger.warning(
            "%s: limits 0 .. 0 of %d joints, including all actuated ones, are treated as not given", path, len(blocked)
        )
        for name in blocked:
            lower[single[name]], upper[single[name]] = -UNLIMITED, UNLIMITED
