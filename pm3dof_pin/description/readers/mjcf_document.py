"""The document of an MJCF model, as MuJoCo sees it before it compiles: includes, attached models, copies, defaults."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pm3dof_pin.description.own_files import package_of, require_own
from pm3dof_pin.description.readers.elements import named
from pm3dof_pin.description.xml_file import Element, children, read_xml

_MAX_NESTED = 20  # includes and attached models within each other
_MAX_COPIES = 1000  # of a <replicate>
_MAX_ELEMENTS = 50_000
_ACTUATORS = (
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "adhesion", "plugin"),
    "dcmotor",
)
_NAMES = frozenset({
    "name", "class", "childclass", "joint", "joint1", "joint2", "jointinparent", "body", "body1", "body2", "geom",
    "geom1", "geom2", "site", "site1", "site2", "sidesite", "cranksite", "slidersite", "refsite", "tendon", "tendon1",
    "tendon2", "mesh", "material", "texture", "hfield", "target", "actuator", "objname", "refname", "flex",
})  # fmt: skip
TIMES = "(times)"
"""How many times the pose of a frame is applied, an attribute of those that hold copies."""

_FOLDER = "(folder)"  # among the settings of a model, the folder of its file
_MERGED = ("default", "asset", "equality", "actuator", "tendon", "contact")  # sections of an attached model


class MjcfDocument:
    """The root of a model, with includes, attached models and copies put in place.

    Args:
        path: the file.
        folders: folders that other files may be read from; by default those of the file's package.
        within: files that attach this one.
        root: its root element if it is known already.
        budget: number of elements that may still be read or copied, shared with attached models.

    Raises:
        DescriptionError: a file is unreadable, not XML or not MJCF, includes itself, or lies outside the folders.
    """

    def __init__(
        self,
        path: Path,
        folders: tuple[Path, ...] = (),
        within: tuple[Path, ...] = (),
        root: Element | None = None,
        budget: list[int] | None = None,
    ) -> None:
        self.path = path
        self.folders = folders or (package_of(path),)
        self._within = (*within, path.resolve())
        self.root = read_xml(path) if root is None else root
        self._budget = [_MAX_ELEMENTS] if budget is None else budget
        self._spend(self.root)
        self._include(self.root, ())
        self.compiler: dict[str, str] = {_FOLDER: str(path.resolve().parent)}
        for element in children(self.root, "compiler"):
            self.compiler |= element.attrib
        self._compilers: dict[int, Mapping[str, str]] = {}
        self._kept: list[Element] = []  # elements whose identity is used, so that it stays theirs
        self.defaults = _Defaults(self.root)
        self._attach()
        self._replicate(self.root)

    def compiler_of(self, element: Element) -> Mapping[str, str]:
        """Return the settings of the model that an element was attached from."""
        return self._compilers.get(id(element), self.compiler)

    def sections(self, tag: str) -> list[Element]:
        """Return the children of all sections with a tag."""
        return [entry for section in children(self.root, tag) for entry in children(section)]

    def asset_path(self, element: Element, kind: str) -> Path:
        """Return the file of an asset, by its name relative to the folder of its kind ("meshdir")."""
        compiler = self.compiler_of(element)
        name = element.get("file", "")
        if compiler.get("strippath") == "true":
            name = name.replace("\\", "/").rpartition("/")[2]
        folder = compiler.get(kind, compiler.get("assetdir", ""))
        return Path(compiler[_FOLDER], folder, name)

    def _include(self, root: Element, within: tuple[Path, ...]) -> None:
        """Replace <include> by the file's content; like MuJoCo, look next to the main file, then the including one."""
        for parent in list(root.iter()):
            for index, entry in reversed(list(enumerate(parent))):
                if entry.tag != "include" or not isinstance(entry, Element):
                    continue
                place = f"<include file='{entry.get('file')}'>"
                candidates = [(file.parent / entry.get("file", "")).resolve() for file in (self.path, *within[-1:])]
                included = next((candidate for candidate in candidates if candidate.is_file()), candidates[0])
                if included in within or len(within) > _MAX_NESTED:
                    raise entry.origin.error(place, "includes itself")
                require_own(included, self.folders, entry.origin, place)
                content = read_xml(included)
                self._spend(content)
                self._include(content, (*within, included))
                parent[index : index + 1] = list(content)

    def _spend(self, element: Element) -> None:
        """Count the parts of an element, which includes, copies and attached models could multiply without end."""
        self._budget[0] -= sum(1 for _ in element.iter())
        if self._budget[0] < 0:
            raise element.origin.error("<mujoco>", f"expected at most {_MAX_ELEMENTS} elements, copies included")

    # Copies

    def _replicate(self, root: Element) -> None:
        for parent in list(root.iter()):
            for index, entry in reversed(list(enumerate(parent))):
                if entry.tag == "replicate" and isinstance(entry, Element):
                    self._replicate(entry)
                    parent[index : index + 1] = self._copies(entry)

    def _copies(self, element: Element) -> list[Element]:
        """Return a frame for each copy of what an element contains, each placed in the one before."""
        count = int(element.get("count", "1")) if element.get("count", "1").isdecimal() else 0
        if not 1 <= count <= _MAX_COPIES:
            raise element.origin.error("<replicate>", f"expected a count from 1 to {_MAX_COPIES}")
        pose = {"pos": element.get("offset", "0 0 0"), "euler": element.get("euler", "0 0 0")}
        frames: list[Element] = []
        for number in range(count):
            self._spend(element)
            suffix = f"{element.get('sep', '')}{number:0{len(str(count - 1))}d}"
            frames.append(_new("frame", {**pose, TIMES: str(number)}, element))
            self._keep(frames[-1], self.compiler_of(element))
            frames[-1].extend([self._copied(part, suffix) for part in children(element)])
        return frames

    def _copied(self, element: Element, suffix: str) -> Element:
        """Return a copy with a suffix to all names."""
        copied = _new(element.tag, element.attrib, element)
        if "name" in element.attrib:
            copied.set("name", element.attrib["name"] + suffix)
        self._keep(copied, self.compiler_of(element))
        copied.extend([self._copied(part, suffix) for part in children(element)])
        return copied

    def _keep(self, element: Element, compiler: Mapping[str, str]) -> None:
        """Remember the settings of an element, which must therefore keep its identity."""
        self._compilers[id(element)] = compiler
        self._kept.append(element)

    # Attached models

    def _attach(self) -> None:
        models: dict[str, Element] = {}
        for model in (entry for entry in self.sections("asset") if entry.tag == "model"):
            path = self.asset_path(model, "")
            require_own(path, self.folders, model.origin, named(model))
            models[model.get("name") or read_xml(path).get("model") or path.stem] = model
        for parent in list(self.root.iter()):
            for index, entry in reversed(list(enumerate(parent))):
                if entry.tag == "attach" and isinstance(entry, Element):
                    parent[index : index + 1] = self._attached(entry, models)

    def _attached(self, element: Element, models: Mapping[str, Element]) -> list[Element]:
        """Return the bodies of another model, with a prefix before all their names, and merge its other sections."""
        place = f"<attach model='{element.get('model', '')}'>"
        if (model := models.get(element.get("model", ""))) is None:
            raise element.origin.error(place, f"expected one of the models {', '.join(models) or '(none)'}")
        path = self.asset_path(model, "")
        if path in self._within or len(self._within) > _MAX_NESTED:
            raise element.origin.error(place, "attaches itself")
        require_own(path, self.folders, element.origin, place)
        other = MjcfDocument(path, self.folders, self._within, budget=self._budget)
        prefix = element.get("prefix", "")
        other.defaults.prefix(prefix)
        self.defaults.classes |= other.defaults.classes
        for part in other.root.iter():
            if isinstance(part, Element):
                for key in _NAMES & part.attrib.keys():
                    part.set(key, prefix + part.attrib[key])
                self._keep(part, other.compiler_of(part))
        for section in children(other.root, *_MERGED):
            self.root.append(section)
        if "body" in element.attrib:
            name = prefix + element.attrib["body"]
            found = [body for body in other.root.iter("body") if body.get("name") == name and isinstance(body, Element)]
            if not found:
                raise element.origin.error(place, f"expected an existing body, not '{element.attrib['body']}'")
            parts = found[:1]
        else:
            parts = [part for world in children(other.root, "worldbody") for part in children(world)]
        frame = _new("frame", {"childclass": prefix + other.defaults.main}, element)
        frame.extend(parts)
        return [frame]


