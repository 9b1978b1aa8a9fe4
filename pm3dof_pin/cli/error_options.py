"""Options of commands about the errors of a robot: its error file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.cli.options import RobotOptions
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.typing import Engine

_ErrorFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        exists=True,
        dir_okay=False,
        help="Error parameters (YAML) to use instead of the robot's own; `pm3dof error-parameters` writes such a file.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class RobotErrorsOptions(RobotOptions):
    """The robot, and its error file by `--errors`."""

    errors: _ErrorFile = None

    def load_errors(self, engine: Engine = "program") -> GeometricErrors:
        """Load the robot with the error parameters of `--errors`, or its own."""
        robot = self.load(engine)
        assert robot.files is not None
        return GeometricErrors.from_file(robot, robot.files.errors if self.errors is None else self.errors)
