"""The pseudo-error source: all errors of a machine as deviations of its commands, Fig. 8.5 of the chapter.

At command u the machine is where its model is at u + du. du is found by inverting the model's kinematics at the
measured pose, as far as the measurements show it (:mod:`pm3dof_pin.errors.command_correction`). All rows of a visit,
such as those of three targets, form one pose: with residuals r, their derivatives A by the tool's motion and their
noise S,

    information L = A^T S^-1 A,      pose error e = L^+ A^T S^-1 r,

which has those of the six components that the rows show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from pm3dof_pin.errors.command_correction import command_scales, descend, weighted_control
from pm3dof_pin.errors.pose_error import TIP_LENGTH, tip_weights
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array, Indices

SEEN = 0.02
"""Directions with a relative gain below this are treated as unobservable: deviations along them stay 0. On the
tripod, positions of the tool point alone show only its height; both tilts rotate it on the spot. Near a singular pose,
an arm has such directions even if full poses are measured."""

_COUNTS = 1e-3  # least weight [1, m/rad]: one of less does not count
_SHOWN = 1e-4  # relative to the best-seen direction of a pose: one with 100 times the noise counts as unseen


@dataclass(frozen=True, eq=False)
class SeenErrors:
    """Tip-weighted errors of poses relative to a model, as far as measurements show them."""

    errors: Array  #: e, 0 along directions that are not shown, shape=(visits, 6) [m]
    covariances: Array  #: of e, from the measurements' noise, shape=(visits, 6, 6) [m^2]
    shown: Array  #: projections on the directions that are shown, as far as they count, shape=(visits, 6, 6)
    rows: Array  #: derivatives of the measured coordinates by e, in their sigmas, shape=(n, coordinates, 6)
    visits: Indices  #: number of the visit of each row, shape=(n,)

    def by(self, derivatives: Array) -> Array:
        """Return e by parameters, shape=(visits, 6, k), from the measured coordinates by them, in their sigmas.

        These have shape=(n, coordinates, k). Of parameters that move the tool alike at all rows of a visit it is the
        shown part of that motion.
        """
        pulls = np.zeros((len(self.errors), 6, derivatives.shape[2]))
        np.add.at(pulls, self.visits, np.swapaxes(self.rows, 1, 2) @ derivatives)
        return np.asarray(self.covariances @ pulls)


def seen_errors(measurements: Measurements, poses: Poses, eta: float = TIP_LENGTH) -> SeenErrors:
    """Combine the rows of each visit, relative to the model's poses; eta weighs the orientation [m/rad].

    Components that do not count, such as the orientation of a pen, explain as much of the rows as if they did, and are
    0 then.
    Errors are infinite at poses that are not finite, as after steps of many turns.
    """
    visits, count = measurements.visit_numbers, len(poses)
    at_rows, weights = poses[visits], tip_weights(eta, poses.robot.tool_motions)
    free = weights < _COUNTS
    motions = np.tile(np.diag(1.0 / np.where(free, tip_weights(), weights)), (len(measurements), 1, 1))
    rows = measurements.derivatives(at_rows, motions) / measurements.sigmas[:, :, None]
    residuals = measurements.residuals(at_rows) / measurements.sigmas
    information, pull = np.zeros((count, 6, 6)), np.zeros((count, 6))
    np.add.at(information, visits, np.swapaxes(rows, 1, 2) @ rows)
    np.add.at(pull, visits, np.einsum("nij,ni->nj", rows, residuals))
    lost = ~np.isfinite(information).all(axis=(1, 2))
    information[lost], pull[lost] = 0.0, 0.0
    values, axes = np.linalg.eigh(information)
    known = values > _SHOWN * values.max(axis=1, keepdims=True)
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    transposed = np.swapaxes(axes, 1, 2)
    covariances = (axes * inverse[:, None, :]) @ transposed
    shown = (axes * known[:, None, :]) @ transposed
    errors = np.einsum("nij,nj->ni", covariances, pull)
    errors[lost] = np.inf
    errors[:, free] = 0.0
    for matrices in (covariances, shown):
        matrices[:, free], matrices[:, :, free] = 0.0, 0.0
    return SeenErrors(errors, covariances, shown, rows, visits)


@dataclass(frozen=True, eq=False)
class PseudoErrors:
    """Pseudo-errors from measurements relative to a model of the machine, one per visit."""

    deviations: Array  #: du, shape=(visits, number of commands) [m, rad]
    covariances: Array  #: of du, from the measurements' noise, shape=(visits, number of commands, same)
    at_commands: SeenErrors  #: seen part of the model's tip-weighted error at the commands
    left: Array  #: the same at the deviated commands: what no command corrects, shape=(visits, 6) [m]
    control: Array  #: tip-weighted motion of the seen part by the drives' joints, shape=(visits, 6, number of commands)
    seen: SeenErrors  #: errors at the deviated commands with their noise
    counted: int  #: number of components of the tip error that count

    @property
    def before(self) -> Array:
        """Seen part of the model's tip-weighted error at the commands, shape=(visits, 6) [m]."""
        return self.at_commands.errors

    @property
    def whole(self) -> bool:
        """Whether all components that count are seen of every pose."""
        return bool(np.all(np.einsum("nii->n", self.seen.shown) > self.counted - 0.5))


