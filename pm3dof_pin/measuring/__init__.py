"""Measurements of a machine: instruments, measurements, their files, and registration of the base."""
