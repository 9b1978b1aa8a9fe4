"""Numbers that record operations: a single-pose algorithm, written in plain Python, becomes a program.

Every operation on a `Number` is recorded in its `Graph` instead of executed. Common subexpressions are shared,
constants are folded, and operations with zeros and ones are simplified. Folding assumes that all numbers are finite:
``x * 0`` and ``x - x`` are 0 even if x is NaN at run time. Division is multiplication by a reciprocal.

Vectors and matrices are NumPy arrays of dtype object, or lists::

    graph = Graph()
    angle = graph.input("angle", samples=[0.1, 0.2])
    length = graph.parameter("length", 0.3)
    program = graph.program("tip", {"position": [length * cos(angle), length * sin(angle)]})
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.programs.program import CODES, OPERATIONS, Program
from pm3dof_pin.typing import Objects


class Graph:
    """The record of one algorithm."""

    def __init__(self) -> None:
        self._inputs: dict[str, Number] = {}
        self._parameters: dict[str, Number] = {}
        self._known: dict[tuple[Any, ...], Any] = {}
        self._values: list[_Value] = []
        self._samples: list[Any] = []
        self._sample_count = 1

    def __len__(self) -> int:
        """Return the number of values recorded so far, dead ones included."""
        return len(self._values)

    def input(self, name: str, samples: ArrayLike) -> Number:
        """Add an input, one value per pose, with its values at the sample poses, shape=(s,).

        Raises:
            InvalidValueError: the name is taken, or the number of samples differs.
        """
        known = np.array(samples, dtype=float)
        if known.ndim != 1 or (self._inputs and len(known) != self._sample_count):
            raise ShapeError(f"samples of {name}", known.shape, f"({self._sample_count},)")
        self._sample_count = len(known)
        self._inputs[name] = number = self._leaf(name)
        self._constant_samples(number, known)
        return number

    def parameter(self, name: str, value: float) -> Number:
        """Add a parameter, shared by all poses of a call, with its value at the samples; InvalidValueError if taken."""
        self._parameters[name] = number = self._leaf(name)
        self._constant_samples(number, np.float64(value))
        return number

    def constant(self, value: float) -> Number:
        """Return the constant as a number of this graph."""
        value = float(value) + 0.0  # no negative zero
        key = ("constant", value if value == value else "nan")
        found: Number | None = self._known.get(key)
        if found is None:
            self._known[key] = found = Number(self, "constant", (), value)
            self._constant_samples(found, np.float64(value))
        return found

    def program(self, name: str, outputs: Mapping[str, ArrayLike | Number]) -> Program:
        """Return the program of the outputs, arrays or nested lists of numbers by group, without unused operations.

        All inputs and parameters remain arguments, in the order they were added.

        Raises:
            InvalidValueError: an output is not a number of this graph.
        """
        if not name.isidentifier():
            raise InvalidValueError("name", repr(name), "an identifier")
        groups = {group: np.array(numbers, dtype=object) for group, numbers in outputs.items()}
        flat = [self._number(number) for array in groups.values() for number in array.ravel()]
        needed = bytearray(len(self._values))
        for number in flat:
            needed[number.index] = 1
        for value in reversed(self._values):
            if needed[value.index]:
                for operand in value.operands:
                    needed[operand.index] = 1
        leaves = [*self._inputs.values(), *self._parameters.values()]
        order = [value for value in self._values if needed[value.index]]
        constants = [value for value in order if value.value is not None]
        lines = _by_first_use(order, flat)
        place = {value: number for number, value in enumerate([*leaves, *constants, *lines])}
        operands = np.full((3, len(lines)), -1, dtype=np.int32)
        for k, line in enumerate(lines):
            for row, operand in enumerate(line.operands):
                operands[row, k] = place[operand]
        return Program(
            name=name,
            inputs=tuple(self._inputs),
            parameters=tuple(self._parameters),
            outputs={group: array.shape for group, array in groups.items()},
            constants=tuple(float(constant.value or 0.0) for constant in constants),
            codes=bytes([CODES[line.operation] for line in lines]),
            operands=operands,
            results=tuple([place[number] for number in flat]),
        )

    def again(self, program: Program, inputs: ArrayLike, parameters: ArrayLike) -> dict[str, Objects]:
        """Record a program's operations on new inputs and parameters of its names; return its outputs by group.

        `inputs` are those of the sample poses, shape=(s, n), and `parameters` values.
        """
        columns = np.asarray(inputs, dtype=float).T
        leaves = [self.input(name, column) for name, column in zip(program.inputs, columns, strict=True)]
        leaves += [self.parameter(*each) for each in zip(program.parameters, np.asarray(parameters), strict=True)]
        values: list[Any] = [*leaves, *map(self.constant, program.constants)]
        for operation, operands in program.lines:
            values.append(_RECORDED[operation](*[values[number] for number in operands]))
        outputs = np.array([values[number] for number in program.results], dtype=object)
        return {name: outputs[place].reshape(program.outputs[name]) for name, place in program.slices.items()}

    def operations(self, *numbers: Scalar) -> int:
        """Return how many operations numbers take together."""
        found: set[_Value] = {self._number(number) for number in numbers}
        waiting: list[_Value] = list(found)
        count = 0
        while waiting:
            value = waiting.pop()
            count += bool(value.operands)
            new = set(value.operands) - found
            found |= new
            waiting += new
        return count

    def _leaf(self, name: str) -> Number:
        if name in self._inputs or name in self._parameters:
            raise InvalidValueError("name", repr(name), "a name that is not taken")
        return Number(self, "leaf")

    def _number(self, value: object) -> Number:
        if isinstance(value, Number):
            if value.graph is not self:
                raise InvalidValueError("number", value, "a number of the same graph")
            return value
        if isinstance(value, (int, float, np.integer, np.floating)):
            return self.constant(float(value))
        raise InvalidValueError("output", value, "a number")

    def _constant_samples(self, value: _Value, samples: Any) -> None:
        self._evaluate(value.index - 1)
        self._samples.append(samples)

    def _evaluate(self, index: int) -> Any:
        """Return the samples of a value, computing missing ones of its predecessors."""
        samples = self._samples
        if index >= len(samples):
            with np.errstate(all="ignore"):
                for value in self._values[len(samples) : index + 1]:
                    samples.append(
                        OPERATIONS[value.operation][1](*[samples[operand.index] for operand in value.operands])
                    )
        return samples[index] if index >= 0 else None


def _by_first_use(order: Sequence[_Value], results: Sequence[_Value]) -> list[_Value]:
    """Return the lines depth first from the results, so that fewer values are live at a time.

    Of the operands of a line, the one that needs more live values comes first (R. Sethi and J. Ullman, J. ACM 17,
    1970).
    """
    waiting: dict[_Value, int] = {}
    for value in order:
        if len(value.operands) == 2:  # nearly all
            first, second = value.operands
            a, b = waiting[first], waiting[second]
            waiting[value] = a + 1 if a == b else max(a, b)
            continue
        counts = sorted([waiting[operand] for operand in value.operands], reverse=True)
        waiting[value] = max([1, *[count + k for k, count in enumerate(counts)]]) if counts else 0
    lines: dict[_Value, None] = {}
    opened: set[_Value] = set()
    stack: list[_Value] = list(reversed(results))
    while stack:
        value = stack[-1]
        if value in opened or not value.operands:
            stack.pop()
            if value.operands:
                lines[value] = None  # repeated for shared values: the first time counts
        else:
            opened.add(value)
            if len(value.operands) == 2:
                first, second = value.operands
                stack += (second, first) if waiting[second] < waiting[first] else (first, second)
            else:
                stack.extend(sorted(value.operands, key=waiting.__getitem__))
    return list(lines)


class _Value:
    """A value in a graph; `value` is set for constants."""

    __slots__ = ("graph", "index", "operands", "operation", "value")

    def __init__(
        self, graph: Graph, operation: str, operands: tuple[Any, ...] = (), value: float | None = None
    ) -> None:
        self.graph = graph
        self.operation = operation
        self.operands = operands
        self.value = value
        self.index = len(graph._values)
        graph._values.append(self)

    @property
    def samples(self) -> NDArray[Any]:
        """Value at every sample pose, shape=(s,)."""
        samples = self.graph._evaluate(self.index)
        return samples if np.ndim(samples) else np.full(self.graph._sample_count, samples)

    def __bool__(self) -> bool:
        raise TypeError("a recorded value is not known while recording: use select")

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.index} {self.operation} {self.samples}>"


class Number(_Value):
    """A recorded number. Arithmetic works with numbers and floats, also in NumPy arrays of dtype object."""

    __slots__ = ()

    @property
    def is_zero(self) -> bool:
        """Whether this is the constant 0."""
        return self.value == 0.0

    def __add__(self, other: Scalar) -> Number:
        b = other if type(other) is Number else _as_number(self, other)
        return NotImplemented if b is None else _add(self, b)

    def __radd__(self, other: float) -> Number:
        b = _as_number(self, other)
        return NotImplemented if b is None else _add(b, self)

    def __sub__(self, other: Scalar) -> Number:
        b = other if type(other) is Number else _as_number(self, other)
        return NotImplemented if b is None else _subtract(self, b)

    def __rsub__(self, other: float) -> Number:
        b = _as_number(self, other)
        return NotImplemented if b is None else _subtract(b, self)

    def __mul__(self, other: Scalar) -> Number:
        b = other if type(other) is Number else _as_number(self, other)
        return NotImplemented if b is None else _multiply(self, b)

    def __rmul__(self, other: float) -> Number:
        b = _as_number(self, other)
        return NotImplemented if b is None else _multiply(b, self)

    def __truediv__(self, other: Scalar) -> Number:
        b = other if type(other) is Number else _as_number(self, other)
        return NotImplemented if b is None else _divide(self, b)

    def __rtruediv__(self, other: float) -> Number:
        b = _as_number(self, other)
        return NotImplemented if b is None else _divide(b, self)

    def __neg__(self) -> Number:
        return _negative(self)

    def __pos__(self) -> Number:
        return self

    def __abs__(self) -> Scalar:
        return absolute(self)

    def __pow__(self, exponent: int) -> Number:
        """Return a power with a positive integer exponent, as a product."""
        if not isinstance(exponent, int) or exponent < 1:
            return NotImplemented
        if exponent == 1:
            return self
        square = (self * self) ** (exponent // 2)
        return square * self if exponent % 2 else square


class _Condition(_Value):
    """A recorded boolean, for `select`; conditions combine by ``&``, ``|`` and ``~``, also with `numpy.bool`."""

    __slots__ = ()
    __array_ufunc__ = None

    def __and__(self, other: Truth) -> Truth:
        if not isinstance(other, _Condition):
            return self if other else np.False_
        return self if self is other else _condition("and", *_sorted(self, other))

    def __or__(self, other: Truth) -> Truth:
        if not isinstance(other, _Condition):
            return np.True_ if other else self
        return self if self is other else _condition("or", *_sorted(self, other))

    def __invert__(self) -> _Condition:
        return self.operands[0] if self.operation == "not" else _condition("not", self)

    __rand__ = __and__
    __ror__ = __or__


Scalar = Number | float
Truth = _Condition | np.bool_


def sin(angle: Scalar) -> Scalar:
    """Sine of an angle [rad]; `cos` of the same angle then costs almost nothing."""
    if not isinstance(angle, Number):
        return float(np.sin(angle))
    return _negative(_unary("sin", angle.operands[0])) if angle.operation == "negative" else _unary("sin", angle)


def cos(angle: Scalar) -> Scalar:
    """Cosine of an angle [rad]."""
    if not isinstance(angle, Number):
        return float(np.cos(angle))
    return _unary("cos", angle.operands[0] if angle.operation == "negative" else angle)


def sqrt(a: Scalar) -> Scalar:
    """Square root; NaN for negative numbers."""
    if not isinstance(a, Number):
        return _folded("sqrt", a)
    return _unary("sqrt", a)


def absolute(a: Scalar) -> Scalar:
    """Magnitude."""
    if not isinstance(a, Number):
        return abs(a)
    if a.operation in ("absolute", "sqrt"):
        return a
    return _unary("absolute", a.operands[0] if a.operation == "negative" else a)


def floor(a: Scalar) -> Scalar:
    """Greatest integer not above a number."""
    return _unary("floor", a) if isinstance(a, Number) else _folded("floor", a)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """Angle of the point (x, y) [rad], in [-pi, pi]."""
    return _binary("atan2", y, x)


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """Lesser of two numbers; NaN if either is."""
    return a if a is b else _binary("minimum", a, b)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """Greater of two numbers; NaN if either is."""
    return a if a is b else _binary("maximum", a, b)


def less(a: Scalar, b: Scalar) -> Truth:
    """Whether a < b; false if either is NaN."""
    graph = _graph_of(a, b)
    if graph is None:
        return np.bool_(a < b)  # type: ignore[operator]
    x, y = graph._number(a), graph._number(b)
    if x is y:
        return np.False_
    if x.value is not None and y.value is not None:
        return np.bool_(x.value < y.value)
    return _condition("less", x, y)


def select(condition: Truth, a: Scalar, b: Scalar) -> Scalar:
    """Return a if the condition is true, else b. Both are computed."""
    if not isinstance(condition, _Condition):
        return a if condition else b
    if condition.operation == "not":
        return select(condition.operands[0], b, a)
    x, y = condition.graph._number(a), condition.graph._number(b)
    return x if x is y else _record(Number, "select", condition, x, y)


V = TypeVar("V", Number, _Condition)


def _record(kind: type[V], operation: str, *operands: _Value) -> V:
    """Return the value of this operation: an existing one, or a new one."""
    graph = operands[0].graph
    key = (operation, *operands)
    found: V | None = graph._known.get(key)
    if found is None:
        for operand in operands:
            if operand.graph is not graph:
                raise InvalidValueError("number", operand, "a number of the same graph")
        graph._known[key] = found = kind(graph, operation, operands)
    return found


def _condition(operation: str, *operands: _Value) -> _Condition:
    return _record(_Condition, operation, *operands)


def _unary(operation: str, a: Number) -> Number:
    if a.value is not None:
        return a.graph.constant(_folded(operation, a.value))
    return _record(Number, operation, a)


def _binary(operation: str, a: Scalar, b: Scalar) -> Scalar:
    graph = _graph_of(a, b)
    if graph is None:
        return _folded(operation, a, b)
    x, y = graph._number(a), graph._number(b)
    if x.value is not None and y.value is not None:
        return graph.constant(_folded(operation, x.value, y.value))
    return _record(Number, operation, x, y)


def _folded(operation: str, *values: Any) -> float:
    with np.errstate(all="ignore"):
        return float(OPERATIONS[operation][1](*map(np.float64, values)))


def _graph_of(*values: Any) -> Graph | None:
    return next((value.graph for value in values if isinstance(value, Number)), None)


def _as_number(number: Number, other: object) -> Number | None:
    """Return the other operand as a number of the same graph; None if it is something else, such as an array."""
    if isinstance(other, (int, float, np.integer, np.floating)):
        return number.graph.constant(float(other))
    return None


def _sorted(a: V, b: V) -> tuple[V, V]:
    return (a, b) if a.index <= b.index else (b, a)


def _negative(a: Number) -> Number:
    if a.value is not None:
        return a.graph.constant(-a.value)
    if a.operation == "negative":
        inner: Number = a.operands[0]
        return inner
    if a.operation == "subtract":
        opposite: Number | None = a.graph._known.get(("subtract", a.operands[1], a.operands[0]))
        if opposite is not None:
            return opposite
    return _record(Number, "negative", a)


def _add(a: Number, b: Number) -> Number:
    if a.value == 0.0:
        return b
    if b.value == 0.0:
        return a
    if a.value is not None and b.value is not None:
        return a.graph.constant(a.value + b.value)
    if b.operation == "negative":
        return _subtract(a, b.operands[0])
    if a.operation == "negative":
        return _subtract(b, a.operands[0])
    return _record(Number, "add", *_sorted(a, b))


def _subtract(a: Number, b: Number) -> Number:
    if b.value == 0.0:
        return a
    if a.value == 0.0:
        return _negative(b)
    if a is b:
        return a.graph.constant(0.0)
    if a.value is not None and b.value is not None:
        return a.graph.constant(a.value - b.value)
    if b.operation == "negative":
        return _add(a, b.operands[0])
    if a.operation == "negative":
        return _negative(_add(a.operands[0], b))
    opposite: Number | None = a.graph._known.get(("subtract", b, a))
    return _record(Number, "subtract", a, b) if opposite is None else _negative(opposite)


def _multiply(a: Number, b: Number) -> Number:
    if a.value is None and b.value is not None:
        a, b = b, a
    if a.value is not None:
        if b.value is not None:
            return a.graph.constant(a.value * b.value)
        if a.value == 0.0:
            return a
        if a.value == 1.0:
            return b
        if a.value < 0.0:
            return _negative(_multiply(a.graph.constant(-a.value), b))
    if a.operation == "negative":
        return _negative(_multiply(a.operands[0], b))
    if b.operation == "negative":
        return _negative(_multiply(a, b.operands[0]))
    return _record(Number, "multiply", *_sorted(a, b))


def _divide(a: Number, b: Number) -> Number:
    if b.value is not None:
        if a.value is not None:
            return a.graph.constant(_folded("divide", a.value, b.value))
        if abs(b.value) == 1.0:
            return a if b.value > 0.0 else _negative(a)
        if b.value:
            return _multiply(a, a.graph.constant(1.0 / b.value))
    elif a.value == 0.0:
        return a
    if a is b:
        return a.graph.constant(1.0)
    if a.operation == "negative":
        return _negative(_divide(a.operands[0], b))
    if b.operation == "negative":
        return _negative(_divide(a, b.operands[0]))
    if a.value != 1.0:  # one reciprocal serves all divisions by the same number
        return _multiply(a, _divide(a.graph.constant(1.0), b))
    return _record(Number, "divide", a, b)


_RECORDED: dict[str, Callable[..., Any]] = {
    "negative": operator.neg,
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "sqrt": sqrt,
    "sin": sin,
    "cos": cos,
    "atan2": atan2,
    "absolute": absolute,
    "floor": floor,
    "minimum": minimum,
    "maximum": maximum,
    "less": less,
    "and": operator.and_,
    "or": operator.or_,
    "not": operator.invert,
    "select": select,
}
"""What records each operation."""


def is_zero(number: Scalar) -> bool:
    """Return whether a number is known to be 0 while recording."""
    return number.is_zero if isinstance(number, Number) else number == 0.0
