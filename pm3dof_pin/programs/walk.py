"""The walk that closes a pose: from a closed configuration to targets, in legs short enough to stay in its branch.

The walk is one loop over two straight-line programs: a Newton step, and a *control* program that decides what happens
next. As these decisions are selections, not branches, every printer needs only the loop: begin with ``start(q,
targets)``, repeat ``state, status = control(step(state), state)`` while the status is positive, and call the target out
of reach if ``branch(state)`` is not ``branch(q)``.

A leg starts from the last accepted configuration, extrapolated from the two before it, and takes Newton steps until the
loops are closed. It is accepted if no joint jumped, no system of equations is singular, and all determinants have the
signs that they have at the start, so that the branch is the same. Then the next leg is up to twice as long; otherwise
it is half as long, until it is too short and the walk has failed. Where a leg has ended on another branch, no later one
goes so far: a third branch that begins between them can have the signs of the first. No leg goes as far as to where the
regularity would be zero if it went on to fall as it did in the leg before: from the flat pose of a parallelogram a
crossed one begins that has its signs. The last leg may end at a singular configuration. The signs of the drives'
determinants are compared at the end, see :func:`~pm3dof_pin.programs.closing.branch_number`.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.programs.closing import Task, branch_number, placement_component, same_side
from pm3dof_pin.programs.graph import (
    Graph,
    Scalar,
    Truth,
    absolute,
    atan2,
    floor,
    less,
    maximum,
    minimum,
    select,
)
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.tolerances import CLOSED
from pm3dof_pin.typing import Array, Objects

NEARLY_CLOSED = 1e-8
"""Closure error from which one quadratic step reaches rounding [m, rad]."""

LEG = 0.1
"""Usual length of a leg [rad, characteristic lengths]."""

STEPS = 6
"""Newton steps in a leg."""

SHORTEST_LEG = 2.0**-10
"""Length of the shortest leg of a thorough walk, relative to the usual one."""

REACHED, SINGULAR, OPEN, TOO_FAR = 0.0, -1.0, -2.0, -3.0
"""Status of a walk that has ended: it is at its targets; a singular configuration or another branch lies ahead; the
loops do not close; the targets, or the start, are not numbers or too far away. While it goes on, it is positive."""


@dataclass(frozen=True)
class _Limits:
    """What a leg may do to be accepted."""

    jump: float  #: largest distance of a joint from its prediction [rad, characteristic lengths]
    regularity: float  #: regularity, see :func:`~pm3dof_pin.programs.closing.closing_program`, that must be exceeded


WALK = _Limits(jump=0.3, regularity=1e-5)
"""Limits of a leg of a walk."""

MARCH = _Limits(jump=0.1, regularity=1e-3)
"""Limits between neighbours of a grid."""

_NARROWING = 2.0  # loss of regularity that the first leg expects [1/rad, 1/characteristic length]
_SLOWEST = 1e-12  # loss of regularity that counts as none
_NEARER = 0.75  # of the way to where the regularity would end, in one leg
_CLOSEST = 1e-3  # to a singular configuration, but at the end [rad, characteristic lengths]
_AS_FAR = 1.05  # of the way to where the regularity would end, up to where the last leg may go
_FAR = 1000.0  # longest walk [rad, characteristic lengths]
_LAST_STEPS = 50  # for the last leg: near a singular configuration the first steps only halve the distance


@dataclass(frozen=True, eq=False)
class Walk:
    """Programs whose loop is a walk, with the same parameters.

    `start` takes q, the targets, the length of the shortest leg relative to the usual one, usually
    :data:`SHORTEST_LEG`, and the largest closure error, usually :data:`CLOSED`; its outputs are the state, which begins
    with the inputs of `step`. `control` takes the outputs of `step`, then the state, and returns the next state up to
    the status. `branch` takes q. Machine code leaves branches to its caller.
    """

    step: Program  #: see :func:`~pm3dof_pin.programs.closing.closing_program`
    start: Program
    control: Program
    branch: Program | None = None  #: needed by printers only, see :meth:`with_branch`
    tolerance: float = CLOSED  #: closure error of a pose that counts as reached, in printed walks [m, rad]

    @classmethod
    def from_programs(cls, step: Program, start: Program, control: Program, branch: Program | None = None) -> Walk:
        """Return the walk of programs, each of which gets the parameters of all."""
        programs = [program for program in (step, start, control, branch) if program is not None]
        names = tuple(dict.fromkeys(name for program in programs for name in program.parameters))
        widened = [program.with_parameters(names) for program in programs]
        return cls(widened[0], widened[1], widened[2], widened[3] if branch is not None else None)

    @cached_property
    def nq(self) -> int:
        """Number of joint positions, with which the state begins."""
        return len(self.step.results) - 3

    @property
    def name(self) -> str:
        """Name of the step."""
        return self.step.name

    def with_branch(self, branch: Program, tolerance: float = CLOSED) -> Walk:
        """Return the walk to print: with a program that tells branches apart, its parameters, and a tolerance."""
        walk = Walk.from_programs(self.step, self.start, self.control, branch)
        return replace(walk, tolerance=tolerance)

    def renamed(self, name: str) -> Walk:
        """Return the same walk with another name."""
        return replace(self, step=replace(self.step, name=name))

    @property
    def parts(self) -> dict[str, Program]:
        """The programs by name."""
        parts = {"step": self.step, "start": self.start, "control": self.control, "branch": self.branch}
        return {name: program for name, program in parts.items() if program is not None}

    @property
    def key(self) -> str:
        """Hexadecimal hash of the programs."""
        return hashlib.sha256("".join(program.key for program in self.parts.values()).encode()).hexdigest()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.step.parameters

    @cached_property
    def n_targets(self) -> int:
        """Number of targets."""
        return len(self.start.inputs) - self.nq - 2

    @cached_property
    def status(self) -> int:
        """Index of the status in the state; the numbers after it are constant."""
        place: int = self.start.slices["status"].start
        return place

    @cached_property
    def singular(self) -> int:
        """Index of the number of the state that is 1 after a walk to a singular configuration, else 0."""
        return self.status - 1

    @cached_property
    def reached(self) -> slice:
        """Slice of the last accepted configuration in the state."""
        return self.start.slices["reached"]

    def evaluate(
        self, starts: ArrayLike, targets: ArrayLike, parameters: ArrayLike, shortest: float = SHORTEST_LEG
    ) -> tuple[Array, Array]:
        """Walk with NumPy, all poses side by side: slow; the reference for the printers.

        Args:
            starts: closed configurations, shape=(n, nq).
            targets: coordinates of the task, shape=(n, m) [m, rad].
            parameters: parameters of the step.
            shortest: length of the shortest leg, relative to the usual one.

        Returns:
            The last accepted configurations, shape=(n, nq), and the statuses, shape=(n,).
        """
        q, goals = np.asarray(starts, dtype=float), np.asarray(targets, dtype=float)
        states = self.start.evaluate(
            np.column_stack([q, goals, np.tile([shortest, self.tolerance], (len(q), 1))]), parameters
        )
        while (rows := np.flatnonzero(states[:, self.status] > 0.0)).size:
            stepped = self.step.evaluate(states[rows, : len(self.step.inputs)], parameters)
            states[rows, : self.status + 1] = self.control.evaluate(np.hstack([stepped, states[rows]]), parameters)
        passed = np.zeros(len(q), dtype=bool)
        if self.branch is not None:
            here, there = (self.branch.evaluate(rows, parameters)[:, 0] for rows in (q, states[:, self.reached]))
            passed = (states[:, self.status] == REACHED) & (states[:, self.singular] == 0.0) & (here != there)
        return states[:, self.reached], np.where(passed, SINGULAR, states[:, self.status])


def branch_program(mechanism: Mechanism, coordinates: Task, samples: ArrayLike, *, dense: bool = False) -> Program:
    """Record the number of a configuration's branch, see :func:`~pm3dof_pin.programs.closing.branch_number`."""
    graph = Graph()
    tree = Tree(graph, mechanism, samples, dense=dense, in_working_axes=True)
    number = branch_number(tree, coordinates, mechanism.branching_drives) if mechanism.has_branches else 0.0
    return graph.program("branch", {"branch": number})


