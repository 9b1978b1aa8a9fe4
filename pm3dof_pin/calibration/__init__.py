"""Errors and calibration, section 8.3: error models, error maps, tolerances, measurement planning."""
