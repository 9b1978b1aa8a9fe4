"""Branches of a robot with loops: the poses that continuation from home reaches without passing a singular one.

Two determinants tell branches apart (C. Gosselin and J. Angeles, IEEE Trans. Robotics and Automation 6, 1990): that of
the loops' equations with the coordinates given, which is zero at a serial singularity, and that with the drives as the
given quantities, zero at a parallel one. Both split into blocks: the systems in which the loops can be solved one after
the other (:mod:`pm3dof_pin.mechanism.loop_systems`), and the connected blocks of the Jacobian A of the drives' rates by
the coordinates' rates, whose determinant is the ratio of the two. Two closed configurations are on the same branch if
all these determinants have the same signs.

Serial arms have no branches here: their singular poses may be passed. Where the drives are more or fewer than the
coordinates, or do not determine these, there is no sign of A: poses are told apart by the loops' determinants alone. If
drives can move while the tool rests, any pose of a branch serves, as of an arm. An overconstrained loop has a sign only
if its equations are the same everywhere, as in a planar machine; otherwise walks compare the space that its equations
span from leg to leg, and branches have no numbers for it.

Programs compute the same numbers, see :func:`~pm3dof_pin.programs.closing.branch_number`; here they are computed from
Pinocchio's Jacobians.
"""

from __future__ import annotations

import itertools
import random
from functools import cached_property

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import median
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.exceptions import AmbiguousHomeError, ConvergenceError, ProgramError, SingularConfigurationError
from pm3dof_pin.kinematics.assembly import Assembly, assemble
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loop_systems import (
    ZERO,
    LoopEquations,
    LoopSystem,
    sign_weights,
    signed_blocks,
    split,
    stacked,
)
from pm3dof_pin.mechanism.tool_components import angle_rates, tool_components
from pm3dof_pin.tolerances import SIGN
from pm3dof_pin.typing import Matrix, Vector

_SAMPLES = 8
_DISTANCE = 0.1  # of samples from home [rad, characteristic lengths]
_TRIALS = 10
_REGULAR = 1e-3  # least singular value at a regular home, relative to the usual one nearby

_KEPT = "_branches"

Signs = tuple[bool, ...]


