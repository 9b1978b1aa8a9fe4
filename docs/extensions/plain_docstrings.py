"""Docstrings are plain text for readers of the source; this converts them to reStructuredText.

An indented paragraph below a blank line is a formula or an example and keeps its lines. Elsewhere `*` and `|` are
themselves: products, powers, absolute values. A colon in the first line of "Returns:" or of a property is punctuation,
where napoleon would look for a type in front of it.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

_CODE = re.compile(r"(``.*?``|`[^`]*`)")
_ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
_BEFORE_NAPOLEON = 400


def _to_restructured_text(_: Sphinx, what: str, __: str, ___: object, ____: Any, lines: list[str]) -> None:
    written, outer, inside = lines[:], 0, False
    firsts = [index + 1 for index, line in enumerate(written) if line.strip() == "Returns:"]
    for index in firsts + [0] * (what in ("property", "attribute", "data")):
        written[index] = written[index].replace(": ", " – ")
    lines.clear()
    for index, line in enumerate(written):
        indent = len(line) - len(line.lstrip())
        if line:
            begins = not inside and index > 0 and not written[index - 1] and indent > outer
            if begins:
                lines.extend([" " * outer + "::", ""])
            inside = begins or (inside and indent > outer)
            outer = outer if inside else indent
        lines.append(line if inside else _escaped(line))


def _with_short_aliases(
    _: Sphinx, __: str, ___: str, ____: object, _____: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Aliases of `autodoc_type_aliases` inside other types are printed as forward references, which they are not."""
    return signature and _ALIAS.sub(r"\1", signature), returns and _ALIAS.sub(r"\1", returns)


def _escaped(line: str) -> str:
    parts = _CODE.split(line)
    parts[::2] = [re.sub(r"([*|])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts)


def setup(app: Sphinx) -> ExtensionMetadata:
    """Run the conversion before napoleon's."""
    app.connect("autodoc-process-docstring", _to_restructured_text, priority=_BEFORE_NAPOLEON)
    app.connect("autodoc-process-signature", _with_short_aliases)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
