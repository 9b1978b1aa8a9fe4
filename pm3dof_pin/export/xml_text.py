"""XML as text, numbers with every digit."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from pm3dof_pin.description.xml_file import comment_text


def numbers_text(numbers: Iterable[float]) -> str:
    """Write numbers, separated by blanks, so that reading them back gives the same ones."""
    return " ".join(number_text(number) for number in numbers)


def number_text(number: float) -> str:
    """Write a number so that reading it back gives the same one; minus zero is written as zero."""
    return repr(float(number) + 0.0).removesuffix(".0")


def document_text(root: ElementTree.Element, banner: str) -> str:
    """Write an XML element as a document, indented, below a banner."""
    ElementTree.indent(root, "  ")
    return f'<?xml version="1.0"?>\n<!-- {comment_text(banner)} -->\n{ElementTree.tostring(root, encoding="unicode")}\n'
