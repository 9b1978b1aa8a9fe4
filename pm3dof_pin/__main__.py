"""`python -m pm3dof_pin` is the command `pm3dof`."""

from pm3dof_pin.cli.app import main

if __name__ == "__main__":
    main()
