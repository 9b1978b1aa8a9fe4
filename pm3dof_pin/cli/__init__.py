"""The command `pm3dof`. Modules here import nothing heavy at the top: `pm3dof --help` has to be instant."""
