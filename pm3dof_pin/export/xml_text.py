"""XML as text, with all digits of numbers."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from pm3dof_pin.description.xml_file import comment_text


def numbers_text(numbers: Iterable[float]) -> str:
    """Write numbers separated by spaces, such that they round-trip."""
    return " ".join(number_text(number) for number in numbers)


def number_text(number: float) -> str:
    """Write a number such that it round-trips; minus zero is written as zero."""
    return repr(float(number) + 0.0).removesuffix(".0")


def document_text(root: ElementTree.Element, banner: str) -> str:
    """Write an XML element as an indented document with a banner, of one line or several."""
    ElementTree.indent(root, "  ")
    comment = "\n".join(map(comment_text, banner.splitlines()))
    return f'<?xml version="1.0"?>\n<!-- {comment} -->\n{ElementTree.tostring(root, encoding="unicode")}\n'
