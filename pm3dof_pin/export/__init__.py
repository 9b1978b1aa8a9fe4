"""The machine's files for other programs: generated, never written by hand."""
