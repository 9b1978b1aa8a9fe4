"""The scene in a notebook."""

from __future__ import annotations

import html
from dataclasses import dataclass


@dataclass(frozen=True)
class NotebookCell:
    """A page in a frame: its attribute `src` or `srcdoc` and its height [pixels]."""

    source: str
    height: int

    @classmethod
    def of_address(cls, url: str, height: int) -> NotebookCell:
        """Show the page at an address."""
        return cls(f'src="{html.escape(url)}"', height)

    @classmethod
    def of_page(cls, page: str, height: int) -> NotebookCell:
        """Show a page that is given as its text."""
        return cls(f'srcdoc="{html.escape(page)}"', height)

    def _repr_html_(self) -> str:
        return f'<iframe {self.source} style="width: 100%; height: {self.height}px; border: none"></iframe>'
