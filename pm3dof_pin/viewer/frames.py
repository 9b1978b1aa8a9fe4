"""Frames as three arrows: x red, y green, z blue."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.objects import Colour
from pm3dof_pin.viewer.scene import Scene

COLOURS: tuple[Colour, Colour, Colour] = ((0.84, 0.15, 0.16), (0.17, 0.63, 0.17), (0.12, 0.47, 0.71))


def draw_frame(scene: Scene, path: str, placement: ArrayLike, size: float) -> None:
    """Put a frame with arrows of a length [m] at a path, at a placement in its parent, shape=(4, 4)."""
    scene.set_transform(path, placement)
    shaft, head = objects.cylinder(0.028 * size, 0.82 * size), objects.cylinder(0.07 * size, 0.2 * size, 0.0)
    for direction, axis, colour in zip(np.eye(3), "xyz", COLOURS, strict=True):
        for part, geometry, middle in (("shaft", shaft, 0.41 * size), ("head", head, 0.9 * size)):
            scene.set_object(f"{path}/{axis}_{part}", objects.mesh(geometry, colour), casts_shadow=False)
            turn = objects.transform(objects.turn_z_to(direction), middle * direction)
            scene.set_transform(f"{path}/{axis}_{part}", turn @ objects.Y_TO_Z)
