"""The error parameters of the robot of `--robot`, and which of them its loops can close with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pm3dof_pin.cli.output import message

if TYPE_CHECKING:
    from pm3dof_pin.errors.error_parameters import GeometricErrors
    from pm3dof_pin.kinematics.poses import Poses

_SHOWN = 10
_POSES = 20


def load_errors(
    name: str, tool_frame: str | None = None, package_paths: Sequence[Path] | None = None
) -> GeometricErrors:
    """Load the robot of `--robot`, `--tool-frame` and `--package-path` with all its error parameters."""
    from pm3dof_pin.errors.error_parameters import GeometricErrors

    return GeometricErrors.load(name, tool_frame=tool_frame, package_paths=package_paths or ())


def closing_errors(errors: GeometricErrors, poses: Poses | None = None, *, quiet: bool = False) -> GeometricErrors:
    """Return the errors with which the loops close, and say how many are left out.

    Args:
        errors: the parameters.
        poses: where the loops are to close; by default at random poses.
        quiet: whether to say nothing.
    """
    import numpy as np

    from pm3dof_pin.errors.sensitivity import closable
    from pm3dof_pin.kinematics.reachable_poses import reachable_poses

    if poses is None:
        poses = reachable_poses(errors.robot, _POSES, np.random.default_rng(0))
    fitting = closable(errors, poses)
    if len(fitting) < len(errors) and not quiet:
        dropped = [name for name in errors.names if name not in fitting.names]
        some = ", ".join(dropped[:_SHOWN]) + (" ..." if len(dropped) > _SHOWN else "")
        message(f"pm3dof: {len(dropped)} parameters are left out, as the loops cannot close with them: {some}")
    return fitting
