"""A minimal, complete set of error parameters: all effects on the tool, without redundancy.

Any joint, closure point or tool can be displaced in six ways, most of them redundant: an offset along the axis of a
revolute joint may be placed before or after it, and a rotation of a rod about its two spherical joints moves nothing.
Going through all parameters in an order of preference, each one is kept that moves the tool in a way that those kept
before do not. Their number is the rank of the sensitivities over the workspace, whatever the order, except for nearly
ineffective ones; for a serial arm with full poses it is 4 per revolute and 2 per prismatic joint, plus 6 (B. Mooring,
Z. Roth and M. Driels, Fundamentals of Manipulator Calibration, 1991).

A parameter that is kept stands for those that are not: of the four ends of a pair of rods only the differences move the
tool, and one of them, known to 0.1 mm as they all are, has to be as wide as all four, 0.2 mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from pm3dof_pin.description.error_file import ErrorEntry
from pm3dof_pin.errors.error_parameters import (
    ANGLE_TOLERANCE,
    LENGTH_TOLERANCE,
    GeometricErrors,
    GeometricParameter,
    TiedParameter,
    all_parameters,
)
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.sensitivity import closable, sensitivities
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Matrix

MIN_EFFECT = 3e-4
"""Effects that add less than this fraction of the greatest are left out: 30 nm if the greatest is 0.1 mm."""

_CLOSING = 20  # number of poses at which the loops must close
_MIN_POSES = 60
_DISTINCT = (0.1, 1e-2, 1e-3, 1e-8)  # independent fraction of an effect: more distinct ones go first
_ALIGNED = 0.99
_WIDER = 1.05  # times a tolerance: less is not worth a class of its own

Kind = Literal["zero of a drive", "length", "position", "axis of a drive", "direction", "tool"]
_PREFERENCE: tuple[Kind, ...] = ("zero of a drive", "length", "position", "axis of a drive", "direction", "tool")


def poses_needed(robot: Robot) -> int:
    """Return the number of poses needed to distinguish a robot's error parameters."""
    return max(_MIN_POSES, len(all_parameters(robot)) // 2)


def minimal_parameters(
    errors: GeometricErrors, poses: Poses, *, first: Iterable[str] = (), least_effect: float = MIN_EFFECT
) -> GeometricErrors:
    """Return the smallest set of parameters with the same effect on the tool as all of them.

    Preferred are, in this order, the zeros of the drives, lengths (from one place to the next), other positions, the
    axes of the drives, other directions, the tool; but of nearly redundant parameters, the more distinct one. The
    tolerances of those left out are counted in those kept, which then have classes of their own: "legs_140_um".

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.errors.minimal_parameters import minimal_parameters
        >>> robot = pm.load("hexapod")
        >>> poses = pm.reachable_poses(robot, 100, np.random.default_rng(0))
        >>> everything = pm.GeometricErrors(robot)
        >>> len(everything), len(minimal_parameters(everything, poses))
        (186, 48)

    Args:
        errors: the candidates, with their tolerances; those with which the loops cannot close are left out.
        poses: poses of the robot as described, over its whole workspace; see :func:`poses_needed`.
        first: names of parameters preferred to all others; their tolerances are declared, and kept.
        least_effect: parameters that add less than this fraction of the greatest effect are left out, such as an offset
            between the crossing axes of a joint that hardly rotates; 0 leaves out only those without any effect.

    Raises:
        InvalidValueError: a name of `first` is unknown.
        SingularConfigurationError: at some pose the tool can move with all drives locked.
    """
    preferred_names = set(errors.select(first).names)
    fitting = closable(errors, poses[:_CLOSING])
    kinds = [_PREFERENCE.index(kind_of(fitting.robot, parameter)) for parameter in fitting.parameters]
    numbers = range(len(fitting))
    preferred = [k for k in numbers if fitting.names[k] in preferred_names]
    others = sorted((k for k in numbers if fitting.names[k] not in preferred_names), key=lambda k: kinds[k])
    effects = _effects(fitting, poses)
    least = max(least_effect, SOLVED) * np.linalg.norm(effects, axis=0).max(initial=0.0)
    rounds = [(preferred, _DISTINCT[-1], 0.0), *((others, distinct, least) for distinct in _DISTINCT)]
    chosen = sorted(_independent(effects, rounds))
    # each of all parameters, one tolerance off, in tolerances of those chosen that do the same
    wider = np.linalg.norm(np.linalg.lstsq(effects[:, chosen], effects, rcond=None)[0], axis=1)
    kept = [
        parameter if parameter.name in preferred_names else _widened(parameter, factor)
        for parameter, factor in zip((fitting.parameters[k] for k in chosen), wider.tolist(), strict=True)
    ]
    return GeometricErrors(fitting.robot, kept, fixed_bearings=fitting.fixed_bearings, file=fitting.file)


def _widened(parameter: GeometricParameter | TiedParameter, factor: float) -> GeometricParameter | TiedParameter:
    """Return a parameter with a wider tolerance, to two digits, and a class named after it."""
    if factor < _WIDER:
        return parameter
    tolerance = float(f"{factor * parameter.tolerance:.2g}")
    unit = "um" if parameter.unit == "m" else "urad"
    return replace(parameter, group=f"{parameter.group}_{1e6 * tolerance:.6g}_{unit}", tolerance=tolerance)


def error_entries(errors: GeometricErrors) -> tuple[ErrorEntry, ...]:
    """Return parameters as entries of an error file; places of a class with the same errors share an entry."""
    lines: dict[tuple[str, tuple[str, ...], tuple[str, ...], str], list[str]] = {}
    for place in dict.fromkeys(parameter.place for parameter in errors.parameters):
        for group in errors.groups:
            parameters = [p for p in errors.parameters if (p.place, p.group) == (place, group)]
            translations, rotations = (
                tuple(dict.fromkeys(_word(p) for p in parameters if p.motion == motion))
                for motion in ("translation", "rotation")
            )
            if parameters:
                kind = "".join(character for character in place if not character.isdigit())
                lines.setdefault((group, translations, rotations, kind), []).append(place)
    return tuple(
        ErrorEntry(group, tuple(places), translations, rotations, *_tolerances(errors, group))
        for (group, translations, rotations, _), places in lines.items()
    )


def _effects(errors: GeometricErrors, poses: Poses) -> Matrix:
    """Return the effect of each parameter at its tolerance; its norm is the root mean square over the poses [m]."""
    rows = np.array(sensitivities(errors, poses, engine="pinocchio").errors)
    rows[:, 3:] *= TIP_LENGTH
    return np.asarray(rows.reshape(-1, len(errors)) * errors.tolerances / np.sqrt(len(poses)))


def _independent(effects: Matrix, rounds: Iterable[tuple[Sequence[int], float, float]]) -> set[int]:
    """Return columns that span all others, adding in each round those whose independent part is large enough."""
    triangle = np.asarray(np.linalg.qr(effects, mode="r"))
    norms = np.linalg.norm(triangle, axis=0)
    nothing = SOLVED * norms.max(initial=0.0)
    chosen: set[int] = set()
    for order, distinct, least in rounds:
        for k in order:
            own = triangle[:, k]
            size = float(np.linalg.norm(own))
            if k not in chosen and norms[k] > nothing and size > max(distinct * norms[k], least):
                chosen.add(k)
                for _ in range(2):  # repeated against rounding
                    triangle = triangle - np.outer(own, own @ triangle) / size**2
                    triangle[:, k] = 0.0
    return chosen


def kind_of(robot: Robot, parameter: GeometricParameter | TiedParameter) -> Kind:
    """Tell what a displacement is of a machine: the zero of a drive, a length, a direction."""
    model, place = robot.model, parameter.place
    if place in robot.rods:
        return "length"
    axis = np.array(parameter.axis)
    is_joint = model.existJointName(place)
    if is_joint and place in robot.actuated_joints:
        along = abs(robot.joint_axis(place)[int(np.argmax(np.abs(axis)))]) > 1.0 / np.sqrt(3.0)
        if along and parameter.unit == robot.single_joint(place).unit:
            return "zero of a drive"
    if place == robot.tool_frame:
        return "tool"
    if parameter.motion == "rotation":
        return "axis of a drive" if place in robot.actuated_joints else "direction"
    if is_joint:
        offset = model.jointPlacements[model.getJointId(place)]
    else:
        offset = model.frames[robot.frame_id(place)].placement
    translation = offset.rotation.T @ offset.translation
    distance = np.linalg.norm(translation)
    return "length" if distance > 0.0 and abs(translation @ axis) > _ALIGNED * distance else "position"


def _word(parameter: GeometricParameter | TiedParameter) -> str:
    """Return the word of the error file for a direction: an axis of the place, or along or across the joint's."""
    return parameter.name.rsplit(".", 1)[1][1:].strip("_12")


def _tolerances(errors: GeometricErrors, group: str) -> tuple[float, float]:
    found = {p.motion: p.tolerance for p in errors.parameters if p.group == group}
    return found.get("translation", LENGTH_TOLERANCE), found.get("rotation", ANGLE_TOLERANCE)
