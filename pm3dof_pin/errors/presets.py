"""Sets of error parameters as people parametrise machines, by name.

==================  ====================================================================================================
complete            the smallest set with the same effect on the tool as all errors; zeros of drives nearly free
dh                  the same of a serial arm: four for each joint, as in Denavit and Hartenberg's convention
zeros-only          the zero of each drive: after a motor or a belt was changed
firmware-delta-6    what the firmware of linear delta printers has: radius, three end stops, two towers' places along
                    the tangent (their angles)
firmware-delta-7    and the length of all arms
firmware-delta-9    and the length of each tower's arms
==================  ====================================================================================================

Zeros of drives are nearly free because a drive that is not homed to an absolute mark has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.error_file import AXES, ErrorEntry, TiedEntry
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.minimal_parameters import error_entries, kind_of, minimal_parameters, poses_needed
from pm3dof_pin.errors.part_tolerances import Process, with_process
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Mask, Vector

Preset = Literal["complete", "dh", "zeros-only", "firmware-delta-6", "firmware-delta-7", "firmware-delta-9"]
PRESETS: tuple[Preset, ...] = get_args(Preset)

ZERO_TOLERANCE = {"m": 5e-3, "rad": 5e-2}
"""Tolerance of a drive's zero that no absolute mark defines, by its unit [m, rad]."""

_TOWER, _ARM = 3e-3, 1e-3  # tolerances of a printer's tower and arm [m]
_ALIGNED = 0.999


def preset(
    robot: Robot, name: Preset, process: Process | None = None
) -> tuple[tuple[ErrorEntry, ...], tuple[TiedEntry, ...]]:
    """Return the entries and ties of an error file by the name of a preset.

    Args:
        robot: the robot.
        name: the preset.
        process: how the parts are made, for `complete` and `dh`; see :mod:`pm3dof_pin.errors.part_tolerances`.

    Raises:
        InvalidValueError: no such preset, or the robot is not of its kind.
    """
    if name not in PRESETS:
        raise InvalidValueError("preset", name, f"one of {', '.join(PRESETS)}")
    if process is not None and name not in ("complete", "dh"):
        raise InvalidValueError("process", process, f"only with the presets complete and dh, not {name}")
    if name == "zeros-only":
        return _zeros(robot), ()
    if name in ("complete", "dh"):
        if name == "dh" and robot.closures:
            raise InvalidValueError("preset", name, f"a serial arm; {robot.name} has closed loops: take complete")
        return error_entries(with_free_zeros(_complete(robot, process))), ()
    return (), _firmware(robot, int(name[-1]))


def with_free_zeros(errors: GeometricErrors) -> GeometricErrors:
    """Return the errors with the zeros of the drives known to :data:`ZERO_TOLERANCE` only, as a class of their own."""
    free = [
        replace(parameter, group="zeros", tolerance=ZERO_TOLERANCE[parameter.unit])
        if kind_of(errors.robot, parameter) == "zero of a drive"
        else parameter
        for parameter in errors.parameters
    ]
    return GeometricErrors(errors.robot, free, fixed_bearings=errors.fixed_bearings, file=errors.file)


def nearly_free(errors: GeometricErrors) -> Mask:
    """Tell which parameters are zeros of drives known to :data:`ZERO_TOLERANCE` or worse, shape=(parameters,)."""
    return np.array(
        [
            parameter.tolerance >= ZERO_TOLERANCE[parameter.unit]
            and kind_of(errors.robot, parameter) == "zero of a drive"
            for parameter in errors.parameters
        ],
        dtype=bool,
    )


def _complete(robot: Robot, process: Process | None) -> GeometricErrors:
    errors = GeometricErrors(robot) if process is None else with_process(GeometricErrors(robot), process)
    return minimal_parameters(errors, reachable_poses(robot, poses_needed(robot), np.random.default_rng(0)))


