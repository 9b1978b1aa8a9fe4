"""An elastic mechanism in one configuration under loads, and Newton's method on such states."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin

from pm3dof_pin.elastic.contact_laws import SEAT
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loads import AppliedLoads
from pm3dof_pin.elastic.motions import elastic_motions
from pm3dof_pin.elastic.springs import AxialSpring, CantileverSpring, JointSpring
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.singular_values import svd
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Indices, Matrix, Vector

_CLOSED = 1e-11  # closure residual of an equilibrium [characteristic lengths, or rad]
_EQUILIBRIUM = 1e-10  # imbalance, relative to the loads
_MAX_BEND = 1.0  # rotation of one spring that represents a body, for small-deflection stiffness [rad]
_SYMMETRY = 1e-6
_MAX_STEPS = 60  # Newton steps
_CLOSING_STEPS = 20
_CLOSING_ROUNDS = 4
_LONGEST_STEP = 0.3  # rad, or characteristic lengths
_SHORTEST_FRACTION = 1e-5
_MIN_GAIN = 1e-4


class LoadedState:
    """The imbalance and the tangent stiffness at a configuration.

    Args:
        model: the elastic mechanism.
        rest: configuration with the springs at rest, of `model.mechanism`.
        loads: the loads.
        configuration: an assembled configuration of `model.mechanism`.
        near: deflections nearest to which those of continuous joints are chosen, shape=(nv,), to count whole turns; by
            default those within half a turn.
        seat: stiffness of contacts within their play, relative to that of the closed contact.

    Attributes:
        motions: the possible motions of the mechanism.
        deflections: deflection of each joint from the configuration with springs at rest, shape=(nv,).
        closure_forces: lambda, force (6d: wrench) on frame b of each closure, opposite to that on frame a, in the axes
            of frame a, shape=(m,).
        unbalanced: unbalanced generalised forces, shape=(nv,).
        basis: motions Z: those of the springs with Z^T K_q Z = 1, then those with the springs at rest, scaled by the
            size of the loads, shape=(nv, k).
        residual: unbalanced forces on these motions, shape=(k,).
    """

    def __init__(
        self,
        model: ElasticModel,
        rest: Configuration,
        loads: AppliedLoads,
        configuration: Configuration,
        near: Vector | None = None,
        seat: float = SEAT,
    ) -> None:
        self.model, self.rest, self.configuration = model, rest, configuration
        self._loads, self._seat = loads, seat
        self.motions = elastic_motions(model, configuration)
        self.deflections: Vector = pin.difference(
            model.mechanism.model, np.array(rest.q), np.array(configuration.q)
        ).reshape(model.mechanism.model.nv)
        if near is not None:
            turning = _continuous(model.mechanism.model)
            turns = np.round((near[turning] - self.deflections[turning]) / (2.0 * np.pi))
            self.deflections[turning] += 2.0 * np.pi * turns
        gradient, self._springs_hessian = model.energy_derivatives(configuration, self.deflections, seat=seat)
        forces = loads.forces(configuration)
        self.closure_forces: Vector = self.motions.closing.T @ (gradient - forces)
        self.unbalanced: Vector = gradient - forces - configuration.constraint_jacobian.T @ self.closure_forces
        self.unbalanced[model.locked_indices] = 0.0
        unit = 1.0 / np.sqrt(loads.size) if loads.size > 0.0 else 1.0
        self.basis: Matrix = np.hstack([self.motions.elastic, unit * self.motions.unstrained])
        self.residual: Vector = self.basis.T @ (gradient - forces)
        self.imbalance = float(np.linalg.norm(self.residual))
        """Size of the residual; its square is twice the energy that Newton's step would release."""
        self.load_size = float(np.linalg.norm(np.abs(self.basis).T @ np.abs(forces)))
        """The imbalance due to the loads alone, in absolute values."""
        rounding = np.finfo(float).eps * np.abs(self._springs_hessian) @ model.mechanism.velocity_scale
        self.rounding = float(np.linalg.norm(np.abs(self.basis).T @ rounding))
        """The imbalance due to rounding of q."""

    @property
    def balanced(self) -> bool:
        """Whether the imbalance is within tolerance, relative to the loads or to rounding."""
        return self.imbalance <= _EQUILIBRIUM * self.load_size + self.rounding

    @cached_property
    def hessian(self) -> Matrix:
        """H, shape=(nv, nv)."""
        loads: Matrix = self._loads.resistance(self.configuration, self.closure_forces)
        return self._springs_hessian + loads

    @cached_property
    def bearing_motions(self) -> Matrix:
        """Motions of the basis resisted by springs or loads, as velocities, shape=(nv, k)."""
        return self.basis @ self._combinations[0]

    @cached_property
    def idle_motions(self) -> Matrix:
        """Motions of the basis resisted by nothing, as velocities, shape=(nv, k)."""
        return self.basis @ self._combinations[1]

    @cached_property
    def tangent(self) -> Matrix:
        """Z^T H Z on the bearing motions; the identity without loads."""
        tangent: Matrix = self.bearing_motions.T @ self.hessian @ self.bearing_motions
        return tangent

    @cached_property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric, as it is if the loads have a potential."""
        asymmetry = np.abs(self.tangent - self.tangent.T).max(initial=0.0)
        return bool(asymmetry <= _SYMMETRY * np.abs(self.tangent).max(initial=0.0))

    @cached_property
    def eigenvalues(self) -> Vector:
        """Eigenvalues of the symmetric part of the tangent, ascending, shape=(k,)."""
        return np.asarray(np.linalg.eigvalsh(0.5 * (self.tangent + self.tangent.T)), dtype=np.float64)

    @property
    def least_eigenvalue(self) -> float:
        """Least eigenvalue of the symmetric part of the tangent; infinite if nothing can move."""
        return float(self.eigenvalues.min(initial=np.inf))

    @cached_property
    def instability(self) -> int:
        """Number of negative eigenvalues of the tangent; only its parity (0 or 1) if the tangent is asymmetric."""
        if self.symmetric:
            return int(np.count_nonzero(self.eigenvalues < 0.0))
        return int(np.linalg.slogdet(self.tangent)[0] < 0.0)

    @cached_property
    def softest(self) -> Vector:
        """The combination of bearing motions with the least resistance, a unit vector, shape=(k,)."""
        vector: Vector = np.linalg.eigh(0.5 * (self.tangent + self.tangent.T))[1][:, 0]
        return vector

    @cached_property
    def out_of_range(self) -> str:
        """Which spring is deflected further than a body of its size can be, and by how much; "" if none is."""
        return _deflection_out_of_range(self.model, self.configuration, self.deflections)

    def force(self, loads: AppliedLoads) -> Vector:
        """Return the forces of loads on the bearing motions, shape=(k,)."""
        force: Vector = self.bearing_motions.T @ loads.forces(self.configuration)
        return force

    @property
    def bearing_residual(self) -> Vector:
        """Unbalanced forces on the bearing motions, shape=(k,)."""
        residual: Vector = self._combinations[0].T @ self.residual
        return residual

    def invariant(self, coordinates: Vector) -> Vector:
        """Express a combination of bearing motions, shape=(k,), independently of the basis, to compare it with others.

        Strains in units of the springs, then motions with the springs at rest in scaled numbers, shape=(s + nv,); has
        the norm of the argument.
        """
        count = self.motions.elastic.shape[1]
        combination = self._combinations[0] @ coordinates
        idle = self.motions.unstrained / self.model.mechanism.velocity_scale[:, None]
        return np.concatenate([self.motions.whitened @ combination[:count], idle @ combination[count:]])

    def coordinates(self, invariant: Vector) -> Vector:
        """Return the combination of bearing motions nearest to a motion given by its :meth:`invariant`."""
        springs = len(self.motions.whitened)
        idle = self.motions.unstrained / self.model.mechanism.velocity_scale[:, None]
        combination = np.concatenate([self.motions.whitened.T @ invariant[:springs], idle.T @ invariant[springs:]])
        coordinates: Vector = self._combinations[0].T @ combination
        return coordinates

    def moved(self, velocity: Vector, loads: AppliedLoads | None = None) -> LoadedState | None:
        """Return the state reached by a velocity, loops closed again, under the same or other loads; or None."""
        mechanism = self.model.mechanism
        configuration = Configuration(
            mechanism, pin.integrate(mechanism.model, np.array(self.configuration.q), velocity)
        )
        near = self.deflections + velocity
        motions, tolerance = self.motions, _CLOSED * mechanism.characteristic_length
        try:
            for _ in range(_CLOSING_ROUNDS):
                configuration = _closed(configuration, motions.closing)
                if configuration.closure_residual <= tolerance:
                    return LoadedState(self.model, self.rest, loads or self._loads, configuration, near, self._seat)
                motions = elastic_motions(self.model, configuration)
        except InvalidValueError:  # loops far from closed, or a spring of nonpositive length
            return None
        return None

    def settled(self) -> tuple[LoadedState, int]:
        """Find the equilibrium from here by Newton's method with a line search on the imbalance; also return the steps.

        One more step is tried after reaching the tolerance.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        state = self.moved(np.zeros_like(self.deflections)) or self
        for step in range(_MAX_STEPS):
            balanced = state.balanced
            better = _line_search(state)
            if balanced:
                return better or state, step + 1
            if better is None:
                break
            state = better
        residual = float(np.abs(state.unbalanced).max(initial=0.0))
        raise ConvergenceError(
            "the equilibrium under load",
            residual,
            "N or N m",
            _MAX_STEPS,
            "the loads may exceed what the mechanism can bear, or need to be applied in steps",
        )

    @cached_property
    def _combinations(self) -> tuple[Matrix, Matrix]:
        """Combinations of the basis resisted by springs or loads, and those resisted by nothing."""
        count, springs = self.basis.shape[1], self.motions.elastic.shape[1]
        whole = self.basis.T @ self.hessian @ self.basis
        both = np.vstack([whole[:, springs:], whole[springs:].T])
        values, right = svd(both)[1:] if both.size else (np.zeros(0), np.eye(count - springs))
        rank = int(np.count_nonzero(values > SOLVED * max(1.0, np.abs(whole).max())))
        bearing, idle = np.zeros((count, springs + rank)), np.zeros((count, count - springs - rank))
        bearing[:springs, :springs] = np.eye(springs)
        bearing[springs:, springs:] = right[:rank].T
        idle[springs:] = right[rank:].T
        return bearing, idle


