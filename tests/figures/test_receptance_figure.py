"""Curves of receptances and lobes in the units of their axes."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.dynamics.stability_lobes import Cutting, StabilityLobes
from pm3dof_pin.figures.receptance import lobes_diagram, receptance_curves


def test_lobes_are_over_turns_per_minute_in_millimetres() -> None:
    speeds, depths = np.array([50.0, 100.0, 150.0]), np.array([2e-3, 3e-3, 4e-3])
    axes = lobes_diagram("it", StabilityLobes(Cutting(1e9), 2e-3, 120.0, speeds, depths)).axes[0]
    np.testing.assert_allclose(axes.lines[0].get_xydata(), np.column_stack([60.0 * speeds, 1e3 * depths]))


def test_phases_are_in_degrees_without_jumps() -> None:
    """A mass on a spring passes from 0 to -180 degrees, and on by another one."""
    frequencies = np.geomspace(1.0, 1e3, 400)
    turns = np.prod([1.0 / (1.0 - (frequencies / f) ** 2 + 0.02j * frequencies / f) for f in (30.0, 200.0)], axis=0)
    magnitude, phase, real = receptance_curves("it", frequencies, {"x": (1e-6 * turns, "m/N")}).axes
    lag = phase.lines[0].get_ydata()
    assert abs(lag[0]) < 1.0
    assert abs(lag[-1] + 360.0) < 1.0
    np.testing.assert_allclose(magnitude.lines[0].get_ydata(), 1e-6 * np.abs(turns))
    np.testing.assert_allclose(real.lines[0].get_ydata(), 1e-6 * turns.real)
