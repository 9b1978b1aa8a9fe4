"""Numbers at points of a picture: scalar quantities of the maps, and their places on a colour scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.maps.datasets import unit_of_entry
from pm3dof_pin.maps.quantities import QUANTITIES, select_quantities
from pm3dof_pin.maps.quantity import Evaluation, MappedRobot
from pm3dof_pin.typing import Array

_WIDE = 20.0  # ratio of greatest to least value from which a scale is logarithmic
_OTHERS = (
    "translational_stiffness:least",
    "rotational_stiffness:least",
    *(f"felt_stiffness:{component}" for component in TOOL_COMPONENTS),
    "condition_number",
)


@dataclass(frozen=True)
class Layer:
    """One quantity at n points: values, shape=(n,), a short name to select it, title and unit."""

    values: Array
    name: str
    title: str
    unit: str

    @property
    def logarithmic(self) -> bool:
        """Whether a logarithmic scale is better: for positive values of a wide range."""
        low, high = float(self.values.min()), float(self.values.max())
        return 0.0 < low * _WIDE < high

    @property
    def places(self) -> Array:
        """Place of each value on the colour scale from the least, 0, to the greatest, 1, shape=(n,)."""
        values = np.log(self.values) if self.logarithmic else self.values
        low, high = float(values.min()), float(values.max())
        places: Array = (values - low) / (high - low) if high > low else np.zeros_like(values)
        return places


@dataclass(frozen=True)
class ScalarQuantity:
    """One number per pose: a quantity, or its entry at `index`."""

    name: str
    index: int | None
    title: str
    unit: str

    @classmethod
    def find(cls, mapped: MappedRobot, text: str) -> ScalarQuantity:
        """Find "name" or "name:entry" among the quantities of the maps; InvalidValueError unless it is a scalar."""
        name, _, label = text.partition(":")
        (quantity,) = select_quantities([name], mapped)
        if not quantity.dims:
            if label:
                raise InvalidValueError("quantity", text, f"'{name}' alone, which is a single number")
            return cls(name, None, quantity.long_name, quantity.unit_for(mapped))
        entries = quantity.dims[0].labels(mapped) if len(quantity.dims) == 1 else ()
        if label not in entries:
            expected = (
                f"'{name}:' and one of {', '.join(entries)}" if entries else "a quantity that is a number or a list"
            )
            raise InvalidValueError("quantity", text, expected)
        unit = unit_of_entry(quantity.unit_for(mapped), label)
        return cls(name, entries.index(label), f"{quantity.long_name}: {label}", unit)

    @staticmethod
    def names(mapped: MappedRobot) -> list[str]:
        """Return all names that :meth:`find` accepts."""
        names = []
        for quantity in QUANTITIES.values():
            if not quantity.exists(mapped):
                continue
            if not quantity.dims:
                names.append(quantity.name)
            elif len(quantity.dims) == 1:
                names += [f"{quantity.name}:{label}" for label in quantity.dims[0].labels(mapped)]
        return names

    @classmethod
    def others(cls, mapped: MappedRobot, chosen: str) -> list[ScalarQuantity]:
        """Return the quantities that a picture offers in addition to the chosen one: the robot's inexpensive ones."""
        known = set(cls.names(mapped))
        return [cls.find(mapped, name) for name in _OTHERS if name in known and name != chosen]

    def values(self, mapped: MappedRobot, poses: Poses) -> Array:
        """Return the number at poses, shape=(...)."""
        values = QUANTITIES[self.name].compute(Evaluation(mapped, poses))
        return values if self.index is None else values[..., self.index]

    def layer(self, mapped: MappedRobot, poses: Poses) -> Layer:
        """Return the number at poses, shape=(n,), as a layer."""
        entry = "" if self.index is None else f", {self.title.rpartition(': ')[2]}"
        return Layer(self.values(mapped, poses), self.name.replace("_", " ") + entry, self.title, self.unit)
