"""Readers of descriptions, one module a dialect; each makes a typed :class:`Description`."""
