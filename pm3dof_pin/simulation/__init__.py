"""Simulated machines: their errors, and what an instrument measures of them."""
