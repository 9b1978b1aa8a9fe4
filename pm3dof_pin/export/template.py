"""Texts for other programs from templates; names in a robot's description are plain text there, never code or markup.

@WORD@ in a template is replaced by a word of code, or by a name as the language needs it; @"WORD"@ by a name as a
string literal, which C, C++ and Python read alike.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from xml.sax.saxutils import escape

from pm3dof_pin.programs.c import harmless

_WORD = re.compile(r'@("?)([A-Z_]+)\1@')
_NOTHING: Mapping[str, str] = MappingProxyType({})


def one_line(text: str) -> str:
    """Return text for a comment that ends with its line; languages may continue a line after a backslash."""
    return " ".join(text.replace("\\", "/").split())


def c_comment(text: str) -> str:
    """Return text for a comment of C or C++ of either kind; two question marks may begin a trigraph."""
    return harmless(one_line(text)).replace("??", "? ?").replace("??", "? ?")


def _string_literal(text: str) -> str:
    """Return text as a string literal of C, C++ or Python."""
    escaped = text.replace("\\", r"\\").replace('"', r"\"").replace("??", r"?\077")
    return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda found: f"\\{ord(found[0]):03o}", escaped) + '"'


def docstring(text: str) -> str:
    """Return text for a docstring of Python in double quotes."""
    return one_line(text).replace('"', "'")


def xml(text: str) -> str:
    """Return text for an element or an attribute in double quotes."""
    return escape(text, {'"': "&quot;"})


def markdown(text: str) -> str:
    """Return text for a line of Markdown."""
    return re.sub(r"([\\`*\[\]<>&])", r"\\\1", " ".join(text.split()))


def fill(
    template: str,
    words: Mapping[str, str],
    names: Mapping[str, str] = _NOTHING,
    escaped: Callable[[str], str] = c_comment,
) -> str:
    """Fill in a template: words as they are, and names of a description as `escaped` writes them."""

    def replaced(token: re.Match[str]) -> str:
        quote, key = token.groups()
        if quote:
            return _string_literal(names[key])
        return words[key] if key in words else escaped(names[key])

    return _WORD.sub(replaced, template)