class Branches:
    """The branches of a robot, and where its poses are reached from.

    Args:
        robot: the robot.
        home: a closed configuration in place of the robot's home.

    Raises:
        ConvergenceError: the loops do not close at home.
    """

    def __init__(self, robot: PlacedMechanism, home: Configuration | None = None) -> None:
        self._robot = robot
        self._home = robot.home if home is None else home
        self._held = [robot.single_joint(c.joint).v_index for c in robot.coordinates if c.joint is not None]
        self._tool = [TOOL_COMPONENTS.index(c.tool) for c in robot.coordinates if c.tool is not None]
        self._drives = robot.branching_drives
        self._nearby = np.array(_closed_nearby(robot, self._home))

    @cached_property
    def samples(self) -> Matrix:
        """Closed configurations near home, at which programs choose their eliminations, shape=(s, nq).

        The start is the first. Home alone would mislead if it is singular.
        """
        home = self._home.q
        first = [self.start] if self._is_regular or len(self._sides) == 1 else []
        return np.array([*first, *([] if self._is_regular else [home]), *self._nearby])

    @cached_property
    def start(self) -> Vector:
        """The configuration from which poses are reached, whose branch is number 0, shape=(nq,) [m, rad].

        Home or, if that is singular, a configuration next to it on the only branch there that is within all limits.

        Raises:
            SingularConfigurationError: several branches meet at home.
        """
        if self._is_regular:
            return self._home.q
        if len(self._sides) != 1:
            raise SingularConfigurationError(
                f"{self._robot.name}: home is a singular pose, at which {max(len(self._sides), 2)} branches meet: "
                "define a configuration 'home' on one of them (pm3dof info --assemble)"
            )
        return next(iter(self._sides.values()))

    @property
    def start_is_home(self) -> bool:
        """Whether poses are reached from home itself."""
        return self._is_regular

    @property
    def conditions(self) -> tuple[str, ...]:
        """Which singularities bound a branch: "serial", "parallel", both or neither.

        Where the coordinates are the commands, those of the loops are parallel singularities.
        """
        if not self._robot.has_branches:
            return ()
        own = any(system.is_determined for system in self._systems)
        found = {self._kind_of_loops} if own else set()
        return tuple(sorted(found | ({"parallel"} if self._blocks else set()), reverse=True))

    def number(self, q: Vector) -> int:
        """Return the number of the branch of a closed configuration: 0 for that of the start, see `sign_weights`."""
        if not self._robot.has_branches:
            return 0
        flips = self._flips(self._determinants(q))
        return sum(itertools.compress(sign_weights(len(flips)), flips))

    def kind(self, q: Vector, other: Vector) -> str | None:
        """Return the kind of singularity between two closed configurations; None if they are on one branch."""
        changed = [a != b for a, b in zip(*(self._flips(self._determinants(x)) for x in (q, other)), strict=True)]
        if not any(changed):
            return None
        return self._kind_of_loops if any(changed[: len(self._systems)]) else "parallel"

    @property
    def _kind_of_loops(self) -> str:
        return "parallel" if self._robot.coordinates == self._robot.command_coordinates else "serial"

    # definitions, from the samples

    @cached_property
    def _systems(self) -> list[LoopSystem]:
        tables = [self._equations(q) for q in self._nearby]
        count = len(tables[0])
        everything = tuple(range(self._robot.model.nv))
        return split([LoopEquations(everything, np.array([t[k] for t in tables])) for k in range(count)], self._held)[0]

    @cached_property
    def _blocks(self) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Blocks of the drives' Jacobian with a sign, by drives and coordinates, but for those that are constant."""
        rates = np.array([self._drive_rates(self._equations(q)) for q in self._nearby])
        trivial = np.ptp(rates, axis=0).max(initial=0.0) <= ZERO
        return [] if trivial else signed_blocks(rates)

    @cached_property
    def _usual(self) -> Vector:
        """The median magnitudes of the determinants, with their signs at the start."""
        usual = median(np.abs([self._determinants(q) for q in self._nearby]))
        return np.asarray(usual * np.sign(self._determinants(self.start)))

    def _flips(self, determinants: Vector) -> list[bool]:
        usual = self._usual
        return [bool(d * np.sign(u) < -SIGN * abs(u)) for d, u in zip(determinants, usual, strict=True)]

    def _determinants(self, q: Vector) -> Vector:
        equations = self._equations(q)
        values = [
            1.0 if system.rows is None else np.linalg.det(system.rows @ self._matrix(system, equations))
            for system in self._systems
        ]
        rates = self._drive_rates(equations)
        return np.array([*values, *(np.linalg.det(rates[np.ix_(*block)]) for block in self._blocks)])

    def _matrix(self, system: LoopSystem, equations: list[Matrix]) -> Matrix:
        everything = tuple(range(self._robot.model.nv))
        return stacked([(everything, equations[k]) for k in system.equations], system.unknowns)

    def _equations(self, q: Vector) -> list[Matrix]:
        """Return the scaled Jacobian of each closure and, if coordinates are components of the tool, of these."""
        robot = self._robot
        jacobian = robot.loop_kinematics.closures(q)[1] * robot.velocity_scale / robot.closure_scale[:, None]
        equations = [jacobian[rows] for rows in robot.loop_kinematics.rows]
        if self._tool:
            frame = robot.tool_frame_id
            tool = robot.loop_kinematics.frame_jacobian(q, frame, pin.LOCAL_WORLD_ALIGNED)
            if not {3, 4, 5} <= set(self._tool) and max(self._tool) >= 3:
                angles = tool_components(robot.loop_kinematics.frame_placement(q, frame).homogeneous)[3:]
                tool = np.vstack([tool[:3], angle_rates(angles) @ tool[3:]])
            equations.append((tool * robot.velocity_scale / robot.twist_scale[:, None])[self._tool])
        return equations

    def _drive_rates(self, equations: list[Matrix]) -> Matrix:
        """Return the rates of the drives by those of the coordinates, joints first, in scaled numbers."""
        count, held = len(self._held) + len(self._tool), len(self._held)
        rows = np.vstack([*equations, np.eye(self._robot.model.nv)[self._held]])
        right = np.zeros((len(rows), count))
        if self._tool:
            right[len(rows) - count : len(rows) - held, held:] = np.eye(count - held)
        right[len(rows) - held :, :held] = np.eye(held)
        try:
            rates = np.linalg.lstsq(rows, right, rcond=None)[0]
        except np.linalg.LinAlgError:  # its singular values do not converge for some of several hundred rows
            from scipy.linalg import lstsq

            rates = lstsq(rows, right, cond=max(rows.shape) * np.finfo(float).eps, lapack_driver="gelsy")[0]
        return np.asarray(rates[self._drives])

    # home

    @cached_property
    def _is_regular(self) -> bool:
        """Whether home is well away from singular configurations, compared with configurations nearby."""
        if not self._robot.has_branches:
            return True
        usual = median([self._regularity(q) for q in self._nearby])
        return bool((self._regularity(self._home.q) > _REGULAR * usual).all())

    def _regularity(self, q: Vector) -> Vector:
        """Return the least singular values of all systems, and of the blocks of A and their inverses."""
        equations = self._equations(q)
        values = [
            np.linalg.svd(self._matrix(system, equations), compute_uv=False)[-1]
            for system in self._systems
            if system.is_determined
        ]
        rates = self._drive_rates(equations)
        for block in self._blocks:
            sizes = np.linalg.svd(rates[np.ix_(*block)], compute_uv=False)
            values += [sizes[-1], 1.0 / sizes[0]]
        return np.array(values)

    @cached_property
    def _sides(self) -> dict[Signs, Vector]:
        """The configurations nearest to a singular home within all limits, by the signs of their determinants."""
        robot, home, sides = self._robot, self._home.q, dict[Signs, Vector]()
        more = _closed_nearby(robot, self._home, count=4 * _SAMPLES, seed=1)
        for q in sorted(
            (*self._nearby, *more), key=lambda q: float(np.linalg.norm(pin.difference(robot.model, home, q)))
        ):
            if not Configuration(robot, q).violated_limits():
                sides.setdefault(tuple(d > 0.0 for d in self._determinants(q)), q)
        return sides


