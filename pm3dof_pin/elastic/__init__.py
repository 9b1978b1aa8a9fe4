"""Elastic mechanisms: springs, the 6 x 6 Cartesian stiffness of any frame, loaded stiffness and buckling, indices.

Names are loaded when they are first used: the indices need neither Pinocchio nor a compiler.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pm3dof_pin.elastic.batch import Evaluation, compliance, evaluate, stiffness
    from pm3dof_pin.elastic.buckling import BucklingLoad, buckling_load
    from pm3dof_pin.elastic.condensation import (
        CartesianCompliance,
        transformed_compliance,
        transformed_stiffness,
        twist_transform,
    )
    from pm3dof_pin.elastic.elastic_model import ElasticModel, SpringBlock
    from pm3dof_pin.elastic.loaded import (
        LoadedEquilibrium,
        equilibrium_path,
        load_deflection,
        loaded_equilibrium,
    )
    from pm3dof_pin.elastic.loads import Loads
    from pm3dof_pin.elastic.report import cartesian_compliance
    from pm3dof_pin.elastic.springs import (
        AxialSpring,
        BeamSpring,
        CantileverSpring,
        ClosureSpring,
        JointLength,
        JointSpring,
        Spring,
        read_springs,
    )

_HOMES = {
    "AxialSpring": "springs",
    "BeamSpring": "springs",
    "BucklingLoad": "buckling",
    "CantileverSpring": "springs",
    "CartesianCompliance": "condensation",
    "ClosureSpring": "springs",
    "ElasticModel": "elastic_model",
    "Evaluation": "batch",
    "JointLength": "springs",
    "JointSpring": "springs",
    "LoadedEquilibrium": "loaded",
    "Loads": "loads",
    "Spring": "springs",
    "SpringBlock": "elastic_model",
    "buckling_load": "buckling",
    "cartesian_compliance": "report",
    "compliance": "batch",
    "equilibrium_path": "loaded",
    "evaluate": "batch",
    "load_deflection": "loaded",
    "loaded_equilibrium": "loaded",
    "read_springs": "springs",
    "stiffness": "batch",
    "transformed_compliance": "condensation",
    "transformed_stiffness": "condensation",
    "twist_transform": "condensation",
}

__all__ = [
    "AxialSpring",
    "BeamSpring",
    "BucklingLoad",
    "CantileverSpring",
    "CartesianCompliance",
    "ClosureSpring",
    "ElasticModel",
    "Evaluation",
    "JointLength",
    "JointSpring",
    "LoadedEquilibrium",
    "Loads",
    "Spring",
    "SpringBlock",
    "buckling_load",
    "cartesian_compliance",
    "compliance",
    "equilibrium_path",
    "evaluate",
    "load_deflection",
    "loaded_equilibrium",
    "read_springs",
    "stiffness",
    "transformed_compliance",
    "transformed_stiffness",
    "twist_transform",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'pm3dof_pin.elastic' has no attribute '{name}'")
    return getattr(importlib.import_module(f"pm3dof_pin.elastic.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
