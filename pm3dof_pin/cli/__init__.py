"""The command `pm3dof`. Modules here import nothing heavy at the top, so that `pm3dof --help` is instant."""