def _is_accepted(
    margin: Scalar, jump: Scalar, residual: Scalar, tolerance: Scalar, mode: Scalar, limits: _Limits
) -> Truth:
    """Return whether a pose is in the given assembly mode, and no limit is exceeded on the way to it."""
    regularity, found = _regularity_and_mode(margin)
    same = less(absolute(found - mode), 0.5) & less(limits.regularity, regularity)
    return same & less(residual, tolerance) & less(jump, limits.jump)


def acceptance_program() -> Program:
    """Record whether a march accepts a pose: inputs `margin`, `jump`, `residual`, `mode` of home; output 1 or 0."""
    graph = Graph()
    margin, jump, residual, mode = (graph.input(name, [0.5]) for name in ("margin", "jump", "residual", "mode"))
    is_accepted = _is_accepted(margin, jump, residual, NEARLY_CLOSED, mode, MARCH)
    return graph.program("accept", {"accepted": select(is_accepted, 1.0, 0.0)})


def _regularity_and_mode(margin: Scalar) -> tuple[Scalar, Scalar]:
    """Decode the margin of a step, see :func:`~pm3dof_pin.programs.closing.regularity_and_mode`."""
    mode = -floor(margin * 0.5)
    return margin + mode * 2.0, mode


def start_program(
    mechanism: Mechanism, task: Task, samples: ArrayLike, *, dense: bool = False, leg: float = LEG
) -> Program:
    """Record the state at the start of a walk: where the coordinates are, and how many legs away the targets are.

    Arguments and errors as for :func:`~pm3dof_pin.programs.closing.closing_program`; `leg` is the usual length of a leg
    [rad, characteristic lengths].
    """
    graph, rows = Graph(), np.asarray(samples, dtype=float)
    if not (mechanism.closures or task.tool):
        leg = np.inf  # joints of a serial arm are set directly, however far away
    q = objects([graph.input(f"q[{k}]", rows[:, k]) for k in range(rows.shape[1])])
    joints = [mechanism.single_joint(name) for name in task.joints]
    origins: list[Scalar] = [
        atan2(q[joint.q_index + 1], q[joint.q_index]) if joint.is_continuous else q[joint.q_index] for joint in joints
    ]
    known = [joint.coordinate(rows) for joint in joints]
    if task.tool:
        assert mechanism.tool_frame is not None
        tree = Tree(graph, mechanism, rows, positions=q, dense=dense, in_working_axes=True)
        tool = tree.in_world(tree.frame(mechanism.tool_frame))
        origins += [placement_component(tool, name) for name in task.tool]
        at_samples = tool_components([Configuration(mechanism, row).tool_placement.homogeneous for row in rows])
        known += [at_samples[:, TOOL_COMPONENTS.index(name)] for name in task.tool]
    names = [*task.joints, *task.tool]
    targets = [graph.input(f"target {name}", values) for name, values in zip(names, known, strict=True)]
    shortest = graph.input("shortest", np.full(len(rows), SHORTEST_LEG))
    tolerance = graph.input("tolerance", np.full(len(rows), CLOSED))
    turns = [joint.is_continuous for joint in joints] + [name in ("rx", "ry", "rz") for name in task.tool]
    slides = [joint.translates for joint in joints] + [name in ("x", "y", "z") for name in task.tool]
    distance: Scalar = 0.0
    for k, (target, is_periodic, is_length) in enumerate(zip(targets, turns, slides, strict=True)):
        if is_periodic:  # the shorter way round
            turn = 2.0 * np.pi
            origins[k] = origins[k] + floor((target - origins[k]) / turn + 0.5) * turn
        unit = mechanism.characteristic_length if is_length else 1.0
        distance = maximum(distance, absolute((target - origins[k]) / unit))
    legs: Scalar = maximum(-floor(-distance / leg), 1.0) if np.isfinite(leg) else 1.0
    far = _FAR if np.isfinite(leg) else np.inf
    state: dict[str, Any] = {
        **{"q": q, "margin": 1.0, "jump": 0.0, "given": origins, "reached": q, "earlier": q},
        **{"mode": 0.0, "barrier": 2.0, "done": 0.0, "step": 1.0 / legs, "last": 0.0, "goal": 0.0},
        **{"regularity": 1.0, "narrowing": distance * _NARROWING if np.isfinite(leg) else 0.0},
        **{"count": select(less(distance, far), -1.0, -2.0), "singular": 0.0, "status": 1.0},
        **{"origins": origins, "targets": targets, "longest": 1.0 / legs, "shortest": shortest / legs},
        **{"tolerance": tolerance, "closest": _CLOSEST / maximum(distance, _SLOWEST) if np.isfinite(leg) else 0.0},
    }
    return graph.program("start", state)


