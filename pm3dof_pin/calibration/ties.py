"""How far parts that are one number of the error file may differ on the machine before its bounds are too small.

Tied parameters are fitted as if their parts did not differ. Differences d move the tool by D d; what is fitted takes
K d of them and moves it by E K d, so that predicted poses are off by (D - E K) d. To first order K = C A^T W B, with
the covariance C of what is fitted, the derivatives A of the measurements by it and B by the differences, and the
weights W. In directions that the measurements do not show, poses may be far off and the residuals small.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.linearisation import Linearisation
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.errors.error_parameters import GeometricErrors, TiedParameter
from pm3dof_pin.errors.presets import nearly_free
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

_POSSIBLE = 0.1  # standard deviation of differences that nobody would think of, in tolerances of the tie
_NOTICED = 0.25  # of the variance of poses: bounds would have to be an eighth wider
_POSES = 200  # over the workspace


def noticed_differences(calibration: Fit) -> dict[str, float]:
    """Return the ties whose parts hardly may differ, and how much before bounds are too small [m, rad].

    It is the standard deviation of each part's own error, in units of its factor. Ties that may differ by a tenth of
    their tolerance are left out; parts that are parameters of their own do not count.
    """
    found, errors = calibration.identification, calibration.identification.errors
    ties = [parameter for parameter in errors.parameters if isinstance(parameter, TiedParameter)]
    own = {
        part.name: replace(part, tolerance=abs(factor) * tie.tolerance)
        for tie in ties
        for part, factor in tie.parts
        if part.name not in errors.names
    }
    if not own:
        return {}
    free, count = GeometricErrors(errors.robot, [*errors.parameters, *own.values()]), len(errors)
    values, start = (np.insert(each, count, np.zeros(len(own))) for each in (found.values, found.scaled_values))
    prior = replace(found.prior, free=nearly_free(free))
    problem = Linearisation.at(found.measurements, free, found.elastic, found.nuisances, prior, found.poses, start)
    by_parts = problem.rows[:, :, count : count + len(own)]
    pulls = np.einsum("nri,nr,nrj->ij", found.rows, found.certainties, by_parts)
    fitted = found.known_covariance @ (pulls / found.units[:, None])
    compensation = calibration.compensation
    poses = reachable_poses(errors.robot, _POSES, np.random.default_rng(0))
    model = compensation.model_poses(poses, on_failure="nan")
    model = model[model.solved]
    effects, moved = compensation.effects(model), sensitivities(free, model, values).errors[:, :, count:]
    moved = moved * compensation.weights[:, None] * free.tolerances[count:]
    off = dict(zip(own, (moved - effects @ (found.seen_map[: effects.shape[2]] @ fitted)).T, strict=True))
    spread = compensation.covariances(model) + compensation.scatter.covariances(
        weighted_control(model, compensation.eta)
    )
    allowed = {}
    for tie in ties:
        added = sum(float(np.sum(off[part.name] ** 2)) for part, _ in tie.parts if part.name in off)
        if _POSSIBLE**2 * added > (most := _NOTICED * float(np.einsum("nii->", spread))):
            allowed[tie.name] = tie.tolerance * float(np.sqrt(most / added))
    return allowed
