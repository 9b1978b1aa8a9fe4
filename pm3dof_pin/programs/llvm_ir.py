"""Programs as a module of LLVM IR: straight lines on vectors of poses, and the loops around them.

The loops go over blocks of poses, over steps, along lines of a grid, and over the legs of a walk. Except for pointer
types, only syntax common to LLVM 14 and later is used. There are no fast-math flags: the text determines every
rounding, and quickly compiled and optimised code give identical bits.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import Walk, acceptance_program

HISTORY = 3
"""Number of poses before the last one that a march uses to predict the next."""

ANGLE_RANGE = 1e6
"""Largest magnitude of an angle that sine and cosine accept [rad]; NaN beyond it."""

# minimax polynomials and the three parts of pi/2 as in fdlibm (Sun Microsystems 1993), for |angle| <= pi/4, and
# |tangent| <= 7/16
_SIN = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
_ATAN = (
    -3.33333333333329318027e-01,
    1.99999999998764832476e-01,
    -1.42857142725034663711e-01,
    1.11111104054623557880e-01,
    -9.09088713343650656196e-02,
    7.69187620504482999495e-02,
    -6.66107313738753120669e-02,
    5.83357013379057348645e-02,
    -4.97687799461593236017e-02,
    3.65315727442169155270e-02,
    -1.62858201153657823623e-02,
)
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_QUARTER_PI = (0.5 * _HALF_PI[0], 0.5 * _HALF_PI[1])
_ROUND = 1.5 * 2.0**52  # adding and subtracting it rounds; the last bits of the sum are the integer
_SIGN = 1 << 63

STAGE = 4000
"""Greatest number of operations in a function."""

# arguments of the functions
_ROWS = "ptr %workspace, ptr %inputs, i64 %inputs_stride, ptr %parameters, ptr %outputs, i64 %outputs_stride, i64 %n"
_LINES = "ptr %workspace, ptr %inputs, i64 %inputs_stride, ptr %parameters, ptr %given, i64 %given_stride, i64 %n"
_STEPS = "double %tolerance, i64 %most"
_MARCH = "i64 %inputs_step, i64 %given_step, i64 %known, i64 %count, ptr %shares, double %mode"


def module(program: Program | Walk, lanes: int, opaque_pointers: bool, fused: bool, attributes: str = "") -> str:
    """Return the text of a module with the functions `evaluate` and, if the program permits, `iterate` and `march`.

    Those of a walk are the functions of its step. The first two take
    ``(workspace, inputs, stride, parameters, outputs, stride, n)``: aligned room for `workspace_size` doubles, rows of
    doubles, strides in doubles, counts and strides as 64-bit integers. `iterate` also takes a tolerance and the maximum
    number of steps; its rows of outputs are the last state and the residual at the start of the last step. With a walk,
    `start` is as `evaluate`; `walk` is as `iterate`, with the walk's whole state as inputs, and the status as residual.
    For `march` see :meth:`pm3dof_pin.programs.llvm.Compiled.march`.

    Args:
        program: the program, or a walk.
        lanes: number of poses computed at once, a power of two.
        opaque_pointers: whether pointers are untyped, as LLVM 17 and later require.
        fused: whether the processor has a fused multiply-add, a b + c rounded once.
        attributes: attributes of all functions.
    """
    walk = program if isinstance(program, Walk) else None
    program = program.step if isinstance(program, Walk) else program
    text = _Module(lanes, opaque_pointers, fused)
    lines = [line := _Line(text, "step", program)]
    text.evaluate("evaluate", line)
    if program.can_iterate:
        text.iterate("iterate", [line], len(program.inputs), program.state_size)
    if program.can_march:
        lines.append(_Line(text, "accept", acceptance_program()))
        text.march(line, lines[-1])
    if walk is not None:
        lines += (_Line(text, name, each) for name, each in (("start", walk.start), ("control", walk.control)))
        text.evaluate("start", lines[-2])
        text.iterate("walk", [line, lines[-1]], len(walk.start.results), walk.status)
    text.copies()
    size = lanes * max(line.workspace for line in lines)
    text.lines.append(f"define dso_local i64 @workspace_size() #0 {{\n  ret i64 {size}\n}}")
    return "\n".join([*text.lines, f"attributes #0 = {{ nounwind {attributes} }}", ""])


class _VectorText:
    """Text of a module under construction; vectors have one number per lane, one lane per pose computed at once."""

    def __init__(self, lanes: int, opaque_pointers: bool, fused: bool) -> None:
        self.lanes = lanes
        self.fused = fused
        self.vector = f"<{lanes} x double>"
        self.integers = f"<{lanes} x i64>"
        self.truths = f"<{lanes} x i1>"
        self.pointer = "ptr" if opaque_pointers else "double*"
        self.vector_pointer = "ptr" if opaque_pointers else f"{self.vector}*"
        self.lines = [
            f"declare {self.vector} @llvm.{function}.v{lanes}f64({', '.join([self.vector] * count)})"
            for function, count in (("sqrt", 1), ("fabs", 1), ("floor", 1), ("fma", 3))
        ]
        self._count = 0

    # instructions

    def emit(self, instruction: str) -> str:
        """Append an instruction and return the name of its result."""
        self._count += 1
        name = f"%t{self._count}"
        self.lines.append(f"  {name} = {instruction}")
        return name

    def do(self, instruction: str) -> None:
        """Append an instruction without a result."""
        self.lines.append(f"  {instruction}")

    def label(self, name: str) -> None:
        """Begin a block."""
        self.lines.append(f"{name}:")

    def splat(self, value: float) -> str:
        """Return a constant vector."""
        bits = f"double 0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"
        return f"<{', '.join([bits] * self.lanes)}>"

    def splat_integer(self, value: int) -> str:
        """Return a constant vector of integers."""
        return f"<{', '.join([f'i64 {value}'] * self.lanes)}>"

    def address(self, pointer: str, index: str | int) -> str:
        """Emit the address of a number of an array."""
        return self.emit(f"getelementptr double, {self.pointer} {pointer}, i64 {index}")

    def load(self, pointer: str, index: str | int) -> str:
        """Emit reading one number."""
        return self.emit(f"load double, {self.pointer} {self.address(pointer, index)}, align 8")

    def store(self, value: str, pointer: str, index: str | int) -> None:
        """Emit writing one number."""
        self.do(f"store double {value}, {self.pointer} {self.address(pointer, index)}, align 8")

    def vector_address(self, pointer: str, index: str | int) -> str:
        """Emit the address of a vector."""
        return self.emit(f"bitcast {self.pointer} {self.address(pointer, index)} to {self.vector_pointer}")

    def load_vector(self, pointer: str, index: str | int, align: int = 8) -> str:
        """Emit reading a vector."""
        address = self.vector_address(pointer, index)
        return self.emit(f"load {self.vector}, {self.vector_pointer} {address}, align {align}")

    def store_vector(self, value: str, pointer: str, index: str | int, align: int = 8) -> None:
        """Emit writing a vector."""
        address = self.vector_address(pointer, index)
        self.do(f"store {self.vector} {value}, {self.vector_pointer} {address}, align {align}")

    def spread(self, scalar: str, kind: str = "double") -> str:
        """Return a vector with the scalar in all lanes."""
        vector = f"<{self.lanes} x {kind}>"
        first = self.emit(f"insertelement {vector} poison, {kind} {scalar}, i32 0")
        return self.emit(f"shufflevector {vector} {first}, {vector} poison, <{self.lanes} x i32> zeroinitializer")

    # arithmetic on vectors

    def binary(self, instruction: str, a: str, b: str) -> str:
        """Emit an operation on two vectors."""
        return self.emit(f"{instruction} {self.vector} {a}, {b}")

    def add(self, a: str, b: str) -> str:
        """Emit a sum."""
        return self.binary("fadd", a, b)

    def subtract(self, a: str, b: str) -> str:
        """Emit a difference."""
        return self.binary("fsub", a, b)

    def multiply(self, a: str, b: str) -> str:
        """Emit a product."""
        return self.binary("fmul", a, b)

    def negative(self, a: str) -> str:
        """Emit a change of sign."""
        return self.emit(f"fneg {self.vector} {a}")

    def multiply_add(self, a: str, b: str, c: str) -> str:
        """Emit a b + c, rounded once if `fused`, where the processor does that in one operation."""
        if not self.fused:
            return self.add(self.multiply(a, b), c)
        v = self.vector
        return self.emit(f"call {v} @llvm.fma.v{self.lanes}f64({v} {a}, {v} {b}, {v} {c})")

    def compare(self, relation: str, a: str, b: str) -> str:
        """Emit a comparison, lane by lane."""
        return self.emit(f"fcmp {relation} {self.vector} {a}, {b}")

    def select(self, condition: str, a: str, b: str) -> str:
        """Emit a selection, lane by lane."""
        return self.emit(f"select {self.truths} {condition}, {self.vector} {a}, {self.vector} {b}")

    def call(self, function: str, a: str) -> str:
        """Emit an LLVM intrinsic function."""
        return self.emit(f"call {self.vector} @llvm.{function}.v{self.lanes}f64({self.vector} {a})")

    def bits(self, a: str) -> str:
        """Emit the bits of numbers as integers."""
        return self.emit(f"bitcast {self.vector} {a} to {self.integers}")

    def from_bits(self, a: str) -> str:
        """Emit the numbers that have these bits."""
        return self.emit(f"bitcast {self.integers} {a} to {self.vector}")

    def on_bits(self, instruction: str, a: str, b: str | int) -> str:
        """Emit an operation on integers."""
        other = self.splat_integer(b) if isinstance(b, int) else b
        return self.emit(f"{instruction} {self.integers} {a}, {other}")

    def flip_sign(self, a: str, sign: str) -> str:
        """Change the sign of `a` in lanes where the highest, and only, bit of the integers `sign` is set."""
        return self.from_bits(self.on_bits("xor", self.bits(a), sign))

    def polynomial(self, z: str, coefficients: tuple[float, ...]) -> str:
        """Emit a polynomial by Horner's rule, the constant coefficient first."""
        value = self.splat(coefficients[-1])
        for coefficient in reversed(coefficients[:-1]):
            value = self.multiply_add(value, z, self.splat(coefficient))
        return value

    def sine_and_cosine(self, angle: str) -> tuple[str, str]:
        """Emit both: reduction to [-pi/4, pi/4] in three parts, two polynomials, swapped and negated by quadrant."""
        inside = self.compare("ole", self.call("fabs", angle), self.splat(ANGLE_RANGE))
        x = self.select(inside, angle, self.splat(float("nan")))
        sum_ = self.multiply_add(x, self.splat(2.0 / 3.141592653589793), self.splat(_ROUND))
        quarters = self.subtract(sum_, self.splat(_ROUND))
        for part in _HALF_PI:
            x = self.multiply_add(quarters, self.splat(-part), x)
        z = self.multiply(x, x)
        sine = self.multiply_add(self.multiply(x, z), self.polynomial(z, _SIN), x)
        half = self.multiply(z, self.splat(0.5))
        near = self.subtract(self.splat(1.0), half)
        lost = self.subtract(self.subtract(self.splat(1.0), near), half)
        cosine = self.add(near, self.multiply_add(self.multiply(z, z), self.polynomial(z, _COS), lost))
        quadrant = self.bits(sum_)
        odd = self.emit(f"icmp ne {self.integers} {self.on_bits('and', quadrant, 1)}, zeroinitializer")
        sine_sign = self.on_bits("shl", self.on_bits("and", quadrant, 2), 62)
        cosine_sign = self.on_bits("shl", self.on_bits("and", self.on_bits("add", quadrant, 1), 2), 62)
        return (
            self.flip_sign(self.select(odd, cosine, sine), sine_sign),
            self.flip_sign(self.select(odd, sine, cosine), cosine_sign),
        )

    def arctangent(self, y: str, x: str) -> str:
        """Emit atan2: a polynomial of the tangent to the nearest of the five multiples of pi/4 in the half plane."""
        left = self.emit(f"icmp slt {self.integers} {self.bits(x)}, zeroinitializer")
        y_sign = self.emit(f"and {self.integers} {self.bits(y)}, {self.splat_integer(-_SIGN)}")
        a, b = self.call("fabs", y), self.call("fabs", x)
        steep = self.compare("ogt", a, b)
        most, least = self.select(steep, a, b), self.select(steep, b, a)
        one, infinity = self.splat(1.0), self.splat(float("inf"))
        infinite = self.compare("oeq", most, infinity)
        limit = self.select(self.compare("oeq", least, infinity), one, self.multiply(least, self.splat(0.0)))
        most, least = self.select(infinite, one, most), self.select(infinite, limit, least)
        diagonal = self.compare("ogt", least, self.multiply(most, self.splat(0.41421356237309503)))
        above = self.select(diagonal, self.subtract(least, most), least)
        below = self.select(diagonal, self.add(least, most), most)
        below = self.select(self.compare("oeq", below, self.splat(0.0)), one, below)
        tangent = self.binary("fdiv", above, below)
        z = self.multiply(tangent, tangent)
        angle = self.multiply_add(self.multiply(tangent, z), self.polynomial(z, _ATAN), tangent)
        turned = self.emit(f"xor {self.truths} {steep}, {left}")
        angle = self.select(turned, self.negative(angle), angle)
        eighths = self.select(diagonal, one, self.splat(0.0))
        eighths = self.select(steep, self.subtract(self.splat(2.0), eighths), eighths)
        eighths = self.select(left, self.subtract(self.splat(4.0), eighths), eighths)
        low = self.multiply_add(eighths, self.splat(_QUARTER_PI[1]), angle)
        return self.flip_sign(self.multiply_add(eighths, self.splat(_QUARTER_PI[0]), low), y_sign)

    def extreme(self, relation: str, a: str, b: str) -> str:
        """Emit the lesser ("olt") or greater ("ogt"): NaN if either is."""
        return self.select(self.compare("uno", a, a), a, self.select(self.compare(relation, a, b), a, b))

    def operation(self, operation: str, operands: Sequence[str]) -> str:
        """Emit an operation of a program, except sine and cosine."""
        match operation:  # LLVM names its instructions fadd, fsub, fmul, fdiv
            case "add" | "subtract" | "multiply" | "divide":
                return self.binary(f"f{operation[:3]}", *operands)
            case "negative":
                return self.negative(operands[0])
            case "sqrt" | "floor":
                return self.call(operation, operands[0])
            case "absolute":
                return self.call("fabs", operands[0])
            case "atan2":
                return self.arctangent(*operands)
            case "minimum":
                return self.extreme("olt", *operands)
            case "maximum":
                return self.extreme("ogt", *operands)
            case "less":
                return self.compare("olt", *operands)
            case "select":
                return self.select(*operands)
            case "not":
                return self.emit(f"xor {self.truths} {operands[0]}, <{', '.join(['i1 true'] * self.lanes)}>")
            case _:  # "and", "or"
                return self.emit(f"{operation} {self.truths} {operands[0]}, {operands[1]}")

    # functions

    def begin(self, name: str, arguments: str, internal: bool = True) -> None:
        """Begin a function."""
        linkage = "internal" if internal else "dso_local"
        self.lines.append(f"define {linkage} void @{name}({arguments}) {'noinline ' if internal else ''}#0 {{")
        self.label("entry")

    def end(self) -> None:
        """End a function."""
        self.do("ret void")
        self.lines.append("}")