def _linear_positions(mechanism: Mechanism) -> list[bool]:
    """Return which entries of q are linear in the joint's motion, and can be extrapolated, shape=(nq,)."""
    return [joint.nq == joint.nv for joint in list(mechanism.model.joints)[1:] for _ in range(joint.nq)]


def side_program(mechanism: Mechanism, task: Task, samples: ArrayLike, *, dense: bool = False) -> Program:
    """Record whether a configuration is on the same side of singular ones as one before it.

    Inputs: q, then that before; output 1 or 0, see :func:`~pm3dof_pin.programs.closing.same_side`; no operations if it
    is always 1. Arguments and errors as for :func:`~pm3dof_pin.programs.closing.closing_program`.
    """
    graph, rows = Graph(), np.asarray(samples, dtype=float)
    q, before = (
        objects([graph.input(f"{name}[{k}]", rows[:, k]) for k in range(rows.shape[1])]) for name in ("q", "before")
    )
    is_same = same_side(graph, mechanism, task, rows, q, before, dense=dense)
    return graph.program("side", {"same": select(is_same, 1.0, 0.0)})


def control_program(
    mechanism: Mechanism, start: Program, task: Task, samples: ArrayLike, *, dense: bool = False
) -> Program:
    """Record what happens after a Newton step of a walk that begins as `start` says.

    Arguments and errors as for :func:`~pm3dof_pin.programs.closing.closing_program`.
    """
    graph, linear, rows = Graph(), _linear_positions(mechanism), np.asarray(samples, dtype=float)

    def group(name: str, prefix: str = "") -> Any:
        size = start.slices[name].stop - start.slices[name].start
        known = rows.T if name in ("q", "reached") else np.full((size, len(rows)), 0.5)
        numbers = objects([graph.input(f"{prefix}{name}[{k}]", known[k]) for k in range(size)])
        return numbers if start.outputs[name] else numbers[0]

    found, margin, jump = (group(name, "new ") for name in ("q", "margin", "jump"))
    residual = graph.input("residual", np.full(len(rows), 0.5))
    now = {name: group(name) for name in start.outputs}
    done, goal, step, last, longest = (now[name] for name in ("done", "goal", "step", "last", "longest"))
    begins = less(now["count"], -0.5)
    regularity, own_mode = _regularity_and_mode(margin)
    mode = select(begins, own_mode, now["mode"])

    # one more step in this leg?
    count = now["count"] + 1.0
    unit = longest * SHORTEST_LEG
    tolerance = maximum(now["tolerance"], NEARLY_CLOSED)
    is_last = less(0.999999, goal)
    # the walk may end at a singular configuration, but not pass it
    is_near = is_last & less(1.0 - done, maximum(now["closest"], unit * 2.5))
    is_nearly_closed = less(residual, tolerance)
    goes_on = ~is_nearly_closed & less(count, select(is_near, _LAST_STEPS, STEPS))
    is_precise = less(residual, now["tolerance"]) & less(1.5, count)
    goes_on = goes_on | (is_last & is_nearly_closed & ~is_precise & less(count, _LAST_STEPS))
    goes_on = goes_on & less(jump, WALK.jump) & less(residual, np.inf) & ~begins

    # if not, is it accepted?
    tolerance = select(is_last, now["tolerance"], tolerance)
    is_closed = less(residual, tolerance) & less(jump, WALK.jump)
    is_same_side = same_side(graph, mechanism, task, rows, found, now["reached"], dense=dense)
    is_accepted = _is_accepted(margin, jump, residual, tolerance, mode, WALK) & less(goal, now["barrier"])
    is_accepted = is_accepted & is_same_side
    ends_singular = is_near & is_closed & less(regularity, WALK.regularity)
    is_accepted = is_accepted | ends_singular
    is_accepted = is_accepted & ~goes_on & ~begins
    is_rejected = ~(goes_on | is_accepted | begins)
    is_beyond = is_rejected & is_closed & (less(0.5, absolute(own_mode - mode)) | ~is_same_side)
    barrier = select(is_beyond, minimum(now["barrier"], goal), now["barrier"])
    reached = _each(is_accepted, _each(ends_singular, now["q"], found), now["reached"])  # a singular step opens loops
    earlier = _each(is_accepted, now["reached"], now["earlier"])
    last = select(is_accepted, goal - done, last)
    narrowing = select(is_accepted, (now["regularity"] - regularity) / (goal - done), now["narrowing"])
    regular = select(is_accepted | begins, regularity, now["regularity"])
    done = select(is_accepted, goal, done)
    step = select(is_accepted, minimum(step * 2.0, longest), select(is_rejected, step * 0.5, step))
    way = regular / maximum(narrowing, _SLOWEST)  # to a singular configuration, if nothing changes
    from_singular = begins & less(regularity, WALK.regularity)
    step = select(from_singular, step, minimum(step, way * _NEARER))
    is_before = (is_accepted | begins) & less(way, now["closest"]) & ~from_singular
    looks_beyond = is_before & less(way * _AS_FAR, 1.0 - done)  # with a last leg, which tells what ends the walk
    following = select(less(1.0 - unit * 1.25, done + step) | is_before, 1.0, done + step)
    following = select(looks_beyond, minimum(done + way * 2.0, 1.0), following)
    is_over = less(step, now["shortest"]) | less(now["barrier"], 0.0)
    ended = select(is_rejected & is_over, select(is_closed, SINGULAR, OPEN), 1.0)
    ended = select(is_accepted & is_last, REACHED, ended)
    ended = select(begins & ~(less(-1.5, now["count"]) & less(margin, 2.0)), TOO_FAR, ended)

    # the next leg
    ratio = select(less(0.0, last), (following - done) / last, 0.0)
    ahead = [a + (a - b) * ratio if extends else a for a, b, extends in zip(reached, earlier, linear, strict=True)]
    between = [a * (1.0 - following) + b * following for a, b in zip(now["origins"], now["targets"], strict=True)]
    state = {
        "q": _each(goes_on, found, objects(ahead)),
        "margin": 1.0,
        "jump": select(goes_on, jump, 0.0),
        "given": _each(goes_on, now["given"], objects(between)),
        **{"reached": reached, "earlier": earlier, "mode": mode},
        **{"barrier": select(looks_beyond, -1.0, barrier), "done": done},
        **{"step": step, "last": last, "goal": select(goes_on, goal, following)},
        **{"regularity": regular, "narrowing": narrowing, "count": select(goes_on, count, 0.0)},
        **{"singular": select(ends_singular & is_accepted, 1.0, 0.0), "status": ended},
    }
    assert list(state) == list(start.outputs)[: len(state)]
    return graph.program("control", state)


def _each(condition: Truth, a: Objects, b: Objects) -> Objects:
    """Return a if the condition is true, else b."""
    return objects([select(condition, x, y) for x, y in zip(a, b, strict=True)])
