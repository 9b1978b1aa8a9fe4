"""Tolerance allocation: how exact each class of parts has to be made for a wanted accuracy of the tool.

With independent errors of standard deviation t, the tip error at pose j is, root mean square over machines,
sqrt(sum_i a_ij t_i^2), a_ij what parameter i does to the squared tip error there. Errors of one class and unit share
one tolerance. A class that does nothing to the tip gets an infinite one. With a coverage all tolerances are then made
so much narrower that this part of the machines, drawn at random, stays within the target at every pose of the map.
Tolerances are what those of the map are: standard deviations, or half widths of uniform distributions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.optimize

from pm3dof_pin.errors.error_map import ErrorMap
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.typing import Array

_MACHINES = 2000
_CHUNK = 200  # machines at a time
_LINEAR = 0.05  # of the machine's size: errors beyond are no small ones
_HALF_WIDTH = np.sqrt(3.0)  # of a uniform distribution, in standard deviations

_ROUNDS = 50
_RELATIVE_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Allocation:
    """Tolerances that keep the tip error within a target at every pose of a map."""

    tolerances: dict[str, float]  #: of each class of parts and unit, by "class [unit]" [m, rad]
    shares: dict[str, float]  #: part of each in the mean squared tip error over the map; they add up to 1
    cost: float  #: sum over the parameters of weight * (tolerance in the map) / tolerance
    tip_rms: Array  #: tip error with these tolerances, root mean square over machines, shape=(n,) [m]
    worst_pose: int  #: index of the pose at which it is greatest


def equal_contributions(
    error_map: ErrorMap,
    target: float,
    *,
    compensated: bool = False,
    weights: Mapping[str, float] | None = None,
    coverage: float | None = None,
) -> Allocation:
    """Allocate tolerances so that every class adds the same to the mean squared tip error over the map.

    All are then scaled together until the worst pose just meets the target. For the arguments see :func:`least_cost`;
    weights change the cost only.

    Raises:
        InvalidValueError: the target or a weight is not positive, the target is no small error, or no such class.
    """
    names, squares, costs = _classes(error_map, compensated, weights)
    _require_small(error_map, target)
    means = squares.mean(axis=0)
    active = means > 0.0
    tolerances = np.full(len(names), np.inf)
    tolerances[active] = 1.0 / np.sqrt(means[active])
    tolerances[active] *= target / np.sqrt((squares[:, active] @ tolerances[active] ** 2).max())
    return _allocation(
        error_map, squares, costs, _covering(error_map, compensated, names, tolerances, target, coverage)
    )


def least_cost(
    error_map: ErrorMap,
    target: float,
    *,
    compensated: bool = False,
    weights: Mapping[str, float] | None = None,
    coverage: float | None = None,
) -> Allocation:
    """Allocate the tolerances that cost least, the cost of a part being inversely proportional to its tolerance.

    A convex problem in the logarithms of the tolerances. Poses are added to it until none is beyond the target.

    Args:
        error_map: sensitivities over the workspace.
        target: greatest tip error allowed at any pose [m].
        compensated: whether commands are corrected, so that only what they cannot undo counts.
        weights: cost of one parameter of a class, by "class [unit]", at the tolerance it has in the map; 1 by default.
        coverage: part of the machines that stay within the target at every pose, such as 0.95; by default it is met by
            the root mean square over machines, which more than half of them exceed somewhere.

    Raises:
        InvalidValueError: the target or a weight is not positive, the target is no small error, or no such class.
        ConvergenceError: the optimisation failed.
    """
    names, squares, costs = _classes(error_map, compensated, weights)
    _require_small(error_map, target)
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
    return _allocation(
        error_map, squares, costs, _covering(error_map, compensated, names, tolerances, target, coverage)
    )


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


def _covering(
    error_map: ErrorMap, compensated: bool, names: list[str], sigmas: Array, target: float, coverage: float | None
) -> dict[str, float]:
    """Return standard deviations of the classes by name, narrowed until they cover so many machines."""
    factor = 1.0
    if coverage is not None:
        if not 0.0 < coverage < 1.0:
            raise InvalidValueError("coverage", coverage, "a part of the machines between 0 and 1, such as 0.95")
        found = dict(zip(names, np.where(np.isfinite(sigmas), sigmas, 0.0), strict=True))
        each = np.array([found[f"{p.group} [{p.unit}]"] for p in error_map.errors.parameters])
        factor = target / float(np.quantile(_greatest_tips(error_map, compensated, each), coverage))
    return dict(zip(names, (factor * sigmas).tolist(), strict=True))


def _greatest_tips(error_map: ErrorMap, compensated: bool, sigmas: Array) -> Array:
    """Return the greatest tip error over the poses of machines drawn at random, to first order, shape=(machines,)."""
    effects = ((error_map.uncompensable if compensated else error_map.weighted) * sigmas).reshape(-1, len(sigmas))
    generator, greatest = np.random.default_rng(0), []
    for _ in range(_MACHINES // _CHUNK):
        shape = (len(sigmas), _CHUNK)
        drawn = (
            generator.standard_normal(shape)
            if error_map.distribution == "normal"
            else generator.uniform(-_HALF_WIDTH, _HALF_WIDTH, shape)
        )
        tips = (effects @ drawn).reshape(-1, 6, _CHUNK)
        greatest.append(np.sqrt(np.max(np.einsum("nim,nim->nm", tips, tips), axis=0)))
    return np.concatenate(greatest)


def _allocation(error_map: ErrorMap, squares: Array, costs: Array, sigmas: Mapping[str, float]) -> Allocation:
    names, values = list(sigmas), np.array(list(sigmas.values()))
    finite = np.isfinite(values)
    parts = squares[:, finite] * values[finite] ** 2
    tip = np.sqrt(parts.sum(axis=1))
    worst = int(np.argmax(tip))
    shares = np.zeros(len(names))
    shares[finite] = parts.mean(axis=0) / parts.mean(axis=0).sum()
    tolerances = values * (1.0 if error_map.distribution == "normal" else _HALF_WIDTH)
    return Allocation(
        tolerances=dict(zip(names, tolerances.tolist(), strict=True)),
        shares=dict(zip(names, shares.tolist(), strict=True)),
        cost=float(np.sum(costs[finite] / tolerances[finite])),
        tip_rms=tip,
        worst_pose=worst,
    )


def _require_small(error_map: ErrorMap, target: float) -> None:
    if not (np.isfinite(target) and target > 0.0):
        raise InvalidValueError("target", target, "a positive length [m]")
    limit = _LINEAR * error_map.errors.robot.characteristic_length
    if target > limit:
        expected = f"a small error in metres, below {limit:.2g} for a machine of this size: 100 µm are 1e-4"
        raise InvalidValueError("target", target, expected)
