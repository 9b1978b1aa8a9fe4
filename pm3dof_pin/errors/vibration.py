r"""Vibration at a fixed pose: motion of the tool under random forces and random motion of the base.

Independent inputs with a power spectral density S(f) give the tool's motion the covariance

    integral of S Re(G G^*) df,

G being the receptances from the inputs to the tool (:meth:`VibratingSystem.covariance`), with the same damping in every
mode. Inputs are forces on the tool, or on each drive along its travel. A base acceleration acts on the bodies like
gravity the other way, and the relevant motion is that of the tool relative to the base, with the workpiece on it. A
white density S over all frequencies gives a single mode of unit mass S / (8 zeta omega^3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pm3dof_pin.description.source_numbers import VibrationNumbers
from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import VibratingSystem, vibrating_system
from pm3dof_pin.elastic.batch import elastic_model
from pm3dof_pin.errors.normal_vectors import correlated_normal
from pm3dof_pin.exceptions import FreeDirectionError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.mechanism.loads import Payloads
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Matrix

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
            InvalidValueError: see :func:`~pm3dof_pin.dynamics.receptance.vibrating_system`.
        """
        numbers = self.spectra or VibrationNumbers(tool=None, motors=None, axes=None)
        spectra = {cause: spectrum for cause in CAUSES if (spectrum := getattr(numbers, cause)) is not None}
        covariances = {cause: np.empty((len(poses), 6, 6)) for cause in spectra}
        if not spectra:
            return covariances
        model, damping = elastic_model(poses.robot), Damping(ratio=numbers.damping)
        for row, q in enumerate(poses.q):
            system = vibrating_system(model, q, damping=damping, payloads=self.payloads)
            if np.abs(system.configuration.tool_jacobian @ system.free_motions).max(initial=0.0) > SOLVED:
                raise FreeDirectionError(f"{poses.robot.name}: the tool can move with all springs at rest")
            tool = np.asarray(system.configuration.tool_jacobian)
            for cause, spectrum in spectra.items():
                inputs = _INPUTS[cause](system)
                covariances[cause][row] = system.covariance(spectrum.edges_Hz, spectrum.levels, tool, inputs)
        return covariances


_INPUTS: dict[str, Callable[[VibratingSystem], Matrix]] = {
    "tool": lambda system: system.configuration.tool_jacobian[:3],
    "motors": lambda system: system.rows(system.configuration.mechanism.actuated_joints),
    "axes": VibratingSystem.base_rows,
}
"""Rows of unit inputs of each cause: forces along the axes of the base, of each drive, accelerations."""
