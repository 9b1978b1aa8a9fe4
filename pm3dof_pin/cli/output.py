"""Output of the subcommands: results to standard output; messages, and on a terminal progress, to standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from pm3dof_pin.programs.making import told_to

LIMIT_BROKEN = 1


def print_result(result: Mapping[str, Any], lines: Iterable[str], *, as_json: bool, files: Sequence[Path] = ()) -> None:
    """Print a result as a JSON object or as text lines, then name the files written."""
    if as_json:
        named = {"files": list(map(str, files))} if files else {}
        typer.echo(json.dumps(_plain({**result, **named}), indent=2, allow_nan=False))
    else:
        typer.echo("\n".join(lines))
    for file in files:
        message(f"wrote {file}")


def message(text: str) -> None:
    """Print a message to standard error."""
    typer.echo(text, err=True)


def table_lines(header: Sequence[str], rows: Sequence[Sequence[str]], *, words: int = 1) -> list[str]:
    """Lay out a table: the first `words` columns aligned left, the others right."""
    widths = [max(len(row[column]) for row in [header, *rows]) for column in range(len(header))]
    return [
        "  ".join(
            cell.ljust(width) if k < words else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in [header, *rows]
    ]


def fixed(number: float, digits: int) -> str:
    """Format a number with this many decimals and no sign on zero."""
    return f"{number:z.{digits}f}"


def stop_on_broken_limits(violations: Sequence[object]) -> None:
    """Print each broken limit on a line of standard error and exit with status 1, if there are any."""
    for violation in violations:
        message(f"pm3dof: joint limit broken: {violation}")
    if violations:
        raise typer.Exit(LIMIT_BROKEN)


@contextmanager
def progress_bar(text: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function (done, total) that advances a bar on standard error if that is a terminal.

    The bar also says that a program is being recorded or compiled, which takes long for large robots.
    """
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=None)

        def show(made: str) -> None:
            bar.update(task, description=f"{text}, {made}" if made else text)

        with told_to(show):
            yield lambda done, total: bar.update(task, completed=done, total=total)


def _plain(value: Any) -> Any:
    """Turn arrays and NumPy numbers into lists and numbers; non-finite values become null, as JSON has no NaN."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
