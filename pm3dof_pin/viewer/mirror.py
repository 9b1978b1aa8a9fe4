"""A scene sent into an existing `meshcat.Visualizer`, command by command."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from pm3dof_pin.viewer.scene import TYPED_ARRAYS, Message, Scene

_OWN = ("/robot", "/ellipsoids", "/forces", "/workspace")  # background, floor and light belong to the user


def mirror(scene: Scene, visualizer: Any) -> None:
    """Send a robot, its ellipsoids and forces, and all later changes, below the path of a `meshcat.Visualizer`."""

    def on_message(message: Message) -> None:
        for command in message.get("commands", []):
            if str(command.get("path", "")).startswith(_OWN):
                visualizer.window.send(_Command(command, visualizer.path.lower()))

    on_message(scene.listen(on_message))


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
