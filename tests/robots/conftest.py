"""Shared by the tests of all machines."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import yaml

from pm3dof_pin.description.robots import robots_directory

Numbers = dict[str, Any]

_FACTORS = {"mm": 1e-3, "deg": math.pi / 180.0}


@pytest.fixture(scope="session")
def numbers_of() -> Callable[[str], Numbers]:
    """Read the values of a robot's YAML file by "section.name", converted here: metres, radians, kilograms."""

    def numbers(robot: str) -> Numbers:
        path = robots_directory() / f"{robot}_description" / "config" / f"{robot}.yaml"
        sections = yaml.safe_load(path.read_text(encoding="utf-8"))
        return {
            f"{section}.{name}": np.asarray(entry["value"]) * _FACTORS.get(entry["unit"], 1.0)
            for section, entries in sections.items()
            if isinstance(entries, dict)
            for name, entry in entries.items()
        }

    return numbers
