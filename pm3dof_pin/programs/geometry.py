"""The geometry of a mechanism as constants and parameters of its programs.

Entries that are exactly 0, 1 or -1 are constants of the program, which saves operations; all others are parameters. The
*pattern* says which entries are constants. One program serves all mechanisms of the same structure and pattern; a
dense pattern, without constants, serves all mechanisms of the structure, with errors anywhere.

Entries within 1e-15 of 0, 1 or -1 are rounded to these: they come from rounding, such as of cos(pi/2) for angles of a
URDF. This moves a point a metre away by 1e-15 m.

What is placed on the base is also there as placed in *working axes*, with a prefix. They are those of the first joint
on the base where many more entries are constants in these, as on a robot that stands turned on its base, else the
world's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.mechanism.configuration import LIMIT_TOLERANCE
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs.graph import Graph, Number
from pm3dof_pin.tolerances import LAST_DIGITS
from pm3dof_pin.typing import Objects, Vector

WORKING = "@"
"""Prefix of joints and frames placed in working axes."""

WORKING_AXES = WORKING
"""Owner of the placement of the working axes in the world: no joint has an empty name."""

_CONSTANTS = (0.0, 1.0, -1.0)
_MANY_MORE = 2.0  # times as many constants: placing the tool in the world costs operations, too


def structure(mechanism: Mechanism) -> str:
    """Describe what programs depend on besides geometry: joints, their order and types, closures, tool, limits."""
    model = mechanism.model
    joints = [
        f"{model.names[index]}:{_kind(model.joints[index])}:{model.parents[index]}" for index in range(1, model.njoints)
    ]
    loops = [f"{loop.frame_a}~{loop.frame_b}:{loop.type}:{loop.swing_limit is None}" for loop in mechanism.closures]
    loops += [f"{index}:{loop.axis}:{loop.axis_b}" for index, loop in enumerate(mechanism.closures) if loop.bases]
    loops += map(repr, mechanism.couplings)
    frames = [f"{name}@{model.frames[mechanism.frame_id(name)].parentJoint}" for name in frame_names(mechanism)]
    limits = [
        f"{k}:{int(np.isfinite(a))}{int(np.isfinite(b))}"
        for k, (a, b) in enumerate(zip(mechanism.lower_limits, mechanism.upper_limits, strict=True))
    ]
    groups = [f"{','.join(group.joints)};{group.closures}" for group in mechanism.limit_groups]
    return "|".join([*joints, *loops, *frames, *limits, *groups])


def numbers(mechanism: Mechanism, frames: Iterable[str] = ()) -> dict[str, float]:
    """Return the geometry of a mechanism by name: placements of joints and frames, axes, and limits with tolerance.

    Frames are those of the closures and the tool, and those given; numbers are rounded as described above.
    """
    model = mechanism.model
    names: list[str] = []
    entries: list[NDArray[Any]] = []
    for index in range(1, model.njoints):
        _add_placement(names, entries, model.names[index], model.jointPlacements[index])
        _add_joint(names, entries, model.names[index], model.joints[index])
    for name in dict.fromkeys([*frame_names(mechanism), *frames]):
        _add_placement(names, entries, f"frame/{name}", model.frames[mechanism.frame_id(name)].placement)
    on_base = _placed_on_base(mechanism, frames)
    axes = _working_axes(list(on_base.values()))
    for name, placement in {
        WORKING_AXES: axes,
        **{WORKING + key: axes.actInv(on_base[key]) for key in on_base},
    }.items():
        _add_placement(names, entries, name, placement)
    found = dict(zip(names, _rounded(np.concatenate([np.zeros(0), *entries])).tolist(), strict=True))
    for k, (lower, upper) in enumerate(zip(mechanism.lower_limits, mechanism.upper_limits, strict=True)):
        found[f"limit/{k}/lower"] = float(lower) - LIMIT_TOLERANCE
        found[f"limit/{k}/upper"] = float(upper) + LIMIT_TOLERANCE
    for index, loop in enumerate(mechanism.closures):
        if loop.length is not None:
            found[f"closure/{index}/length"] = loop.length
        if loop.swing_limit is not None:
            angle = loop.swing_limit + LIMIT_TOLERANCE
            found[f"swing/{index}/sine"], found[f"swing/{index}/cosine"] = float(np.sin(angle)), float(np.cos(angle))
    return found


def values(mechanism: Mechanism, names: Sequence[str], others: Mapping[str, float] | None = None) -> Vector:
    """Return the values of a program's parameters, from its mechanism's geometry and the others given.

    Raises:
        ProgramError: the mechanism lacks a number.
    """
    plain = [name.removeprefix(WORKING) for name in names]
    frames = [name[6:].rpartition("/")[0] for name in plain if name.startswith("frame/")]
    found = numbers(mechanism, frames) | dict(others or {})
    if missing := [name for name in names if name not in found]:
        raise ProgramError(f"{mechanism.name}: no geometry {missing[0]}, expected that of the program's mechanism")
    return chosen(found, names)


def chosen(found: Mapping[str, float], names: Iterable[str]) -> Vector:
    """Return the values of a program's parameters from a mechanism's :func:`numbers`, shape=(number of names,)."""
    return np.array([found[name] for name in names])


def _placed_on_base(mechanism: Mechanism, frames: Iterable[str] = ()) -> dict[str, pin.SE3]:
    """Return the placements of joints and frames on the base, by owner."""
    model = mechanism.model
    found = {model.names[k]: model.jointPlacements[k] for k in range(1, model.njoints) if model.parents[k] == 0}
    for name in dict.fromkeys([*frame_names(mechanism), *frames]):
        frame = model.frames[mechanism.frame_id(name)]
        if frame.parentJoint == 0:
            found[f"frame/{name}"] = frame.placement
    return found


def _working_axes(placements: Sequence[pin.SE3]) -> pin.SE3:
    """Return the first placement if many more entries of all are constants in its axes, else the world's."""

    def constant(axes: pin.SE3) -> int:
        entries = [axes.actInv(placement).homogeneous[:3].ravel() for placement in placements]
        return int(np.isin(_rounded(np.concatenate(entries)), _CONSTANTS).sum())

    world = pin.SE3.Identity()
    is_turned = placements and constant(placements[0]) > _MANY_MORE * constant(world)
    return placements[0] if is_turned else world


