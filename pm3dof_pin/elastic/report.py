"""The elastic behaviour of one frame at one configuration, by program if nothing is in doubt."""

from __future__ import annotations

from numpy.typing import ArrayLike

from pm3dof_pin.arrays import require_choice, require_kind
from pm3dof_pin.elastic.compiled import elastic_program
from pm3dof_pin.elastic.condensation import CartesianCompliance, condensed
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import COMPLIANCE_AND_STIFFNESS
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Engine, Matrix, Vector


def cartesian_compliance(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    *,
    frame: str | None = None,
    engine: Engine | None = None,
) -> CartesianCompliance:
    """Compute the elastic behaviour of an unloaded frame.

    Compliance and stiffness of the tool come from its compiled program, if nothing is in doubt; all else, and other
    frames, from Pinocchio's Jacobians and singular values.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> tool = pm.cartesian_compliance(model, model.rigid.home)
        >>> tool.exists, tool.stiffness.shape
        (True, (6, 6))

    Args:
        model: the elastic mechanism.
        configuration: an assembled configuration of the rigid mechanism, or its q, shape=(nq,) [m, rad]; or a
            configuration of the mechanism with virtual joints.
        frame: the frame; the tool by default.
        engine: instead of the robot's; "pinocchio" uses singular values always.

    Raises:
        FrameNotFoundError: the model has no such frame.
        DescriptionError: no frame is given, and the mechanism has no tool frame.
        InvalidValueError: the loops are not closed, or a length changed by a joint is not positive.
    """
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    engine = model.rigid.engine if engine is None else engine
    require_choice("engine", engine, Engine)
    tool = model.mechanism.tool_frame
    name = model.mechanism.frame_name(frame)
    given = configuration if isinstance(configuration, Configuration) else model.rigid.checked_positions(configuration)
    matrices = None
    if engine == "program" and name == tool:
        if not isinstance(given, Configuration):
            matrices = _from_program(model, given)
        elif given.mechanism is model.rigid:
            matrices = _from_program(model, given.q)
    if matrices is None:
        return condensed(model, given, frame=name)
    return CartesianCompliance(model, given, name, matrices)


def _from_program(model: ElasticModel, q: Vector) -> Matrix | None:
    """Return C and K of the tool, shape=(2, 6, 6); None if there is no program or a rank is in doubt."""
    tool = model.mechanism.tool_frame
    assert tool is not None
    try:
        values, sound = elastic_program(model, tool, COMPLIANCE_AND_STIFFNESS, closed=False).with_doubt(q[None], 1)
    except ProgramError:
        return None
    return values.reshape(2, 6, 6) if sound[0] else None
