"""A still picture (SVG) of a machine for browsers that draw no 3D graphics: outlines of its parts, farthest first."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import colours
from pm3dof_pin.viewer.bodies import Bodies

_SIZE = 760.0  # of the picture [pixels]
_SHADE = 0.75  # of the lines, relative to the faces


def still_picture(bodies: Bodies, configuration: Configuration, azimuth: float, elevation: float) -> str:
    """Return a parallel projection of the drawn bodies as SVG, seen from a direction [deg].

    Each part is drawn as the outline of its points, which is exact for convex parts.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    view = np.array(
        [
            [-math.sin(a), math.cos(a), 0.0],
            [-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)],
            [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)],
        ]
    )
    parts = sorted(_outlines(bodies, configuration, view), key=lambda part: part[0])
    if not parts:
        return ""
    points = np.concatenate([outline for _, outline, _ in parts])
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    scale = _SIZE / max(float(extent.max()), 1e-9)
    width, height = extent * scale
    shapes = []
    for _, outline, colour in parts:
        text = " ".join(f"{x:.1f},{height - y:.1f}" for x, y in (outline - low) * scale)
        line = colours.css(_SHADE * np.array(colour[:3]))
        shapes.append(
            f'<polygon points="{text}" fill="{colours.css(colour[:3])}" fill-opacity="{colour[3]:g}" stroke="{line}"/>'
        )
    box = f"-8 -8 {width + 16:.0f} {height + 16:.0f}"
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" width="{width + 16:.0f}">{"".join(shapes)}</svg>'


def _outlines(
    bodies: Bodies, configuration: Configuration, view: Array
) -> Iterator[tuple[float, Array, tuple[float, float, float, float]]]:
    """Yield the nearness of each part to the eye, its outline, shape=(n, 2), and its colour."""
    from scipy.spatial import ConvexHull, QhullError  # slower to import than the rest of the page

    placements = bodies.placements(configuration)
    for body in bodies:
        turn, at = placements[body.path][:3, :3], placements[body.path][:3, 3]
        for part in body.parts:
            points = (part.corners @ turn.T + at) @ view.T
            try:
                outline = points[ConvexHull(points[:, :2]).vertices, :2]
            except (QhullError, ValueError):  # seen edge-on
                outline = points[[points[:, 0].argmin(), points[:, 0].argmax()], :2]
            yield float(points[:, 2].mean()), outline, part.colour
