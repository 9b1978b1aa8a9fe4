"""Reading a YAML file into a mapping, with errors that name the file and the line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from pm3dof_pin.exceptions import DescriptionError

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml, ten times faster, where it is built in


def read_mapping(path: Path | str) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping.

    Args:
        path: file to read; only plain data is accepted, no Python objects.

    Raises:
        DescriptionError: the file is missing, is no YAML, or is no mapping.
    """
    path = Path(path)
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=_LOADER)
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(path, "file", f"expected a readable text file ({error})") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else "file"
        raise DescriptionError(path, line, f"expected YAML ({getattr(error, 'problem', error)})") from error
    if not isinstance(data, dict):
        raise DescriptionError(path, "file", "expected a mapping of keys to values at the top level")
    return data
