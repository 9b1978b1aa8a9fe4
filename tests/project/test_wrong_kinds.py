"""Public functions refuse objects of the wrong kind by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import InvalidValueError

CALLS: dict[str, Callable[[object], object]] = {
    "Robot": lambda wrong: pm.Robot(wrong),  # type: ignore[arg-type]
    "Configuration": lambda wrong: pm.Configuration(wrong, np.zeros(3)),  # type: ignore[arg-type]
    "reachable_poses": lambda wrong: pm.reachable_poses(wrong, 3, np.random.default_rng(0)),  # type: ignore[arg-type]
    "sensitivities": lambda wrong: pm.sensitivities(wrong, wrong),  # type: ignore[arg-type]
    "error_map": lambda wrong: pm.error_map(wrong, wrong),  # type: ignore[arg-type]
    "PlanningProblem": lambda wrong: pm.PlanningProblem(wrong, wrong),  # type: ignore[arg-type]
    "calibrate": lambda wrong: pm.calibrate(wrong, wrong),  # type: ignore[arg-type]
    "compute_atlas": lambda wrong: pm.compute_atlas(wrong),  # type: ignore[arg-type]
    "loaded_equilibrium": lambda wrong: pm.loaded_equilibrium(wrong, np.zeros(3), {}),  # type: ignore[arg-type]
    "free_motion_stiffness": lambda wrong: pm.free_motion_stiffness(wrong, np.zeros(3)),  # type: ignore[arg-type]
    "compliance": lambda wrong: pm.compliance(wrong, np.zeros((1, 3))),  # type: ignore[arg-type]
    "natural_modes": lambda wrong: pm.natural_modes(wrong, np.zeros(3)),  # type: ignore[arg-type]
    "holding_forces": lambda wrong: pm.holding_forces(wrong),  # type: ignore[arg-type]
    "inverse_dynamics": lambda wrong: pm.inverse_dynamics(wrong, [0.0], [0.0]),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("wrong", ["pm3dof", None, 3.0, np.zeros(12), {}], ids=lambda wrong: type(wrong).__name__)
@pytest.mark.parametrize("name", CALLS)
def test_refused_by_name(name: str, wrong: object) -> None:
    if name == "calibrate" and isinstance(wrong, str):
        pytest.skip("a string is the path of a file of measurements")
    with pytest.raises(InvalidValueError, match=r" = .*: expected an? [A-Z]\w+, as returned by "):
        CALLS[name](wrong)
