"""Pictures at full resolution."""

from __future__ import annotations

import pytest

from pm3dof_pin.figures import outlined_mesh, style

_DPI, _CELLS = style.DPI, outlined_mesh._CELLS


@pytest.fixture(autouse=True)
def _full_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render at full resolution, see `_coarse_pictures`."""
    monkeypatch.setattr(style, "DPI", _DPI)
    monkeypatch.setattr(outlined_mesh, "_CELLS", _CELLS)
