"""Read a YAML file into a mapping, with errors that name the file and the line; and write data as YAML."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, JointNotFoundError
from pm3dof_pin.files import read_text

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml, ten times faster, if available
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_MAX_DEPTH = 50
_MAX_ENTRIES = 1_000_000


def read_mapping(path: Path | str) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping of plain data.

    Raises:
        DescriptionError: the file is missing, too large, too deeply nested, not YAML or not a mapping, or has a
            key twice.
    """
    path = Path(path)
    try:
        text = read_text(path)
        _check_structure(path, text)
        data = yaml.load(text, Loader=_LOADER)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else "file"
        raise DescriptionError(path, line, f"expected YAML ({getattr(error, 'problem', error)})") from error
    except (ValueError, OverflowError) as error:  # an impossible date, a number of a million digits
        raise DescriptionError(path, "file", f"expected YAML ({error})") from error
    if not isinstance(data, dict):
        raise DescriptionError(path, "file", "expected a mapping of keys to values at the top level")
    if _size(data, {}) > _MAX_ENTRIES:
        raise DescriptionError(path, "file", f"expected at most {_MAX_ENTRIES} entries, aliases expanded")
    return data


def yaml_text(data: object) -> str:
    """Return plain data as YAML, in the order of its keys."""
    return str(yaml.dump(data, Dumper=_DUMPER, sort_keys=False, width=120, allow_unicode=True))


@contextmanager
def naming_lines() -> Iterator[None]:
    """Add the line to errors that name an entry of a YAML file and no line."""
    try:
        yield
    except DescriptionError as error:
        line = None if error.line else _line_of(error.path, error.element)
        if line is None:
            raise
        raise DescriptionError(error.path, error.element, error.expected, line) from error
    except (FrameNotFoundError, JointNotFoundError) as error:
        path, _, element = error.source.partition(": ")
        line = _line_of(Path(path), element) if Path(path).suffix in (".yaml", ".yml") else None
        if line is None:
            raise
        raise type(error)(error.name, f"{path}, line {line}: {element}", error.known) from error


def _line_of(path: Path, element: str) -> int | None:
    """Return the line of an entry such as `springs[2].matrix`, or of the one around it; None if it is not found."""
    try:
        node = yaml.compose(read_text(path), Loader=_LOADER)
    except (DescriptionError, yaml.YAMLError):
        return None
    line = None
    for word in re.findall(r"[^.\[\]]+", element):
        if isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if getattr(key, "value", None) == word]
            if not found:
                break
            line, node = found[-1][0].start_mark.line + 1, found[-1][1]
        elif isinstance(node, yaml.SequenceNode) and word.isdigit() and int(word) < len(node.value):
            node = node.value[int(word)]
            line = node.start_mark.line + 1
        else:
            break
    return line


def _check_structure(path: Path, text: str) -> None:
    """Refuse lists and mappings that are nested deeply, since the loader is recursive, and keys that stand twice.

    Of such a key the loader would take the last value.
    """
    keys: list[set[str] | None] = []  # of the mappings and lists around an event, which have none
    at_value: list[bool] = []
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.NodeEvent) and keys and (known := keys[-1]) is not None:
            if not at_value[-1] and isinstance(event, yaml.ScalarEvent):
                if event.value in known:
                    problem = f"has '{event.value}' twice in one mapping, expected it once"
                    raise DescriptionError(path, _place_of(event), problem)
                known.add(event.value)
            at_value[-1] = not at_value[-1]
        if isinstance(event, yaml.CollectionStartEvent):
            keys.append(set() if isinstance(event, yaml.MappingStartEvent) else None)
            at_value.append(False)
            if len(keys) > _MAX_DEPTH:
                problem = f"expected lists and mappings at most {_MAX_DEPTH} deep"
                raise DescriptionError(path, _place_of(event), problem)
        elif isinstance(event, yaml.CollectionEndEvent):
            keys.pop()
            at_value.pop()


def _place_of(event: yaml.Event) -> str:
    return f"line {event.start_mark.line + 1}" if event.start_mark else "file"


def _size(data: Any, known: dict[int, float]) -> float:
    """Count the entries with all aliases expanded; data that contains itself has infinitely many."""
    if not isinstance(data, (dict, list)):
        return 1.0
    if id(data) not in known:
        known[id(data)] = math.inf
        known[id(data)] = 1.0 + sum(
            _size(entry, known) for entry in (data.values() if isinstance(data, dict) else data)
        )
    return known[id(data)]


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping updated with the values of another, recursively."""
    result = dict(base)
    for key, value in changes.items():
        own = result.get(key)
        result[key] = merged(own, value) if isinstance(own, dict) and isinstance(value, dict) else value
    return result
