"""Tolerance allocation: how exact each class of parts has to be made for a wanted accuracy of the tool.

With independent errors of standard deviation t, the tip error at pose j is sqrt(sum_i a_ij t_i^2), a_ij what parameter
i does to the squared tip error there. Errors of one class and unit share one tolerance. A class that does nothing to
the tip gets an infinite one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from pm3dof_pin.errors.error_map import ErrorMap
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.typing import Array

_ROUNDS = 50
_RELATIVE_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Allocation:
    """Tolerances that keep the tip error within a target at every pose of a map.

    Attributes:
        tolerances: standard deviation of each class of parts and unit, by "class [unit]" [m, rad].
        shares: part of each in the mean squared tip error over the map; they add up to 1.
        cost: sum over the parameters of weight * (tolerance in the map) / tolerance.
        tip_rms: tip error with these tolerances, shape=(n,) [m].
        worst_pose: index of the pose at which it is greatest.
    """

    tolerances: dict[str, float]
    shares: dict[str, float]
    cost: float
    tip_rms: Array
    worst_pose: int


def equal_contributions(
    error_map: ErrorMap, target: float, *, compensated: bool = False, weights: Mapping[str, float] | None = None
) -> Allocation:
    """Allocate tolerances so that every class adds the same to the mean squared tip error over the map.

    All are then scaled together until the worst pose just meets the target.

    Args:
        error_map: sensitivities over the workspace.
        target: greatest tip error allowed, root mean square over machines, at any pose [m].
        compensated: whether commands are corrected, so that only what they cannot undo counts.
        weights: see :func:`least_cost`; they do not change the tolerances here, only the cost.

    Raises:
        InvalidValueError: the target or a weight is not positive, or there is no such class.
    """
    names, squares, costs = _classes(error_map, compensated, weights)
    _require_positive(target)
    means = squares.mean(axis=0)
    active = means > 0.0
    tolerances = np.full(len(names), np.inf)
    tolerances[active] = 1.0 / np.sqrt(means[active])
    tolerances[active] *= target / np.sqrt((squares[:, active] @ tolerances[active] ** 2).max())
    return _allocation(names, squares, costs, tolerances)


def least_cost(
    error_map: ErrorMap, target: float, *, compensated: bool = False, weights: Mapping[str, float] | None = None
) -> Allocation:
    """Allocate the tolerances that cost least, the cost of a part being inversely proportional to its tolerance.

    A convex problem in the logarithms of the tolerances. Poses are added to it until none is beyond the target.

    Args:
        error_map: sensitivities over the workspace.
        target: greatest tip error allowed, root mean square over machines, at any pose [m].
        compensated: whether commands are corrected, so that only what they cannot undo counts.
        weights: cost of one parameter of a class, by "class [unit]", at the tolerance it has in the map; 1 by default.

    Raises:
        InvalidValueError: the target or a weight is not positive, or there is no such class.
        ConvergenceError: the optimisation failed.
    """
    names, squares, costs = _classes(error_map, compensated, weights)
    _require_positive(target)
    active = np.flatnonzero(squares.max(axis=0) > 0.0)
    scaled, active_costs = squares[:, active] / target**2, costs[active]
    pose = int(np.argmax(scaled.sum(axis=1)))
    # exact for one pose: cost c / t under sum a t^2 = 1 is least where t^3 is proportional to c / a
    cubes = active_costs / np.maximum(scaled[pose], 1e-6 * scaled.max(axis=0))
    logarithms = np.log(cubes) / 3.0
    logarithms -= 0.5 * np.log((scaled @ np.exp(2.0 * logarithms)).max())
    chosen = [pose]
    for step in range(_ROUNDS):
        logarithms = _cheapest(active_costs, scaled[chosen], logarithms, step)
        tip = scaled @ np.exp(2.0 * logarithms)
        worst = int(np.argmax(tip))
        if tip[worst] <= 1.0 + 1e-7 or worst in chosen:
            break
        chosen.append(worst)
    tolerances = np.full(len(names), np.inf)
    tolerances[active] = np.exp(logarithms) / np.sqrt(tip.max())
    return _allocation(names, squares, costs, tolerances)


def _cheapest(costs: Array, rows: Array, start: Array, step: int) -> Array:
    """Minimise sum c exp(-y) under rows @ exp(2 y) <= 1."""
    unit = float(costs @ np.exp(-start))

    def cost(y: Array) -> tuple[float, Array]:
        terms = costs * np.exp(-y) / unit
        return float(terms.sum()), -terms

    constraint = {
        "type": "ineq",
        "fun": lambda y: -np.log(rows @ np.exp(2.0 * y)),
        "jac": lambda y: -2.0 * rows * np.exp(2.0 * y) / (rows @ np.exp(2.0 * y))[:, None],
    }
    result = scipy.optimize.minimize(
        cost,
        start,
        jac=True,
        method="SLSQP",
        constraints=[constraint],
        options={"ftol": 1e-12, "maxiter": 500},
    )
    if not result.success:
        raise ConvergenceError(f"tolerance allocation ({result.message})", float(result.fun), "of the cost", step)
    return np.asarray(result.x)


def _classes(
    error_map: ErrorMap, compensated: bool, weights: Mapping[str, float] | None
) -> tuple[list[str], Array, Array]:
    """Return names of the classes, what unit tolerances of each do to the squared tip error, and their costs."""
    effects = error_map.uncompensable if compensated else error_map.weighted
    squares = np.sum(effects**2, axis=1)
    labels = [f"{p.group} [{p.unit}]" for p in error_map.errors.parameters]
    names = list(dict.fromkeys(labels))
    weights = weights or {}
    for name, weight in weights.items():
        if name not in names or not weight > 0.0:
            raise InvalidValueError(f"weight of {name}", weight, f"a positive one for one of {', '.join(names)}")
    members = np.array([[label == name for label in labels] for name in names], dtype=float)
    sums = squares @ members.T
    sums[sums < _RELATIVE_TOLERANCE * sums.max()] = 0.0
    costs = members @ error_map.errors.tolerances * [weights.get(name, 1.0) for name in names]
    return names, sums, costs


def _allocation(names: list[str], squares: Array, costs: Array, tolerances: Array) -> Allocation:
    finite = np.isfinite(tolerances)
    parts = squares[:, finite] * tolerances[finite] ** 2
    tip = np.sqrt(parts.sum(axis=1))
    worst = int(np.argmax(tip))
    shares = np.zeros(len(names))
    shares[finite] = parts.mean(axis=0) / parts.mean(axis=0).sum()
    return Allocation(
        tolerances=dict(zip(names, tolerances.tolist(), strict=True)),
        shares=dict(zip(names, shares.tolist(), strict=True)),
        cost=float(np.sum(costs[finite] / tolerances[finite])),
        tip_rms=tip,
        worst_pose=worst,
    )


def _require_positive(target: float) -> None:
    if not (np.isfinite(target) and target > 0.0):
        raise InvalidValueError("target", target, "a positive length [m]")
