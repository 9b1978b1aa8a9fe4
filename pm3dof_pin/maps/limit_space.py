"""One to three coordinates of a machine and the limits over them, in which the reachable set is searched."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.coordinate_ranges import require_quick_poses
from pm3dof_pin.kinematics.grid import Grid, with_neighbours
from pm3dof_pin.kinematics.poses import REACH, limit_names
from pm3dof_pin.typing import Array, Branch

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

Flags: TypeAlias = NDArray[np.uint32]

DECLARED_RANGE = "declared_range"
"""Name of the limit that a coordinate leaves its declared range, or one turn about home if it has none."""

_MAX_COORDINATES = 3
_BATCH = 200_000  # poses at a time
_AROUND = 0.02  # of a range, beyond its ends
# of the points otherwise taken along each coordinate: robots that no program solves, serial arms with many solutions
_SLOW, _OF_ARMS = 0.25, 0.5
_MOST_OPERATIONS = 150_000  # of a Newton step: a workspace takes some hundred thousand of them


@dataclass(frozen=True, eq=False)
class LimitSpace:
    """Coordinates and the limits over them.

    Sections are over the first two coordinates and stacked along the third, if there is one. Over a single coordinate
    there are no sections but intervals.
    """

    machine: str  #: name of the machine
    names: tuple[str, ...]  #: names of the coordinates, one to three
    units: tuple[str, ...]  #: "m" or "rad" of each
    limits: tuple[str, ...]  #: names of the limits, from the lowest bit
    #: function from values of the coordinates, shape=(..., number of coordinates) [m, rad], to the sums of the limits
    #: they break, shape=(...); zero within all
    broken_limits: Callable[[Array], Flags]
    box: Array  #: where the search starts; it goes on beyond if the set does, shape=(number of coordinates, 2) [m, rad]
    start: Array  #: a pose from which the set is also searched: home, shape=(number of coordinates,) [m, rad]
    density: float = 1.0  #: points along each coordinate, relative to the usual number
    ends: Array | None = None  #: declared ranges, beyond which some limit is broken, shape=(number of coordinates, 2)
    #: if poses of all branches count, the limits as above and the numbers of the branches
    branches: Callable[[Array], tuple[Flags, NDArray[np.int64]]] | None = None
    #: which points of a product grid are within the limits, if that takes less than point by point
    over_grid: Callable[[Sequence[Array]], NDArray[np.bool_]] | None = None
    #: the limits broken at points, and the configurations there, from those at points nearby (from home where NaN),
    #: shape=(n, nq), if that takes less than from home
    followed: Callable[[Array, Array], tuple[Flags, Array]] | None = None
    nq: int = 0  #: of them

    @property
    def stacked(self) -> bool:
        """Whether there is a third coordinate."""
        return len(self.names) == _MAX_COORDINATES

    def within(self, points: Array, level: float | None = None) -> NDArray[np.bool_]:
        """Tell which points are within the limits, shape=(..., number of coordinates); or (..., 2), at a level."""
        if level is not None:
            points = np.concatenate([points, np.full((*points.shape[:-1], 1), level)], axis=-1)
        within = self._within_ends(points)
        within[within] = self.broken_limits(points[within]) == 0
        return within

    def limits_from(self, points: Array, near: Array) -> tuple[Flags, Array]:
        """Return the sums of the limits that points break, shape=(n,), and their configurations, shape=(n, nq).

        They are found from the configurations of points nearby, from home where these are NaN; NaN where there is none.
        """
        return (self.broken_limits(points), near) if self.followed is None else self.followed(points, near)

    def within_from(self, points: Array, near: Array) -> tuple[NDArray[np.bool_], Array]:
        """Tell which points are within the limits, shape=(n,), and return their configurations as `limits_from`."""
        within, q = self._within_ends(points), np.full_like(near, np.nan)
        flags, q[within] = self.limits_from(points[within], near[within])
        within[within] = flags == 0
        return within, q

    def _within_ends(self, points: Array) -> NDArray[np.bool_]:
        """Tell which points are within the declared ranges, outside of which no loops are closed."""
        if self.ends is None:
            return np.ones(points.shape[:-1], dtype=bool)
        return np.asarray(np.all((points >= self.ends[:, 0]) & (points <= self.ends[:, 1]), axis=-1))

    def within_grid(self, axes: Sequence[Array]) -> NDArray[np.bool_]:
        """Tell which points of a product grid are within the limits, from the increasing values of each coordinate."""
        return self.within(nodes(axes)) if self.over_grid is None else self.over_grid(axes)


def nodes(axes: Sequence[Array]) -> Array:
    """Return the points of a product grid, shape=(n1, n2, ..., number of axes)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def robot_space(
    robot: Robot,
    names: tuple[str, ...] | None = None,
    fixed: Mapping[str, float] | None = None,
    *,
    declared_ranges: bool = True,
    all_branches: bool = False,
) -> LimitSpace:
    """Return one to three coordinates of a robot with the limits over them.

    By default the first ones, with those of equal units in the sections; others are at home unless fixed [m, rad].
    Coordinates end at their declared ranges, on request at the limits of joints and closures only, and angles after one
    turn. Poses are those of home's branch, on request of all that the coordinates alone determine.

    Raises:
        InvalidValueError: an unknown coordinate, none or more than three; or a robot that takes more than 150,000
            operations for a Newton step, or has more than 100 joints and no program, or has loops and more drives than
            the tool has motions.
        ConvergenceError: the loops do not close at home.
    """
    robot.assemble()  # at home, where searches start
    solver = robot.continuation(robot.coordinates) if robot.engine == "program" else None
    if solver is not None and solver.operations > _MOST_OPERATIONS:
        size = f"{robot.name}, of {solver.operations:,} operations a Newton step"
        raise InvalidValueError("robot", size, f"at most {_MOST_OPERATIONS:,} for a workspace")
    require_quick_poses(robot, "boundaries")
    if robot.has_branches and robot.has_null_motions(robot.coordinates):
        drives = f"{robot.name}, whose {len(robot.placing_drives)} drives can move while the tool rests"
        expected = "loops whose poses follow from the coordinates: of the many here, those within limits are not sought"
        raise InvalidValueError("robot", drives, expected)
    chosen = names or _default_names(robot)
    if not 1 <= len(set(chosen)) == len(chosen) <= _MAX_COORDINATES:
        expected = "one, or two for the sections, and optionally one to stack them"
        raise InvalidValueError("coordinates", ", ".join(chosen) or "none", expected)
    coordinates = [robot.coordinate(name) for name in chosen]
    home = np.array([robot.home_coordinates[robot.coordinates.index(coordinate)] for coordinate in coordinates])
    ends = np.array([(-np.pi, np.pi) if c.unit == "rad" else (-np.inf, np.inf) for c in coordinates]) + home[:, None]
    box = []
    for row, coordinate, centre in zip(ends, coordinates, home, strict=True):
        if declared_ranges:
            row[:] = [
                own if own is not None else end
                for own, end in zip((coordinate.lower, coordinate.upper), row, strict=True)
            ]
        width = robot.characteristic_length if coordinate.unit == "m" else np.pi
        low, high = np.clip(robot.range_of(coordinate), *row)
        low, high = low if np.isfinite(low) else centre - width, high if np.isfinite(high) else centre + width
        box.append((low - _AROUND * (high - low), high + _AROUND * (high - low)))
    complete = coordinates_over(robot, chosen, fixed)
    judged, beyond = _judged(robot, complete, "all" if all_branches else "home"), 1 << len(limit_names(robot))

    def of_ranges(values: Array) -> Flags:
        outside = np.any((values < ends[:, 0]) | (values > ends[:, 1]), axis=-1)
        return np.where(outside, np.uint32(beyond), np.uint32(0))

    def with_ranges(values: Array) -> tuple[Flags, NDArray[np.int64]]:
        flags, branches = judged(values)
        return flags | of_ranges(values), branches

    def followed(values: Array, near: Array) -> tuple[Flags, Array]:
        flags, q, from_home = of_ranges(values), np.empty_like(near), np.isnan(near[:, 0])
        for rows, guess in ((from_home, None), (~from_home, near[~from_home])):
            if rows.any():
                poses = robot.solve(complete(values[rows]), guess=guess, on_failure="nan")
                flags[rows] |= poses.broken_limits
                q[rows] = poses.q
        return flags, q

    at_home = {c.name: value for c, value in zip(robot.coordinates, robot.home_coordinates, strict=True)}
    others = {name: value for name, value in {**at_home, **(fixed or {})}.items() if name not in chosen}

    def over_grid(axes: Sequence[Array]) -> NDArray[np.bool_]:
        within: NDArray[np.bool_] = np.zeros([len(axis) for axis in axes], dtype=bool)
        parts = [
            slice(np.searchsorted(axis, low), np.searchsorted(axis, high, "right"))
            for axis, (low, high) in zip(axes, ends, strict=True)
        ]
        own = [axis[part] for axis, part in zip(axes, parts, strict=True)]
        if any(not axis.size for axis in own):
            return within
        grid = Grid(robot.coordinates, dict(zip(chosen, own, strict=True)), others)
        flags = robot.solve(grid, on_failure="nan", branches="all" if all_branches else "home").broken_limits.copy()
        reached = (flags & REACH) == 0
        rim = with_neighbours(reached) & ~reached  # neighbours do not lead to all that walks from farther away reach
        flags[rim] = judged(nodes(own)[rim])[0]
        within[tuple(parts)] = flags == 0
        return within

    return LimitSpace(
        machine=robot.name,
        names=chosen,
        units=tuple(coordinate.unit for coordinate in coordinates),
        limits=(*limit_names(robot), DECLARED_RANGE),
        broken_limits=lambda values: with_ranges(values)[0],
        box=np.array(box),
        start=home,
        ends=ends,
        density=_density(robot),
        branches=with_ranges if all_branches else None,
        over_grid=over_grid if solver is not None else None,
        followed=followed if solver is not None and robot.has_branches and not all_branches else None,
        nq=robot.model.nq,
    )


