"""Background, floor and lights around a mechanism, in proportion to its size."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.scene import Scene

_TOP = [0.985, 0.99, 1.0]
_BOTTOM = [0.80, 0.84, 0.885]
_FLOOR = (0.76, 0.78, 0.81)
_LINE = (0.58, 0.63, 0.70)


def draw_surroundings(scene: Scene, middle: Array, radius: float, floor: float) -> None:
    """Set the background, draw a floor [m] under a machine's bounding sphere, and light it from the upper front."""
    scene.set_property("/Background", "top_color", _TOP, of_object=False)
    scene.set_property("/Background", "bottom_color", _BOTTOM, of_object=False)
    for path in ("/Grid", "/Axes"):
        scene.set_visible(path, False)
    _draw_floor(scene, np.array([middle[0], middle[1], floor]), radius)
    _light(scene, middle, radius)


def _draw_floor(scene: Scene, middle: Array, radius: float) -> None:
    size = 2.2 * radius
    plate = 0.01 * radius
    scene.set_object("/floor/plate", objects.mesh(objects.cylinder(size, plate), _FLOOR))
    below = middle - [0.0, 0.0, 0.5 * plate + 1e-3 * radius]
    scene.set_transform("/floor/plate", objects.transform(translation=below) @ objects.Y_TO_Z)
    step = 10.0 ** round(math.log10(0.2 * radius))
    grid = np.concatenate([_chords(middle, size, step, axis) for axis in (0, 1)])
    scene.set_object("/floor/lines", objects.line_segments(grid, _LINE, opacity=0.6), casts_shadow=False)


def _chords(middle: Array, size: float, step: float, axis: int) -> Array:
    """Return the ends of parallel chords of a disc, at round coordinates along an axis, shape=(2 n, 3)."""
    first, last = np.ceil((middle[axis] - size) / step), np.floor((middle[axis] + size) / step)
    places = step * np.arange(first, last + 1)
    half = np.sqrt(np.maximum(0.0, size**2 - (places - middle[axis]) ** 2))
    ends = np.tile(middle, (2 * len(places), 1))
    ends[:, axis] = np.repeat(places, 2)
    ends[:, 1 - axis] += np.column_stack([-half, half]).ravel()
    return ends


def _light(scene: Scene, middle: Array, radius: float) -> None:
    x, y, z = middle
    lights: dict[str, dict[str, Any]] = {
        # the only one that casts shadows
        "SpotLight": {
            "position": [x + 2.5 * radius, y - 2.0 * radius, z + 6.0 * radius],
            "intensity": 0.45,
            "angle": 0.5,
            "penumbra": 0.8,
            "castShadow": True,
        },
        "PointLightNegativeX": {"position": [x + 4.0 * radius, y + 4.0 * radius, z + 4.0 * radius], "intensity": 0.12},
        "PointLightPositiveX": {"position": [x - 4.0 * radius, y - 5.0 * radius, z + 3.0 * radius], "intensity": 0.2},
        "AmbientLight": {"intensity": 0.46},
        "FillLight": {"position": [x - 5.0 * radius, y + 5.0 * radius, z + 4.0 * radius], "intensity": 0.15},
    }
    scene.set_visible("/Lights/SpotLight", True)  # off by default in meshcat
    for name, properties in lights.items():
        for key, value in properties.items():
            scene.set_property(f"/Lights/{name}", key, value)
            if name.startswith("PointLight"):
                scene.set_property(f"/Lights/{name}", "distance", 40.0 * radius)
