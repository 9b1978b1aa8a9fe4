"""A surface in space of many triangles, and lines in it, drawn by depth as one raster image."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import allow_rasterization
from matplotlib.collections import Collection
from matplotlib.transforms import IdentityTransform
from mpl_toolkits.mplot3d.proj3d import proj_transform
from numpy.typing import ArrayLike

from pm3dof_pin.typing import Array

_DILATION = 0.5  # pixels by which Agg enlarges triangles on each side, which closes seams


class RasterSurface(Collection):
    """Triangles whose colours blend between their corners, and lines, sorted by depth together.

    Ten thousand triangles take a fifth of the time of as many polygons, each of which Matplotlib draws as a path. In
    vector files it is an image. Lines must be as short as the triangles, and slightly nearer, to be in front of them.

    Args:
        triangles: their corners, shape=(t, 3, 3).
        colors: red, green, blue, opacity of the corners, shape=(t, 3, 4), or of whole triangles, shape=(t, 1, 4).
        lines: ends of straight lines, shape=(s, 2, 3).
        line_color: of all lines.
        width: of the lines [points].
    """

    def __init__(self, triangles: Array, colors: Array, lines: Array, line_color: ArrayLike, width: float) -> None:
        super().__init__(rasterized=True)
        self._triangles, self._lines, self._width = triangles, lines, width
        tinted = np.broadcast_to(line_color, (2 * len(lines), 3, 4))
        self._colors = np.concatenate([np.broadcast_to(colors, (len(triangles), 3, 4)), tinted])
        self._flat, self._flat_lines = triangles[..., :2], lines[..., :2]
        self._farthest_first = np.arange(len(self._colors))

    def do_3d_projection(self) -> float:
        """Project onto the plane of the drawing and sort by depth; return the least depth."""

        def projected(points: Array) -> tuple[Array, Array]:
            x, y, depth = proj_transform(*points.reshape(-1, 3).T, self.axes.M)  # type: ignore[union-attr]
            shape = points.shape[:-1]
            return np.stack([x, y], axis=-1).reshape(*shape, 2), np.asarray(depth).reshape(shape).mean(axis=-1)

        self._flat, depth = projected(self._triangles)
        self._flat_lines, line_depth = projected(self._lines)
        depths = np.concatenate([depth, np.repeat(line_depth, 2)])
        self._farthest_first = np.argsort(-depths, kind="stable")
        return float(depths.min(initial=np.inf))

    @allow_rasterization  # type: ignore[untyped-decorator]
    def draw(self, renderer: Any) -> None:
        """Draw everything, the farthest first."""
        if not self.get_visible():
            return
        to_pixels = self.axes.transData  # type: ignore[union-attr]

        def placed(points: Array) -> Array:
            return np.asarray(to_pixels.transform(points.reshape(-1, 2))).reshape(points.shape)

        start, end = np.moveaxis(placed(self._flat_lines), 1, 0)
        along = end - start
        length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
        half = max(0.5 * renderer.points_to_pixels(self._width) - _DILATION, 0.05)
        aside = half * np.stack([-along[:, 1], along[:, 0]], axis=-1) / length
        strips = np.stack([start - aside, start + aside, end + aside, start - aside, end + aside, end - aside], axis=1)
        corners = np.concatenate([placed(self._flat), strips.reshape(-1, 3, 2)])[self._farthest_first]
        gc = renderer.new_gc()
        self._set_gc_clip(gc)  # type: ignore[attr-defined]
        renderer.draw_gouraud_triangles(gc, corners, self._colors[self._farthest_first], IdentityTransform())
        gc.restore()
