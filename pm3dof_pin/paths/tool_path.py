"""A tool path: moves of the tool point, or of the robot's coordinates, from a table of poses or a program in G-code."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.arrays import finite_array, frozen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.files import read_text
from pm3dof_pin.kinematics.pose_file import PoseTable, read_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import coordinate_periods
from pm3dof_pin.measuring.wrenches import is_wrench, wrenches_of
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.paths.gcode import MACHINE, Move, Systems, in_machine, read_program
from pm3dof_pin.typing import Array, Indices, Mask, Matrix, Vector

logger = logging.getLogger(__name__)

TIME, FEED, FEED_PER_MINUTE = "time_s", "feed_m_s", "feed_mm_min"
"""Columns of a table: the time at each row, or the feed of the move that ends there."""

_MAX_PROGRAM = 2**30  # bytes: some thirty million lines

_MOVES = np.dtype(
    [
        ("lines", np.int64),
        ("start", np.float64, 6),
        ("end", np.float64, 6),
        *((name, np.float64) for name in ("feed", "turning_feed", "duration", "blend")),
        ("arc_axes", np.int64, 2),
        ("arcs", np.float64, 3),
        ("system", np.int64),
        ("rapid", np.bool_),
        ("named", np.bool_, 6),
    ],
    align=True,
)
"""A move of a program, as :class:`ToolPath` has it."""

_AT_ONCE = 4096  # moves

_TURNS = TOOL_COMPONENTS[3:]
_UNITS: Mapping[str, Mapping[str, float]] = {"m": {"m": 1.0, "mm": 1e-3}, "rad": {"rad": 1.0, "deg": np.pi / 180.0}}


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Moves one after the other: lines and arcs of given numbers, over each of which a share runs from 0 to 1.

    The numbers are X, Y, Z [m] and A, B, C [rad] of the tool in placed coordinate systems, or the coordinates of the
    robot. Between the ends of a line they change linearly, as in a controller; angles too. A dwell is a move that ends
    where it starts.
    """

    lines: NDArray[np.int64]  #: line of the file of each move, shape=(n,)
    start: Matrix  #: numbers at its start, shape=(n, k) [m, rad]
    end: Matrix  #: numbers at its end, shape as above
    #: components of the placement of the tool that the path sets, if the numbers are such; else None: coordinates
    components: tuple[str, ...] | None = None
    rapid: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))  #: whether it is a rapid, shape=(n,)
    feed: Vector = field(default_factory=lambda: np.zeros(0))  #: of the tool point [m/s], NaN if not given, shape=(n,)
    turning_feed: Vector = field(default_factory=lambda: np.zeros(0))  #: of moves that only turn the tool [rad/s]
    duration: Vector = field(default_factory=lambda: np.zeros(0))  #: of the move, NaN if not given, shape=(n,) [s]
    blend: Vector = field(default_factory=lambda: np.zeros(0))  #: tolerance of the corner at its end, NaN if not given
    #: axes of arcs, -1 for lines, shape=(n, 2); centre in these [m] and swept angle [rad], shape=(n, 3)
    arc_axes: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    arcs: Matrix = field(default_factory=lambda: np.zeros((0, 3)))
    system: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  #: of each move, shape=(n,)
    #: which of X, Y, Z, A, B, C the program has named by the end of each move, others follow from home, shape=(n, 6)
    named: Mask = field(default_factory=lambda: np.zeros((0, 6), dtype=bool))
    placements: Systems = field(default_factory=dict)  #: of the coordinate systems in the base
    times: Vector | None = None  #: times at the ends of moves, shape=(n + 1,) [s]; None: from feeds
    wrenches: Matrix | None = None  #: on the tool at the ends of moves, shape=(n + 1, 6) [N, N m]; None: none given
    names: tuple[str, ...] = ()  #: names of the numbers

    def __post_init__(self) -> None:
        """Fill in what was not given."""
        n = len(self.lines)
        usual: dict[str, Any] = {
            "rapid": np.zeros(n, dtype=bool),
            **{name: np.full(n, np.nan) for name in ("feed", "turning_feed", "duration", "blend")},
            "arc_axes": np.full((n, 2), -1),
            "arcs": np.zeros((n, 3)),
            "system": np.full(n, MACHINE),
            "named": np.ones((n, 6), dtype=bool),
        }
        for name, values in usual.items():
            if len(getattr(self, name)) != n:
                object.__setattr__(self, name, values)

    def __len__(self) -> int:
        """Return the number of moves."""
        return len(self.lines)

    def __repr__(self) -> str:
        return f"ToolPath({len(self)} moves of {', '.join(self.names)})"

    @cached_property
    def turns(self) -> bool:
        """Whether the path turns the tool: A, B or C are among its components."""
        return self.components is not None and bool({*self.components} & {*_TURNS})

    @cached_property
    def has_durations(self) -> bool:
        """Whether some moves have a duration."""
        return bool(np.isfinite(self.duration).any())

    @cached_property
    def lasting(self) -> Vector:
        """How long moves take by the times of the path, shape=(n,) [s]."""
        assert self.times is not None
        return np.diff(self.times)

    def values(self, moves: Indices, shares: Array) -> Matrix:
        """Return the numbers at shares of moves, shape=(m, k); X, Y, Z, A, B, C are those in the base."""
        start, end, t = self.start[moves], self.end[moves], shares[:, None]
        found = start + t * (end - start)
        if self._spline is not None and self.times is not None:
            first, last = self.times[moves], self.times[moves + 1]
            return np.asarray(self._spline(first + shares * (last - first)))
        if len(rows := np.flatnonzero(self.arc_axes[moves, 0] >= 0)):
            arcs, axes, k = self.arcs[moves[rows]], self.arc_axes[moves[rows]], rows[:, None]
            from_centre, to_end = (points[k, axes] - arcs[:, :2] for points in (start, end))
            radii = np.hypot(*from_centre.T), np.hypot(*to_end.T)
            radius = radii[0] + shares[rows] * (radii[1] - radii[0])
            angle = np.arctan2(from_centre[:, 1], from_centre[:, 0]) + shares[rows] * arcs[:, 2]
            circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            found[k, axes] = arcs[:, :2] + radius[:, None] * circle
        for system, placement in self.placements.items() if self.components is not None else ():
            if len(rows := np.flatnonzero(self.system[moves] == system)):
                found[rows] = in_machine(placement, found[rows], turns=self.turns)
        return found

    @cached_property
    def _spline(self) -> Any:
        """Interpolant of a path with times: a cubic spline through all numbers."""
        if self.times is None:
            return None
        from scipy.interpolate import CubicSpline  # slow to load

        points = np.vstack([self.start[:1], self.end])
        return CubicSpline(self.times, points) if np.isfinite(points).all() else None


