"""Quantities of any robot: commands, stiffness, frequencies, forces, distances from singularities."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices, natural_frequencies
from pm3dof_pin.elastic.quantities import (
    AXIS_STIFFNESS,
    COMPLIANCE,
    CONDITIONING,
    PRINCIPAL_STIFFNESS,
    STIFFNESS,
    ElasticQuantity,
    free_stiffness,
    spring_shares,
)
from pm3dof_pin.kinematics.singularity_measures import singularity_measures
from pm3dof_pin.maps.quantity import Dimension, Evaluation, MappedRobot, Quantity
from pm3dof_pin.typing import Array

_MODES = 6


def has_drives_and_tool(mapped: MappedRobot) -> bool:
    """Tell whether the robot has drives and a tool."""
    return mapped.robot.tool_frame is not None and bool(mapped.robot.actuated_joints)


def drives_hold_tool(mapped: MappedRobot) -> bool:
    """Tell whether the robot has drives and a tool, which these determine at usual poses, if they are enough."""
    return has_drives_and_tool(mapped) and not mapped.robot.drives_are_dependent


def _command_unit(mapped: MappedRobot) -> str:
    """Return the units of the commands."""
    return _listed_units((command.unit, command.name) for command in mapped.robot.commands)


def _chatter_free_cutting(negative_real_part: Array) -> Array:
    """Return -1 / (2 Re G) at the most negative Re G (J. Tlusty and M. Polacek, 1963); infinite if it never is."""
    with np.errstate(divide="ignore"):
        return np.asarray(-0.5 / np.where(negative_real_part < 0.0, negative_real_part, -0.0))


def _force_unit(mapped: MappedRobot) -> str:
    """Return the units of the forces of the actuated joints."""
    robot = mapped.robot
    return _listed_units(("N" if robot.single_joint(n).translates else "N m", n) for n in robot.actuated_joints)


def _listed_units(entries: Iterable[tuple[str, str]]) -> str:
    """Return units; if they differ, each followed by the names that have it."""
    by_unit: dict[str, list[str]] = {}
    for unit, name in entries:
        by_unit.setdefault(unit, []).append(name)
    if len(by_unit) == 1:
        return next(iter(by_unit))
    return ", ".join(f"{unit} ({', '.join(names)})" for unit, names in by_unit.items())


def _free_motion_names(mapped: MappedRobot) -> tuple[str, ...]:
    """Return the names of the robot's free motions."""
    motions = mapped.free_motions
    return () if motions is None else motions.names


def _free_motion_unit(mapped: MappedRobot) -> str:
    """Return the units of the free motions' stiffnesses, with the diagonal entries in brackets."""
    motions = mapped.free_motions
    if motions is None:
        return "1"
    names = {
        unit: [name for name, own in zip(motions.names, motions.units, strict=True) if own == unit]
        for unit in ("m", "rad")
    }
    listed = [f"{word} ({', '.join(names[unit])})" for unit, word in (("m", "N/m"), ("rad", "N m/rad")) if names[unit]]
    return ", ".join(listed)


def _part_of(source: ElasticQuantity, part: Any = np.s_[...]) -> Callable[[Evaluation], Array]:
    """Return a function that reads a part of an elastic quantity."""
    return lambda evaluation: evaluation.elastic(source)[part]


def _condition_number(evaluation: Evaluation) -> Array:
    values = evaluation.elastic(CONDITIONING)
    with np.errstate(divide="ignore"):
        ratio: Array = values[..., _MODES - 1] / values[..., 0]
    return ratio


def _spring_shares(evaluation: Evaluation) -> Array:
    return evaluation.elastic(spring_shares(evaluation.mapped.elastic))


def _frequencies(evaluation: Evaluation, count: int = _MODES) -> Array:
    return natural_frequencies(evaluation.mapped.elastic, evaluation.poses, count=count, **evaluation.batch)


def _holding_forces(evaluation: Evaluation) -> Array:
    return actuator_forces(evaluation.mapped.robot, evaluation.poses, **evaluation.batch)


def _drive_inertia(evaluation: Evaluation) -> Array:
    return drive_mass_matrices(evaluation.mapped.robot, evaluation.poses, **evaluation.batch)


def _singularity_distance(evaluation: Evaluation) -> Array:
    mapped = evaluation.mapped
    return singularity_measures(mapped.robot, evaluation.poses, mapped.usual_mobility, **evaluation.batch)


def _free_stiffness(evaluation: Evaluation) -> Array:
    motions = evaluation.mapped.free_motions
    assert motions is not None  # it exists
    return evaluation.elastic(free_stiffness(evaluation.mapped.elastic, motions.components))


_SIX = tuple(str(number + 1) for number in range(_MODES))  # ascending values
_AXIS = Dimension("axis", lambda mapped: TOOL_COMPONENTS)
_AXES = (_AXIS, Dimension("axis_2", _AXIS.labels))
_PRINCIPAL = (Dimension("principal", lambda mapped: ("least", "middle", "greatest")),)
_SPRING = Dimension("spring", lambda mapped: mapped.elastic.spring_names)
_DRIVE = Dimension("drive", lambda mapped: mapped.robot.actuated_joints)
_STIFFNESS = (_part_of(STIFFNESS), "N/m, N, N m/rad", "elastic stiffness at the tool, axes of the base", _AXES)
_COMPLIANCE = (_part_of(COMPLIANCE), "m/N, 1/N, rad/(N m)", "elastic compliance at the tool", _AXES)

