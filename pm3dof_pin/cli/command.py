"""How a function becomes a subcommand: groups of options as one parameter, and options of several values."""

from __future__ import annotations

import functools
import inspect
import os
from collections import deque
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from typer import BadParameter
from typer.core import TyperCommand

NUMBER_OF_VALUES = {"--range": 4, "--over": 4, "--at": 2, "--wrench": 6, "--twist": 6, "--centre": 3}
"""Number of values of each such option."""


class _NotANumber(BadParameter):
    """A word where a number was expected."""


class _Words:
    """Conversion of a parameter's words by its type. What fails is left to Typer, which explains it.

    Typer's own conversion is by pydantic in later versions, whose import takes a third of the time of a short command.
    """

    def __init__(self, parameter: Any) -> None:
        self._parameter = parameter
        descriptor = parameter.type_descriptor
        self._type, self._info = descriptor.annotation, descriptor.parameter_info

    def coerce(self, value: Any, **context: Any) -> Any:
        """Return the value of the parameter for its words; None, or no values, if it was not given."""
        if value is None:
            return () if self._parameter.multiple or self._parameter.nargs == -1 else None
        try:
            return self._converted(value, self._type)
        except _NotANumber:
            raise
        except Exception:  # a parser's own errors too: Typer runs it again and words them
            self._parameter._runtime_param = None
            return type(self._parameter).get_runtime_param(self._parameter).coerce(value, **context)

    def _converted(self, value: Any, kind: Any) -> Any:
        if get_origin(kind) is list:
            return [self._converted(item, get_args(kind)[0]) for item in value]
        if get_origin(kind) is tuple:
            return tuple(self._converted(item, one) for item, one in zip(value, get_args(kind), strict=True))
        if self._info.parser is not None:
            return self._info.parser(value)
        if get_origin(kind) is Literal and value in get_args(kind):
            return value
        if kind in (int, float):
            try:
                number = kind(value)
            except ValueError:
                raise _NotANumber(f"{value} is not a {'whole number' if kind is int else 'number'}") from None
            low, high = self._info.min, self._info.max
            if (low is None or number >= low) and (high is None or number <= high):
                return number
        if kind in (bool, str) and isinstance(value, kind):
            return value
        if kind is Path and not self._info.exists and (not Path(value).exists() or os.access(value, os.R_OK)):
            return Path(value)
        raise ValueError(value)


class PlainWords:
    """A command whose parameters convert their words without pydantic."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return all parameters, the help's included."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in parameters:
            if hasattr(parameter, "_runtime_param"):
                parameter._runtime_param = parameter._runtime_param or _Words(parameter)
        return parameters


class RepeatableCommand(PlainWords, TyperCommand):
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