def read_path(
    robot: Robot,
    path: Path | str,
    *,
    workpiece: Mapping[int, ArrayLike] | None = None,
    has_tool: bool = False,
) -> ToolPath:
    r"""Read a tool path: a table of poses (.csv, .txt) or a program in G-code (any other name).

    A table is read by :func:`~pm3dof_pin.kinematics.pose_file.read_poses`; each row after the first ends a move. It may
    have columns time_s, or feed_m_s or feed_mm_min, and load_fx_N .. load_mz_Nm. Programs: see
    :mod:`pm3dof_pin.paths.gcode`.

    Args:
        robot: the robot, with its tool at the tool point.
        path: the file.
        workpiece: placements of coordinate systems in the base, by number (54 for G54), shape=(4, 4).
        has_tool: whether the robot's tool has the length of the real one, which G43 in a program requires.

    Raises:
        MeasurementError: the table cannot be read, times do not increase, or it has fewer than two poses.
        GCodeError: a line of the program is not understood.
        InvalidValueError: the program has no moves.
    """
    file = Path(path)
    if file.suffix.lower() in (".csv", ".txt", ".tsv"):
        return _from_table(robot, file, read_poses(robot, file))
    systems = {
        number: finite_array(f"placement of G{number}", placement, (4, 4))
        for number, placement in (workpiece or {}).items()
    }
    home = tool_components(robot.home.tool_placement.homogeneous)
    text = read_text(file, _MAX_PROGRAM)
    path_of_program = from_moves(*read_program(file, text, systems, home, has_tool=has_tool), systems)
    if not len(path_of_program):
        raise InvalidValueError("program", str(file), "at least one move")
    return path_of_program


