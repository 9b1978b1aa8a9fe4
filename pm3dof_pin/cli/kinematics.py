"""`pm3dof ik` and `pm3dof fk`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.options import Config, Height, Json, ThetaX, ThetaY, finite_number, load_tripod, pose_of
from pm3dof_pin.cli.output import LIMIT_BROKEN, fixed, message, print_result, stop_on_broken_limits, table_lines

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Travels = Annotated[
    list[float], typer.Argument(metavar="U1 U2 U3", parser=finite_number, help="Slider travels of the legs [m].")
]


def ik(theta_x: ThetaX, theta_y: ThetaY, z_e: Height, as_json: Json = False, config: Config = None) -> None:
    """Slider travels for a pose of the platform (inverse kinematics): angles in degrees, lengths in metres.

    Legs in their order in the description (the chapter's: at -30, 90, -150 degrees). A pose that breaks a joint limit
    is still answered, with a message and exit status 1.
    """
    from pm3dof_pin.chapter.kinematics import inverse_kinematics, passive_joint_angles
    from pm3dof_pin.chapter.limits import limit_violations

    tripod = load_tripod(config)
    pose = pose_of(theta_x, theta_y, z_e)
    u = inverse_kinematics(tripod, pose)
    angles = passive_joint_angles(tripod, pose)
    violations = limit_violations(tripod, pose)
    result = {
        "u_m": u,
        "within_limits": not violations,
        "violated": [violation.joint for violation in violations],
        "universal_first_rad": angles[:, 0],
        "universal_second_rad": angles[:, 1],
        "spherical_swing_rad": angles[:, 2],
    }
    rows = [
        [str(leg + 1), fixed(u[leg], 9), *(fixed(math.degrees(angle), 3) for angle in angles[leg])]
        for leg in range(tripod.leg_count)
    ]
    header = ["leg", "u [m]", "universal 1 [deg]", "universal 2 [deg]", "spherical [deg]"]
    print_result(result, table_lines(header, rows), as_json=as_json)
    stop_on_broken_limits(violations)


def fk(
    u: Travels,
    as_json: Json = False,
    all_modes: Annotated[bool, typer.Option("--all", help="Every assembly mode, not only the machine's own.")] = False,
    config: Config = None,
) -> None:
    """Pose of the platform for slider travels in metres (direct kinematics).

    Without --all, the pose that is reached from home. A pose that breaks a joint limit is still answered, with a
    message and exit status 1; so are other assembly modes with --all, where none is reached from home.
    """
    import numpy as np

    from pm3dof_pin.chapter.direct_kinematics import all_assembly_modes, direct_kinematics, newton
    from pm3dof_pin.chapter.kinematics import assembly_mode_of
    from pm3dof_pin.chapter.limits import limit_violations
    from pm3dof_pin.exceptions import ConvergenceError, UnreachablePoseError

    tripod = load_tripod(config)
    if len(u) != tripod.leg_count or not np.all(np.isfinite(u)):
        raise typer.BadParameter(f"expected {tripod.leg_count} finite slider travels in metres, got {u}")
    modes = list(all_assembly_modes(tripod, u)) if all_modes else []
    if all_modes and not modes:
        travels = ", ".join(f"{travel:g}" for travel in u)
        raise UnreachablePoseError(f"no pose closes the loops at u = ({travels}) m: there is no assembly mode")
    try:
        pose = direct_kinematics(tripod, u)
    except ConvergenceError:
        if not all_modes:
            raise
        pose = np.full(3, np.nan)
    reached = bool(np.all(np.isfinite(pose)))
    violations = limit_violations(tripod, pose, assembly_mode=assembly_mode_of(tripod, pose, u)) if reached else []
    result = _pose_result(pose, float(newton(tripod, u, pose).residual))
    result |= {
        "within_limits": reached and not violations,
        "violated": [violation.joint for violation in violations],
    }
    poses = modes if all_modes else [pose]
    if all_modes:
        residuals = newton(tripod, u, np.array(poses)).residual
        result["assembly_modes"] = [
            _pose_result(mode, float(left)) for mode, left in zip(poses, residuals, strict=True)
        ]
    rows = [[fixed(math.degrees(x), 9), fixed(math.degrees(y), 9), fixed(z, 12)] for x, y, z in poses]
    print_result(result, table_lines(["theta_x [deg]", "theta_y [deg]", "z_e [m]"], rows), as_json=as_json)
    if not reached:
        message("pm3dof: the machine's own assembly mode does not exist at these travels, or is not reached from home")
        raise typer.Exit(LIMIT_BROKEN)
    stop_on_broken_limits(violations)


def _pose_result(pose: NDArray[np.float64], residual: float) -> dict[str, Any]:
    theta_x, theta_y, z_e = pose
    return {"theta_x_rad": theta_x, "theta_y_rad": theta_y, "z_e_m": z_e, "residual_m": residual}