def control_inverse(control: Array, seen: float = SEEN) -> Array:
    """Return the pseudo-inverse of motions by the drives' joints, without directions below :data:`SEEN`."""
    return np.asarray(np.linalg.pinv(control, rcond=seen))


def motions_seen(measurements: Measurements, nominal: Poses, eta: float = TIP_LENGTH) -> tuple[int, int, bool]:
    """Return how many independent motions of the tool by its drives a visit shows at most, and their number.

    The third is whether all visits show the whole pose.
    """
    found = pseudo_errors(measurements, nominal, eta)
    seen, possible = (
        int(np.linalg.matrix_rank(control_inverse(control)).max())
        for control in (found.control, weighted_control(nominal, eta))
    )
    return seen, possible, found.whole


def pseudo_errors(
    measurements: Measurements, model: Poses, eta: float = TIP_LENGTH, *, seen: float = SEEN
) -> PseudoErrors:
    """Find the deviations of the commands that explain measurements, by inverting a model's kinematics at the visits.

    Where the model cannot go all the way, as at the end of its reach, the rest is left over.

    Raises:
        SingularConfigurationError: at some command the tool can move with all drives locked.
    """
    scales = command_scales(model)

    @cache  # poses after a step are requested again
    def errors_at(poses: Poses) -> SeenErrors:
        return seen_errors(measurements, poses, eta)

    def residuals(poses: Poses) -> Array:
        return errors_at(poses).errors

    def control(poses: Poses, found: SeenErrors) -> Array:
        whole = weighted_control(poses, eta)
        shown = found.shown @ whole
        # drives that hardly move the seen part, such as a delta robot's its orientation, do not explain it
        shown[np.linalg.norm(shown, axis=(1, 2)) <= seen * np.linalg.norm(whole, axis=(1, 2))] = 0.0
        return np.asarray(shown)

    def step(poses: Poses) -> Array:
        found = errors_at(poses)
        return np.asarray(scales * np.einsum("nij,nj->ni", control_inverse(control(poses, found), seen), found.errors))

    deviations, poses = descend(model, measurements.visits.commands, step, residuals, on_failure="nan")
    found = errors_at(poses)
    reached = control(poses, found)
    gain = scales[:, None] * control_inverse(reached, seen)
    covariances = gain @ found.covariances @ np.swapaxes(gain, 1, 2)
    counted = int(np.count_nonzero(tip_weights(eta, model.robot.tool_motions) >= _COUNTS))
    return PseudoErrors(deviations, covariances, errors_at(model), found.errors, reached, found, counted)
