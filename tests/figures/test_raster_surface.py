"""Triangles and lines in space as one image: what is nearer is in front."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pm3dof_pin.figures.raster_surface import RasterSurface

RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)


@pytest.mark.parametrize("red_first", [True, False])
def test_the_nearer_triangle_covers_the_other(red_first: bool) -> None:
    """Seen from above, the higher one, in whichever order they are given."""
    flat = np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]])
    low, high = (np.column_stack([flat, np.full(3, height)]) for height in (-0.5, 0.5))
    triangles, colors = np.array([high, low]), np.array([[RED], [BLUE]])
    order = slice(None, None, 1 if red_first else -1)
    figure = Figure(figsize=(2.0, 2.0), dpi=50)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    axes.view_init(elev=90.0, azim=-90.0)
    axes.set(xlim=(-1.0, 1.0), ylim=(-1.0, 1.0), zlim=(-1.0, 1.0))
    axes.set_axis_off()
    surface = RasterSurface(triangles[order], colors[order], np.zeros((0, 2, 3)), (0.0, 0.0, 0.0, 1.0), 0.5)
    axes.add_collection(surface, autolim=False)
    canvas.draw()
    middle = np.asarray(canvas.buffer_rgba())[50, 50, :3]
    assert middle.tolist() == [255, 0, 0]