def _deflection_out_of_range(model: ElasticModel, configuration: Configuration, deflections: Vector) -> str:
    """Describe which spring is deflected further than a body of its size can be; "" if none is.

    Springs at revolute joints may turn freely, other rotations reach at most 1 rad. Translations reach
    at most the length of the spring, or else the characteristic length of the mechanism.
    """
    scale = model.mechanism.characteristic_length
    for spring, block in zip(model.springs, model.blocks, strict=True):
        length, slides = scale, 1 if isinstance(spring, AxialSpring) else 3
        by = np.abs(deflections[block.indices])
        if isinstance(spring, JointSpring):
            by = by[: spring.unit == "N/m"]
        elif isinstance(spring, CantileverSpring):
            slides = 2 if spring.axial_stiffness is None else 3
            by = by.reshape(spring.elements, -1).max(axis=0)
            if spring.shear_stiffness is not None:
                by = np.concatenate([by[:2] + by[-2:], by[2:-2]])
            length = spring.length if isinstance(spring.length, float) else model.length(block, configuration)
        give, bend = by[:slides].max(initial=0.0), by[slides:].max(initial=0.0)
        if give > length:
            return f"spring '{spring.name}' deflects by {give:.3g} m, more than {length:.3g} m"
        if bend > _MAX_BEND:
            return f"spring '{spring.name}' deflects by {bend:.3g} rad, more than {_MAX_BEND:g} rad"
    return ""