class _Defaults:
    """Default attributes by class and element."""

    def __init__(self, root: Element) -> None:
        self.main = "main"
        #: by class, then by kind of element, the default attributes
        self.classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for index, default in enumerate(children(root, "default")):
            if index == 0:
                self.main = default.get("class", "main")
                self.classes = {self.main: {}}
            self._read(default, self.main, {} if index == 0 else self.classes[self.main], top=True)

    def _read(
        self, default: Element, parent: str, inherited: Mapping[str, Mapping[str, str]], *, top: bool = False
    ) -> None:
        name = parent if top else default.get("class", "")
        if not name:
            raise default.origin.error("<default>", "has no class, expected one")
        entries = {kind: dict(values) for kind, values in inherited.items()}
        for element in children(default):
            if element.tag != "default":
                kind = _kind_of(element)
                entries[kind] = entries.get(kind, {}) | element.attrib
        self.classes[name] = entries
        for element in children(default, "default"):
            self._read(element, name, entries)

    def prefix(self, prefix: str) -> None:
        """Put a prefix before the names of all classes, and of what their attributes refer to."""
        self.classes = {
            prefix + name: {
                kind: {key: prefix + value if key in _NAMES else value for key, value in values.items()}
                for kind, values in entries.items()
            }
            for name, entries in self.classes.items()
        }

    def attributes(self, element: Element, default_class: str = "", kind: str = "") -> dict[str, str]:
        """Return an element's attributes, completed by those of its class, or of the class around it."""
        name = element.get("class") or default_class or self.main
        if name not in self.classes:
            raise element.origin.error(named(element), f"no default class '{name}' in <default>")
        if element.tag == "freejoint":
            return dict(element.attrib)
        return self.classes[name].get(kind or _kind_of(element), {}) | element.attrib


def _kind_of(element: Element) -> str:
    """Return the kind of element that shares its defaults: one for all actuators, and one for all equalities."""
    if element.tag in _ACTUATORS:
        return "actuator"
    return "equality" if element.tag in ("connect", "weld", "equality") else element.tag


def _new(tag: str, attributes: Mapping[str, str], like: Element) -> Element:
    element = Element(tag, dict(attributes))
    element.path, element.line = like.path, like.line
    return element
