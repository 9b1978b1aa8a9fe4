"""The equations of a mechanism's motion: rates of joints and other sources, and the twist of a frame.

Every closure holds part of the relative twist of its two frames, a sum of what the joints between them contribute: on
two long chains that are closed again and again, all joints would enter every equation. But where another closure joins
the same chains further down, the joints up to there contribute only motions that it leaves free. The rates of these
become unknowns and are substituted for the joints, as is the twist of the frame for the joints that carry it. So each
equation names what is near it, and there are about as many entries as joints.

Lengths, and rates of slides, are measured in a given unit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from pm3dof_pin.programs.elimination import identity, product, zeros
from pm3dof_pin.programs.graph import is_zero
from pm3dof_pin.programs.joints import Screw, cross, objects
from pm3dof_pin.programs.loops import apply_rows, closure_frames, coupling_equations, held_twist, scaled_rows
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Array, Objects

Mover: TypeAlias = str | int
"""What has a twist: a frame by its name, or a free motion by its number."""

_WORTH = 2  # entries that a free motion must save: it adds an equation and an unknown


@dataclass(frozen=True, eq=False)
class Column:
    """The screw at unit rate of a joint, source or free motion, and what it moves."""

    screw: Screw
    moves: frozenset[Mover]  #: which closure frames, and whether the tool frame; or itself, if it is a free motion
    joint: int | None = None  #: its entry of v, if it is the rate of a joint

    @property
    def slides(self) -> bool:
        """Whether it is purely translational; its rate is then in units of length."""
        return all(map(is_zero, self.screw.angular))


@dataclass(frozen=True, eq=False)
class Block:
    """Equations that each take something from a sum of twists at one point."""

    rows: slice
    terms: Mapping[Mover, float]  #: the factors of the twists
    taken: Objects  #: what is taken from a scaled twist at the origin of x's frame, shape=(number of rows, 6)
    closure: int | None  #: the closure that it is of; None for x's frame


@dataclass(frozen=True, eq=False)
class MotionEquations:
    """twist @ x + rates @ [rates of unknown columns; of free motions; of sources] = 0."""

    twist: Objects  #: shape=(m, 6)
    rates: Objects  #: shape=(m, n)
    unknown: int  #: number of columns before the sources
    blocks: Sequence[Block]  #: those of x's frame, if there is one, and of the closures


def joint_columns(tree: Tree, indices: Iterable[int], frame: str | None = None) -> list[Column]:
    """Return the columns of joint rates by their index in v."""
    names = {name for loop in tree.mechanism.closures for name in (loop.frame_a, loop.frame_b)}
    supports = {name: tree.support(name) for name in (names | {frame} if frame else names)}
    return [
        Column(tree.screws[k], frozenset(name for name, support in supports.items() if k in support), k)
        for k in indices
    ]


def motion_equations(
    tree: Tree,
    unit: float,
    unknown: Sequence[Column],
    sources: Sequence[Column] = (),
    frame: str | None = None,
    *,
    displaced: bool = False,
) -> MotionEquations:
    """Record the equations of a frame, x - J v = 0, of the closures and of the couplings.

    Args:
        tree: the mechanism.
        unit: the unit of length [m].
        unknown: columns of unknown rates.
        sources: columns of given rates.
        frame: the frame whose twist x enters, if any.
        displaced: whether frames may be displaced in directions in which no joint can move them.
    """
    columns, count = [*unknown, *sources], len(unknown)
    origin = tree.frame(frame).translation if frame else objects([0.0, 0.0, 0.0])
    twists, rates, blocks = [zeros(0, 6)], [zeros(0, len(columns))], list[Block]()

    def record(
        terms: Mapping[Mover, float], point: Objects, taken: Objects, share: float, closure: int | None = None
    ) -> None:
        first = sum(map(len, rates))
        at_frame = product(taken, _transfer((point - origin) * (1.0 / unit)))
        blocks.append(Block(slice(first, first + len(taken)), terms, at_frame, closure))
        twists.append(at_frame * share)
        rates.append(product(taken, _velocities(columns, terms, point, unit)))

    if frame:
        record({frame: -1.0}, origin, identity(6), 1.0)
    substitutes = _substitutes(tree, columns, frame)
    needed = {substitute.closure for substitute in substitutes.values()}
    free: dict[int, list[int]] = {}
    for index, (share, other) in substitutes.items():
        kind, (a, b) = tree.mechanism.closures[index].kind, closure_frames(tree, index)
        point = (a if share < 0.0 and kind.holds_vectors else b).translation
        terms = _relative(tree, index)
        if other is not None:
            terms = _sum(terms, _relative(tree, other), -share) | dict.fromkeys(free[other], share)
            share = 0.0
        elif frame:
            terms = _sum(terms, {frame: 1.0}, -share)
        record(terms, point, apply_rows(held_twist(kind, a, b), identity(6)), share, index)
        if index not in needed:
            continue
        free[index] = []
        for direction in _free_directions(tree, index):
            record(terms, point, direction[None], share, index)
            number = len(columns)
            if not displaced and all(map(is_zero, [*twists[-1][0], *rates[-1][0]])):
                continue  # 0 = 0: the chains cannot move that way
            columns.append(Column(Screw(direction[3:], direction[:3], point), frozenset({number})))
            free[index].append(number)
            rates[-1] = np.hstack([rates[-1], [[-1.0]]])
    couplings = scaled_rows(tree, coupling_equations(tree), unit)
    rates.append(zeros(len(couplings), len(columns)))
    for k, column in enumerate(columns):
        if column.joint is not None:
            rates[-1][:, k] = couplings[:, column.joint]
    twists.append(zeros(len(rates[-1]), 6))
    last, every = len(columns) - len(sources), len(columns)
    matrix = np.vstack([widened(part, range(part.shape[1]), every) for part in rates])
    order = [*range(count), *range(count + len(sources), every), *range(count, count + len(sources))]
    return MotionEquations(np.vstack(twists), matrix[:, order], last, blocks)


def widened(rows: Objects, columns: Sequence[int], count: int) -> Objects:
    """Expand rows over some columns to all columns, shape=(m, count)."""
    wide = zeros(len(rows), count)
    wide[:, list(columns)] = rows
    return wide


class _Substitute(NamedTuple):
    """What stands for joints in the equations of a closure: x, or motions that another closure leaves free."""

    share: float  #: times which it does
    closure: int | None = None  #: None for x


def _substitutes(tree: Tree, columns: Sequence[Column], frame: str | None) -> dict[int, _Substitute]:
    """Return what is substituted in each closure's equations, those first on which others depend."""

    def moved(terms: Mapping[Mover, float]) -> Array:
        return np.array([sum(terms[mover] for mover in column.moves & terms.keys()) for column in columns])

    relative = [moved(_relative(tree, index)) for index in range(len(tree.mechanism.closures))]
    order = sorted(range(len(relative)), key=lambda index: np.count_nonzero(relative[index]))
    carried = moved({frame: 1.0}) if frame else np.zeros(len(columns))
    substitutes: dict[int, _Substitute] = {}
    for place, index in enumerate(order):
        ways = [(np.count_nonzero(relative[index]), _Substitute(0.0))]
        if frame:
            ways += [(np.count_nonzero(relative[index] - s * carried), _Substitute(s)) for s in (1.0, -1.0)]
        for other in order[:place]:
            if (number := _free_count(tree, other)) is not None:
                ways += [
                    (np.count_nonzero(relative[index] - s * relative[other]) + _WORTH * number, _Substitute(s, other))
                    for s in (1.0, -1.0)
                ]
        substitutes[index] = min(ways, key=lambda way: way[0])[1]
    return substitutes


