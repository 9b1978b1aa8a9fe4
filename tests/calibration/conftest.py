"""Cheaper calibrations for these tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def small_networks() -> Iterator[None]:
    """Two networks instead of five, two decays instead of four, three folds instead of five, a quarter of the steps.

    Training takes longest.
    """
    from pm3dof_pin.calibration import neural_network

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(neural_network, "_MEMBERS", 2)
        patch.setattr(neural_network, "_DECAYS", (1e-2, 1.0))
        patch.setattr(neural_network, "_FOLDS", 3)
        patch.setattr(neural_network, "_MAX_STEPS", 100)
        yield
