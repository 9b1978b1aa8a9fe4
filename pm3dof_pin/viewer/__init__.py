"""The viewer: any mechanism in meshcat's page in a browser, served on this machine or as one file."""

from __future__ import annotations

from pm3dof_pin.viewer.in_meshcat import draw_in_meshcat
from pm3dof_pin.viewer.viewer import Viewer

__all__ = ["Viewer", "draw_in_meshcat"]