def _continuous(model: pin.Model) -> Indices:
    """Return the entries of v of continuous joints, whose q does not count turns."""
    joints = [joint for joint in list(model.joints)[1:] if joint.nv == 1 and joint.nq == 2]
    return np.array([joint.idx_v for joint in joints], dtype=np.intp)


def _closed(configuration: Configuration, closing: Matrix) -> Configuration:
    """Close loops by simplified Newton steps, as long as these help."""
    mechanism = configuration.mechanism
    for _ in range(_CLOSING_STEPS):
        residual = configuration.closure_residual
        if residual == 0.0:
            break
        q = pin.integrate(mechanism.model, np.array(configuration.q), -closing @ configuration.closure_error)
        closer = Configuration(mechanism, q)
        if not closer.closure_residual < residual:
            break
        configuration = closer
    return configuration


def _line_search(state: LoadedState) -> LoadedState | None:
    """Return a state with less imbalance along the Newton step; None if there is none."""
    velocity = -state.bearing_motions @ np.linalg.lstsq(state.tangent, state.bearing_residual, rcond=None)[0]
    longest = float(np.abs(velocity / state.model.mechanism.velocity_scale).max(initial=0.0))
    fraction = min(1.0, _LONGEST_STEP / longest) if longest > 0.0 else 1.0
    while fraction > _SHORTEST_FRACTION:
        trial = state.moved(fraction * velocity)
        if trial is not None and trial.imbalance <= (1.0 - _MIN_GAIN * fraction) * state.imbalance:
            return trial
        fraction /= 2.0
    return None
