"""Calibrations to first order about the machine as described: thirty times faster, for a study of many machines.

The measurements and their machines are those of calibration_coverage.py, and the statistics are the package's own: the
robust fit and its covariance, the prior from data, the correction that does no harm, scatter and bounds. Only the
kinematics is linear: one set of derivatives serves all machines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.calibration.caution import Gain
from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.linearisation import Linearisation, tool_motions_by_drives
from pm3dof_pin.calibration.prior import PRIOR, Prior
from pm3dof_pin.calibration.pseudo_error import control_inverse, seen_errors
from pm3dof_pin.calibration.scatter import Scatter
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.errors.normal_vectors import covariance_root, norm_quantiles
from pm3dof_pin.errors.pose_error import TIP_LENGTH, tip_weights
from pm3dof_pin.errors.presets import nearly_free
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import Nuisances, datum_motions

_FOLDS = 5
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Station:
    """Poses of the machine as described, with all derivatives."""

    errors: pm.GeometricErrors
    poses: pm.Poses

    @cached_property
    def motions(self) -> np.ndarray:
        """The tool's motion by parameters, base and tool, shape=(n, 6, p + 12)."""
        return np.concatenate([sensitivities(self.errors, self.poses).errors, datum_motions(self.poses)], axis=2)

    @cached_property
    def effects(self) -> np.ndarray:
        """The same, tip-weighted."""
        return np.asarray(self.motions * tip_weights(TIP_LENGTH)[:, None])

    @cached_property
    def control(self) -> np.ndarray:
        """Tip-weighted motion by the drives' joints, shape=(n, 6, drives)."""
        return weighted_control(self.poses)

    @cached_property
    def by_drives(self) -> np.ndarray:
        """The tool's motion by the drives' joints, shape=(n, 6, drives)."""
        return tool_motions_by_drives(self.poses)


def _at_the_description(
    station: Station, measurements: Measurements, prior: Prior, known: np.ndarray | None
) -> Linearisation:
    """Return measurements' residuals against the machine as described, linear in all parameters.

    In the parameters of the measurement about known values, because the instrument is far away.
    """
    errors, numbers, count = station.errors, measurements.pose_numbers, len(station.errors)
    poses, drives = station.poses[numbers], station.by_drives[numbers]
    nuisances = Nuisances.from_measurements(measurements, tuple(command.unit for command in errors.robot.commands))
    known = np.zeros(len(nuisances)) if known is None else known
    settled = nuisances.removed(measurements, poses, drives, known)
    others = nuisances.motions(measurements, poses, drives)
    derivatives = settled.derivatives(poses, np.concatenate([station.motions[numbers, :, :count], others], axis=2))
    units = np.concatenate([errors.tolerances, nuisances.scales])
    return Linearisation(
        measurements,
        settled,
        errors,
        ElasticTerm.from_measurements(errors.robot, measurements),
        nuisances,
        prior,
        poses,
        np.concatenate([np.zeros(count), known / nuisances.scales]),
        settled.residuals(poses),
        derivatives / measurements.sigmas[:, :, None] * units,
    )


def _solved(problem: Linearisation) -> Identification:
    return Identification.from_fit(problem, problem.robust("tukey", None), "tukey", 1)


def identified(station: Station, measurements: Measurements) -> Identification:
    """Identify parameters from measurements at the poses of a station."""
    prior, known = Prior(PRIOR, nearly_free(station.errors)), None
    for _ in range(_ROUNDS):
        found = _solved(_at_the_description(station, measurements, prior, known))
        frame, known = found.nuisances.columns("frame"), found.nuisance_values.copy()
        if frame.size:
            measurements = measurements.in_moved_base(known[frame])
            known[frame] = 0.0
        if prior.k == PRIOR:
            prior = found.likely_prior()
    return replace(found, measurements=measurements, nuisance_values=known)