class _Line:
    """A program as two functions: one fills a table of values shared by all poses, one is the straight line.

    Long ones are cut into stages, functions of their own: the frame of a function has room for all its values that do
    not fit into registers, and the time that LLVM takes grows faster than its length. Values that outlive a stage are
    kept in a workspace.
    """

    def __init__(self, text: _VectorText, name: str, program: Program) -> None:
        self._text = text
        self.name, self.program = name, program
        self.workspace = 0  #: vectors in the workspace
        self._differs = self._differing()
        self.shared = self._shared()
        self._products = self._fusible() if text.fused else {}
        self._fused = frozenset(self._products.values())
        self._prepare()
        self._straight_line()

    def _differing(self) -> list[bool]:
        """Return for each value whether it differs between poses."""
        differs = [number < len(self.program.inputs) for number in range(self.program.first_line)]
        for _, operands in self.program.lines:
            differs.append(any(differs[number] for number in operands))
        return differs

    def _shared(self) -> dict[int, int]:
        """Return the table indices of shared values that are used by per-pose values."""
        first_constant = len(self.program.inputs) + len(self.program.parameters)
        used = list(self.program.results)
        for number, (_, operands) in enumerate(self.program.lines, start=self.program.first_line):
            if self._differs[number]:
                used.extend(operands)
        places: dict[int, int] = {}
        for number in used:
            if not self._differs[number] and not first_constant <= number < self.program.first_line:
                places.setdefault(number, len(places))
        return places

    def _fusible(self) -> dict[int, int]:
        """Return the product of each sum or difference that can be fused with one, by number."""
        first, lines = self.program.first_line, self.program.lines
        uses = Counter(self.program.results)
        for _, operands in lines:
            uses.update(operands)
        products: dict[int, int] = {}
        for number, (operation, operands) in enumerate(lines, start=first):
            if operation in ("add", "subtract"):
                for operand in operands:
                    is_product = operand >= first and lines[operand - first][0] == "multiply"
                    if is_product and uses[operand] == 1 and self._differs[operand] == self._differs[number]:
                        products[number] = operand
                        break
        return products

    def _prepare(self) -> None:
        """Emit the function that fills the table of shared values."""
        text, first = self._text, len(self.program.inputs)

        def leaf(number: int) -> str:
            return self._constant(number) or text.spread(text.load("%parameters", number - first))

        def store(name: str, place: int) -> None:
            text.store(text.emit(f"extractelement {text.vector} {name}, i32 0"), "%shared", place)

        columns = {number: [place] for number, place in self.shared.items()}
        self._function(f"prepare_{self.name}", ("parameters", "shared"), False, leaf, columns, store)

    def _straight_line(self) -> None:
        """Emit the function that computes a block of poses, one value of all lanes at a time."""
        text, lanes = self._text, self._text.lanes
        columns: dict[int, list[int]] = {}
        for column, number in enumerate(self.program.results):
            columns.setdefault(number, []).append(column)

        def leaf(number: int) -> str:
            if number in self.shared:
                return self._as_condition(number, text.spread(text.load("%shared", self.shared[number])))
            return self._constant(number) or text.load_vector("%inputs", lanes * number, 8 * lanes)

        def store(name: str, column: int) -> None:
            text.store_vector(name, "%outputs", lanes * column, 8 * lanes)

        self._function(f"line_{self.name}", ("inputs", "shared", "outputs"), True, leaf, columns, store)

    def _function(
        self,
        name: str,
        arguments: Sequence[str],
        differs: bool,
        leaf: Callable[[int], str],
        columns: Mapping[int, Sequence[int]],
        store: Callable[[str, int], None],
    ) -> None:
        """Emit a function of the lines that differ between poses, or of the others.

        `leaf` returns a value that is not one of them, `store` writes one to a column.
        """
        text, first, width = self._text, self.program.first_line, self._text.lanes
        everything = range(first, first + len(self.program.lines))
        lines = [number for number in everything if self._differs[number] == differs and number not in self._fused]
        stages = [lines[k : k + STAGE] for k in range(0, len(lines), STAGE)] or [[]]
        last = {operand: k for k, stage in enumerate(stages) for number in stage for operand in self._operands(number)}
        pointers = ", ".join(f"{text.pointer} noalias %{argument}" for argument in (*arguments, "workspace"))
        slots: dict[int, int] = {}
        free: list[int] = []
        for k, stage in enumerate(stages):
            text.begin(f"{name}_{k}" if len(stages) > 1 else name, pointers)
            names: dict[int, str] = {}
            angles: dict[int, tuple[str, str]] = {}

            def value(number: int, names: Mapping[int, str] = names) -> str:
                if number in names:
                    return names[number]
                if number in slots:
                    kept = text.load_vector("%workspace", width * slots[number], 8 * width)
                    return self._as_condition(number, kept)
                return leaf(number)

            for number in stage:
                names[number] = self._emitted(number, value, angles)
                for column in columns.get(number, ()):
                    store(self._as_number(number, names[number]), column)
                if last.get(number, k) > k:
                    slots[number] = free.pop() if free else len(slots)
                    kept = self._as_number(number, names[number])
                    text.store_vector(kept, "%workspace", width * slots[number], 8 * width)
            self.workspace = max(self.workspace, len(slots) + len(free))
            for number in [number for number in slots if last[number] == k]:
                free.append(slots.pop(number))
            if k == len(stages) - 1:
                for number, places in columns.items():
                    for column in places if not (number >= first and self._differs[number] == differs) else ():
                        store(leaf(number), column)
            text.end()
        if len(stages) > 1:
            text.begin(name, pointers)
            for k in range(len(stages)):
                text.do(f"call void @{name}_{k}({pointers.replace(' noalias', '')})")
            text.end()

    def _operands(self, number: int) -> tuple[int, ...]:
        """Return the operands of a line, including those of a product that is fused into it."""
        lines, first = self.program.lines, self.program.first_line
        operands = lines[number - first][1]
        product = self._products.get(number)
        return operands if product is None else (*operands, *lines[product - first][1])

    def _emitted(self, number: int, value: Callable[[int], str], angles: dict[int, tuple[str, str]]) -> str:
        """Emit a line."""
        text = self._text
        operation, operands = self.program.lines[number - self.program.first_line]
        if number in self._products:
            product = self._products[number]
            x, y = map(value, self.program.lines[product - self.program.first_line][1])
            if operands[0] == product:
                other = value(operands[1])
                return text.multiply_add(x, y, other if operation == "add" else text.negative(other))
            return text.multiply_add(x if operation == "add" else text.negative(x), y, value(operands[0]))
        if operation in ("sin", "cos"):
            if operands[0] not in angles:
                angles[operands[0]] = text.sine_and_cosine(value(operands[0]))
            return angles[operands[0]][operation == "cos"]
        return text.operation(operation, [value(operand) for operand in operands])

    def _constant(self, number: int) -> str:
        """Return a constant, or nothing if the value is none."""
        first = len(self.program.inputs) + len(self.program.parameters)
        is_constant = first <= number < self.program.first_line
        return self._text.splat(self.program.constants[number - first]) if is_constant else ""

    def _is_condition(self, number: int) -> bool:
        line = number - self.program.first_line
        return line >= 0 and self.program.lines[line][0] in ("less", "and", "or", "not")

    def _as_number(self, number: int, name: str) -> str:
        """Return a value as it is stored."""
        text = self._text
        return text.select(name, text.splat(1.0), text.splat(0.0)) if self._is_condition(number) else name

    def _as_condition(self, number: int, name: str) -> str:
        """Return a stored value."""
        return self._text.compare("une", name, self._text.splat(0.0)) if self._is_condition(number) else name


