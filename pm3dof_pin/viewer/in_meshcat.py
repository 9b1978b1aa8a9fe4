"""Robots drawn into an existing `meshcat.Visualizer`, as with Pinocchio's MeshcatVisualizer."""

from __future__ import annotations

from typing import Any

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import MOTIONS
from pm3dof_pin.viewer.ellipsoids import EllipsoidMatrix
from pm3dof_pin.viewer.mirror import mirror
from pm3dof_pin.viewer.viewer import Viewer


def draw_in_meshcat(
    visualizer: Any, configuration: Configuration, *, of: EllipsoidMatrix | None = "stiffness"
) -> Viewer:
    """Draw a robot, its pose and its ellipsoids at the tool (unless `of` is None) into a `meshcat.Visualizer`.

    A second call with another configuration replaces the first drawing. Drawing with the returned viewer also draws
    here, and is faster.

    Raises:
        InvalidValueError: the configuration's mechanism is not a robot.
        DescriptionError: as :class:`Viewer`.
    """
    robot = configuration.mechanism
    if not isinstance(robot, Robot):
        raise InvalidValueError("configuration", configuration, "a configuration of a Robot")
    viewer = Viewer(robot, sliders=False)
    viewer.display(configuration)
    drawn = []
    if of is not None and robot.springs and robot.tool_frame is not None:
        compliance = cartesian_compliance(ElasticModel(robot), configuration).compliance
        for kind in MOTIONS:
            try:
                viewer.stiffness_ellipsoid(compliance=compliance, kind=kind, of=of)
                drawn.append(kind)
            except SingularConfigurationError:
                continue
    for kind in MOTIONS:
        if kind not in drawn:  # from an earlier call
            visualizer["ellipsoids"][kind].delete()

    mirror(viewer.scene, visualizer)
    return viewer
