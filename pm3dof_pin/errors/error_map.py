"""Error maps: tool errors caused by errors of parts at each pose, and the part that commands can undo.

To first order dx = S p, with sensitivities S and errors p of the parts. A command correction moves the tool by C du.
In the tip-weighted metric, W = diag(1, 1, 1, eta, eta, eta), the best du leaves (1 - W C (W C)^+) W S p, which no
command can remove. With fewer than six drives this is considerable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.errors.error_parameters import HALF_WIDTH, Distribution, GeometricErrors
from pm3dof_pin.errors.normal_vectors import norm_quantiles
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_weights
from pm3dof_pin.errors.sensitivity import Sensitivities, sensitivities
from pm3dof_pin.errors.tool_errors import ToolErrors
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array


@dataclass(frozen=True, eq=False)
class ParameterShare:
    """Share of one parameter in the errors of the tool."""

    name: str  #: the parameter
    group: str  #: its class of parts
    share: float  #: its share of the mean squared tip error over the map; all shares sum to 1
    uncompensable_share: float  #: its share of what commands cannot undo; 0 if they undo everything
    tip_rms: float  #: tip error caused by it alone within its tolerance, root mean square over the map [m]


@dataclass(frozen=True, eq=False)
class ErrorMap(ToolErrors):
    """First-order errors of the tool at n poses."""

    errors: GeometricErrors  #: the parameters, with their tolerances
    poses: Poses  #: the poses, of the robot as described
    sensitivities: Sensitivities  #: the tool's motion by errors and commands
    sigmas: Array  #: standard deviation of each parameter, shape=(number of parameters,) [m, rad]
    eta: float  #: weight of the orientation in the tip error [m/rad]
    #: meaning of the tolerances: standard deviations ("normal") or half widths of uniform distributions
    distribution: Distribution = "normal"

    @cached_property
    def weighted(self) -> Array:
        """W S, shape=(n, 6, number of parameters) [m per unit of the parameter]."""
        return frozen(self.sensitivities.errors * self.weights[:, None])

    @cached_property
    def uncompensable(self) -> Array:
        """The part of W S that no command can undo, shape=(n, 6, number of parameters)."""
        left = self._basis @ -self._compensable
        left += self.weighted
        sizes, whole = (np.einsum("nik,nik->nk", columns, columns) for columns in (left, self.weighted))
        left *= (sizes > SOLVED**2 * whole)[:, None]
        return frozen(left)

    @cached_property
    def _compensable(self) -> Array:
        """Part of W S that commands undo, in the basis of their motions, shape=(n, number of commands, parameters)."""
        return np.asarray(np.swapaxes(self._basis, 1, 2) @ self.weighted)

    def _by_commands(self) -> Array:
        return self.sensitivities.commands

    @property
    def shift(self) -> Array:
        """Zero, since geometric errors have no known part, shape=(n, 6)."""
        return np.zeros((len(self.poses), 6))

    @property
    def effects(self) -> Array:
        """Effect of each parameter at one standard deviation, shape=(n, 6, number of parameters) [m, rad]."""
        return np.asarray(self.sensitivities.errors * self.sigmas)

    @property
    def greatest(self) -> Array:
        """The tolerances in standard deviations, shape=(number of parameters,)."""
        return np.asarray(self.errors.tolerances / self.sigmas)

    @property
    def tip_rms(self) -> Array:
        """Root-sum-square tip error of all parameters, shape=(n,) [m]."""
        return self._sizes(self.weighted, self.sigmas)

    @property
    def position_rms(self) -> Array:
        """Root-sum-square error of the tool point, shape=(n,) [m]."""
        return self._sizes(self.sensitivities.errors[:, :3], self.sigmas)

    @property
    def orientation_rms(self) -> Array:
        """Root-sum-square error of the orientation, shape=(n,) [rad]."""
        return self._sizes(self.sensitivities.errors[:, 3:], self.sigmas)

    @property
    def uncompensable_rms(self) -> Array:
        """Remaining tip error with the best commands, shape=(n,) [m]."""
        return self._sizes(self.uncompensable, self.sigmas)

    @property
    def compensable_rms(self) -> Array:
        """Tip error that the best commands undo, orthogonal to the remaining one, shape=(n,) [m]."""
        return self._sizes(self._compensable, self.sigmas)

    def tip_bound(self, coverage: float) -> Array:
        """Return the tip error below which this fraction of machines, such as 0.95, stays at each pose, shape=(n,) [m].

        To first order; sums of many uniform errors are approximated as normal.

        Raises:
            InvalidValueError: the coverage is not between 0 and 1.
        """
        scaled = self.weighted * self.sigmas
        return norm_quantiles(np.zeros(scaled.shape[:2]), scaled @ np.swapaxes(scaled, 1, 2), coverage)

    def ranking(self) -> list[ParameterShare]:
        """Return all parameters, the most critical first."""
        squares, left = (
            np.einsum("nik,nik->k", effects, effects) * (self.sigmas**2 / len(effects))
            for effects in (self.weighted, self.uncompensable)
        )
        shares = [
            ParameterShare(
                parameter.name,
                parameter.group,
                float(squares[k] / squares.sum()),
                float(left[k] / left.sum()) if left.sum() > 0.0 else 0.0,
                float(np.sqrt(squares[k])),
            )
            for k, parameter in enumerate(self.errors.parameters)
        ]
        # parameters of equal share, as of similar legs, keep their order
        return sorted(shares, key=lambda share: -float(f"{share.share:.9e}"))


def error_map(
    errors: GeometricErrors,
    poses: Poses,
    *,
    eta: float = TIP_LENGTH,
    distribution: Distribution = "normal",
    found: Sensitivities | None = None,
) -> ErrorMap:
    """Compute the tool errors caused by tolerances of the parts.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> errors = pm.GeometricErrors.load("pm3dof")
        >>> errors_of_the_tool = pm.error_map(errors, pm.reachable_poses(errors.robot, 50, np.random.default_rng(0)))
        >>> errors_of_the_tool.tip_rms.shape
        (50,)
        >>> errors_of_the_tool.ranking()[0].name
        'passive_slider_joint.tx'

    Args:
        errors: the parameters, with their tolerances.
        poses: poses of the robot as described.
        eta: weight of the orientation in the tip error [m/rad].
        distribution: meaning of the tolerances: standard deviations ("normal") or half widths of uniform distributions.
        found: the sensitivities at these poses, if they are known already.

    Raises:
        InvalidValueError: there are no poses or no parameters, or the loops cannot close with an error.
        SingularConfigurationError: at some pose the tool can move with all drives locked.
    """
    require_kind("errors", errors, GeometricErrors, "pm.GeometricErrors.load")
    require_kind("poses", poses, Poses, "Robot.solve")
    if not len(poses) or not len(errors):
        raise InvalidValueError(
            "error map", problem=f"has {len(poses)} poses and {len(errors)} parameters", expected="at least one of each"
        )
    sigmas = errors.tolerances if distribution == "normal" else errors.tolerances / HALF_WIDTH
    found = sensitivities(errors, poses) if found is None else found
    return ErrorMap(errors, poses, found, frozen(np.array(sigmas)), eta, distribution)


def section_grid(
    robot: Robot,
    *,
    ranges: Mapping[str, tuple[float, float, int]] | None = None,
    fixed: Mapping[str, float] | None = None,
    points: int = 41,
) -> Grid | None:
    """Make the grid of a section over two coordinates, with the others in the middle of their ranges or at home.

    By default over the first two with ranges and no fixed value, `points` values each; None without such.
    `ranges` are first value, last value, count by name; `fixed` values by name [m, rad].

    Raises:
        InvalidValueError: the robot has no such coordinate, or a range is malformed.
    """
    known = {c.name: robot.range_of(c) for c in robot.coordinates}
    limited = {name: ends for name, ends in known.items() if np.isfinite(ends).all()}
    values: dict[str, float | tuple[float, float, int]] = {name: 0.5 * sum(ends) for name, ends in limited.items()}
    values |= fixed or {}
    if ranges is None:
        free = [name for name in limited if name not in (fixed or {})][:2]
        ranges = {name: (*limited[name], points) for name in free}
    return robot.grid(**{**values, **ranges}) if ranges else None


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """Errors of simulated machines, computed by closing their loops, without linearisation."""

    values: Array  #: p of each machine, shape=(machines, number of parameters) [m, rad]
    differences: Array  #: pose errors at fixed commands [translation; rotation vector], shape=(machines, n, 6) [m, rad]

    def tip_rms(self) -> Array:
        """Return the root mean square tip error over the machines, shape=(n,) [m]."""
        return np.asarray(np.sqrt(np.mean(np.sum((self.differences * tip_weights(TIP_LENGTH)) ** 2, axis=2), axis=0)))


def monte_carlo(
    errors: GeometricErrors,
    poses: Poses,
    machines: int,
    generator: np.random.Generator,
    *,
    distribution: Distribution = "normal",
) -> MonteCarlo:
    """Draw machines within the tolerances and compute their true tool poses at the commands of given poses.

    Raises:
        UnreachablePoseError: the loops of a machine do not close at a command.
    """
    values = np.array([errors.sample(generator, distribution) for _ in range(machines)])
    differences = [
        pose_difference(poses.transforms, errors.apply(p).forward(poses.commands, guess=poses.q).transforms)
        for p in values
    ]
    return MonteCarlo(frozen(values), frozen(np.array(differences)))