def from_moves(moves: Iterable[Move], letters: frozenset[str], systems: Systems) -> ToolPath:
    """Return the path of the moves of a program that uses these letters; many are kept in a temporary file."""
    rest = iter(moves)
    with tempfile.TemporaryFile() as file:
        while some := list(islice(rest, _AT_ONCE)):
            np.array([_row(move) for move in some], _MOVES).tofile(file)
        table = np.asarray(np.memmap(file, _MOVES, mode="r")) if file.tell() else np.zeros(0, _MOVES)
    return ToolPath(
        **{name: frozen(table[name]) for name in _MOVES.names or ()},
        components=tuple(c for c, letter in zip(TOOL_COMPONENTS, "XYZABC", strict=True) if letter in letters),
        placements=systems,
        names=tuple("XYZABC"),
    )


def _row(move: Move) -> tuple[Any, ...]:
    """Return a move as a row of :data:`_MOVES`."""
    arc, is_dwell = move.arc, move.start == move.end and move.arc is None
    numbers = (move.feed, move.turning_feed, move.duration, move.blend)
    return (
        move.line,
        move.start,
        move.end,
        *(np.nan if number is None else number for number in numbers),
        (-1, -1) if arc is None else arc.axes,
        (0.0, 0.0, 0.0) if arc is None else (*arc.centre, arc.sweep),
        move.system,
        move.feed is None and move.duration is None and not is_dwell,
        move.named,
    )


def _from_table(robot: Robot, file: Path, table: PoseTable) -> ToolPath:
    values, others = _continued(robot, table.poses.coordinates), table.others
    for k, coordinate in enumerate(robot.coordinates):  # as they are written, also out of reach and over full turns
        for unit, factor in _UNITS[coordinate.unit].items():
            if (column := table.columns.get(f"{coordinate.name}_{unit}")) is not None:
                values[:, k] = factor * column
    if len(values) < 2:
        raise MeasurementError(file, "a path needs at least two poses")
    times = others.get(TIME)
    if times is not None and not (np.diff(times) > 0.0).all():
        raise MeasurementError(file, f"{TIME} does not increase from row to row")
    feed = others.get(FEED, others.get(FEED_PER_MINUTE, np.full(len(values), np.nan)) / 6e4)
    if times is None and (wrong := feed[1:] <= 0.0).any():
        raise MeasurementError(file, "a feed is not positive", np.array(table.lines)[1:][wrong].tolist())
    if unused := [name for name in others if name not in (TIME, FEED, FEED_PER_MINUTE) and not is_wrench(name)]:
        logger.warning("%s: columns %s are not used", file, ", ".join(unused))
    wrenches = None
    if any(map(is_wrench, others)):
        wrenches = wrenches_of(others, robot, len(values))
    return ToolPath(
        lines=np.array(table.lines[1:]),
        start=values[:-1],
        end=values[1:],
        feed=feed[1:],
        times=times,
        wrenches=wrenches,
        names=tuple(coordinate.name for coordinate in robot.coordinates),
    )


def _continued(robot: Robot, values: Array) -> Array:
    """Return coordinates of poses with each row in that form, of those that mean the same, nearest to the row before.

    Angles may differ by full turns, and rx, ry, rz are rx + pi, pi - ry, rz + pi too.
    """
    found, periods = np.array(values), coordinate_periods(robot, robot.coordinates)
    known = np.isfinite(found).all(axis=1)
    rows = found[known]
    by_tool = [coordinate.tool for coordinate in robot.coordinates]
    if {*_TURNS} <= {*by_tool}:
        rx, ry, rz = (by_tool.index(name) for name in _TURNS)
        other = rows.copy()
        other[:, [rx, rz]] += np.pi
        other[:, ry] = np.pi - other[:, ry]

        def change(after: Array) -> Vector:
            steps = (after[1:] - rows[:-1])[:, [rx, ry, rz]]
            return np.asarray(np.abs((steps + np.pi) % (2.0 * np.pi) - np.pi).sum(axis=1))

        is_other = np.append(False, np.cumsum(change(other) < change(rows)) % 2 == 1)[: len(rows)]
        rows = np.where(is_other[:, None], other, rows)
    for k in np.flatnonzero(np.isfinite(periods)):
        rows[:, k] = np.unwrap(rows[:, k], period=float(periods[k]))
    found[known] = rows
    return found
