r"""Receptances of an elastic mechanism at a configuration: the motion of points per force, by frequency.

With the motions Z that strain springs and have no momentum along the free motions N (:mod:`pm3dof_pin.dynamics.modes`),
of unit strain energy, turned to the natural modes, the dynamic stiffness at the angular frequency omega is

    D = 1 + i (H + omega T) - omega^2 diag(1 / omega_r^2),

H and T being the springs' loss factors and viscous damping in these modes (:mod:`pm3dof_pin.dynamics.damping`): modes
are coupled unless damping is proportional. Between an output a and an input b, rows of Jacobians,

    G = a Z D^-1 Z^T b^T - a N (N^T M N)^-1 N^T b^T / omega^2,

so that G(0) is the compliance, and G is symmetric. The share of a mode in G is the term of the product in its row of
D^-1 Z^T b^T; the shares sum to G. This is for small vibrations about an unloaded pose.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.beam_masses import consistent_masses, vibrating_mass
from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.modes import elastic_modes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.motions import elastic_motions
from pm3dof_pin.exceptions import FreeDirectionError, InvalidValueError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_FRAME_POINT = re.compile(rf"(?P<frame>.+):(?P<component>{'|'.join(TOOL_COMPONENTS)})")

_POINTS_PER_MODE = 241
_AT_ONCE = 1_000_000  # entries of matrices of which several are held together
_DAMPINGS = 30.0  # half-width of the finely sampled band about a natural frequency, in dampings


@dataclass(frozen=True, eq=False)
class VibratingSystem:
    """An elastic mechanism at one configuration, in its natural modes of unit strain energy."""

    model: ElasticModel  #: the mechanism with its springs
    configuration: Configuration  #: the configuration, of the mechanism with virtual joints
    shapes: Matrix  #: joint velocities in the modes, ascending in frequency, Z^T K_q Z = 1, shape=(nv, e)
    inverse_squares: Vector  #: 1 / omega_r^2 of each mode, zero if it moves no mass, shape=(e,) [s^2]
    structural: Matrix  #: loss factors H in the modes, shape=(e, e)
    viscous: Matrix  #: viscous damping T in the modes, shape=(e, e) [s]
    free_motions: Matrix  #: basis N of the motions with all springs at rest, N^T M N = 1, shape=(nv, u)
    payloads: Payloads | None  #: bodies fixed to frames

    @property
    def frequencies(self) -> Vector:
        """Undamped natural frequencies, ascending; infinite for modes without mass, shape=(e,) [Hz]."""
        with np.errstate(divide="ignore"):
            return frozen(1.0 / (2.0 * np.pi * np.sqrt(self.inverse_squares)))

    def rows(self, points: Sequence[str]) -> Matrix:
        """Return the Jacobians of points over all velocities, shape=(p, nv).

        A point is `FRAME:COMPONENT`, a component x, y, z, rx, ry or rz of a frame's twist in axes of the base, `tool`
        being the tool's frame; or the name of a single-DoF joint, such as a drive, with the force or torque along it.

        Raises:
            FrameNotFoundError: there is no such frame.
            JointNotFoundError: there is no such joint.
            InvalidValueError: the joint has several degrees of freedom.
            DescriptionError: the mechanism has no tool frame.
        """
        mechanism = self.configuration.mechanism
        rows = np.zeros((len(points), mechanism.model.nv))
        for row, point in zip(rows, points, strict=True):
            if (given := _FRAME_POINT.fullmatch(point)) is None:
                row[mechanism.single_joint(point).v_index] = 1.0
            else:
                frame = mechanism.frame_name(None if given["frame"] == "tool" else given["frame"])
                row[:] = self.configuration.frame_jacobian(frame)[TOOL_COMPONENTS.index(given["component"])]
        return rows

    def base_rows(self) -> Matrix:
        """Return the generalised forces of unit acceleration of the base along its axes, shape=(3, nv) [kg, kg m]."""
        model = model_with_payloads(self.configuration.mechanism, self.payloads)
        data = scratch_data(model)
        velocity = pin.jacobianCenterOfMass(model, data, np.array(self.configuration.q)).reshape(3, model.nv)
        rows: Matrix = -data.mass[0] * velocity  # the force is minus mass times acceleration
        return rows - consistent_masses(self.model, self.configuration)[1]

    def receptance(self, frequencies: ArrayLike, outputs: Matrix, inputs: Matrix) -> Array:
        """Return G at frequencies [Hz] between rows of Jacobians, shape=(f, outputs, inputs), complex [output/input].

        Raises:
            InvalidValueError: a frequency is negative.
            FreeDirectionError: a frequency is zero, and an input moves an output with all springs at rest.
        """
        omegas = angular_frequencies(frequencies)
        left = outputs @ self.shapes
        bound = np.concatenate([left @ response for response in self._responses(omegas, inputs)])
        free = (outputs @ self.free_motions) @ (inputs @ self.free_motions).T
        return np.asarray(bound - _over_squares(free, omegas))

    def direct_receptances(self, frequencies: ArrayLike, points: Matrix) -> Array:
        """Return G at frequencies [Hz] from each of some rows of Jacobians to itself, shape=(f, p), complex.

        Errors as :meth:`receptance`.
        """
        omegas = angular_frequencies(frequencies)
        left = points @ self.shapes
        parts = [np.einsum("pe,fep->fp", left, response) for response in self._responses(omegas, points)]
        free: Matrix = np.sum((points @ self.free_motions) ** 2, axis=1, keepdims=True).T
        return np.asarray(np.concatenate(parts) - _over_squares(free, omegas)[:, 0])

    def frequencies_around_modes(self) -> Vector:
        """Return frequencies up to 30 dampings from the natural ones, denser near them, ascending [Hz]."""
        natural = self.frequencies[np.isfinite(self.frequencies)]
        losses, times = (matrix.diagonal()[: len(natural)] for matrix in (self.structural, self.viscous))
        ratios = np.clip(0.5 * (losses + 2.0 * np.pi * natural * times), 1e-3, 0.9 / _DAMPINGS)
        steps = np.sinh(np.linspace(-1.0, 1.0, _POINTS_PER_MODE) * np.arcsinh(_DAMPINGS))
        return frozen(np.unique(natural[:, None] * (1.0 + ratios[:, None] * steps)))

    def shares(self, frequency: float, output: Vector, unit_input: Vector) -> Vector:
        """Return what each mode contributes to G at a frequency [Hz] between two rows, shape=(e,), complex."""
        omegas = angular_frequencies([frequency])
        stiffness = self._dynamic_stiffness(omegas)[0]
        return frozen((output @ self.shapes) * np.linalg.solve(stiffness, self.shapes.T @ unit_input))

    def covariance(self, edges: Sequence[float], levels: Sequence[float], outputs: Matrix, inputs: Matrix) -> Matrix:
        """Return the covariance of outputs under independent random inputs of the same spectrum, shape=(o, o).

        The poles s_k of the state-space form make G = sum_k c_k b_k^T / (i omega - s_k), and of each pair of poles the
        integral over a band is a difference of logarithms.

        Args:
            edges: frequencies between which the density is constant, ascending, shape=(b + 1,) [Hz].
            levels: one-sided power spectral density of each input there, shape=(b,) [unit^2/Hz].
            outputs: rows of Jacobians, shape=(o, nv).
            inputs: the same of the inputs, shape=(i, nv).

        Raises:
            FreeDirectionError: an input moves an output with all springs at rest.
        """
        if np.abs((outputs @ self.free_motions) @ (inputs @ self.free_motions).T).max(initial=0.0) > SOLVED:
            raise FreeDirectionError(f"{self.model.rigid.name}: the input moves the output with all springs at rest")
        poles, seen, excited = self._residues(outputs, inputs)
        logarithms = np.log(2j * np.pi * np.asarray(edges, dtype=float)[:, None] - poles)
        bands = -1j / (2.0 * np.pi) * np.tensordot(np.array(levels), np.diff(logarithms, axis=0), axes=1)
        pairs = -(bands[:, None] + bands.conj()) / (poles[:, None] + poles.conj())
        products = (seen @ (pairs * (excited @ excited.conj().T)) @ seen.conj().T).real
        covariance: Matrix = 0.5 * (products + products.T)
        return covariance

    @cached_property
    def _poles(self) -> tuple[Mask, Array, Array, Array]:
        """Modes with mass, poles of their state-space form, shape=(2 e,), and right and left vectors.

        Only parts of these matter: amplitudes of the right ones, shape=(e, 2 e), velocities of the left, (2 e, e).
        """
        kept = self.inverse_squares > 0.0  # what moves no mass follows at once, and is left out
        roots = np.sqrt(self.inverse_squares[kept])
        scale = np.outer(1.0 / roots, 1.0 / roots)  # to unit modal mass
        stiffness = scale * (np.eye(len(roots)) + 1j * self.structural[np.ix_(kept, kept)])
        damping = scale * self.viscous[np.ix_(kept, kept)]
        size, one = len(roots), np.eye(len(roots))
        own, decay = stiffness.diagonal(), damping.diagonal()
        if np.array_equal(stiffness, one * own) and np.array_equal(damping, one * decay):
            apart = np.sqrt(decay**2 - 4.0 * own)  # modes that are not coupled have a pair of poles each
            if (np.abs(apart) > SOLVED * decay).all():
                poles = 0.5 * np.concatenate([apart - decay, -apart - decay])
                return kept, poles, np.hstack([one, one]), np.vstack([one, -one]) / np.tile(apart, 2)[:, None]
        state = np.block([[np.zeros((size, size)), one], [-stiffness, -damping]])
        poles, right = np.linalg.eig(state)
        return kept, poles, right[:size], np.linalg.inv(right)[:, size:]

    def _residues(self, outputs: Matrix, inputs: Matrix) -> tuple[Array, Matrix, Matrix]:
        """Return poles of the modes with mass, shape=(2 e,), and factors c, (o, 2 e), and b, (2 e, i), of G."""
        kept, poles, right, left = self._poles
        roots = np.sqrt(self.inverse_squares[kept])
        seen = (outputs @ self.shapes[:, kept] / roots) @ right
        excited = left @ (inputs @ self.shapes[:, kept] / roots).T
        return poles, seen, excited

    def _responses(self, omegas: Vector, inputs: Matrix) -> Iterator[Array]:
        """Yield D^-1 Z^T b^T of rows of Jacobians, shape=(f, e, i), some frequencies at a time."""
        right = (inputs @ self.shapes).T[None].astype(complex)
        count = 1 + _AT_ONCE // max(self.structural.size, right.size)
        for first in range(0, max(len(omegas), 1), count):
            yield np.linalg.solve(self._dynamic_stiffness(omegas[first : first + count]), right)

    def _dynamic_stiffness(self, omegas: Vector) -> Array:
        inertia = omegas[:, None, None] ** 2 * np.diag(self.inverse_squares)
        # a force at rest is not a cycle: springs lose nothing
        damping = self.structural * (omegas > 0.0)[:, None, None] + omegas[:, None, None] * self.viscous
        stiffness: Array = np.eye(len(self.inverse_squares)) + 1j * damping - inertia
        return stiffness


def vibrating_system(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    *,
    damping: Damping | None = None,
    payloads: Payloads | None = None,
) -> VibratingSystem:
    """Return an elastic mechanism at a configuration in its natural modes, for receptances.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.dynamics.receptance import vibrating_system
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> system = vibrating_system(model, model.rigid.home)
        >>> tool = system.rows(["tool:x"])
        >>> G = system.receptance([0.0, 50.0], tool, tool)[:, 0, 0]
        >>> print(f"{1 / G[0].real:.4g} N/m at rest, {1 / np.abs(G[1]):.4g} N/m at 50 Hz")
        1.808e+06 N/m at rest, 1.745e+06 N/m at 50 Hz

    Args:
        model: the mechanism with its springs.
        configuration: an assembled configuration, see :meth:`ElasticModel.configuration`.
        damping: of the springs; by default those of the description, or `LOSS_FACTOR`.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia` in its axes.

    Raises:
        PM3DofError: as :func:`~pm3dof_pin.dynamics.modes.natural_modes`; InvalidValueError for damping of unknown
            springs or drives.
    """
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    damping = damping or Damping()
    losses, times = damping.of_springs(model)
    elastic = model.configuration(configuration)
    motions = elastic_motions(model, elastic)
    mass = vibrating_mass(model, elastic, payloads=payloads)
    inverse_squares, directions, free = elastic_modes(motions, mass)
    whitened = motions.whitened @ directions
    structural, viscous = (whitened.T * losses) @ whitened, (whitened.T * times) @ whitened
    if damping.ratio is not None:
        structural = np.zeros_like(structural)
        viscous = np.diag(2.0 * damping.ratio * np.sqrt(inverse_squares))
    return VibratingSystem(
        model=model,
        configuration=elastic,
        shapes=frozen((motions.elastic - free @ (free.T @ mass @ motions.elastic)) @ directions),
        inverse_squares=frozen(inverse_squares),
        structural=frozen(structural),
        viscous=frozen(viscous),
        free_motions=frozen(free),
        payloads=payloads,
    )


def angular_frequencies(frequencies: ArrayLike) -> Vector:
    """Return 2 pi times frequencies [Hz], shape=(f,) [rad/s].

    Raises:
        InvalidValueError: a frequency is negative.
    """
    values = finite_array("frequencies", frequencies, (np.size(frequencies),))
    if (values < 0.0).any():
        raise InvalidValueError("frequencies", float(values.min()), "frequencies that are not negative [Hz]")
    return 2.0 * np.pi * values


def _over_squares(free: Matrix, omegas: Vector) -> Array:
    """Return the motions of free bodies over omega^2, shape=(f, o, i); rounding is no motion."""
    free = np.where(np.abs(free) > SOLVED, free, 0.0)
    if not free.any():
        return np.zeros((len(omegas), *free.shape))
    if not omegas.all():
        raise FreeDirectionError(
            "at 0 Hz the receptance is infinite: the input moves the output with all springs at rest"
        )
    return np.asarray(free / omegas[:, None, None] ** 2)
