"""Geometric errors of any robot: parameters, sensitivities, error maps, tolerances, pose errors."""
