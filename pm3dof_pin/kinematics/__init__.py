"""Loop closing, poses, limits, mobility and singularities of any mechanism."""
