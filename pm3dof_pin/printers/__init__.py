"""Delta printers: their firmware's files, as robots, and calibration from touches of the bed."""
