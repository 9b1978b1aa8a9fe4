"""The error parameters with which the loops of a robot close; those left out are named."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pm3dof_pin.cli.output import message

if TYPE_CHECKING:
    from pm3dof_pin.errors.error_parameters import GeometricErrors
    from pm3dof_pin.kinematics.poses import Poses

SHOWN = 10


def closing_errors(errors: GeometricErrors, poses: Poses) -> GeometricErrors:
    """Return the errors with which the loops close at these poses, and say how many are left out."""
    from pm3dof_pin.errors.sensitivity import closable

    fitting = closable(errors, poses)
    if len(fitting) < len(errors):
        dropped = [name for name in errors.names if name not in fitting.names]
        some = ", ".join(dropped[:SHOWN]) + (" ..." if len(dropped) > SHOWN else "")
        message(f"pm3dof: {len(dropped)} parameters are left out, as the loops cannot close with them: {some}")
    return fitting
