"""The map of the springs that give most: which one is where, and how clearly."""

from __future__ import annotations

import numpy as np
import xarray as xr

from pm3dof_pin.figures.critical_springs import critical_springs
from pm3dof_pin.maps.workspace_evaluation import CRITICAL, SHARES


def test_the_spring_with_the_largest_share_is_drawn_where_it_leads() -> None:
    """Of two springs the second one leads to the right, by more the farther right, whatever the other coordinate."""
    x, y = np.linspace(-1.0, 1.0, 9), np.linspace(0.0, 1.0, 5)
    second = np.tile(0.5 + 0.4 * x[:, None], (1, 5))
    shares = np.stack([1.0 - second, second], axis=-1)[:, :, None, :]
    critical = 1 + shares.argmax(axis=-1)
    labels = {"x": x, "y": y, "axis": ["z"], "spring": ["left", "right"]}
    section = xr.Dataset(
        {SHARES: (("x", "y", "axis", "spring"), shares), CRITICAL: (("x", "y", "axis"), critical)},
        coords=labels,
        attrs={"machine": "it"},
    )
    for name in "xy":
        section[name].attrs["units"] = "m"
    image = critical_springs(section).axes[0].images[0]
    drawn, alpha = np.asarray(image.get_array()), np.asarray(image.get_alpha())
    assert drawn.shape == alpha.shape == (33, 65)  # eight times as fine; rows along y
    assert image.get_extent() == [-1.0, 1.0, 0.0, 1.0]
    assert (drawn[:, :32] == 1).all()
    assert (drawn[:, 33:] == 2).all()
    np.testing.assert_allclose(alpha[16, [0, 32, 64]], [0.25 + 0.75 * share for share in (0.9, 0.5, 0.9)], atol=1e-9)
