"""Interface of the learned models: deviations of the commands as functions of scaled inputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from pm3dof_pin.typing import Array


@dataclass(frozen=True, eq=False)
class LearnedModel(ABC):
    """Deviations of the commands as functions of scaled inputs; the fields are arrays."""

    kind: ClassVar[str]  #: its name in files

    @abstractmethod
    def deviations(self, inputs: Array) -> Array:
        """Return du, shape=(n, number of commands) [m, rad], for inputs of shape (n, number of inputs)."""

    @abstractmethod
    def uncertainties(self, inputs: Array) -> Array:
        """Return the standard deviation of du, shape=(n, number of commands) [m, rad]."""

    def as_data(self) -> dict[str, object]:
        """Return the model as numbers and lists, for JSON."""
        return {"kind": self.kind} | {field.name: getattr(self, field.name).tolist() for field in fields(self)}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Return the model that :meth:`as_data` was called on."""
        return cls(*(np.array(data[field.name], dtype=float) for field in fields(cls)))
