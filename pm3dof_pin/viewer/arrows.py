"""Arrows: forces of prismatic joints, moments (two heads) of revolute ones, and frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.bodies import joint_placements
from pm3dof_pin.viewer.objects import Colour
from pm3dof_pin.viewer.scene import Json, Scene

COLOUR: Colour = (0.78, 0.07, 0.13)
LOAD_COLOUR: Colour = (0.0, 0.5, 0.35)
_AXIS_COLOURS: tuple[Colour, Colour, Colour] = ((0.84, 0.15, 0.16), (0.17, 0.63, 0.17), (0.12, 0.47, 0.71))

_MIN_LENGTH = 1e-6  # a zero length would leave no direction


@dataclass(frozen=True)
class ActuatorAxis:
    """The axis of an actuated joint in the world: origin on the moved body [m] and positive unit direction."""

    joint: str
    origin: Array
    direction: Array
    turns: bool

    @classmethod
    def from_configuration(cls, configuration: Configuration) -> tuple[ActuatorAxis, ...]:
        """Return the axes of all actuated joints, in order."""
        mechanism, placements, axes = configuration.mechanism, joint_placements(configuration), []
        for name in mechanism.actuated_joints:
            placement = placements[mechanism.model.getJointId(name)]
            direction = placement[:3, :3] @ mechanism.joint_axis(name)
            axes.append(cls(name, placement[:3, 3], direction, not mechanism.single_joint(name).translates))
        return tuple(axes)

    @property
    def unit(self) -> str:
        """Unit of its actuator's force."""
        return "N m" if self.turns else "N"

    def draw(self, scene: Scene, path: str) -> None:
        """Draw the arrow of :func:`draw_arrow` at a path."""
        draw_arrow(scene, path, turns=self.turns)

    def arrow(self, force: float, *, scale: float, width: float) -> Array:
        """Return the transform that makes the arrow of :meth:`draw` a force [N, N m] on the axis, shape=(4, 4).

        A force of 1 has length `scale` [m]; the half width of the head is `width` [m], less for short arrows.
        """
        turn = objects.turn_z_to(self.direction if force >= 0.0 else -self.direction)
        length = max(scale * abs(force), _MIN_LENGTH * width)
        slim = min(width, 0.5 * length)
        return objects.transform(turn * np.array([slim, slim, length]), self.origin)


def draw_arrow(scene: Scene, path: str, *, turns: bool, colour: Colour = COLOUR) -> None:
    """Draw an arrow of length 1 and half width 1 along z at a path, with one head for a force, two for a moment."""
    parts: dict[str, tuple[Json, float]] = {"shaft": (objects.cylinder(0.35, 0.75), 0.375)}
    for head in range(1 + turns):
        parts[f"head{head}"] = (objects.cylinder(1.0, 0.28, 0.0), 0.86 - 0.2 * head)
    for name, (geometry, height) in parts.items():
        scene.set_object(f"{path}/{name}", objects.mesh(geometry, colour, overlaid=True), casts_shadow=False)
        scene.set_transform(f"{path}/{name}", objects.transform(translation=[0.0, 0.0, height]) @ objects.Y_TO_Z)


def draw_frame(scene: Scene, path: str, placement: ArrayLike, size: float) -> None:
    """Draw a frame with arrows of a length [m] at a path, at a placement in its parent, shape=(4, 4)."""
    scene.set_transform(path, placement)
    shaft, head = objects.cylinder(0.028 * size, 0.82 * size), objects.cylinder(0.07 * size, 0.2 * size, 0.0)
    for direction, axis, colour in zip(np.eye(3), "xyz", _AXIS_COLOURS, strict=True):
        for part, geometry, middle in (("shaft", shaft, 0.41 * size), ("head", head, 0.9 * size)):
            scene.set_object(f"{path}/{axis}_{part}", objects.mesh(geometry, colour), casts_shadow=False)
            turn = objects.transform(objects.turn_z_to(direction), middle * direction)
            scene.set_transform(f"{path}/{axis}_{part}", turn @ objects.Y_TO_Z)
