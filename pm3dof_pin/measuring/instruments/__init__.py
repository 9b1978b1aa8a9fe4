"""One file an instrument; the table of them is :mod:`pm3dof_pin.measuring.instruments.table`."""
