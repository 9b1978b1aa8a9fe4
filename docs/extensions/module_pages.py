"""The directive `modules`: autodoc of every public module of a package, so that new ones are added automatically."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata


class Modules(SphinxDirective):
    """Headings and autodoc for each public module of the given packages or modules."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return one section for each module."""
        names = [name for argument in self.arguments[0].split() for name in _public_modules(argument)]
        sections = [f"## `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n" for name in names]
        return self.parse_text_to_nodes("\n".join(sections), allow_section_headings=True)


def _public_modules(name: str) -> list[str]:
    module = importlib.import_module(name)
    if not hasattr(module, "__path__"):
        return [name]
    return [f"{name}.{entry.name}" for entry in pkgutil.iter_modules(module.__path__) if entry.name[0] != "_"]


def _skip_generated(_: Sphinx, __: str, ___: str, member: Any, ____: bool, _____: object) -> bool | None:
    """Leave out methods that a base class of another package writes into ours, as Matplotlib's artists do."""
    module = getattr(member, "__module__", None) or ""
    return True if callable(member) and module.startswith("matplotlib.") else None


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directive."""
    app.add_directive("modules", Modules)
    app.connect("autodoc-skip-member", _skip_generated)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
