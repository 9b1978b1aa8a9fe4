"""Forces and motions of closed-chain mechanisms: holding forces, inverse dynamics, natural modes."""

from __future__ import annotations

from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices, natural_frequencies
from pm3dof_pin.dynamics.force_balance import ActuatorForces
from pm3dof_pin.dynamics.inverse_dynamics import InverseDynamics, JointMotion, inverse_dynamics, loop_motion
from pm3dof_pin.dynamics.mass_matrix import drive_mass_matrix, manifold_mass_matrix, mass_matrix
from pm3dof_pin.dynamics.modes import Modes, natural_modes
from pm3dof_pin.dynamics.statics import holding_forces

__all__ = [
    "ActuatorForces",
    "InverseDynamics",
    "JointMotion",
    "Modes",
    "actuator_forces",
    "drive_mass_matrices",
    "drive_mass_matrix",
    "holding_forces",
    "inverse_dynamics",
    "loop_motion",
    "manifold_mass_matrix",
    "mass_matrix",
    "natural_frequencies",
    "natural_modes",
]
