"""The load at which an elastic mechanism buckles."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.load_path import FIRST_STEP, LoadPath, PathStep
from pm3dof_pin.elastic.loaded import LoadedEquilibrium
from pm3dof_pin.elastic.loaded_state import LoadedState
from pm3dof_pin.elastic.loads import AppliedLoads, Loads
from pm3dof_pin.exceptions import ConvergenceError, DeflectionRangeError, InvalidValueError, SingularConfigurationError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Vector

_log = logging.getLogger(__name__)

_REACH = 10.0
_MAX_POINTS = 1000
_AT_BIFURCATION = 1e-6  # least eigenvalue at a bifurcation point
_TYPICAL_MOTION = 0.1  # rad, or characteristic lengths


@dataclass(frozen=True, eq=False)
class BucklingLoad:
    """The first load at which the equilibrium becomes unstable."""

    factor: float  #: the load factor
    #: the same by linearised buckling: the stiffness removed by the loads is taken as proportional to them, in the
    #: unloaded geometry; infinite if they only add stiffness
    linear_estimate: float
    #: "bifurcation": the path continues to greater loads and is unstable; "limit point": the load has a maximum
    kind: Literal["bifurcation", "limit point"]
    #: initial motion of buckling, as velocities of all joints of the mechanism with virtual joints, normalised to a
    #: greatest one of 1 in scaled numbers, shape=(nv,)
    mode: Vector
    equilibrium: LoadedEquilibrium  #: the equilibrium there


@dataclass(frozen=True, eq=False)
class BucklingSearch:
    """The result of a search for a buckling load."""

    load: BucklingLoad | None  #: the buckling load; None if the mechanism is stable over the whole search
    largest_factor: float  #: the largest load factor reached
    end: str  #: why the search ended there


def search_buckling(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    loads: Loads,
    *,
    permanent: Loads | None = None,
    largest_factor: float | None = None,
) -> BucklingSearch:
    """Find the first buckling load along the equilibrium path from zero load, or how far the path is stable.

    The path is followed by arc length until the least eigenvalue of Z^T H Z changes sign, and the bracket is then
    narrowed from the nearest point found. An imperfect structure has no bifurcation: it deflects gradually, and its
    path is followed. The search ends at the largest factor, where a spring that represents a body is deflected further
    than a body can be, or where the mechanism reaches a dead point.

    Args:
        model: the elastic mechanism.
        configuration: configuration with springs at rest: an assembled one of the rigid mechanism, or its q.
        loads: loads that are multiplied by the factor sought.
        permanent: loads that always act in full.
        largest_factor: largest factor to search; by default ten times the linear estimate, or, if the loads only add
            stiffness, ten times the factor at which they double one.

    Raises:
        InvalidValueError: the loads have no potential (a moment of fixed direction in the world), or as for
            :func:`~pm3dof_pin.elastic.loaded.loaded_equilibrium`.
        SingularConfigurationError: the mechanism is unstable under the permanent loads alone.
        ConvergenceError: it has no equilibrium under the permanent loads alone.
        FrameNotFoundError: a load acts on a frame that the model does not have.
    """
    path = LoadPath(model, configuration, loads, permanent)
    start = path.unloaded()
    if start.least_eigenvalue <= 0.0:
        raise SingularConfigurationError(
            f"{model} is unstable without the growing loads: least eigenvalue {start.least_eigenvalue:.3e}"
        )
    estimate, doubling, moving = _scales(start, path.growing)
    largest = _REACH * (estimate if np.isfinite(estimate) else doubling) if largest_factor is None else largest_factor
    if not np.isfinite(largest):
        return BucklingSearch(None, 0.0, "the loads neither move the mechanism nor change its stiffness")
    point, length = path.begin(start, min(estimate, largest, moving)), FIRST_STEP
    for _ in range(_MAX_POINTS):
        try:
            step = path.advance(point, length)
        except DeflectionRangeError as error:
            return BucklingSearch(None, error.factor, str(error))
        except ConvergenceError as error:
            if point.state.least_eigenvalue > _AT_BIFURCATION:
                _log.warning("searched for buckling only up to a factor of %.6g: %s", point.factor, error)
                return BucklingSearch(None, point.factor, str(error))
            # next to a bifurcation, a correction may return to any of its branches
            step = PathStep(point, point, 0.0, bifurcation=True)
        if not step.end.state.symmetric:
            raise InvalidValueError("loads", problem="have no potential: they include moments of fixed direction")
        if step.length == 0.0 or not step.end.stable:
            critical = path.critical_point(step)
            if critical.factor > largest:
                break
            load = BucklingLoad(
                factor=critical.factor,
                linear_estimate=estimate,
                kind="limit point" if step.limit_point else "bifurcation",
                mode=_softest_motion(critical.state),
                equilibrium=LoadedEquilibrium(critical.factor, critical.steps, critical.state),
            )
            return BucklingSearch(load, critical.factor, load.kind)
        if step.end.factor > largest:
            break
        point, length = step.end, 2.0 * step.length
    else:
        return BucklingSearch(None, point.factor, f"stable at each of {_MAX_POINTS} points of the path")
    return BucklingSearch(None, largest, "stable up to the largest factor")


def _scales(state: LoadedState, loads: AppliedLoads) -> tuple[float, float, float]:
    """Return characteristic load factors, to first order; infinite if there are none.

    Returns:
        The factors at which the loads' stiffness, taken as proportional to them, cancels the tangent stiffness in some
        motion; at which it equals it in magnitude in some motion; and at which a joint has moved noticeably.
    """
    model, where, motions = state.model, state.configuration, state.bearing_motions
    forces = loads.forces(where)
    moved = motions @ np.linalg.solve(state.tangent, motions.T @ forces)
    closure_forces = state.motions.closing.T @ (state.hessian @ moved - forces)
    deflections = state.deflections
    ahead, back = (model.energy_derivatives(where, deflections + sign * moved)[1] for sign in (1.0, -1.0))
    change = motions.T @ (loads.resistance(where, closure_forces) + 0.5 * (ahead - back)) @ motions
    tangent = 0.5 * (state.tangent + state.tangent.T)
    values = scipy.linalg.eigvalsh(-0.5 * (change + change.T), tangent)
    largest = float(np.abs(values).max(initial=0.0))
    softening = float(values.max(initial=0.0))
    motion = float(np.abs(moved / model.mechanism.velocity_scale).max(initial=0.0))
    return (
        1.0 / softening if softening > SOLVED * largest else np.inf,
        1.0 / largest if largest > 0.0 else np.inf,
        _TYPICAL_MOTION / motion if motion > 0.0 else np.inf,
    )


def _softest_motion(state: LoadedState) -> Vector:
    motion = state.bearing_motions @ state.softest
    scaled = motion / state.model.mechanism.velocity_scale
    return frozen(motion / scaled[np.argmax(np.abs(scaled))])
