"""How a function becomes a subcommand: groups of options as one parameter, and options of several values."""

from __future__ import annotations

import functools
import inspect
from collections import deque
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, get_type_hints

from typer.core import TyperCommand

NUMBER_OF_VALUES = {"--range": 4, "--over": 4, "--at": 2, "--wrench": 6, "--centre": 3}
"""Number of values of each such option."""


class RepeatableCommand(TyperCommand):
    """A command with repeatable options of several values, which Typer does not support."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the values of such an option into one, then parse as usual."""
        repeatable = {
            name for parameter in self.params if getattr(parameter, "multiple", False) for name in parameter.opts
        }
        joined: list[str] = []
        rest = deque(args)
        while rest:
            joined.append(rest.popleft())
            count = NUMBER_OF_VALUES[joined[-1]] if joined[-1] in repeatable & NUMBER_OF_VALUES.keys() else 0
            if count and rest and " " not in rest[0]:
                joined.append(" ".join(rest.popleft() for _ in range(min(count, len(rest)))))
        return super().parse_args(ctx, joined)


def with_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return the command with each option group replaced by the options in it."""
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        group = groups.get(parameter.name)
        if group is None:
            parameters.append(parameter.replace(annotation=hints[parameter.name], kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        kinds = get_type_hints(group, include_extras=True)
        parameters += [
            inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=kinds[f.name])
            for f in fields(group)
        ]

    @functools.wraps(function)
    def command(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        function(**given)

    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    del command.__wrapped__
    return command