class Geometry:
    """The geometry of one mechanism, as constants and parameters of a graph; all are parameters if `dense`."""

    def __init__(
        self,
        graph: Graph,
        mechanism: Mechanism,
        frames: Iterable[str] = (),
        *,
        dense: bool = False,
        in_working_axes: bool = False,
    ) -> None:
        self._graph = graph
        self._numbers = numbers(mechanism, frames)
        self.in_working_axes = in_working_axes
        self._moved = set(_placed_on_base(mechanism, frames)) if in_working_axes else set[str]()
        self._dense = dense
        self._known: dict[str, Number | float] = {}

    def number(self, owner: str, entry: str) -> Number | float:
        """Return one entry of the geometry of a joint or frame."""
        name = f"{owner}/{entry}"
        if owner in self._moved and entry[0] in "Rp":
            name = WORKING + name
        if name not in self._known:
            value = self._numbers[name]
            is_constant = not self._dense and value in _CONSTANTS
            self._known[name] = value if is_constant else self._graph.parameter(name, value)
        return self._known[name]

    def limit(self, name: str) -> Number:
        """Return a limit, which is always a parameter."""
        if name not in self._known:
            self._known[name] = self._graph.parameter(name, self._numbers[name])
        return self._known[name]  # type: ignore[return-value]

    def vector(self, owner: str, entry: str) -> Objects:
        """Return a vector of the geometry, shape=(3,)."""
        return np.array([self.number(owner, f"{entry}{k}") for k in range(3)], dtype=object)

    def rotation(self, owner: str) -> Objects:
        """Return the rotation of a placement, shape=(3, 3)."""
        return np.array([[self.number(owner, f"R{i}{j}") for j in range(3)] for i in range(3)], dtype=object)


def pattern(mechanism: Mechanism, frames: Iterable[str] = ()) -> str:
    """Return a hash of which entries are constants, and their values."""
    rows = constants(numbers(mechanism, frames))
    return hashlib.sha256(repr(rows).encode()).hexdigest()


def constants(found: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return the pattern of a mechanism's :func:`numbers`: the entries that are constants, with their values."""
    return [
        (name, value)
        for name, value in found.items()
        if value in _CONSTANTS and not name.startswith(("limit/", "swing/"))
    ]


def frame_names(mechanism: Mechanism) -> list[str]:
    """Return the frames of the closures and the tool."""
    names = [name for loop in mechanism.closures for name in (loop.frame_a, loop.frame_b)]
    return list(dict.fromkeys([*names, *([mechanism.tool_frame] if mechanism.tool_frame is not None else [])]))


def _add_placement(names: list[str], entries: list[NDArray[Any]], owner: str, placement: pin.SE3) -> None:
    names += _placement_names(owner)
    entries += placement.rotation.ravel(), placement.translation


@lru_cache(maxsize=1000)
def _placement_names(owner: str) -> tuple[str, ...]:
    return (*(f"{owner}/R{i}{j}" for i in range(3) for j in range(3)), *(f"{owner}/p{k}" for k in range(3)))


def _add_joint(names: list[str], entries: list[NDArray[Any]], owner: str, model_joint: Any) -> None:
    joint = model_joint.extract() if hasattr(model_joint, "extract") else model_joint
    axes = {entry: getattr(joint, entry) for entry in ("axis", "axis1", "axis2") if hasattr(joint, entry)}
    if model_joint.shortname() == "JointModelRevoluteUnboundedUnaligned":
        axes["axis"] = _unbounded_axis(joint)
    for entry, axis in axes.items():
        names += [f"{owner}/{entry}{k}" for k in range(3)]
        entries.append(np.asarray(axis).ravel())
    if hasattr(joint, "jointPlacements"):
        for k, (part, placement) in enumerate(zip(joint.joints, joint.jointPlacements, strict=True)):
            _add_placement(names, entries, f"{owner}[{k}]", placement)
            _add_joint(names, entries, f"{owner}[{k}]", part)


def _unbounded_axis(joint: Any) -> NDArray[Any]:
    """Return the axis, which Pinocchio's bindings only expose through the joint's motion subspace."""
    data, q = joint.createData(), np.zeros(joint.idx_q + 2)
    q[joint.idx_q] = 1.0
    joint.calc(data, q)
    return np.asarray(data.S).reshape(6)[3:]


def _kind(model_joint: Any) -> str:
    joint = model_joint.extract() if hasattr(model_joint, "extract") else model_joint
    if hasattr(joint, "jointPlacements"):
        return f"Composite({','.join(_kind(part) for part in joint.joints)})"
    return str(model_joint.shortname())


def _rounded(entries: NDArray[Any]) -> NDArray[Any]:
    nearest = np.rint(entries) + 0.0  # no negative zeros
    return np.where((np.abs(entries - nearest) <= LAST_DIGITS) & (np.abs(nearest) <= 1.0), nearest, entries)
