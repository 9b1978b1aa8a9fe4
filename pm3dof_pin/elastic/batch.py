"""Cartesian compliance and stiffness at many poses, by compiled program, or pose by pose where that is in doubt."""

from __future__ import annotations

from typing import Unpack

from numpy.typing import ArrayLike

from pm3dof_pin.arrays import require_kind
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import COMPLIANCE, STIFFNESS, ElasticQuantity
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.traced import elastic_program
from pm3dof_pin.kinematics.pose_values import BatchOptions, PoseValues, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, Engine, Mask, Matrix, OnFailure


def compliance(
    model: ElasticModel | Robot,
    poses: Poses | Configuration | ArrayLike,
    *,
    frame: str | None = None,
    on_failure: OnFailure = "raise",
    engine: Engine | None = None,
    threads: int | None = None,
) -> Array:
    """Compute the Cartesian compliance of a frame at many poses.

    Example:
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("pm3dof")
        >>> C = pm.compliance(robot, robot.solve(robot.grid(theta_x=(-0.2, 0.2, 5), z_e=0.5)))
        >>> C.shape
        (5, 6, 6)
        >>> print(f"{1 / C[2, 2, 2]:.4e} N/m felt by a vertical force on the level platform")
        2.6181e+08 N/m felt by a vertical force on the level platform

    Args:
        model: the robot, with the springs of its description; or an elastic model.
        poses: solved poses, a configuration, or many as q with closed loops, shape=(..., nq) [m, rad].
        frame: the frame; the tool by default.
        on_failure: "raise", or "nan" for unsolved poses, those with a nonpositive spring length, and those at which the
            frame is free. Their number is logged.
        engine: instead of the robot's, see :meth:`Robot.with_engine <pm3dof_pin.kinematics.robot.Robot.with_engine>`;
            "pinocchio" uses Pinocchio's Jacobians and singular value decompositions at every pose.
        threads: instead of the robot's.

    Returns:
        C, twist = C wrench at the frame's origin, world axes, shape=(..., 6, 6) [m/N, 1/N, rad/(N m)].

    Raises:
        FreeDirectionError: the frame has free directions at a pose, and `on_failure` is "raise".
        InvalidValueError: a pose is unsolved, or the length of a spring is not positive, and `on_failure` is "raise";
            or `poses` has the wrong shape.
        FrameNotFoundError: the model has no such frame.
        DescriptionError: no frame is given, and the mechanism has no tool frame; or the robot has no springs.
    """
    return evaluate(model, poses, COMPLIANCE, frame=frame, on_failure=on_failure, engine=engine, threads=threads).values


def stiffness(
    model: ElasticModel | Robot,
    poses: Poses | Configuration | ArrayLike,
    *,
    frame: str | None = None,
    **options: Unpack[BatchOptions],
) -> Array:
    """Compute the Cartesian stiffness of a frame at many poses; arguments and errors as in :func:`compliance`.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("hexapod")
        >>> poses = robot.solve(robot.grid(x=(-0.005, 0.005, 3)))
        >>> np.allclose(pm.stiffness(robot, poses) @ pm.compliance(robot, poses), np.eye(6), atol=1e-9)
        True

    Returns:
        K, wrench = K twist at the frame's origin, world axes, shape=(..., 6, 6) [N/m, N, N m/rad]; NaN if the frame is
        rigid in some direction.
    """
    return evaluate(model, poses, STIFFNESS, frame=frame, **options).values


def evaluate(
    model: ElasticModel | Robot,
    poses: Poses | Configuration | ArrayLike,
    quantity: ElasticQuantity,
    *,
    frame: str | None = None,
    **options: Unpack[BatchOptions],
) -> PoseValues:
    """Compute an elastic quantity of a frame; other arguments and errors as in :func:`compliance`."""
    elastic = model if isinstance(model, ElasticModel) else elastic_model(model)
    name = elastic.mechanism.frame_name(frame)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        closed = isinstance(poses, Poses)
        return elastic_program(elastic, name, quantity.name, quantity.traced, closed=closed).with_doubt(q, threads)

    return evaluate_at(
        elastic.rigid,
        poses,
        quantity.name,
        quantity.shape,
        program=program,
        reference=lambda q: quantity.computed(cartesian_compliance(elastic, q, frame=name)),
        **options,
    )


def elastic_model(robot: Robot) -> ElasticModel:
    """Return the elastic model of a robot with the springs of its description; cached with the robot.

    Raises:
        DescriptionError: the robot has no springs; or as for :class:`ElasticModel`.
    """
    require_kind("robot", robot, Robot, "pm.load")
    if "_elastic_model" not in vars(robot):
        vars(robot)["_elastic_model"] = ElasticModel(robot)
    model: ElasticModel = vars(robot)["_elastic_model"]
    return model