def limits_over(
    robot: Robot, names: Sequence[str], fixed: Mapping[str, float] | None = None, branches: Branch = "home"
) -> Callable[[Array], Flags]:
    """Return a robot's limits over some coordinates, see :attr:`LimitSpace.broken_limits`; others at home or fixed."""
    judged = _judged(robot, coordinates_over(robot, names, fixed), branches)
    return lambda values: judged(values)[0]


def _judged(
    robot: Robot, complete: Callable[[Array], Array], which: Branch
) -> Callable[[Array], tuple[Flags, NDArray[np.int64]]]:
    """Return a robot's limits over coordinates that are completed, and with all branches their numbers."""

    def judged(values: Array) -> tuple[Flags, NDArray[np.int64]]:
        rows = values.reshape(-1, values.shape[-1])
        flags, branches = np.empty(len(rows), dtype=np.uint32), np.zeros(len(rows), dtype=np.int64)
        for first in range(0, len(rows), _BATCH):
            part = slice(first, first + _BATCH)
            poses = robot.solve(complete(rows[part]), on_failure="nan", branches=which)
            flags[part] = poses.broken_limits
            if which == "all":
                branches[part] = poses.branch
        return flags.reshape(values.shape[:-1]), branches.reshape(values.shape[:-1])

    return judged


