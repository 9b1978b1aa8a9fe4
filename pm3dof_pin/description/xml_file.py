"""Read an XML file into its elements, with limits on its size and nesting."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from pm3dof_pin.description.origin import Origin
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import read_bytes

MAX_DEPTH = 200
"""Maximum nesting of elements: later stages, in C++ and here, are recursive."""

_BEGINNING = 2048  # bytes that hold most root elements


class Element(ElementTree.Element):
    """An element that knows its file and line."""

    path: Path | str = ""
    line: int | None = None

    @property
    def origin(self) -> Origin:
        """Where the element stands."""
        return Origin(self.path, self.line)


def children(element: Element, *tags: str) -> list[Element]:
    """Return the children of an element, or those with certain tags, in the order of the file."""
    return [child for child in element if isinstance(child, Element) and (not tags or child.tag in tags)]


def child(element: Element | None, tag: str) -> Element | None:
    """Return the child with a tag, or None; DescriptionError if there are several: none says which one counts."""
    found = [] if element is None else children(element, tag)
    if len(found) > 1:
        raise found[1].origin.error(f"<{tag}>", f"stands {len(found)} times in one element, expected it once")
    return found[0] if found else None


def read_xml(path: Path | str) -> Element:
    """Read the root element of an XML file, without comments; entities, which can expand without limit, are refused.

    Names keep their prefixes, such as `drake:joint`, whether these are declared or not.

    Raises:
        DescriptionError: the file is unreadable, too large, too deeply nested, declares entities or is not XML; the
            message names the line.
    """
    return parse_xml(read_bytes(path), path)


def parse_xml(content: bytes, source: Path | str) -> Element:
    """Read the root element of a document in memory, as :func:`read_xml`; `source` names it in messages."""
    reader = _Reader(source)
    reader.read(content)
    root = reader.builder.close()
    assert isinstance(root, Element)
    return root


def read_root_tag(path: Path | str) -> str:
    """Read the name of the root element, and no more of the file than needed; raises as :func:`read_xml`."""
    reader = _Reader(path)
    reader.read(until_root=True)
    return reader.root_tag


def comment_text(text: str) -> str:
    """Return text that does not end the comment it is put in."""
    return " ".join(text.replace("--", "- -").replace("--", "- -").split())


class _Reader:
    def __init__(self, path: Path | str) -> None:
        self._path = path
        self._depth = 0
        self.root_tag = ""
        self.builder = ElementTree.TreeBuilder(element_factory=Element)
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self.builder.data
        self.parser.EntityDeclHandler = self._refuse_entity

    def read(self, content: bytes | None = None, *, until_root: bool = False) -> None:
        try:
            content = read_bytes(self._path) if content is None else content
            size = _BEGINNING if until_root else len(content) + 1
            for start in range(0, len(content) + 1, size):
                self.parser.Parse(content[start : start + size], start + size > len(content))
                if until_root and self.root_tag:
                    return
        except expat.ExpatError as error:
            place = f"line {error.lineno}, column {error.offset}"
            raise DescriptionError(self._path, place, f"expected XML ({expat.ErrorString(error.code)})") from error
        except (ValueError, LookupError) as error:  # unknown encoding
            raise DescriptionError(self._path, "file", f"expected XML in a known encoding ({error})") from error

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.root_tag = self.root_tag or tag
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise DescriptionError(self._path, self._place(), f"expected elements at most {MAX_DEPTH} deep")
        element = self.builder.start(tag, attributes)
        assert isinstance(element, Element)
        element.path, element.line = self._path, self.parser.CurrentLineNumber

    def _end(self, tag: str) -> None:
        self._depth -= 1
        self.builder.end(tag)

    def _refuse_entity(self, name: str, *_: object) -> None:
        raise DescriptionError(self._path, self._place(), f"declares the entity '{name}': expected none")

    def _place(self) -> str:
        return f"line {self.parser.CurrentLineNumber}"
