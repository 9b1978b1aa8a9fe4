"""Elastic mechanisms: springs, the 6 x 6 Cartesian stiffness of any frame, loaded stiffness and buckling, indices."""