def _relative(tree: Tree, index: int) -> dict[Mover, float]:
    """Return the factors of the frames' twists in the relative twist of a closure."""
    loop = tree.mechanism.closures[index]
    return {loop.frame_a: -1.0, loop.frame_b: 1.0}


def _sum(a: Mapping[Mover, float], b: Mapping[Mover, float], factor: float) -> dict[Mover, float]:
    return {mover: a.get(mover, 0.0) + factor * b.get(mover, 0.0) for mover in (*a, *b)}


def _free_count(tree: Tree, index: int) -> int | None:
    """Return how many motions a closure leaves free, None if they are not along or about axes of one frame."""
    kind = tree.mechanism.closures[index].kind
    return None if kind.is_distance or kind.rotations == (2,) else 6 - kind.size


def _free_directions(tree: Tree, index: int) -> list[Objects]:
    """Return the scaled twists [v; omega] that a closure leaves free at frame b, world axes, shape=(6,) each."""
    kind, (a, _) = tree.mechanism.closures[index].kind, closure_frames(tree, index)
    axes = identity(3) if kind.holds_vectors else a.rotation.T
    still = objects([0.0, 0.0, 0.0])
    along = [np.concatenate([axes[k], still]) for k in range(3) if k not in kind.translations]
    return along + [np.concatenate([still, axes[k]]) for k in range(3) if k not in kind.rotations]


def _transfer(lever: Objects) -> Objects:
    """Return the matrix that maps scaled twists to a point at a scaled vector from theirs, shape=(6, 6)."""
    matrix = identity(6)
    for k in range(3):
        matrix[:3, 3 + k] = cross(identity(3)[k], lever)
    return matrix


def _velocities(columns: Sequence[Column], terms: Mapping[Mover, float], point: Objects, unit: float) -> Objects:
    """Return what each column contributes to a sum of scaled twists at a point, shape=(6, n)."""
    rows = zeros(6, len(columns))
    for k, column in enumerate(columns):
        if factor := sum(terms[mover] for mover in column.moves & terms.keys()):
            rows[:3, k] = column.screw.velocity(point) * (factor if column.slides else factor / unit)
            rows[3:, k] = column.screw.angular * factor
    return rows