class _Module(_VectorText):
    """The text under construction."""

    def __init__(self, lanes: int, opaque_pointers: bool, fused: bool) -> None:
        super().__init__(lanes, opaque_pointers, fused)
        self._copies: set[tuple[str, int]] = set()

    def evaluate(self, name: str, line: _Line) -> None:
        """Emit the loop over blocks of poses."""
        program = line.program
        self.begin_function(name, _ROWS, lines=[line], block_inputs=len(program.inputs))
        self.begin_blocks("loop")
        self.gather("inputs", len(program.inputs))
        self.call_line(line)
        self.scatter("outputs", len(program.results), "%block_outputs")
        self.end_blocks()

    def iterate(self, name: str, lines: Sequence[_Line], inputs: int, n: int) -> None:
        """Emit the loop over blocks of poses, and in it the loop over steps, which compute n numbers and a residual.

        A step is one line; or two, of which the second takes the results of the first, then the inputs of both.
        """
        self.begin_function(name, _ROWS, _STEPS, lines=lines, block_inputs=inputs + 2)
        tolerance = self.spread("%tolerance")
        self.begin_blocks("done")
        self.gather("inputs", inputs)
        self.do("br label %step")
        self.steps("loop", lines, n, tolerance)
        self.store_vector("%residual_next", "%block_inputs", n * self.lanes)
        self.scatter("outputs", n + 1, "%block_inputs")
        self.end_blocks()

    def steps(self, before: str, lines: Sequence[_Line], n: int, tolerance: str) -> None:
        """Emit the loop over steps of a block, entered from the label `before`, and the label `done` after it."""
        self.label("step")
        zeros = "zeroinitializer"
        everywhere = f"<{', '.join(['i1 true'] * self.lanes)}>"
        self.do(f"%taken = phi i64 [ 0, %{before} ], [ %taken_next, %step ]")
        self.do(f"%active = phi {self.truths} [ {everywhere}, %{before} ], [ %active_next, %step ]")
        self.do(f"%residual = phi {self.vector} [ {zeros}, %{before} ], [ %residual_next, %step ]")
        if len(lines) == 1:
            self.call_line(lines[0])
        else:
            self.call_line(lines[0], outputs="%results")
            self.call_line(lines[1], inputs="%results")
        for k in range(n):
            old = self.load_vector("%block_inputs", k * self.lanes)
            new = self.load_vector("%block_outputs", k * self.lanes)
            self.store_vector(self.select("%active", new, old), "%block_inputs", k * self.lanes)
        fresh = self.load_vector("%block_outputs", n * self.lanes)
        self.do(f"%residual_next = select {self.truths} %active, {self.vector} {fresh}, {self.vector} %residual")
        self.do("%taken_next = add i64 %taken, 1")
        above = self.compare("ogt", fresh, tolerance)
        self.do(f"%active_next = and {self.truths} %active, {above}")
        mask = self.emit(f"bitcast {self.truths} %active_next to i{self.lanes}")
        some = self.emit(f"icmp ne i{self.lanes} {mask}, 0")
        again = self.emit(f"and i1 {some}, {self.emit('icmp slt i64 %taken_next, %most')}")
        self.do(f"br i1 {again}, label %step, label %done")
        self.label("done")

    def march(self, line: _Line, accept: _Line) -> None:
        """Emit the loop over blocks of lines, the loop along them, and in it the loop over steps."""
        n, inputs = line.program.state_size, len(line.program.inputs)
        size, lanes = n - 2, self.lanes
        names = ("current", *(f"previous_{back}" for back in range(1, HISTORY + 1)))
        self.begin_function(
            "march", _LINES, _STEPS, _MARCH, lines=[line, accept], block_inputs=inputs + 2, **dict.fromkeys(names, size)
        )
        tolerance, mode = (self.spread(f"%{x}") for x in ("tolerance", "mode"))
        self.begin_blocks("closed")
        self.gather("inputs", size, "%current")
        for back in range(1, HISTORY + 1):
            is_known = self.emit(f"icmp slt i64 {back}, %known")
            place = self.emit(f"mul i64 {self.emit(f'select i1 {is_known}, i64 {-back}, i64 0')}, %inputs_step")
            self.gather("inputs", size, f"%previous_{back}", place)
            for k in range(size):
                now, before = (self.load_vector(x, k * lanes) for x in ("%current", f"%previous_{back}"))
                usable = self.select(self.compare("ord", before, before), before, now)
                self.store_vector(usable, f"%previous_{back}", k * lanes)
        self.do("br label %along")
        self.label("along")
        self.do("%index = phi i64 [ 1, %loop ], [ %index_next, %done ]")
        first_share = self.emit(f"mul i64 {self.emit('sub i64 %index, 1')}, {HISTORY}")
        shares_here = self.address("%shares", first_share)
        shares = [self.spread(self.load(shares_here, back)) for back in range(HISTORY)]
        for k in range(size):
            points = [
                self.load_vector(x, k * lanes) for x in ("%current", *(f"%previous_{j + 1}" for j in range(HISTORY)))
            ]
            ahead = points[0]
            for share, point in zip(shares, points[1:], strict=True):
                ahead = self.multiply_add(self.subtract(points[0], point), share, ahead)
            self.store_vector(ahead, "%block_inputs", k * lanes)
            for back, point in enumerate(points[:-1], start=1):
                self.store_vector(point, f"%previous_{back}", k * lanes)
        self.store_vector(self.splat(1.0), "%block_inputs", size * lanes)
        self.store_vector(self.splat(0.0), "%block_inputs", (size + 1) * lanes)
        self.do("%given_place = mul i64 %index, %given_step")
        block = self.address("%block_inputs", n * lanes)
        self.gather("given", inputs - n, block, "%given_place")
        self.do("br label %step")
        self.steps("along", [line], n, tolerance)
        self.store_vector("%residual_next", "%block_inputs", n * lanes)  # after margin and jump
        self.store_vector(mode, "%block_inputs", (n + 1) * lanes)
        self.call_line(accept, self.address("%block_inputs", size * lanes))
        accepted = self.compare("ogt", self.load_vector("%block_outputs", 0), self.splat(0.0))
        for k in range(size):
            found = self.load_vector("%block_inputs", k * lanes)
            self.store_vector(self.select(accepted, found, self.splat(float("nan"))), "%current", k * lanes)
        self.do("%place = mul i64 %index, %inputs_step")
        self.scatter("inputs", size, "%current", "%place")
        self.do("%index_next = add i64 %index, 1")
        self.do("%further = icmp sle i64 %index_next, %count")
        self.do("br i1 %further, label %along, label %closed")
        self.label("closed")
        self.end_blocks()

    # loops over blocks of poses; lanes past the end repeat the last pose, which is written again

    def begin_function(self, name: str, *arguments: str, lines: Sequence[_Line], **buffers: int) -> None:
        """Begin a function on blocks of rows, with the values that lines share for all poses, and buffers of vectors.

        The results of the first of two lines are directly before the inputs of the block.
        """
        p, before = self.pointer, len(lines[0].program.results)
        self.begin(name, ", ".join(arguments).replace("ptr", f"{p} noalias"), internal=False)
        outputs = max(1, *(len(line.program.results) for line in lines))
        sizes = {f"shared_{line.name}": max(1, len(line.shared)) for line in lines}
        buffers = {"block_outputs": outputs, **buffers}
        buffers["results"] = before + buffers.pop("block_inputs")
        sizes |= {buffer: self.lanes * max(1, size) for buffer, size in buffers.items()}
        for buffer, size in sizes.items():
            array = self.emit(f"alloca [{size} x double], align 64")
            typed = "ptr" if p == "ptr" else f"[{size} x double]*"
            self.do(f"%{buffer} = bitcast {typed} {array} to {p}")
        self.do(f"%block_inputs = getelementptr double, {p} %results, i64 {before * self.lanes}")
        for line in lines:
            self.do(f"call void @prepare_{line.name}({p} %parameters, {p} %shared_{line.name}, {p} %workspace)")
        self.do("%last = sub i64 %n, 1")

    def begin_blocks(self, latch: str) -> None:
        """Begin the loop over blocks; its last label is `latch`."""
        self.do("%some = icmp sgt i64 %n, 0")
        self.do("br i1 %some, label %loop, label %end")
        self.label("loop")
        self.do(f"%first = phi i64 [ 0, %entry ], [ %next, %{latch} ]")

    def end_blocks(self) -> None:
        self.do(f"%next = add i64 %first, {self.lanes}")
        self.do("%more = icmp slt i64 %next, %n")
        self.do("br i1 %more, label %loop, label %end")
        self.label("end")
        self.end()

    def call_line(self, line: _Line, inputs: str = "%block_inputs", outputs: str = "%block_outputs") -> None:
        p = self.pointer
        self.do(f"call void @line_{line.name}({p} {inputs}, {p} %shared_{line.name}, {p} {outputs}, {p} %workspace)")

    def transpose(self, rows: list[str]) -> list[str]:
        step = 1
        while step < self.lanes:
            for i in range(self.lanes):
                if not i & step:
                    a, b = rows[i], rows[i + step]
                    low = [j if not j & step else self.lanes + j - step for j in range(self.lanes)]
                    high = [j + step if not j & step else self.lanes + j for j in range(self.lanes)]
                    rows[i], rows[i + step] = self.shuffle(a, b, low), self.shuffle(a, b, high)
            step *= 2
        return rows

    def shuffle(self, a: str, b: str, picked: list[int]) -> str:
        mask = ", ".join(f"i32 {index}" for index in picked)
        return self.emit(f"shufflevector {self.vector} {a}, {self.vector} {b}, <{self.lanes} x i32> <{mask}>")

    def gather(self, array: str, n: int, block: str = "%block_inputs", offset: str = "0") -> None:
        """Emit reading n columns of the rows in the lanes, from an offset, into vectors of a block."""
        self._copy("gather", array, n, block, offset)

    def scatter(self, array: str, n: int, block: str, offset: str = "0") -> None:
        """Emit writing n vectors of a block to columns of the rows in the lanes, from an offset."""
        self._copy("scatter", array, n, block, offset)

    def _copy(self, direction: str, array: str, n: int, block: str, offset: str) -> None:
        if n:
            width, p = self.lanes if n >= self.lanes else 1, self.pointer
            self._copies.add((direction, width))
            start = self.address(f"%{array}", offset)
            rows = f"{p} {start}, i64 %{array}_stride, i64 %first, i64 %last"
            self.do(f"call void @{direction}_{width}({rows}, i64 {n}, {p} {block})")

    def copies(self) -> None:
        """Emit the functions that gather and scatter, either one column per lane at a time, or one by one.

        The last columns may be copied twice.
        """
        p, lanes = self.pointer, self.lanes
        rows = f"{p} noalias %array, i64 %stride, i64 %first, i64 %last"
        for direction, width in sorted(self._copies):
            self.begin(f"{direction}_{width}", f"{rows}, i64 %count, {p} noalias %block")
            pointers = []
            for lane in range(lanes):
                row = self.emit(f"add i64 %first, {lane}")
                inside = self.emit(f"icmp slt i64 {row}, %last")
                row = self.emit(f"select i1 {inside}, i64 {row}, i64 %last")
                pointers.append(self.address("%array", self.emit(f"mul i64 {row}, %stride")))
            self.do(f"%final = sub i64 %count, {width}")
            self.do("br label %loop")
            self.label("loop")
            self.do("%column = phi i64 [ 0, %entry ], [ %next, %loop ]")
            self.do("%before = icmp slt i64 %column, %final")
            self.do("%start = select i1 %before, i64 %column, i64 %final")
            vectors = self.address("%block", self.emit(f"mul i64 %start, {lanes}"))
            if direction == "gather" and width > 1:
                columns = self.transpose([self.load_vector(pointer, "%start") for pointer in pointers])
                for k, column in enumerate(columns):
                    self.store_vector(column, vectors, k * lanes)
            elif direction == "gather":
                vector = "poison"
                for lane, pointer in enumerate(pointers):
                    number = self.load(pointer, "%start")
                    vector = self.emit(f"insertelement {self.vector} {vector}, double {number}, i32 {lane}")
                self.store_vector(vector, vectors, 0)
            elif width > 1:
                columns = [self.load_vector(vectors, k * lanes) for k in range(lanes)]
                for pointer, values in zip(pointers, self.transpose(columns), strict=True):
                    self.store_vector(values, pointer, "%start")
            else:
                vector = self.load_vector(vectors, 0)
                for lane, pointer in enumerate(pointers):
                    self.store(self.emit(f"extractelement {self.vector} {vector}, i32 {lane}"), pointer, "%start")
            self.do(f"%next = add i64 %column, {width}")
            self.do("%more = icmp slt i64 %next, %count")
            self.do("br i1 %more, label %loop, label %end")
            self.label("end")
            self.end()