def branches_of(robot: PlacedMechanism) -> Branches:
    """Return the branches of a robot; errors as :class:`Branches`."""
    if _KEPT not in vars(robot):
        vars(robot)[_KEPT] = Branches(robot)
    found: Branches = vars(robot)[_KEPT]
    return found


def start_of(robot: PlacedMechanism) -> Vector:
    """Return the configuration from which poses are reached, for a variant that next to its prototype's.

    Raises:
        ConvergenceError: the loops do not close at home.
        SingularConfigurationError: several branches meet at home.
    """
    if not robot.has_loops:
        return robot.home.q
    first = robot.prototype
    if first is robot or not robot.is_variant_of(first):
        return branches_of(robot).start
    branches = branches_of(first)
    start, home = branches.start, robot.home
    if branches.start_is_home:
        if home.closure_residual > robot.closure_tolerance:
            raise not_closed(robot, assemble(robot, home))
        return home.q
    drives = {name: first.configuration(start).joint_position(name) for name in first.actuated_joints}
    result = assemble(robot, start, joints=drives)
    if not result.converged:
        raise not_closed(robot, result)
    return result.q


def samples_near_home(robot: PlacedMechanism) -> Matrix:
    """Return the :attr:`Branches.samples` of a robot; ProgramError if the loops do not close near home."""
    try:
        return branches_of(robot).samples
    except ConvergenceError as error:
        raise ProgramError(str(error)) from error


def _closed_nearby(
    robot: PlacedMechanism, home: Configuration, *, count: int = _SAMPLES, seed: int = 0
) -> list[Vector]:
    """Find closed configurations near a home; deterministic.

    Raises:
        ConvergenceError: the loops do not close at home, or hardly anywhere near it.
    """
    model, generator = robot.model, random.Random(seed)  # NumPy's takes 25 ms to load
    if home.closure_residual > robot.closure_tolerance:
        raise not_closed(robot, assemble(robot, home))
    rows: list[Vector] = []
    distance = _DISTANCE
    for _ in range(_TRIALS):
        for _ in range(count):
            steps = [generator.uniform(-distance, distance) for _ in range(model.nv)]
            result = assemble(robot, pin.integrate(model, home.q, robot.velocity_scale * steps))
            if result.converged:
                rows.append(result.q)
            if len(rows) == count:
                return rows
        distance /= 2.0
    raise not_closed(robot, result)


def not_closed(robot: PlacedMechanism, result: Assembly) -> ConvergenceError:
    """Return the error about loops that are open at home: no way to close them was found, or several."""
    advice = "pm3dof info names the loops that are open; define a configuration 'home' (pm3dof info --assemble)"
    if result.converged:
        return AmbiguousHomeError(robot.name, robot.home.closure_residual, result.steps, advice)
    task = f"{robot.name}: closing the loops at home"
    return ConvergenceError(task, result.residual, "m or rad", result.steps, advice)
