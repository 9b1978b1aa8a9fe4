"""What the tool can do at a pose: how hard it can push in any direction, how fast it can go, and what loads it holds.

With rates c of as many drives as degrees of freedom, all drives move at A c and the tool at T c. A wrench w on the
environment and the weight are in balance with the drives' forces tau if A^T tau = T^T w + h. Hence T^T w lies in a
zonotope about -h, the image of the box of the drives' efforts; wrenches that T^T does not see are carried by the
structure, and unlimited.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.capability.polytopes import MOST_FACETS, Polytopes, pairs_of_facets
from pm3dof_pin.capability.transmission import Limit, drive_values
from pm3dof_pin.dynamics.motion_dynamics import motion_dynamics
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.pose_values import BatchOptions
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_UNFELT = 1e-18  # relative square of a force that the drives do not feel, as in polytopes.py
_REACHED = 1e-9  # relative part of a direction that the tool cannot move in, up to which it counts as rounding
_MOST_FREEDOMS = 8  # of redundant drives, the vertices of whose polytope of rates are all found


@dataclass(frozen=True, eq=False)
class ToolCapability:
    """Forces and speeds of the tool at many poses, shape=(...); twists and wrenches at the tool point, base axes."""

    drives: tuple[str, ...]  #: names of the u actuated joints
    tool_rates: Array  #: T, the tool's twist by the rates of independent drives, shape=(..., 6, n)
    drive_rates: Array  #: A, the rates of all drives by those of independent ones, shape=(..., u, n)
    weight: Array  #: h, forces at the independent drives that hold all bodies, shape=(..., n) [N, N m]
    effort: Vector  #: greatest effort of each drive, to either side, shape=(u,) [N, N m]; infinite if unknown
    speed: Vector  #: greatest speed of each drive, to either side, shape=(u,) [m/s, rad/s]; infinite if unknown

    @cached_property
    def wrenches(self) -> Polytopes:
        """Wrenches [f; m] that the tool can exert on its environment, in six dimensions [N, N m].

        Raises:
            InvalidValueError: the effort of a drive is not described.
        """
        _require_known("effort", self.drives, self.effort)
        forces = Polytopes.from_box(self.drive_rates.swapaxes(-1, -2), -self.effort, self.effort, centre=-self.weight)
        return forces.pulled_back(self.tool_rates.swapaxes(-1, -2))

    def greatest_wrench(self, directions: ArrayLike) -> Array:
        """Return how many times each direction the tool can push, with no other load, shape=(...).

        Infinite where the structure alone carries it; NaN where the drives cannot even hold the weight. Of drives whose
        set of wrenches has too many facets, each direction is a linear program of its own, by HiGHS.

        Args:
            directions: wrenches [f; m], shape=(..., 6) [N, N m].

        Raises:
            InvalidValueError: the effort of a drive is not described.
        """
        if pairs_of_facets(len(self.drives), self.drive_rates.shape[-1]) <= MOST_FACETS:
            return self.wrenches.extent(directions)
        _require_known("effort", self.drives, self.effort)
        batch = self.tool_rates.shape[:-2]
        wanted = np.broadcast_to(np.asarray(directions, dtype=float), (*batch, 6))
        felt = np.einsum("...tn,...t->...n", self.tool_rates, wanted)
        found = [self._greatest_share(self.drive_rates[k], self.weight[k], felt[k]) for k in np.ndindex(batch)]
        return np.array(found).reshape(batch)

    def _greatest_share(self, drive_rates: Matrix, weight: Vector, felt: Vector) -> float:
        """Return the greatest s at which efforts t of all drives give A^T t = h + s f, for f at independent drives."""
        from scipy.optimize import linprog

        count, size = len(self.drives), float(np.linalg.norm(felt))
        if not np.isfinite([size, *weight, *drive_rates.ravel()]).all():
            return math.nan
        carried = size <= ROUNDING * float(np.abs(drive_rates).max(initial=0.0))
        along = np.zeros_like(felt) if carried else felt / size
        bounds = [*zip(-self.effort, self.effort, strict=True), (0.0, 0.0 if carried else None)]
        equal = np.hstack([drive_rates.T, -along[:, None]])
        best = linprog([0.0] * count + [-1.0], A_eq=equal, b_eq=weight, bounds=bounds, method="highs")
        if best.status not in (0, 2):
            raise ConvergenceError("the linear program of a wrench", math.nan, "N", best.nit, best.message)
        if best.status == 2:
            return math.nan
        return math.inf if carried else float(best.x[-1]) / size

    def greatest_twist(self, directions: ArrayLike) -> Array:
        """Return how many times each direction the tool can move at most; 0 where it cannot move that way alone.

        Args:
            directions: twists [v; omega], shape=(..., 6) [m/s, rad/s].

        Raises:
            InvalidValueError: the speed of a drive is not described.
        """
        _require_known("speed", self.drives, self.speed)
        wanted = np.broadcast_to(np.asarray(directions, dtype=float), (*self.tool_rates.shape[:-2], 6))
        known, inverse = self._solved_inverse
        found = np.full(known.shape, np.nan)
        rates = np.einsum("...nt,...t->...n", inverse, wanted[known])
        left = np.linalg.norm(np.einsum("...tn,...n->...t", self.tool_rates[known], rates) - wanted[known], axis=-1)
        moves = Polytopes.from_inequalities(self.drive_rates[known], -self.speed, self.speed).extent(rates)
        possible = left <= _REACHED * np.linalg.norm(wanted[known], axis=-1)
        found[known] = np.where(possible, moves, 0.0)
        return found

    def velocities(self, rows: slice) -> Matrix:
        """Return points whose convex hull is the set of velocities of the tool at a single pose, shape=(k, 3).

        Where every drive is independent it is a zonotope, whose facets are pairs of drives, however many there are.

        Args:
            rows: 0:3 of the twist, whatever the rotation [m/s], or 3:6, whatever the translation [rad/s].

        Raises:
            InvalidValueError: the speed of a drive is not described, or redundant drives have too many degrees of
                freedom.
        """
        _require_known("speed", self.drives, self.speed)
        rates = self.tool_rates[rows]
        count = rates.shape[1]
        if len(self.drives) > count:
            if count > _MOST_FREEDOMS:
                asked = f"of {len(self.drives)} drives for {count} freedoms"
                raise InvalidValueError("speed polytope", asked, f"redundant drives for at most {_MOST_FREEDOMS}")
            bounds = Polytopes.from_inequalities(self.drive_rates, -self.speed, self.speed)
            return np.asarray(bounds.vertices() @ rates.T)
        left, sizes, _ = np.linalg.svd(rates * self.speed)
        axes = left[:, : len(sizes)][:, sizes > _REACHED * np.linalg.norm(self.tool_rates * self.speed)]
        if not axes.size:
            return np.zeros((1, 3))
        return np.asarray(Polytopes.from_box(axes.T @ rates, -self.speed, self.speed).vertices() @ axes.T)

    def force_ellipsoid(self) -> tuple[Array, Array]:
        """Return semi-axes and directions of the forces at which the drives' efforts, by their limits, have norm 1.

        Without moments and weight. It lies within the polytope, whose extent is at most as many times as great as the
        root of the number of drives (T. Yoshikawa, Foundations of Robotics, 1990).

        Returns:
            Semi-axes, greatest first, shape=(..., 3) [N], infinite where the structure carries a force alone; and unit
            vectors as columns, shape=(..., 3, 3).

        Raises:
            InvalidValueError: the effort of a drive is not described.
        """
        _require_known("effort", self.drives, self.effort)
        squares, directions = self._squares(self.effort)
        with np.errstate(divide="ignore"):
            return 1.0 / np.sqrt(squares), directions

    def speed_ellipsoid(self) -> tuple[Array, Array]:
        """Return semi-axes and directions of the velocities at which the drives' speeds, by their limits, have norm 1.

        Whatever the tool's rotation. Shapes as of :meth:`force_ellipsoid` [m/s].

        Raises:
            InvalidValueError: the speed of a drive is not described.
        """
        _require_known("speed", self.drives, self.speed)
        squares, directions = self._squares(1.0 / self.speed)
        return np.sqrt(squares[..., ::-1]), directions[..., ::-1]

    def _squares(self, weights: Vector) -> tuple[Array, Array]:
        """Return eigenvalues, least first, and eigenvectors of T_v (A^T W^2 A)^-1 T_v^T."""
        moves, known = self.tool_rates[..., :3, :], np.asarray(np.isfinite(self.tool_rates).all(axis=(-2, -1)))
        scaled = np.where(known[..., None, None], weights[:, None] * self.drive_rates, 1.0)
        inverse = np.linalg.pinv(np.einsum("...un,...um->...nm", scaled, scaled), hermitian=True)
        found = np.where(known[..., None, None], moves @ inverse @ moves.swapaxes(-1, -2), np.eye(3))
        squares, directions = np.linalg.eigh(found)
        squares = np.where(squares > _UNFELT * squares[..., -1:], squares, 0.0)
        return np.where(known[..., None], squares, np.nan), np.where(known[..., None, None], directions, np.nan)

    @cached_property
    def _solved_inverse(self) -> tuple[Mask, Array]:
        """Where poses are solved, shape=(...), and the pseudoinverses of T there, shape=(k, n, 6)."""
        known = np.asarray(np.isfinite(self.tool_rates).all(axis=(-2, -1)))
        return known, np.asarray(np.linalg.pinv(self.tool_rates[known]))

    def effort_left(self, wrenches: ArrayLike) -> Array:
        """Return the share of the drives' efforts that is left under wrenches, the least of them, shape=(...).

        Negative where one of the wrenches cannot be held. With redundant drives, internal forces are chosen best.

        Of drives whose set of wrenches has too many facets, each wrench is a linear program of its own, by HiGHS.

        Args:
            wrenches: wrenches [f; m] of the tool on its environment, shape=(6,) or (k, 6) [N, N m].

        Raises:
            InvalidValueError: the effort of a drive is not described.
        """
        rows = np.atleast_2d(np.asarray(wrenches, dtype=float))
        if pairs_of_facets(len(self.drives), self.drive_rates.shape[-1]) <= MOST_FACETS:
            return np.asarray(np.min([self.wrenches.share_left(wrench) for wrench in rows], axis=0))
        _require_known("effort", self.drives, self.effort)
        batch = self.tool_rates.shape[:-2]
        loads = self.weight[..., None, :] + np.einsum("...tn,kt->...kn", self.tool_rates, rows)
        found = [
            min(1.0 - self._least_share(self.drive_rates[k], load) for load in loads[k]) for k in np.ndindex(batch)
        ]
        return np.array(found).reshape(batch)

    def _least_share(self, drive_rates: Matrix, load: Vector) -> float:
        """Return the least share of all efforts with which efforts t of all drives give A^T t = load."""
        from scipy.optimize import linprog

        if not np.isfinite([*load, *drive_rates.ravel()]).all():
            return math.nan
        count, size = len(self.drives), float(np.linalg.norm(load)) or 1.0
        one, last = np.eye(count), -np.ones((count, 1))
        best = linprog(
            [0.0] * count + [1.0],
            A_ub=np.block([[one, last], [-one, last]]),
            b_ub=np.zeros(2 * count),
            A_eq=np.hstack([drive_rates.T * (self.effort / size), np.zeros((len(load), 1))]),
            b_eq=load / size,
            bounds=(None, None),
            method="highs",
        )
        if best.status != 0:
            raise ConvergenceError("the linear program of a wrench", math.nan, "N", best.nit, best.message)
        return float(best.x[-1])


def tool_capability(
    robot: Robot,
    poses: Poses | Configuration | ArrayLike,
    *,
    effort: Limit = None,
    speed: Limit = None,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> ToolCapability:
    """Compute what the tool can push, and how fast it can move, within the limits of the drives.

    Example:
        The tripod, with 500 N a drive, pushes up with what its weight leaves of three times 474 N:

        >>> import pm3dof_pin as pm
        >>> robot = pm.load("pm3dof")
        >>> at = pm.tool_capability(robot, robot.home, effort=500.0)
        >>> float(at.greatest_wrench([0, 0, 1, 0, 0, 0]).round(1))
        1404.4

    Args:
        robot: the robot, with a tool and drives.
        poses: solved poses, a configuration, or q with closed loops, shape=(..., nq) [m, rad].
        effort: limits of the drives' forces or torques, to either side [N, N m]; the description's by default.
        speed: limits of their rates [m/s, rad/s]; the description's by default.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia`.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Raises:
        SingularConfigurationError: the drives do not determine the tool's motion at a pose, or anywhere.
        InvalidValueError: a limit is negative, or names no drive.
        DescriptionError: the robot has no tool frame.
    """
    require_kind("robot", robot, Robot, "pm.load")
    if not robot.actuated_joints:
        raise SingularConfigurationError(f"{robot.name} has no drives")
    robot.require_regular_drives(from_home=False)
    names = [robot.actuated_joints[index] for index in robot.placing_drives]
    tool = jacobian(robot, poses, of="tool", by=names, **options).values
    if len(names) < len(robot.actuated_joints):
        drives = jacobian(robot, poses, of=robot.actuated_joints, by=names, **options).values
    else:
        drives = np.where(np.isfinite(tool[..., :1, :1]), np.eye(len(names)), np.nan)
    return ToolCapability(
        drives=robot.actuated_joints,
        tool_rates=tool,
        drive_rates=frozen(drives),
        weight=motion_dynamics(robot, poses, by=names, payloads=payloads, **options).weight,
        effort=drive_values(robot, "effort", effort),
        speed=drive_values(robot, "speed", speed),
    )


def _require_known(name: str, drives: tuple[str, ...], limits: Vector) -> None:
    for drive, limit in zip(drives, limits, strict=True):
        if not np.isfinite(limit):
            raise InvalidValueError(f"{name} of {drive}", "not described", f"--{name}, or a {name} in the description")
