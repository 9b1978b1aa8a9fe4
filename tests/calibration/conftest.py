"""Calibrations of these tests, made cheaper."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def small_networks() -> Iterator[None]:
    """Two of them instead of five, and two decays instead of four: training takes most of the time."""
    from pm3dof_pin.calibration import neural_network

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(neural_network, "_MEMBERS", 2)
        patch.setattr(neural_network, "_DECAYS", (1e-2, 1.0))
        yield
