"""Quantities over grids of poses as labelled arrays, and the workspace."""
