"""Held-out poses are off by what their covariance says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.calibration.held_out import _scores_of
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.table import placed_instrument
from pm3dof_pin.simulation.worlds import World

DRAWS = 150


@pytest.mark.parametrize("kind", ["gauge", "camera", "drift and hysteresis"])
def test_the_place_of_the_instrument_counts_with_the_machine(kind: str) -> None:
    """Parameters of machine and set-up are drawn together: what shifts both alike shows at no held-out pose."""
    errors, generator = pm.GeometricErrors.load("three_rps"), np.random.default_rng(0)
    poses = pm.reachable_poses(errors.robot, 40, generator)
    of_session = kind.startswith("drift")
    instrument = Instrument() if of_session else placed_instrument(kind, poses, point=(0.12, 0.0, 0.01))
    rows = World.random("geometry", errors, generator).measure(poses.commands, generator, instrument)
    if of_session:
        sides = generator.choice([-1.0, 1.0], poses.commands.shape)
        rows = replace(rows, approaches=sides, times=np.arange(40.0))
    told = fit(rows, errors, Options("lm"))
    found, compensation = told.identification, replace(told.compensation, values=told.identification.values)
    hidden = found.measurements[:5]
    held = _scores_of(compensation, found, found.linearised(hidden), compensation)
    noise = seen_errors(found.linearised(hidden).settled, found.poses[:5]).covariances
    promised = np.einsum("nii->n", held.covariances - noise)
    drawn = []
    mean = np.concatenate([found.values, found.nuisance_values])
    for values in generator.multivariate_normal(mean, found.known_covariance, DRAWS, method="cholesky"):
        machine, setup = np.split(values, [len(errors)])
        linear = replace(found, values=machine, nuisance_values=setup).linearised(hidden)
        drawn.append(seen_errors(linear.settled, linear.poses).errors - held.missed)
    sampled = np.mean(np.sum(np.square(drawn), axis=2), axis=0)
    np.testing.assert_allclose(sampled, promised, rtol=0.5)
    assert sampled.mean() == pytest.approx(promised.mean(), rel=0.15)
