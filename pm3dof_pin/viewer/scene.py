"""The scene: a tree of objects, stored as commands of meshcat's page, and the panel next to it.

meshcat's page (three.js) understands commands such as "set the transform of /robot/platform". Its own Python package
sends them through two more servers, one of which listens on every network interface. Here the commands are stored in a
tree, from which a page can be written at any time, and passed on to listeners; the page of this package feeds them to
meshcat's page as JSON.
"""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Json = dict[str, Any]
Message = dict[str, Any]
Listener = Callable[[Message], None]

OBJECT = "<object>"  # meshcat's name of the object itself at a path, among its child paths

TYPED_ARRAYS = {0x12: "Uint8Array", 0x15: "Int32Array", 0x16: "Uint32Array", 0x17: "Float32Array"}
"""Names of array types by meshcat's msgpack codes."""


@dataclass
class _Node:
    object: Json | None = None
    transform: Json | None = None
    properties: dict[tuple[str, str], Json] = field(default_factory=dict)


class Scene:
    """A tree of objects with transforms and properties, an animation, and the panel data; thread-safe.

    Paths are slash-separated names, as in "/robot/platform".
    """

    def __init__(self) -> None:
        self._nodes: dict[str, _Node] = {}
        self._animation: Json | None = None
        self._listeners: list[Listener] = []
        self._lock = threading.RLock()
        self.panel: Json = {}

    def set_object(self, path: str, scene_object: Json, *, casts_shadow: bool = True) -> None:
        """Set an object of :mod:`pm3dof_pin.viewer.objects` at a path; translucent ones cast no shadow."""
        self._apply({"type": "set_object", "path": path, "object": scene_object})
        if not casts_shadow:
            self.set_property(path, "castShadow", False)
            self.set_property(path, "receiveShadow", False)

    def set_transform(self, path: str, matrix: ArrayLike) -> None:
        """Set the transform of everything at and below a path, shape=(4, 4)."""
        self._apply({"type": "set_transform", "path": path, "matrix": column_major(matrix)})

    def set_transforms(self, matrices: Mapping[str, ArrayLike]) -> None:
        """Set several transforms in one step, so that no picture shows only some of them."""
        commands = [
            {"type": "set_transform", "path": path, "matrix": column_major(matrix)} for path, matrix in matrices.items()
        ]
        self._apply(*commands)

    def set_property(self, path: str, name: str, value: object, *, of_object: bool = True) -> None:
        """Set a property of three.js, of the object at a path or (of_object=False) of the group at it."""
        target = f"{path}/{OBJECT}" if of_object else path
        self._apply({"type": "set_property", "path": target, "property": name, "value": value})

    def set_visible(self, path: str, visible: bool) -> None:
        """Show or hide everything at and below a path."""
        self.set_property(path, "visible", visible, of_object=False)

    def set_colour(self, path: str, colour: Iterable[float]) -> None:
        """Colour all objects at and below a path: red, green, blue, opacity in 0 .. 1."""
        self.set_property(path, "color", list(colour), of_object=False)

    def delete(self, path: str) -> None:
        """Remove everything at and below a path."""
        self._apply({"type": "delete", "path": path})

    def set_animation(self, animations: list[Json], *, repetitions: int) -> None:
        """Play an animation, of :mod:`pm3dof_pin.viewer.animation`."""
        options = {"play": True, "repetitions": repetitions}
        self._apply({"type": "set_animation", "animations": animations, "options": options})

    def stop_animation(self) -> None:
        """Stop the animation."""
        with self._lock:
            self._animation = None
            stop = {"type": "set_animation", "animations": [], "options": {"play": False}}
            self._publish({"commands": [stop]})

    def set_panel(self, panel: Json) -> None:
        """Replace the panel data."""
        with self._lock:
            self.panel = panel
            self._publish({"panel": panel})

    def send(self, command: Any) -> None:
        """Accept a command of meshcat's Python package, so that a `meshcat.Visualizer(window=scene)` draws here."""
        self._apply(_plain(command.lower()))

    def listen(self, listener: Listener) -> Message:
        """Pass later changes to a listener, in the thread that makes them; return a message with the current scene."""
        with self._lock:
            self._listeners.append(listener)
            return self.snapshot()

    def unsubscribe(self, listener: Listener) -> None:
        """Remove a listener; an unknown one is ignored."""
        with self._lock:
            self._listeners = [other for other in self._listeners if other != listener]

    def snapshot(self) -> Message:
        """Return a message that makes an empty page show the whole scene."""
        with self._lock:
            commands: list[Json] = []
            for node in self._nodes.values():
                commands += [node.object] if node.object else []
            for node in self._nodes.values():
                commands += [node.transform] if node.transform else []
                commands += node.properties.values()
            commands += [self._animation] if self._animation else []
            return {"commands": commands, "panel": self.panel}

    def paths(self) -> tuple[str, ...]:
        """Return the paths with an object."""
        with self._lock:
            return tuple(path for path, node in self._nodes.items() if node.object is not None)

    def _apply(self, *commands: Json) -> None:
        with self._lock:
            for command in commands:
                self._keep(command)
            self._publish({"commands": list(commands)})

    def _keep(self, command: Json) -> None:
        kind = command["type"]
        if kind == "set_animation":
            self._animation = command
        elif kind == "delete":
            path = _tidy(command["path"])
            for other in [other for other in self._nodes if other == path or other.startswith(f"{path}/")]:
                del self._nodes[other]
        else:
            self._keep_node(kind, command)

    def _keep_node(self, kind: str, command: Json) -> None:
        path = _tidy(command["path"])
        target = "group"
        if path.endswith(f"/{OBJECT}"):
            path, target = path.removesuffix(f"/{OBJECT}"), OBJECT
        node = self._nodes.setdefault(path, _Node())
        if kind == "set_object":
            node.object = command
        elif kind == "set_transform":
            node.transform = command
        elif kind == "set_property":
            # the latest comes last, since colours of a group and of part of it may both be set
            node.properties.pop((target, command["property"]), None)
            node.properties[target, command["property"]] = command

    def _publish(self, message: Message) -> None:
        for listener in self._listeners:
            listener(message)


def column_major(matrix: ArrayLike) -> list[float]:
    """Return the 16 numbers of a matrix, shape=(4, 4), in the order of three.js."""
    numbers: list[float] = np.asarray(matrix, dtype=float).T.ravel().tolist()
    return numbers


def _tidy(path: str) -> str:
    return "/" + "/".join(name for name in path.split("/") if name)


def _plain(value: Any) -> Any:
    """Convert commands of meshcat's Python package into JSON: arrays packed for msgpack become base64."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if type(value).__name__ == "Ext":
        return {"typed_array": TYPED_ARRAYS[value.type], "base64": base64.b64encode(value.data).decode()}
    return value.item() if isinstance(value, np.generic) else value