def coordinates_over(
    robot: Robot, names: Sequence[str], fixed: Mapping[str, float] | None = None
) -> Callable[[Array], Array]:
    """Return a function that completes coordinates, shape=(n, m), to all of them; others at home or fixed."""
    places = [robot.coordinates.index(robot.coordinate(name)) for name in names]
    home = np.array(robot.home_coordinates)
    for name, value in (fixed or {}).items():
        home[robot.coordinates.index(robot.coordinate(name))] = value

    def complete(values: Array) -> Array:
        rows = np.tile(home, (len(values), 1))
        rows[:, places] = values
        return rows

    return complete


def _density(robot: Robot) -> float:
    if robot.engine != "program" or robot.reason_without_programs() is not None:
        return _SLOW
    return 1.0 if robot.has_branches or all(c.tool is None for c in robot.coordinates) else _OF_ARMS


def _default_names(robot: Robot) -> tuple[str, ...]:
    first = robot.coordinates[:_MAX_COORDINATES]
    for stacked in reversed(first):
        others = [coordinate for coordinate in first if coordinate is not stacked]
        if len(first) == _MAX_COORDINATES and others[0].unit == others[1].unit:
            return (*(coordinate.name for coordinate in others), stacked.name)
    return tuple(coordinate.name for coordinate in first)
