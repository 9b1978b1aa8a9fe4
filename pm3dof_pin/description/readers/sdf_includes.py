"""SDF: models that a file includes from folders next to it, put in their places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from pm3dof_pin.description.own_files import require_own
from pm3dof_pin.description.readers.elements import named
from pm3dof_pin.description.xml_file import Element, child, children, read_xml

_CONFIG = "model.config"  # marks the folder of a model, and names its file
_MAX_DEPTH = 20
_HONOURED = ("uri", "name", "pose", "static")


def included_model(include: Element, folders: Iterable[Path], depth: int = 0) -> Element | str:
    """Return the model that an `<include>` stands for, with its name and pose; or why it cannot be read.

    `model://x` is a folder x with a model.config, in or next to the folder of the file or in one of `folders`; other
    names are of files, which must be in one of `folders` or in such a model.

    Raises:
        DescriptionError: the file found is no SDF with one model, or is none of the robot's own.
    """
    folders = tuple(folders)
    name = (getattr(child(include, "uri"), "text", None) or "").strip()
    for part in children(include):
        if part.tag not in _HONOURED:
            return f"is not supported with <{part.tag}>"
    if depth > _MAX_DEPTH:
        return f"is nested more than {_MAX_DEPTH} deep"
    candidates = _candidates(name, Path(include.path).absolute().parent, folders)
    found = next(((path, own) for path, own in candidates if path.is_file()), None)
    if found is None:
        return f"expected a model in or next to the file's folder, or in one of --package-path, not '{name}'"
    path, own = found
    require_own(path, (*folders, *own), include.origin, named(include))
    models = children(read_xml(path), "model")
    if len(models) != 1:
        raise include.origin.error(named(include), f"{path} has {len(models)} models, expected one")
    return _placed(models[0], include)


def _is_model(folder: Path) -> bool:
    return (folder / _CONFIG).is_file()


def _candidates(name: str, folder: Path, folders: tuple[Path, ...]) -> Iterator[tuple[Path, tuple[Path, ...]]]:
    """Yield the paths that an include may mean, each with the folders that it may be in besides the robot's own."""
    if not name.startswith("model://"):
        if "://" not in name.removeprefix("file://"):
            yield from ((start / name.removeprefix("file://"), ()) for start in (folder, *folders) if name)
        return
    model, _, inside = name.removeprefix("model://").partition("/")
    if model in ("", ".", ".."):
        return
    for above in (folder, folder.parent, *folders):
        if not _is_model(above / model):
            continue
        own = (above / model,)
        if inside:
            yield above / model / inside, own
            continue
        entries = children(read_xml(above / model / _CONFIG), "sdf")
        for entry in sorted(entries, key=_version, reverse=True):
            yield above / model / (entry.text or "").strip(), own


def _version(entry: Element) -> tuple[int, ...]:
    return tuple(int(word) for word in entry.get("version", "0").split(".") if word.isdigit())


def _placed(model: Element, include: Element) -> Element:
    """Return a model with the name, pose and mobility that its include gives it."""
    name = child(include, "name")
    given = {part.tag: part for part in children(include, "pose", "static")}
    placed = Element("model", dict(model.attrib))
    placed.path, placed.line = model.path, model.line
    if name is not None and (name.text or "").strip():
        placed.set("name", (name.text or "").strip())
    placed.extend(part for part in children(model) if part.tag not in given)
    placed.extend(given.values())
    return placed


def is_merged(include: Element) -> bool:
    """Return whether the parts of the included model become those of the model that includes it."""
    return include.get("merge") in ("true", "1")


def merged_parts(model: Element) -> list[Element] | str:
    """Return the parts of a model for another one, placed in a frame that stands for its own; or why they cannot be.

    The frame has the name that SDF reserves for it, `_merged__NAME__model__`. The elements of the model are changed.
    """
    frame = Element("frame", {"name": f"_merged__{model.get('name', '')}__model__"})
    frame.path, frame.line = model.path, model.line
    frame.extend(children(model, "pose"))
    parts = [frame]
    for part in children(model, "link", "joint", "frame", "model", "include", "plugin"):
        if part.tag == "include":
            return "is not supported with merge: its model includes others"
        if part.tag == "frame" and not part.get("attached_to"):
            part.set("attached_to", frame.attrib["name"])
        if part.tag in ("link", "model"):
            _require_pose(part, frame.attrib["name"])
        for inner in [part, child(part, "pose")] if part.tag == "model" else part.iter():
            for key in ("relative_to", "attached_to", "expressed_in"):
                if inner is not None and inner.get(key) == "__model__":
                    inner.set(key, frame.attrib["name"])
        parts.append(part)
    return parts


def _require_pose(part: Element, frame: str) -> None:
    """Give a part a pose that names the frame it is relative to."""
    pose = child(part, "pose")
    if pose is None:
        pose = Element("pose")
        pose.path, pose.line, pose.text = part.path, part.line, "0 0 0 0 0 0"
        part.append(pose)
    if not pose.get("relative_to"):
        pose.set("relative_to", frame)
