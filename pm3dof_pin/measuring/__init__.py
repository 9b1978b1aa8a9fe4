"""What is seen of a machine: instruments, measurements, their files, and where the base stands in the instrument."""
