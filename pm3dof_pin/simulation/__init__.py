"""Simulated machines: what is wrong with them, and what an instrument sees of them."""
