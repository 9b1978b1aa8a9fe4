"""Whose a calibration is."""

from __future__ import annotations

from pathlib import Path

import pytest

import pm3dof_pin as pm
from pm3dof_pin.cli.calibration_options import require_calibration_of
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.shared_commands import SharedCommands

_MACHINES = Path(__file__).parents[1] / "machines"


def test_redundant_drives_are_moved_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """One alone would contradict the others: a long search by least squares, after which only home was compared."""

    def contradicting(*_: object, **__: object) -> None:
        raise AssertionError("the commands contradict each other")

    monkeypatch.setattr(SharedCommands, "_least_squares", contradicting)
    one, other = (pm.load(_MACHINES / "four_rrr") for _ in range(2))
    require_calibration_of(one, other, Path("calibration"))
    with pytest.raises(InvalidValueError, match="not of five_bar"):
        require_calibration_of(one, pm.load(_MACHINES / "five_bar"), Path("calibration"))
