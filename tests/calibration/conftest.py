"""What calibrations of these tests are spared."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def small_networks() -> Iterator[None]:
    """Two of them instead of five, and two decays tried instead of four: most of the time goes into training."""
    from pm3dof_pin.calibration import neural_network

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(neural_network, "_MEMBERS", 2)
        patch.setattr(neural_network, "_DECAYS", (1e-2, 1.0))
        yield