ROBOT_QUANTITIES = (
    Quantity("K", *_STIFFNESS),
    Quantity("stiffness", *_STIFFNESS),
    Quantity("C", *_COMPLIANCE),
    Quantity("compliance", *_COMPLIANCE),
    Quantity(
        "felt_stiffness",
        _part_of(AXIS_STIFFNESS),
        "N/m (x, y, z), N m/rad (rx, ry, rz)",
        "felt stiffness, all other motions free",
        (_AXIS,),
    ),
    Quantity(
        "translational_stiffness",
        _part_of(PRINCIPAL_STIFFNESS, np.s_[..., 0, :]),
        "N/m",
        "principal translational stiffnesses, rotations free",
        _PRINCIPAL,
    ),
    Quantity(
        "rotational_stiffness",
        _part_of(PRINCIPAL_STIFFNESS, np.s_[..., 1, :]),
        "N m/rad",
        "principal rotational stiffnesses, translations free",
        _PRINCIPAL,
    ),
    Quantity(
        "eigenvalues",
        _part_of(CONDITIONING, np.s_[..., :_MODES]),
        "N/m",
        "eigenvalues of K at its characteristic length",
        (Dimension("mode", lambda mapped: _SIX),),
    ),
    Quantity("condition_number", _condition_number, "1", "condition number of K at its characteristic length"),
    Quantity(
        "characteristic_length",
        _part_of(CONDITIONING, np.s_[..., _MODES]),
        "m",
        "length that makes rotations as stiff as translations",
    ),
    Quantity("spring_shares", _spring_shares, "1", "share of each spring in the deflection", (_AXIS, _SPRING)),
    Quantity(
        "natural_frequencies",
        _frequencies,
        "Hz",
        "lowest natural frequencies",
        (Dimension("natural_mode", lambda mapped: _SIX),),
    ),
    Quantity(
        "first_frequency", lambda evaluation: _frequencies(evaluation, 1)[..., 0], "Hz", "lowest natural frequency"
    ),
    Quantity(
        "dynamic_stiffness_minimum",
        lambda evaluation: evaluation.dynamic_stiffness.minimum,
        "N/m (x, y, z), N m/rad (rx, ry, rz)",
        "least dynamic stiffness along each axis, over all frequencies",
        (_AXIS,),
        has_drives_and_tool,
    ),
    Quantity(
        "critical_frequency",
        lambda evaluation: evaluation.dynamic_stiffness.critical_frequency,
        "Hz",
        "frequency of the least dynamic stiffness along each axis",
        (_AXIS,),
        has_drives_and_tool,
    ),
    Quantity(
        "negative_real_part",
        lambda evaluation: evaluation.dynamic_stiffness.negative_real_part,
        "m/N (x, y, z), rad/(N m) (rx, ry, rz)",
        "most negative real part of the receptance along each axis, which limits the depth of cut",
        (_AXIS,),
        has_drives_and_tool,
    ),
    Quantity(
        "chatter_free_cutting",
        lambda evaluation: _chatter_free_cutting(evaluation.dynamic_stiffness.negative_real_part),
        "N/m (x, y, z), N m/rad (rx, ry, rz)",
        "cutting force per chip thickness along each axis below which no cut chatters: depth limit times K_s",
        (_AXIS,),
        has_drives_and_tool,
    ),
    Quantity(
        "holding_forces",
        _holding_forces,
        _force_unit,
        "drive forces that hold the weight",
        (_DRIVE,),
        drives_hold_tool,
    ),
    Quantity(
        "drive_inertia",
        _drive_inertia,
        "kg, kg m, kg m^2",
        "mass matrix as seen by the drives",
        (_DRIVE, Dimension("drive_2", _DRIVE.labels)),
        drives_hold_tool,
    ),
    Quantity(
        "singularity_distance",
        _singularity_distance,
        "1",
        "least scaled singular value of each type of singularity, zero where it is singular",
        (Dimension("singularity", lambda mapped: mapped.singularity_types),),
        has_drives_and_tool,
    ),
    Quantity(
        "commands",
        lambda evaluation: evaluation.poses.commands,
        _command_unit,
        "readings of the drives' counters",
        (Dimension("command", lambda mapped: tuple(command.name for command in mapped.robot.commands)),),
    ),
    Quantity(
        "branch",
        lambda evaluation: evaluation.poses.branch.astype(float),
        "1",
        "branch of the pose, 0 for that of home",
        exists=lambda mapped: mapped.robot.has_loops,
    ),
    Quantity(
        "free_stiffness",
        _free_stiffness,
        _free_motion_unit,
        "stiffness of the free motions",
        (Dimension("free_motion", _free_motion_names), Dimension("free_motion_2", _free_motion_names)),
        lambda mapped: mapped.free_motions is not None,
    ),
)
"""The quantities that any robot can have."""
