"""Robots drawn into an existing `meshcat.Visualizer`, as with Pinocchio's MeshcatVisualizer."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import MOTIONS
from pm3dof_pin.viewer.ellipsoids import EllipsoidMatrix
from pm3dof_pin.viewer.scene import TYPED_ARRAYS, Message
from pm3dof_pin.viewer.viewer import Viewer

_OWN = ("/robot", "/ellipsoids", "/forces")  # background, floor and light belong to the user


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

    def on_message(message: Message) -> None:
        for command in message.get("commands", []):
            if str(command.get("path", "")).startswith(_OWN):
                visualizer.window.send(_Command(command, visualizer.path.lower()))

    on_message(viewer.scene.listen(on_message))
    return viewer


class _Command:
    """A command of a scene, in the form meshcat's package sends."""

    def __init__(self, command: Message, root: str) -> None:
        self._command = command
        self._root = root.rstrip("/")

    def lower(self) -> Message:
        """Return the data to be packed and sent."""
        scene_object: Message = _packed(self._command)
        return {**scene_object, "path": self._root + self._command["path"]}


def _packed(value: Any) -> Any:
    """Convert arrays in base64 into those of msgpack."""
    import umsgpack

    if isinstance(value, dict):
        if "base64" in value:
            kind, data = value["typed_array"], base64.b64decode(value["base64"])
            if kind == "Uint16Array":  # not supported by meshcat's messages
                kind, data = "Uint32Array", np.frombuffer(data, dtype=np.uint16).astype(np.uint32).tobytes()
            codes = {name: code for code, name in TYPED_ARRAYS.items()}
            return umsgpack.Ext(codes[kind], data)
        return {key: _packed(entry) for key, entry in value.items()}
    return [_packed(entry) for entry in value] if isinstance(value, list) else value