@dataclass(frozen=True, eq=False)
class Correction:
    """Knowledge of a machine after a calibration, and the correction of its commands."""

    found: Identification
    gain: Gain
    values: np.ndarray

    @classmethod
    def of(cls, station: Station, found: Identification) -> Correction:
        """Return the correction that does no harm over the poses of a station, where the machine works."""
        covariance, count = found.seen_covariance, len(station.errors)
        effects, control = station.effects[:, :, : len(covariance)], station.control
        corrected = control @ (np.linalg.pinv(control) @ effects[:, :, :count])
        gain = Gain(found.values, covariance, effects, corrected)
        return cls(found, gain, gain.sure_values())

    @property
    def covariance(self) -> np.ndarray:
        """Uncertainty of parameters, base and tool."""
        covariance = self.gain.covariance.copy()
        count = len(self.values)
        left_out = self.found.values - self.values
        covariance[:count, :count] += np.outer(left_out, left_out)
        return covariance

    def covariances(self, station: Station) -> np.ndarray:
        """Return the covariance of predicted poses, tip-weighted, shape=(n, 6, 6)."""
        covariance = self.covariance
        effects = station.effects[:, :, : len(covariance)]
        return np.asarray(effects @ covariance @ np.swapaxes(effects, 1, 2))

    def standard_effects(self, station: Station) -> np.ndarray:
        """Return the tool's motion by parameters one standard deviation off, shape=(n, 6, directions)."""
        return np.asarray(station.effects[:, :, : len(self.covariance)] @ covariance_root(self.covariance))

    def at(self, station: Station, scatter: Scatter) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
        """Return the tool's motion by corrected commands, the expected tip error, its bound, and its rms."""
        error = station.effects[:, :, : len(self.values)] @ self.values
        change = -np.einsum("nij,nj->ni", control_inverse(station.control, 1e-9), error)
        moved = np.einsum("nij,nj->ni", station.control, change)
        spread = self.covariances(station) + scatter.covariances(station.control)
        expected = np.sqrt(np.sum((error + moved) ** 2, axis=1) + np.einsum("nii->n", spread))
        rms = scatter.rms_interval(error + moved, self.standard_effects(station), station.control)
        return moved, expected, norm_quantiles(error + moved, spread, 0.95), rms


def cross_validated(station: Station, correction: Correction) -> tuple[Scatter, np.ndarray, tuple[float, float]]:
    """Return the scatter at held-out poses, and the excess of each drive at each pose, squared, with its interval."""
    found, units = correction.found, [command.unit for command in station.errors.robot.commands]
    measurements, numbers, count = found.measurements, found.measurements.pose_numbers, len(station.poses)
    folds = np.random.default_rng(0).permutation(np.arange(count) % _FOLDS)
    whole = _at_the_description(station, measurements, found.prior, found.nuisance_values)
    seen = seen_errors(whole.settled, station.poses)
    weights = np.tile(np.diag(1.0 / tip_weights(TIP_LENGTH)), (len(measurements), 1, 1))
    by_tool = whole.settled.derivatives(whole.poses, weights) / measurements.sigmas[:, :, None]
    missed, uncertain, effects = np.zeros((count, 6)), np.zeros((count, 6, 6)), seen.by(whole.rows)
    for fold in range(_FOLDS):
        shown, hidden = folds[numbers] != fold, folds[numbers] == fold
        again = _solved(whole[shown])
        left = whole[hidden].left_over(again.scaled_values)
        pulls = np.zeros((count, 6))
        np.add.at(pulls, numbers[hidden], np.einsum("nij,ni->nj", by_tool[hidden], left))
        own = folds == fold
        missed[own] = np.einsum("nij,nj->ni", seen.covariances[own], pulls[own])
        covariance = again.known_covariance / np.outer(again.units, again.units)
        uncertain[own] = effects[own] @ covariance @ np.swapaxes(effects[own], 1, 2)
    known = seen.covariances + uncertain
    given = (missed, known, seen.shown, station.control, units)
    scatter, sure = Scatter.from_errors(*given), Scatter.from_errors(*given, least=1.0)
    gains = control_inverse(station.control)
    spread = correction.covariances(station) + sure.covariances(station.control)
    interval = sure.excess_interval(correction.standard_effects(station), station.control)
    return scatter, np.einsum("nij,njk,nik->ni", gains, spread, gains), interval or (np.nan, np.nan)
