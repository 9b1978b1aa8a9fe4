"""`pm3dof compensate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.cli.options import THE_TRIPOD, Height, Json, ThetaX, ThetaY, load_tripod, pose_of
from pm3dof_pin.cli.output import message, print_result, stop_on_broken_limits, table_lines


def compensate(
    theta_x: ThetaX,
    theta_y: ThetaY,
    z_e: Height,
    calibration: Annotated[Path, typer.Option(metavar="DIR", help="Folder that `pm3dof calibrate` wrote.")],
    condition: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="A temperature or load, by the name of its column; may be repeated."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Commands that bring the calibrated machine to a pose: angles in degrees, height in metres.

    A pose that breaks a joint limit is still answered, with a message and exit status 1.
    """
    from pm3dof_pin.calibration.results import read_compensation
    from pm3dof_pin.chapter.kinematics import inverse_kinematics
    from pm3dof_pin.chapter.limits import limit_violations
    from pm3dof_pin.exceptions import InvalidValueError

    compensation = read_compensation(calibration)
    if compensation.errors.mechanism.name != THE_TRIPOD:
        raise InvalidValueError(
            "--calibration", calibration, f"one of {THE_TRIPOD}; for other robots there is Compensation in Python"
        )
    given = _conditions(condition or [])
    usual = {} if compensation.inputs is None else compensation.inputs.middle()
    for name in sorted(set(given) - set(usual)):
        raise InvalidValueError("--condition", name, f"one of {', '.join(usual) or 'none, it knows none'}")
    for name in sorted(set(usual) - set(given)):
        message(f"pm3dof: {name} is not given: {usual[name]:.4g}, the middle of those measured, is taken")
    if compensation.inputs is not None:
        for name, (least, most) in compensation.inputs.beyond(given).items():
            message(
                f"pm3dof: {name} = {given[name]:.4g} is outside what was measured, {least:.4g} .. {most:.4g}: "
                "the correction is a guess there"
            )
    tripod, pose = load_tripod(None), pose_of(theta_x, theta_y, z_e)
    inverse_kinematics(tripod, pose)  # raises where the pose is out of reach
    home = compensation.errors.mechanism.home.tool_placement.translation[2]
    answer = compensation.compensate_coordinates([[pose[0], pose[1], pose[2] - home]], usual | given)
    broken = limit_violations(tripod, pose)
    result = {
        "u_m": answer.commands[0],
        "u_nominal_m": answer.nominal_commands[0],
        "predicted_error_m": answer.predicted_error[0],
        "deviation_m": answer.deviations[0],
        "conditions": usual | given,
    }
    rows = [
        [f"u{k}", f"{u:.9f}", f"{nominal:.9f}", f"{1e6 * (u - nominal):.2f}"]
        for k, (u, nominal) in enumerate(zip(answer.commands[0], answer.nominal_commands[0], strict=True), start=1)
    ]
    lines = table_lines(["drive", "command [m]", "nominal [m]", "difference [µm]"], rows)
    lines.append(f"tip error to be expected: {1e6 * answer.predicted_error[0]:.1f} µm")
    print_result(result, lines, as_json=as_json)
    stop_on_broken_limits(broken)


def _conditions(words: list[str]) -> dict[str, float]:
    conditions = {}
    for word in words:
        name, sign, value = word.partition("=")
        try:
            conditions[name.strip()] = float(value) if sign else float("nan")
        except ValueError as error:
            raise typer.BadParameter(f"--condition {word}: expected NAME=VALUE with a number") from error
        if not sign:
            raise typer.BadParameter(f"--condition {word}: expected NAME=VALUE with a number")
    return conditions
