"""Intervals of root mean squares, against random machines."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.calibration.scatter import Scatter

POSES, DRIVES = 50, 3


@pytest.mark.parametrize(("size", "everywhere"), [(0.0, [0.0, 0.0]), (3.0, [0.0, 0.0]), (1.0, [0.04, 0.09])])
def test_an_interval_holds_for_95_percent_of_machines(size: float, everywhere: list[float]) -> None:
    generator = np.random.default_rng(1)
    effects = generator.standard_normal((POSES, 6, 8)) * np.geomspace(1.0, 0.05, 8)
    fixed, control = size * generator.standard_normal((POSES, 6)), generator.standard_normal((POSES, 6, DRIVES))
    scatter = Scatter(np.array(everywhere), np.full(DRIVES, everywhere[0]), alike=np.ones(DRIVES))
    low, high = scatter.rms_interval(fixed, effects, control)
    parameters = generator.standard_normal((1000, 8))
    scattered = np.sqrt(np.repeat(everywhere, 3)) * generator.standard_normal((1000, POSES, 6))
    by_drives = np.sqrt(everywhere[0]) * generator.standard_normal((1000, POSES, DRIVES))
    drawn = fixed + np.einsum("nij,mj->mni", effects, parameters) + scattered
    drawn = drawn + np.einsum("nij,mnj->mni", control, by_drives)
    sizes = np.sqrt(np.mean(np.sum(drawn**2, axis=2), axis=1))
    assert 0.93 < np.mean((low < sizes) & (sizes < high)) < 0.98


def test_commands_are_off_by_what_drives_undo() -> None:
    """One parameter that moves the tool as the first drive does: half a normal distribution, over three drives."""
    control = np.tile(np.eye(6)[:, :DRIVES], (POSES, 1, 1))
    interval = Scatter().excess_interval(control[:, :, :1], control)
    assert interval is not None
    low, high = interval
    assert low == pytest.approx(0.03134 / np.sqrt(DRIVES), rel=1e-3)  # the 2.5 and 97.5 % points of |x|
    assert high == pytest.approx(2.2414 / np.sqrt(DRIVES), rel=1e-3)


def test_nothing_is_said_near_singular_poses() -> None:
    control = np.tile(np.eye(6)[:, :DRIVES], (POSES, 1, 1))
    control[7, :, 2] *= 1e-3
    assert Scatter().excess_interval(control, control) is None
