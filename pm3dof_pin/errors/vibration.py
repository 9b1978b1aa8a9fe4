r"""Vibration at a fixed pose: motion of the tool under random forces and random motion of the base.

The natural modes, of unit modal mass, move as q_r'' + 2 zeta omega_r q_r' + omega_r^2 q_r = phi_r . f(t), decoupled,
with H_r = 1 / (omega_r^2 - omega^2 + 2 i zeta omega_r omega). Independent inputs with a power spectral density G(f),
which force the modes through the columns of F, give the tool's motion the covariance

    sum_rs t_r t_s^T (F F^T)_rs  integral of G Re(H_r H_s*) df,

where t_r is the tool's twist in mode r. If G is constant between two frequencies, the integral has a closed form by
partial fractions: each pole p contributes its residue times log((b - p) / (a - p)). Forces act on the tool, or on each
drive along its travel. A base acceleration a acts on the modes like gravity -a, and the relevant motion is that of the
tool relative to the base, with the workpiece on it. A white density G over all frequencies gives a single mode
G / (8 zeta omega^3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.source_numbers import Spectrum, VibrationNumbers
from pm3dof_pin.dynamics.modes import Modes, natural_modes
from pm3dof_pin.elastic.batch import elastic_model
from pm3dof_pin.errors.normal_vectors import correlated_normal
from pm3dof_pin.exceptions import FreeDirectionError
from pm3dof_pin.kinematics.robot import Poses, Robot
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Matrix, Vector

CAUSES = ("tool", "motors", "axes")
"""Causes of vibration: a force on the tool, the drives' forces, motion of the base that carries the axes."""


@dataclass(frozen=True, eq=False)
class Vibration:
    """Scatter of a pose while measuring or working: of the tool, and of the drives with their motors."""

    #: covariance of the tool's displacement, the same at all poses, [translation; rotation vector], world axes,
    #: shape=(6, 6) [m^2, m rad, rad^2]
    tool_covariance: Matrix = field(default_factory=lambda: np.zeros((6, 6)))
    drive_sigma: float = 0.0  #: standard deviation of each drive's coordinate [m, rad]
    spectra: VibrationNumbers | None = None  #: spectra that also excite the natural modes at each pose; None for none
    payloads: Payloads | None = None  #: bodies fixed to frames that vibrate with the machine

    def tool_displacements(self, poses: Poses, generator: np.random.Generator) -> Matrix:
        """Draw displacements of the tool at n poses, without those of the drives, shape=(n, 6) [m, rad]."""
        drawn = correlated_normal(self.tool_covariance, len(poses), generator)
        if self.spectra is not None:
            by_cause = self.covariances_by_cause(poses)
            for row in range(len(poses)):
                covariance = sum((parts[row] for parts in by_cause.values()), np.zeros((6, 6)))
                drawn[row] += correlated_normal(covariance, 1, generator)[0]
        return drawn

    def travel_errors(self, count: int, drives: int, generator: np.random.Generator) -> Matrix:
        """Draw displacements of the drives, shape=(count, drives) [m, rad]."""
        return self.drive_sigma * generator.standard_normal((count, drives))

    def covariances_by_cause(self, poses: Poses) -> dict[str, Array]:
        """Return the covariance of the tool at n poses by each cause with a spectrum, shape=(n, 6, 6).

        Raises:
            DescriptionError: the robot has no springs, or no tool frame.
            FreeDirectionError: the tool can move with all springs at rest, so its vibration is unbounded.
            InvalidValueError: see :func:`~pm3dof_pin.dynamics.modes.natural_modes`.
        """
        numbers = self.spectra or VibrationNumbers(tool=None, motors=None, axes=None)
        spectra = {cause: spectrum for cause in CAUSES if (spectrum := getattr(numbers, cause)) is not None}
        covariances = {cause: np.empty((len(poses), 6, 6)) for cause in spectra}
        if not spectra:
            return covariances
        forcing = _Forcing(elastic_model(poses.robot).mechanism, self.payloads)
        for row, modes in enumerate(self._modes(poses)):
            omegas = 2.0 * np.pi * modes.frequencies
            joint = {s: _response_products(omegas, numbers.damping, s) for s in set(spectra.values())}
            for cause, spectrum in spectra.items():
                inputs = forcing.of(cause, modes)
                covariances[cause][row] = modes.twists @ (joint[spectrum] * (inputs @ inputs.T)) @ modes.twists.T
        return covariances

    def _modes(self, poses: Poses) -> Iterator[Modes]:
        model = elastic_model(poses.robot)
        for q in poses.q:
            modes = natural_modes(model, q, payloads=self.payloads)
            if np.abs(modes.free_twists).max(initial=0.0) > SOLVED:
                raise FreeDirectionError(f"{poses.robot.name}: the tool can move with all springs at rest")
            yield modes


def _response_products(omegas: Vector, damping: float, spectrum: Spectrum) -> Matrix:
    """Return the integrals of G Re(H_r H_s*) over all frequencies, shape=(k, k) [unit^2 s^4].

    H are the modes of angular frequencies `omegas` [rad/s] and damping zeta, G the spectrum [unit^2/Hz].
    """
    turn = np.sqrt(1.0 - damping**2)
    poles = np.stack([omegas * (1j * damping + turn), omegas * (1j * damping - turn)])  # of H, shape=(2, k)
    logarithms = np.log(2.0 * np.pi * np.asarray(spectrum.edges_Hz)[:, None, None] - poles)
    # the logarithms of a pole differ by its share in the band: its imaginary part keeps them off the branch cut
    bands = np.tensordot(spectrum.levels, np.diff(logarithms, axis=0), axes=1)
    products = np.zeros((len(omegas), len(omegas)))
    for pole, other, band in zip(poles, poles[::-1], bands, strict=True):
        residue = 1.0 / ((pole - other)[:, None] * np.prod(pole[:, None] - poles.conj()[:, None, :], axis=0))
        products += (residue * band[:, None]).real
    return (products + products.T) / (2.0 * np.pi)  # the poles of H_s* give the same with r and s swapped


class _Forcing:
    """Forcing of a mechanism's modes by unit inputs of each cause."""

    def __init__(self, mechanism: Robot, payloads: Payloads | None) -> None:
        self._model = model_with_payloads(mechanism, payloads).copy()
        self._data = self._model.createData()

    def of(self, cause: str, modes: Modes) -> Matrix:
        """Return the forcing, shape=(k, inputs): forces along the axes of the base, of each drive, accelerations."""
        if cause == "tool":
            return np.asarray(modes.twists[:3].T)
        if cause == "motors":
            return np.asarray(modes.shapes[modes.configuration.mechanism.actuated_indices].T)
        q = np.array(modes.configuration.q)
        inertial = np.empty((self._model.nv, 3))
        for axis, direction in enumerate(np.eye(3)):
            self._model.gravity = pin.Motion(direction, np.zeros(3))
            inertial[:, axis] = pin.computeGeneralizedGravity(self._model, self._data, q)
        return np.asarray(modes.shapes.T @ inertial)
