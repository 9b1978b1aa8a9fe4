"""The closures file: what a URDF, which is a tree, cannot say about a closed-chain robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError

ClosureType = Literal["3d", "6d"]

_KEYS = {
    "closed_loop",
    "type",
    "name_mot",
    "joint_name",
    "joint_type",
    "tool_frame",
    "motion_coordinates",
    "closure_limits",
    "springs",
}


@dataclass(frozen=True)
class LoopClosure:
    """One loop closure between two frames of the tree.

    Attributes:
        frame_a: frame at the end of one branch.
        frame_b: frame at the end of the other.
        type: "3d", the origins coincide (a spherical joint), or "6d", the frames coincide (a weld).
        swing_limit: greatest angle between the z axes of the two frames [rad], or None.
    """

    frame_a: str
    frame_b: str
    type: ClosureType
    swing_limit: float | None = None


@dataclass(frozen=True)
class ClosuresFile:
    """A closures file as read and checked, names not yet compared with the URDF.

    The keys `closed_loop`, `type`, `name_mot`, `joint_name` and `joint_type` are those of the `robot.yaml` files of
    example-parallel-robots; the others are this package's own.

    Attributes:
        path: the file.
        closures: the loop closures.
        actuated_joints: names of the actuated joints (`name_mot`), in their order.
        tool_frame: frame whose pose, twist and stiffness are meant by "the tool", or None.
        motion_coordinates: joints whose rates are the platform's independent motions; empty if there are none such.
        springs: the entries of `springs`, unread.
    """

    path: Path
    closures: tuple[LoopClosure, ...]
    actuated_joints: tuple[str, ...]
    tool_frame: str | None
    motion_coordinates: tuple[str, ...]
    springs: tuple[Mapping[str, Any], ...]


def read_closures(path: Path | str) -> ClosuresFile:
    """Read and check a closures file.

    Args:
        path: YAML file with the keys of :class:`ClosuresFile`.

    Raises:
        DescriptionError: the file is unreadable, has an unknown key, or an entry is not of its form.
    """
    path = Path(path)
    data = read_mapping(path)
    for key in data:
        if key not in _KEYS:
            raise DescriptionError(path, str(key), f"unknown key, expected some of {', '.join(sorted(_KEYS))}")
    springs = data.get("springs") or []
    if not isinstance(springs, list) or not all(isinstance(spring, dict) for spring in springs):
        raise DescriptionError(path, "springs", "expected a list of mappings")
    return ClosuresFile(
        path=path,
        closures=_loop_closures(path, data),
        actuated_joints=_names(path, data, "name_mot"),
        tool_frame=_optional_name(path, data, "tool_frame"),
        motion_coordinates=_names(path, data, "motion_coordinates"),
        springs=tuple(springs),
    )


def _loop_closures(path: Path, data: Mapping[str, Any]) -> tuple[LoopClosure, ...]:
    pairs = data.get("closed_loop") or []
    types = data.get("type") or []
    limits = data.get("closure_limits") or [None] * len(pairs)
    for key, entries in (("closed_loop", pairs), ("type", types), ("closure_limits", limits)):
        if not isinstance(entries, list) or len(entries) != len(pairs):
            raise DescriptionError(path, key, f"expected a list with one entry for each of {len(pairs)} closures")
    closures = []
    for index, (pair, kind, limit) in enumerate(zip(pairs, types, limits, strict=True)):
        if not isinstance(pair, list) or len(pair) != 2 or not all(isinstance(frame, str) for frame in pair):
            raise DescriptionError(path, f"closed_loop[{index}]", f"expected two frame names, not {pair}")
        if str(kind).lower() not in ("3d", "6d"):
            raise DescriptionError(path, f"type[{index}]", f"expected '3d' or '6d', not '{kind}'")
        closure_type: ClosureType = "3d" if str(kind).lower() == "3d" else "6d"
        closures.append(LoopClosure(pair[0], pair[1], closure_type, _swing_limit(path, index, limit)))
    return tuple(closures)


def _swing_limit(path: Path, index: int, limit: Any) -> float | None:
    if limit is None:
        return None
    angle = limit.get("swing_rad") if isinstance(limit, dict) else None
    if isinstance(angle, bool) or not isinstance(angle, (int, float)) or not 0.0 < angle <= math.pi:
        raise DescriptionError(path, f"closure_limits[{index}]", "expected {swing_rad: an angle in (0, pi]} or null")
    return float(angle)


def _names(path: Path, data: Mapping[str, Any], key: str) -> tuple[str, ...]:
    names = data.get(key) or []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise DescriptionError(path, key, "expected a list of names")
    if len(set(names)) != len(names):
        raise DescriptionError(path, key, "names a joint twice")
    return tuple(names)


def _optional_name(path: Path, data: Mapping[str, Any], key: str) -> str | None:
    name = data.get(key)
    if name is not None and not isinstance(name, str):
        raise DescriptionError(path, key, f"expected a frame name, not {name}")
    return name
