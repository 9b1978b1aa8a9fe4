"""MJCF, as MuJoCo reads it: bodies, joints, equalities, actuators and keyframes of a compiled model.

A coordinate is MuJoCo's `qpos`, quaternions in Pinocchio's order. A weld or connect by bodies holds them as they are in
the initial configuration, unless it says otherwise. MuJoCo itself is not needed to read a model; the tests hold this
reader against it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from pm3dof_pin.description.description import WORLD, Description, Joint, Placement, Unread
from pm3dof_pin.description.physical_bounds import ANY
from pm3dof_pin.description.readers.elements import named
from pm3dof_pin.description.readers.mjcf_actuators import MjcfActuators
from pm3dof_pin.description.readers.mjcf_document import MjcfDocument
from pm3dof_pin.description.readers.mjcf_equalities import MjcfEqualities
from pm3dof_pin.description.readers.mjcf_tree import MjcfTree
from pm3dof_pin.description.xml_file import Element, children

_TOOL_SITES = ("tool", "tool_frame", "tool0", "tcp", "ee", "eef", "end_effector", "attachment_site")
_HOME, _INITIAL = "home", "qpos0"


def read_mjcf(
    path: Path, folders: tuple[Path, ...] = (), *, lenient: bool = False, root: Element | None = None
) -> Description:
    """Read an MJCF model, with includes and attached models from `folders`, by default those of its own package.

    `root` is the root element if it is known already.

    Raises:
        DescriptionError: a file is unreadable or not XML, a number is malformed or impossible, or an element that could
            carry a loop, a coupling or a drive is not supported.
        FrameNotFoundError: an equality refers to an unknown body.
        JointNotFoundError: an actuator, tendon or equality refers to an unknown joint.
    """
    document = MjcfDocument(path, folders, root=root)
    tree = MjcfTree(document, lenient=lenient)
    equalities = MjcfEqualities(tree)
    couplings, held = equalities.couplings()
    closures = equalities.closures()
    actuators = MjcfActuators(tree, couplings)
    drives = actuators.drives()
    for drive in (drive for drive in drives if drive.joint in held):
        said = f"drives joint '{drive.joint}', which an equality holds"
        tree.unread.append(Unread(f"<actuator> '{drive.name}'", drive.origin, said))
    drives = tuple(drive for drive in drives if drive.joint not in held)
    springs = actuators.springs()
    description = Description(
        document.root.get("model") or document.path.stem,
        (*tree.scaled_bodies(), *actuators.bodies),
        (*(_held(joint, held) for joint in tree.joints), *actuators.joints),
        tuple(tree.frames.values()),
        closures,
        (*couplings, *actuators.couplings),
        drives,
        tuple(dict.fromkeys(drive.joint for drive in drives)),
        actuators.commands(drives),
        tool_frame=next((tree.sites[name] for name in _TOOL_SITES if name in tree.sites), None),
        springs=springs,
        configurations=_configurations(tree, held),
        untouchable=tuple(
            (entry.get("body1", WORLD), entry.get("body2", WORLD))
            for entry in document.sections("contact")
            if entry.tag == "exclude"
        ),
        gravity=_gravity(tree),
        dialect="mjcf",
        origin=document.root.origin,
    )
    return replace(description, unread=tuple(tree.unread))


def _held(joint: Joint, held: dict[str, float]) -> Joint:
    """Return a joint that an equality holds at a coordinate as a fixed one."""
    if joint.name not in held:
        return joint
    moved = joint.motion(held[joint.name] - joint.zero)
    return replace(joint, type="fixed", placement=Placement.from_se3(joint.placement.se3 * moved))


def _configurations(tree: MjcfTree, held: dict[str, float]) -> dict[str, dict[str, tuple[float, ...]]]:
    initial = {joint.name: numbers for joint, numbers in tree.qpos if joint.name not in held}
    qpos0 = tuple(
        number
        for _, own in tree.qpos
        for number in (own if len(own) == 1 else (*own[:-4], own[-1], *own[-4:-1]))  # quaternions begin with w
    )
    count = len(qpos0)
    named_configurations = {_INITIAL: initial}
    for index, key in enumerate(entry for entry in tree.document.sections("keyframe") if entry.tag == "key"):
        name = key.get("name") or f"key{index}"
        if "qpos" not in key.attrib:
            named_configurations[name] = initial
            continue
        numbers = tree.numbers(key, "qpos", None, ANY, named(key))
        if len(numbers) > count:
            raise key.origin.error(f"{named(key)}: qpos", f"expected {count} numbers, not {len(numbers)}")
        numbers += qpos0[len(numbers) :]  # a short one is completed by the initial configuration
        values, start = {}, 0
        for joint, own in tree.qpos:
            part = numbers[start : start + len(own)]
            start += len(own)
            if len(own) > 1:  # MuJoCo's quaternions begin with w
                w, x, y, z = part[-4:]
                part = (*part[:-4], x, y, z, w if math.hypot(w, x, y, z) else 1.0)  # as MuJoCo completes it
            if joint.name not in held:
                values[joint.name] = part
        named_configurations[name] = values
    named_configurations.setdefault(_HOME, initial)
    return named_configurations


def _gravity(tree: MjcfTree) -> tuple[float, ...]:
    gravity: tuple[float, ...] = (0.0, 0.0, -9.81)
    for option in children(tree.document.root, "option"):
        gravity = tree.numbers(option, "gravity", 3, ANY, "<option>", gravity)
        if any(flag.get("gravity") == "disable" for flag in children(option, "flag")):
            return (0.0, 0.0, 0.0)
    return gravity
