"""Tolerance allocation: how accurately each class of parts must be made for a desired accuracy of the tool.

With independent errors of standard deviation t, the rms tip error at pose j over machines is sqrt(sum_i a_ij t_i^2),
where a_ij is the effect of parameter i on the squared tip error there. Errors of one class and unit share one
tolerance; a class without effect on the tip gets an infinite one. With a coverage, all tolerances are then scaled down
so that this fraction of the machines, drawn at random, stays within the target at every pose of the map. Tolerances
have the same meaning as those of the map: standard deviations, or half widths of uniform distributions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from pm3dof_pin.errors.error_map import ErrorMap
from pm3dof_pin.errors.error_parameters import HALF_WIDTH, Distribution
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array

_MACHINES = 2000
_CHUNK = 200  # machines at a time
_LINEAR = 0.05  # of the machine's size: larger errors are not small

_ROUNDS = 50


Rule = Literal["equal_contributions", "least_cost"]


@dataclass(frozen=True, eq=False)
class Allocation:
    """Tolerances that keep the tip error within a target at every pose of a map."""

    tolerances: dict[str, float]  #: of each class of parts and unit, by "class [unit]" [m, rad]
    shares: dict[str, float]  #: share of each in the mean squared tip error over the map; they sum to 1
    cost: float  #: sum over the parameters of (tolerance in the map) / tolerance
    tip_rms: Array  #: tip error with these tolerances, root mean square over machines, shape=(n,) [m]


def allocate_tolerances(
    error_map: ErrorMap, target: float, rule: Rule, *, compensated: bool = False, coverage: float | None = None
) -> Allocation:
    """Allocate tolerances so that the worst pose just meets a target.

    Args:
        error_map: sensitivities over the workspace.
        target: greatest allowed tip error at any pose [m].
        rule: "equal_contributions", every class contributes equally to the mean squared tip error over the map; or
            "least_cost", with the cost of a part inversely proportional to its tolerance.
        compensated: whether commands are corrected, so that only the rest counts.
        coverage: fraction of the machines that stay within the target at every pose, such as 0.95; by default the
            target applies to the rms over machines, which more than half of them exceed somewhere.

    Raises:
        InvalidValueError: the target is not positive or not small, or the coverage is not between 0 and 1.
        ConvergenceError: the optimisation failed.
    """
    if not (np.isfinite(target) and target > 0.0):
        raise InvalidValueError("target", target, "a positive length [m]")
    limit = _LINEAR * error_map.errors.robot.characteristic_length
    if target > limit:
        expected = f"a small error in metres, below {limit:.2g} for a machine of this size: 100 µm are 1e-4"
        raise InvalidValueError("target", target, expected)
    effects = error_map.uncompensable if compensated else error_map.weighted
    labels = [f"{parameter.group} [{parameter.unit}]" for parameter in error_map.errors.parameters]
    names = list(dict.fromkeys(labels))
    members = np.equal.outer(names, labels).astype(float)
    # effect of unit tolerances of each class on the squared tip error at each pose
    squares = np.sum(effects**2, axis=1) @ members.T
    squares[squares < SOLVED * squares.max()] = 0.0
    costs = members @ error_map.errors.tolerances
    active = np.flatnonzero(squares.max(axis=0) > 0.0)
    scaled = squares[:, active] / target**2
    equal = rule == "equal_contributions"
    sigmas = 1.0 / np.sqrt(scaled.mean(axis=0)) if equal else _cheap(scaled, costs[active])
    sigmas /= np.sqrt((scaled @ sigmas**2).max())
    if coverage is not None:
        if not 0.0 < coverage < 1.0:
            raise InvalidValueError("coverage", coverage, "a fraction of the machines between 0 and 1, such as 0.95")
        greatest = _greatest_tips(effects * (sigmas @ members[active]), error_map.distribution)
        sigmas *= target / float(np.quantile(greatest, coverage))
    parts = squares[:, active] * sigmas**2
    tolerances, shares = np.full(len(names), np.inf), np.zeros(len(names))
    tolerances[active] = sigmas * (1.0 if error_map.distribution == "normal" else HALF_WIDTH)
    shares[active] = parts.mean(axis=0) / parts.mean(axis=0).sum()
    return Allocation(
        tolerances=dict(zip(names, tolerances.tolist(), strict=True)),
        shares=dict(zip(names, shares.tolist(), strict=True)),
        cost=float(np.sum(costs[active] / tolerances[active])),
        tip_rms=np.sqrt(parts.sum(axis=1)),
    )


def _cheap(scaled: Array, costs: Array) -> Array:
    """Return the cheapest sigmas: a convex problem in their logarithms, adding poses until all meet the target."""
    pose = int(np.argmax(scaled.sum(axis=1)))
    # exact for one pose: cost c / t under sum a t^2 = 1 is least if t^3 is proportional to c / a
    cubes = costs / np.maximum(scaled[pose], 1e-6 * scaled.max(axis=0))
    logarithms = np.log(cubes) / 3.0
    logarithms -= 0.5 * np.log((scaled @ np.exp(2.0 * logarithms)).max())
    chosen = [pose]
    for step in range(_ROUNDS):
        logarithms = _cheapest(costs, scaled[chosen], logarithms, step)
        tip = scaled @ np.exp(2.0 * logarithms)
        worst = int(np.argmax(tip))
        if tip[worst] <= 1.0 + 1e-7 or worst in chosen:
            break
        chosen.append(worst)
    return np.asarray(np.exp(logarithms))


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
    options = {"ftol": 1e-12, "maxiter": 500}
    result = scipy.optimize.minimize(cost, start, jac=True, method="SLSQP", constraints=[constraint], options=options)
    if not result.success:
        raise ConvergenceError(f"tolerance allocation ({result.message})", float(result.fun), "of the cost", step)
    return np.asarray(result.x)


def _greatest_tips(effects: Array, distribution: Distribution) -> Array:
    """Return the greatest tip error over the poses for random machines, to first order, shape=(machines,).

    `effects` are tip-weighted, of each parameter at one standard deviation, shape=(n, 6, parameters) [m].
    """
    flat = effects.reshape(-1, effects.shape[2])
    generator, greatest = np.random.default_rng(0), []
    for _ in range(_MACHINES // _CHUNK):
        shape, normal = (effects.shape[2], _CHUNK), distribution == "normal"
        drawn = generator.standard_normal(shape) if normal else generator.uniform(-HALF_WIDTH, HALF_WIDTH, shape)
        tips = (flat @ drawn).reshape(-1, 6, _CHUNK)
        greatest.append(np.sqrt(np.max(np.einsum("nim,nim->nm", tips, tips), axis=0)))
    return np.concatenate(greatest)
