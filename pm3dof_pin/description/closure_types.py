"""The types of loop closures: which components of the motion of frame b relative to frame a each of them holds.

Components are numbered in the axes of frame a: 0, 1, 2 along and about x, y, z. A translation is held where frame b's
origin cannot move along that axis. Of the rotations, all three are held where the axes of both frames stay parallel;
0 and 1 where their z axes do (a hinge about z); and 2 alone where the x axis of frame a stays perpendicular to the
y axis of frame b (a cross between two shafts): to first order that is rotation about z, and exactly rotation about the
common normal of both axes. Whoever needs rows, sizes or axes of a type reads this table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent

ClosureTypeName: TypeAlias = Literal["3d", "6d", "hinge", "universal", "prismatic", "cylindrical", "planar", "distance"]


@dataclass(frozen=True)
class ClosureType:
    """A type of loop closure, a row of :data:`CLOSURE_TYPES`."""

    name: ClosureTypeName  #: its name in files
    translations: tuple[int, ...]  #: axes of frame a along which frame b's origin is held
    rotations: tuple[int, ...]  #: rotations that are held: all three, 0 and 1, 2 alone, or none
    #: which axis of the frames an axis given with the closure replaces, 0 for x, 2 for z; None if none makes sense
    axis: int | None = None
    #: whether frame b may have another axis than frame a; if all rotations are held, it may not
    has_two_axes: bool = False
    is_distance: bool = False  #: whether the distance of the origins is held instead, a single row
    aliases: tuple[str, ...] = ()  #: other names accepted in files

    @property
    def size(self) -> int:
        """Number of rows: components of the relative twist that are held."""
        return 1 if self.is_distance else len(self.translations) + len(self.rotations)

    @property
    def holds_vectors(self) -> bool:
        """Whether it holds whole vectors, all translations and all rotations or none, so that any axes serve."""
        return self.components in (TOOL_COMPONENTS[:3], TOOL_COMPONENTS)

    @property
    def is_angular(self) -> tuple[bool, ...]:
        """Which rows are rotations, shape=(size,)."""
        return (False,) * (self.size - len(self.rotations)) + (True,) * len(self.rotations)

    @property
    def components(self) -> tuple[ToolComponent, ...]:
        """The held components of the twist [v; omega] in the axes of frame a, by name; none for a distance."""
        held = (*self.translations, *(3 + axis for axis in self.rotations))
        return () if self.is_distance else tuple(TOOL_COMPONENTS[k] for k in held)


_XYZ = (0, 1, 2)

CLOSURE_TYPES: Mapping[str, ClosureType] = MappingProxyType(
    {
        row.name: row
        for row in (
            ClosureType("3d", _XYZ, (), aliases=("3D", "ball", "spherical")),
            ClosureType("6d", _XYZ, _XYZ, aliases=("6D", "weld", "fixed")),
            ClosureType("hinge", _XYZ, (0, 1), axis=2, has_two_axes=True, aliases=("revolute",)),
            ClosureType("universal", _XYZ, (2,), axis=0, has_two_axes=True),
            ClosureType("prismatic", (0, 1), _XYZ, axis=2),
            ClosureType("cylindrical", (0, 1), (0, 1), axis=2, has_two_axes=True),
            ClosureType("planar", (2,), (0, 1), axis=2, has_two_axes=True),
            ClosureType("distance", _XYZ, (), is_distance=True, aliases=("rod",)),
        )
    }
)
"""The types of loop closures, by name."""

CLOSURE_TYPE_NAMES: Mapping[str, ClosureTypeName] = MappingProxyType(
    {name: row.name for row in CLOSURE_TYPES.values() for name in (row.name, *row.aliases)}
)
"""The name of a type by each name accepted in files."""

assert set(get_args(ClosureTypeName)) == set(CLOSURE_TYPES)
