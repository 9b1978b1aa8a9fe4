"""Quantities over grids of poses as labelled arrays, and what the chapter prints of them."""
