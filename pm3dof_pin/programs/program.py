"""Finished straight-line programs, as passed from the graph to the printers and cached on disk."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array

FORMAT = "pm3dof program 1"


def _minimum(a: Any, b: Any) -> Any:
    return np.where((a < b) | np.isnan(a), a, b)


def _maximum(a: Any, b: Any) -> Any:
    return np.where((b < a) | np.isnan(a), a, b)


OPERATIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "negative": (1, np.negative),
    "add": (2, np.add),
    "subtract": (2, np.subtract),
    "multiply": (2, np.multiply),
    "divide": (2, np.divide),
    "sqrt": (1, np.sqrt),
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "atan2": (2, np.arctan2),
    "absolute": (1, np.absolute),
    "minimum": (2, _minimum),
    "maximum": (2, _maximum),
    "less": (2, np.less),
    "and": (2, np.logical_and),
    "or": (2, np.logical_or),
    "not": (1, np.logical_not),
    "select": (3, np.where),
    "floor": (1, np.floor),
}
"""Number of operands and meaning of each operation. `minimum` and `maximum` are NaN if an operand is NaN, and the
second operand if both are equal; `less` is false if an operand is NaN."""

_NAMES = tuple(OPERATIONS)
CODES = {name: code for code, name in enumerate(OPERATIONS)}
"""Index of each operation in `OPERATIONS`."""


@dataclass(frozen=True, eq=False)
class Program:
    """A straight-line sequence of operations on the numbers of one pose.

    Values are numbered: the inputs, the parameters, the constants, then one value per line.
    """

    name: str  #: name of the printed function, an identifier
    inputs: tuple[str, ...]  #: names of the inputs, one value per pose
    parameters: tuple[str, ...]  #: names of the parameters, shared by all poses of a call
    #: name and shape of each group of outputs; results are ordered group by group, each in C order
    outputs: Mapping[str, tuple[int, ...]]
    constants: tuple[float, ...]  #: the constants
    codes: bytes  #: index in `OPERATIONS` of each line's operation
    operands: NDArray[np.int32]  #: numbers of their operands, which precede the line, or -1, shape=(3, lines)
    results: tuple[int, ...]  #: numbers of the output values, flat

    def __len__(self) -> int:
        """Return the number of operations."""
        return len(self.codes)

    @cached_property
    def lines(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """Name of the operation and numbers of its operands, by line."""
        return tuple(
            (_NAMES[code], (a,) if b < 0 else (a, b) if c < 0 else (a, b, c))
            for code, a, b, c in zip(self.codes, *self.operands.tolist(), strict=True)
        )

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Slice of each group in the flat outputs."""
        places: dict[str, slice] = {}
        first = 0
        for name, shape in self.outputs.items():
            places[name] = slice(first, first + math.prod(shape))
            first = places[name].stop
        return places

    def split(self, flat: Array) -> dict[str, Array]:
        """Return views of flat outputs, shape=(..., number of outputs), by group: shape=(..., *shape of the group)."""
        return {
            name: flat[..., self.slices[name]].reshape((*flat.shape[:-1], *shape))
            for name, shape in self.outputs.items()
        }

    @cached_property
    def first_line(self) -> int:
        """Number of the value of the first line."""
        return len(self.inputs) + len(self.parameters) + len(self.constants)

    @cached_property
    def content(self) -> bytes:
        """The program as bytes, identical for equal programs on every machine; `Program.from_bytes` reads them."""
        header = {
            "format": FORMAT,
            "name": self.name,
            "inputs": self.inputs,
            "parameters": self.parameters,
            "outputs": [[name, list(shape)] for name, shape in self.outputs.items()],
            "counts": [len(self.constants), len(self), len(self.results)],
        }
        return b"".join(
            (
                json.dumps(header).encode() + b"\n",
                np.array(self.constants, dtype="<f8").tobytes(),
                np.array(self.results, dtype="<i4").tobytes(),
                self.operands.astype("<i4").tobytes(),
                self.codes,
            )
        )

    @cached_property
    def key(self) -> str:
        """Hexadecimal hash of the content."""
        return hashlib.sha256(self.content).hexdigest()

    @classmethod
    def from_bytes(cls, content: bytes) -> Program:
        """Read a program from its `content`; InvalidValueError for bytes of another version."""
        try:
            head, body = content.split(b"\n", 1)
            header = json.loads(head)
            if header["format"] != FORMAT:
                raise ValueError(header["format"])
            n_constants, n_lines, n_results = header["counts"]
            ends = np.cumsum([8 * n_constants, 4 * n_results, 12 * n_lines, n_lines])
            if len(body) != ends[-1]:
                raise ValueError("length")
            codes = body[ends[2] :]
            if codes and max(codes) >= len(_NAMES):
                raise ValueError("operations")
            program = cls(
                name=header["name"],
                inputs=tuple(header["inputs"]),
                parameters=tuple(header["parameters"]),
                outputs={name: tuple(shape) for name, shape in header["outputs"]},
                constants=tuple(np.frombuffer(body[: ends[0]], dtype="<f8").tolist()),
                results=tuple(np.frombuffer(body[ends[0] : ends[1]], dtype="<i4").tolist()),
                codes=codes,
                operands=np.frombuffer(body[ends[1] : ends[2]], dtype="<i4").reshape(3, -1),
            )
            program.__dict__["content"] = content  # so that the key need not recompute it
            return program
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise InvalidValueError("content", f"{content[:20]!r}...", f"a '{FORMAT}'") from error

    def with_parameters(self, names: tuple[str, ...]) -> Program:
        """Return the same program with more parameters, unused ones; InvalidValueError if one of its own is missing."""
        if missing := set(self.parameters) - set(names):
            raise InvalidValueError("parameters", sorted(missing)[0], "a parameter of both programs")
        first, last = len(self.inputs), len(self.inputs) + len(self.parameters)
        places = [first + names.index(name) for name in self.parameters]
        shift = len(names) - len(self.parameters)
        moved = [*range(first), *places, *range(last + shift, self.first_line + len(self) + shift), -1]
        return replace(
            self,
            parameters=names,
            operands=np.array(moved, dtype=np.int32)[self.operands],
            results=tuple([moved[number] for number in self.results]),
        )

    def of_results(self, outputs: Mapping[str, tuple[int, ...]], chosen: Sequence[int]) -> Program:
        """Return a program of some of the flat outputs, grouped anew, without the operations they do not need."""
        results, first = [self.results[k] for k in chosen], self.first_line
        needed = bytearray(first + len(self) + 1)  # the last for the operand -1
        needed[:first] = bytes([1]) * first
        for number in results:
            needed[number] = 1
        lines = list(enumerate(zip(*self.operands.tolist(), strict=True), first))
        for number, (a, b, c) in reversed(lines):
            if needed[number]:
                needed[a] = needed[b] = needed[c] = 1
        is_kept = np.frombuffer(needed, dtype=bool)[:-1]
        places = np.append(np.cumsum(is_kept) - 1, -1).astype(np.int32)  # the operand -1 stays
        kept = np.flatnonzero(is_kept[first:])
        return replace(
            self,
            outputs=dict(outputs),
            codes=np.frombuffer(self.codes, dtype=np.uint8)[kept].tobytes(),
            operands=places[self.operands[:, kept]],
            results=tuple(places[results].tolist()),
        )

    @property
    def state_size(self) -> int:
        """Number of outputs before the last one, which is the residual of an iteration."""
        return len(self.results) - 1

    @property
    def can_iterate(self) -> bool:
        """Whether the outputs are new values of the first inputs and a residual."""
        return 1 <= self.state_size <= len(self.inputs)

    @property
    def can_march(self) -> bool:
        """Whether the program closes loops, its state being q, `margin` and `jump`."""
        return self.can_iterate and tuple(self.outputs) == ("q", "margin", "jump", "residual")

    def evaluate(self, inputs: ArrayLike, parameters: ArrayLike = (), dtype: type[np.floating] = np.float64) -> Array:
        """Run the program at n poses with NumPy, operation by operation: slow; the reference for the printers.

        Every operation is rounded to `dtype`.
        """
        rows = np.asarray(inputs, dtype=dtype)
        values: list[Any] = [*rows.T, *np.asarray(parameters, dtype=dtype), *map(dtype, self.constants)]
        with np.errstate(all="ignore"):
            for operation, operands in self.lines:
                values.append(OPERATIONS[operation][1](*(values[number] for number in operands)))
        flat = np.empty((len(rows), len(self.results)))
        for column, number in enumerate(self.results):
            flat[:, column] = values[number]
        return flat
