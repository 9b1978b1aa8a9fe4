"""A robot's files for other programs, all generated."""
