"""Elastic mechanisms: springs, 6 x 6 Cartesian stiffness of any frame, loaded stiffness, buckling, and indices."""
