"""Closing loops, poses, limits, mobility and singularities of any mechanism."""