def _zeros(robot: Robot) -> tuple[ErrorEntry, ...]:
    tolerances, entries = (ZERO_TOLERANCE["m"], ZERO_TOLERANCE["rad"]), []
    for unit, (translations, rotations) in {"m": (("along",), ()), "rad": ((), ("along",))}.items():
        joints = tuple(joint for joint in robot.actuated_joints if robot.single_joint(joint).unit == unit)
        if joints:
            entries.append(ErrorEntry("zeros", joints, translations, rotations, *tolerances))
    return tuple(entries)


def _firmware(robot: Robot, count: int) -> tuple[TiedEntry, ...]:
    drives = robot.actuated_joints
    if len(drives) != 3 or any(robot.single_joint(joint).unit != "m" for joint in drives):
        raise InvalidValueError("preset", f"firmware-delta-{count}", f"three sliding drives; {robot.name} has others")
    neutral = robot.configuration(pin.neutral(robot.model))
    placed = [neutral.frame_placement(joint) for joint in drives]
    centre = np.mean([each.translation for each in placed], axis=0)
    radial: list[tuple[str, float]] = []
    tangent: list[tuple[str, float]] = []
    along: list[tuple[str, float]] = []
    for joint, at in zip(drives, placed, strict=True):
        up = at.rotation @ robot.joint_axis(joint)
        outward = at.translation - centre
        outward = outward - (outward @ up) * up
        outward /= np.linalg.norm(outward)
        for parts, direction in ((radial, outward), (tangent, np.cross(up, outward)), (along, up)):
            parts.append(_word(robot, joint, at.rotation.T @ direction))
    arms = _arms(robot)
    ties = [_tie("radius", radial, _TOWER)]
    ties += [_tie(f"end_stop{k}", [part], ZERO_TOLERANCE["m"]) for k, part in enumerate(along, start=1)]
    ties += [_tie(f"tangent{k}", [part], _TOWER) for k, part in enumerate(tangent[:2], start=1)]
    if count == 7:
        ties.append(_tie("arms", [part for own in arms for part in own], _ARM))
    if count == 9:
        ties += [_tie(f"arm{k}", own, _ARM) for k, own in enumerate(arms, start=1)]
    return tuple(ties)


def _arms(robot: Robot) -> list[list[tuple[str, float]]]:
    """Return the displacements that lengthen the rods of each drive."""
    model, found = robot.model, list[list[tuple[str, float]]]()
    lengths = [
        p
        for p in all_parameters(robot)
        if p.group == "legs" and not model.existJointName(p.place) and kind_of(robot, p) == "length"
        if p.place in robot.rods or not robot.rods
    ]
    for drive in robot.actuated_joints:
        carried = model.subtrees[model.getJointId(drive)]
        own = [p for p in lengths if any(model.frames[k].parentJoint in carried for k in _ends(robot, p.place))]
        signs = [float(np.sign(np.array(p.axis) @ _offset(robot, p.place))) for p in own]
        if not own:
            raise InvalidValueError("preset", "firmware-delta", f"rods that end in a closure; {drive} has none")
        found.append([(p.name, sign) for p, sign in zip(own, signs, strict=True)])
    return found


def _ends(robot: Robot, place: str) -> list[int]:
    """Return a frame, or both frames of a rod, by index."""
    loop = robot.closures[robot.rods[place]] if place in robot.rods else None
    return [robot.frame_id(name) for name in ([place] if loop is None else [loop.frame_a, loop.frame_b])]


def _offset(robot: Robot, frame: str) -> Vector:
    if frame in robot.rods:
        return np.array([1.0, 0.0, 0.0])
    placement = robot.model.frames[robot.frame_id(frame)].placement
    return np.asarray(placement.rotation.T @ placement.translation)


def _word(robot: Robot, joint: str, direction: Vector) -> tuple[str, float]:
    """Return the displacement of a joint along a direction in its axes, and its factor."""
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) < _ALIGNED:
        expected = f"joints with an axis outward; those of {joint} of {robot.name} are oblique"
        raise InvalidValueError("preset", "firmware-delta", expected)
    return f"{joint}.t{AXES[k]}", float(np.sign(direction[k]))


def _tie(name: str, parts: Sequence[tuple[str, float]], tolerance: float) -> TiedEntry:
    return TiedEntry(name, dict(parts), "firmware", tolerance, "m")
