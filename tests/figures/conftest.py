"""Pictures at full resolution."""

from __future__ import annotations

import pytest

from pm3dof_pin.figures import section_map, style

_DPI, _FACES = style.DPI, section_map._FACES


@pytest.fixture(autouse=True)
def _full_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render at full resolution, see `_coarse_pictures`."""
    monkeypatch.setattr(style, "DPI", _DPI)
    monkeypatch.setattr(section_map, "_FACES", _FACES)
