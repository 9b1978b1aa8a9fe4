"""How far the bodies' weight moves the tool, compared with geometric errors, which alone are identified."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses


def sag_in_words(errors: GeometricErrors, poses: Poses, eta: float) -> str:
    """Say by how much the bodies' weight moves the tool, if by more than errors of one tolerance; "" otherwise.

    Medians over poses of the robot as described; eta weighs the orientation [m/rad].
    """
    if not errors.robot.springs:
        return ""
    try:
        sag = ElasticDeflection().displacements(poses)
    except PM3DofError:
        return ""
    size = float(np.median(np.hypot(np.linalg.norm(sag[:, :3], axis=1), eta * np.linalg.norm(sag[:, 3:], axis=1))))
    possible = float(np.median(error_map(errors, poses, eta=eta).tip_rms))
    if size <= possible:
        return ""
    return (
        f"by the springs of the description the weight of the bodies alone moves the tool by {1e3 * size:.3g} mm, more "
        f"than errors of one tolerance, {1e3 * possible:.3g} mm (medians), and no parameter describes that"
    )
