"""Tables of the documentation, read from the description files so that no number is typed twice.

Directives: `quantities` (one section of the machine's YAML file), `derived-numbers` (what follows from it) and
`table-8-3` (published and computed).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata

from pm3dof_pin.chapter.table_8_3 import TableRow, table_8_3
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.description.parameters import Parameter, TripodParameters

_GREEK = re.compile(r"(?<![a-zA-Z\\])(alpha|beta|gamma|theta)(?![a-zA-Z])")
_AXES = {
    "theta_x": r"$\theta_x$",
    "theta_y": r"$\theta_y$",
    "t_z": "$T_z$",
    "t_x": "$T_x = T_y$",
    "theta_z": r"$\theta_z$",
    "global": "global",
}


class MarkdownTable(SphinxDirective):
    """A directive whose content is a Markdown table made by :meth:`rows`."""

    header: Sequence[str]
    alignment: Sequence[str]

    def rows(self) -> Iterable[Sequence[str]]:
        """Return the cells of the table."""
        raise NotImplementedError

    def run(self) -> list[nodes.Node]:
        """Return the table's nodes."""
        lines = [self.header, self.alignment, *self.rows()]
        content = self.parse_text_to_nodes("\n".join("| " + " | ".join(line) + " |" for line in lines))
        for table in content:
            table["classes"] += ["numbers", self.name]
        return content


class Quantities(MarkdownTable):
    """One section of the machine's YAML file."""

    required_arguments = 1
    header = ("quantity", "symbol", "value", "origin", "source")
    alignment = ("---", "---", "---", "---", "---")

    def rows(self) -> Iterable[Sequence[str]]:
        """Return one row for each quantity of the section."""
        section = self.arguments[0]
        for key, quantity in TripodParameters.load().quantities.items():
            if key.startswith(f"{section}."):
                name = key.split(".")[1].replace("_", " ")
                origin = "printed" if quantity.status == "printed" else f"**{quantity.status}**"
                yield name, _symbol(quantity), _value(quantity), origin, _prose(quantity.source)


class DerivedNumbers(MarkdownTable):
    """Numbers derived from the YAML file."""

    header = ("quantity", "symbol", "value")
    alignment = ("---", "---", "---")

    def rows(self) -> Iterable[Sequence[str]]:
        """Return one row for each derived height."""
        tripod = Tripod.load()
        for name, symbol, height in (
            ("lowest level platform, sliders at their lower stop", r"z_\mathrm{min}", tripod.height_min),
            ("home: level, sliders at the middle of their stroke", r"z_\mathrm{home}", tripod.height_home),
            ("highest level platform, sliders at their upper stop", r"z_\mathrm{max}", tripod.height_max),
            (
                "section of Table 8.3, middle of the two extremes",
                r"\tfrac{1}{2}(z_\mathrm{min} + z_\mathrm{max})",
                tripod.middle_height,
            ),
            ("clamp of the passive leg in the middle platform", "z_b", tripod.clamp_height),
            (
                "free length of the passive leg in that section",
                "L = z_e - z_b",
                tripod.middle_height - tripod.clamp_height,
            ),
        ):
            yield name, f"${symbol}$", f"{height:.6f} m"


class PublishedTable(MarkdownTable):
    """Table 8.3, published and computed."""

    header = ("axis", "statistic", "published", "computed", "difference", "in the fifth digit")
    alignment = ("---", "---", "--:", "--:", "--:", "--:")

    def rows(self) -> Iterable[Sequence[str]]:
        """Return one row for each published number."""
        for row in table_8_3():
            yield (
                _AXES[row.axis],
                row.statistic,
                _power(row.published, 4),
                _power(row.computed, 4),
                f"{100.0 * row.relative_difference:+.4f} %",
                _last_digit(row),
            )


def _symbol(quantity: Parameter) -> str:
    if quantity.symbol == "none":
        return ""
    upright = re.sub(r"_([a-z]{3,})", r"_\\mathrm{\1}", quantity.symbol)
    return "$" + _GREEK.sub(r"\\\1", re.sub(r"_(\w+)", r"_{\1}", upright)).replace(", ", r",\; ") + "$"


def _value(quantity: Parameter) -> str:
    numbers = quantity.value if isinstance(quantity.value, tuple) else (quantity.value,)
    unit = "" if quantity.unit == "1" else " " + quantity.unit.replace("^2", "²")
    return ", ".join(_number(number) for number in numbers) + unit


def _number(number: float) -> str:
    return f"{number:.10g}" if number == 0.0 or 1e-6 <= abs(number) < 1e6 else _power(number, None)


def _power(number: float, digits: int | None) -> str:
    mantissa, exponent = (f"{number:e}" if digits is None else f"{number:.{digits}e}").split("e")
    if digits is None:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return rf"${mantissa} \times 10^{{{int(exponent)}}}$"


def _last_digit(row: TableRow) -> str:
    difference = row.last_digit_difference
    return "exact" if difference == 0 else f"**{difference:+d}**"


def _prose(source: str) -> str:
    """Names as the YAML file writes them, kept as they are."""
    return re.sub(r"(?<![\w`])(\w*_\w+)", r"`\1`", source).replace("|", r"\|")


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directives."""
    app.add_directive("quantities", Quantities)
    app.add_directive("derived-numbers", DerivedNumbers)
    app.add_directive("table-8-3", PublishedTable)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
