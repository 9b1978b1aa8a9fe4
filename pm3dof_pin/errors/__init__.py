"""Geometric errors of any mechanism: parameters, sensitivities, error maps, tolerances, pose errors."""
