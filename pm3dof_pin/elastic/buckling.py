"""The load at which an elastic mechanism buckles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.load_path import LoadPath, PathPoint
from pm3dof_pin.elastic.loaded import EQUILIBRIUM_TOLERANCE, LoadedEquilibrium
from pm3dof_pin.elastic.loaded_state import LoadedState
from pm3dof_pin.elastic.loads import AppliedLoads, Loads
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError, SingularConfigurationError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Vector

_PRECISION = 1e-9
_ASYMMETRY = 1e-6
_STEP = 0.2
_REACH = 10.0


@dataclass(frozen=True, eq=False)
class BucklingLoad:
    """The first load at which an equilibrium stops being stable.

    Attributes:
        factor: what the loads are multiplied by there.
        linear_estimate: the same by linearised buckling: the stiffness that the loads take away is taken as
            proportional to them, in the geometry before they act; infinite if they add stiffness only.
        kind: "bifurcation", the path goes on to greater loads and is unstable; "limit point", the load has a maximum.
        mode: motion that buckling begins with, as velocities of all joints of the mechanism with virtual joints, the
            greatest of which is 1 in scaled numbers, shape=(nv,).
        equilibrium: the equilibrium there.
    """

    factor: float
    linear_estimate: float
    kind: Literal["bifurcation", "limit point"]
    mode: Vector
    equilibrium: LoadedEquilibrium


def buckling_load(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    loads: Loads,
    *,
    permanent: Loads | None = None,
    largest_factor: float | None = None,
    tolerance: float = EQUILIBRIUM_TOLERANCE,
    max_steps: int = 60,
) -> BucklingLoad | None:
    """Find the first buckling load on the path of equilibria from no loads on.

    The path is followed by its arc length until the least eigenvalue of Z^T H Z changes its sign, and the root is found
    by Brent's method. An imperfect structure has no bifurcation: it bends away, and its path is followed as it bends.

    Args:
        model: the elastic mechanism.
        configuration: where the springs are at rest: an assembled configuration of the rigid mechanism, or its q.
        loads: loads, which are multiplied by the factor that is looked for.
        permanent: loads that always act in full.
        largest_factor: factor to look up to; ten times the linear estimate by default.
        tolerance: see :func:`~pm3dof_pin.elastic.loaded.loaded_equilibrium`.
        max_steps: Newton steps for one increment.

    Returns:
        The buckling load, or None if the mechanism is stable up to the largest factor, or if none is given and the
        loads add stiffness only.

    Raises:
        InvalidValueError: the loads have no potential (a moment that keeps its direction in the world), or see
            :func:`~pm3dof_pin.elastic.loaded.loaded_equilibrium`.
        SingularConfigurationError: the mechanism is unstable under the permanent loads alone.
        ConvergenceError: it has no equilibrium under the permanent loads alone, or the path could not be followed.
        FrameNotFoundError: a load acts on a frame that the model does not have.
    """
    path = LoadPath(model, configuration, loads, permanent, tolerance=tolerance, max_steps=max_steps)
    start, _ = path.equilibrium(0.0, path.rest)
    if start.least_eigenvalue <= 0.0:
        raise SingularConfigurationError(
            f"{model} is unstable without the loads that are to grow: least eigenvalue {start.least_eigenvalue:.3e}"
        )
    estimate = _linear_estimate(start, path.growing)
    largest = _REACH * estimate if largest_factor is None else largest_factor
    if not np.isfinite(largest):
        return None
    stable = path.begin(start, min(estimate, largest))
    while stable.factor < largest:
        beyond, step = path.advance(stable, _STEP)
        _require_potential(beyond.state)
        if beyond.state.least_eigenvalue <= 0.0:
            critical = _critical_point(path, stable, beyond, step)
            return BucklingLoad(
                factor=critical.factor,
                linear_estimate=estimate,
                kind="bifurcation" if beyond.load_grows else "limit point",
                mode=_softest_motion(critical.state),
                equilibrium=LoadedEquilibrium(critical.factor, critical.steps, critical.state),
            )
        stable = beyond
    return None


def _critical_point(path: LoadPath, stable: PathPoint, beyond: PathPoint, step: float) -> PathPoint:
    """Return the point between two where the least eigenvalue vanishes."""
    found = {0.0: stable, step: beyond}

    def least_eigenvalue(length: float) -> float:
        if length not in found:
            point = path.point_at(stable, length)
            if point is None:
                raise ConvergenceError(
                    f"the load path beyond a factor of {stable.factor:.6g}", stable.state.imbalance, "J^(1/2)", 0
                )
            found[length] = point
        return found[length].state.least_eigenvalue

    root = scipy.optimize.brentq(least_eigenvalue, 0.0, step, xtol=_PRECISION * step, rtol=_PRECISION)
    return found[min(found, key=lambda length: abs(length - root))]


def _require_potential(state: LoadedState) -> None:
    asymmetry = np.abs(state.tangent - state.tangent.T).max(initial=0.0)
    if asymmetry > _ASYMMETRY * np.abs(state.tangent).max(initial=0.0):
        raise InvalidValueError("loads", "without a potential", "no moments that keep their direction in the world")


def _linear_estimate(state: LoadedState, loads: AppliedLoads) -> float:
    """Return the factor at which the loads' stiffness, taken as proportional to them, uses up the tangent stiffness."""
    model, where, motions = state.model, state.configuration, state.bearing_motions
    forces = loads.forces(where)
    moved = motions @ np.linalg.solve(state.tangent, motions.T @ forces)
    closure_forces = state.motions.closing.T @ (state.hessian @ moved - forces)
    deflections = state.deflections
    ahead, back = (model.energy_derivatives(where, deflections + sign * moved)[1] for sign in (1.0, -1.0))
    change = motions.T @ (loads.resistance(where, closure_forces) + 0.5 * (ahead - back)) @ motions
    tangent = 0.5 * (state.tangent + state.tangent.T)
    greatest = float(scipy.linalg.eigvalsh(-0.5 * (change + change.T), tangent).max(initial=0.0))
    return 1.0 / greatest if greatest > 0.0 else float("inf")


def _softest_motion(state: LoadedState) -> Vector:
    vectors = np.linalg.eigh(0.5 * (state.tangent + state.tangent.T))[1]
    motion = state.bearing_motions @ vectors[:, 0]
    scaled = motion / state.model.mechanism.velocity_scale
    return frozen(motion / scaled[np.argmax(np.abs(scaled))])
