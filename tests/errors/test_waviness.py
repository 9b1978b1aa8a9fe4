"""Waves of guideways: each drive and each direction has its own."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.errors.waviness import GuideWaviness, Wave
from pm3dof_pin.exceptions import InvalidValueError


def test_each_wave_moves_its_own_drive_in_its_own_direction() -> None:
    """Sines by hand: a quarter of a period, and a phase of 30 degrees."""
    quarter, thirty = Wave(2e-6, 0.04, 0.0), Wave(3e-6, 1.0, np.pi / 6.0)
    waves = GuideWaviness(((), (quarter, thirty)), (((), (thirty,)), ((quarter,), ())))
    travels = np.array([[0.0, 0.01]])
    both = 2e-6 + 3e-6 * np.sin(0.02 * np.pi + np.pi / 6.0)
    np.testing.assert_allclose(waves.travel_errors(travels), [[0.0, both]], rtol=1e-13)
    np.testing.assert_allclose(waves.offsets(travels), [[[0.0, 1.5e-6], [2e-6, 0.0]]], rtol=1e-13)
    with pytest.raises(InvalidValueError, match="one for each of 3 actuated joints"):
        waves.travel_errors(np.zeros((1, 3)))
