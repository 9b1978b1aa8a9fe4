"""A program as LLVM's text: the straight line on vectors of poses, and the loops that drive it.

Only what every LLVM from 14 on reads the same way is used, except for the spelling of pointers. There is no fast-math
flag but `contract`, which lets a product and a sum become one fused operation.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable

from pm3dof_pin.programs.program import Program

ANGLE_RANGE = 1e6
"""Largest magnitude of an angle that sine and cosine accept [rad]; NaN beyond it."""

HISTORY = 3
"""Poses before the last one from which a march predicts the next."""

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
_ROUND = 1.5 * 2.0**52  # added and taken away again it rounds; the last bits of the sum are the whole number
_SIGN = 1 << 63

# arguments of the functions
_ROWS = "ptr %inputs, i64 %inputs_stride, ptr %parameters, ptr %outputs, i64 %outputs_stride, i64 %n"
_LINES = "ptr %inputs, i64 %inputs_stride, ptr %parameters, ptr %given, i64 %given_stride, i64 %n"
_STEPS = "double %tolerance, i64 %most"
_MARCH = (
    "i64 %inputs_step, i64 %given_step, i64 %known, i64 %count, ptr %shares, double %lower, double %upper, "
    "double %longest"
)


def module(program: Program, lanes: int, opaque_pointers: bool, attributes: str = "") -> str:
    """Return the text of a module with the function `evaluate` and, where the program allows, `iterate` and `march`.

    The first two take ``(inputs, stride, parameters, outputs, stride, n)``: rows of doubles, strides in doubles, counts
    and strides as 64-bit integers. `iterate` takes a tolerance and the greatest number of steps besides; its rows of
    outputs are the last state, the residual that the last step began with, and the number of steps. For `march` see
    :meth:`pm3dof_pin.programs.llvm.Compiled.march`.

    Args:
        program: the program.
        lanes: poses computed at once, a power of two.
        opaque_pointers: whether pointers are spelt without their type, as LLVM 17 and later want it.
        attributes: attributes of all functions.
    """
    text = _Module(program, lanes, opaque_pointers)
    text.prepare()
    text.straight_line()
    text.evaluate()
    if can_iterate(program):
        text.iterate()
    if can_march(program):
        text.march()
    return "\n".join([*text.lines, f"attributes #0 = {{ nounwind {attributes} }}", ""])


def state_size(program: Program) -> int:
    """Return the number of outputs before the last one, the residual."""
    return len(program.results) - 1


def can_iterate(program: Program) -> bool:
    """Whether the outputs can be the next values of the first inputs, and a residual."""
    return 1 <= state_size(program) <= len(program.inputs)


def can_march(program: Program) -> bool:
    """Whether the program closes loops, its state being q, `margin` and `jump`."""
    return can_iterate(program) and tuple(program.outputs) == ("q", "margin", "jump", "residual")


class _Module:
    """The text under construction."""

    def __init__(self, program: Program, lanes: int, opaque_pointers: bool) -> None:
        self.program = program
        self.lanes = lanes
        self.vector = f"<{lanes} x double>"
        self.integers = f"<{lanes} x i64>"
        self.truths = f"<{lanes} x i1>"
        self.pointer = "ptr" if opaque_pointers else "double*"
        self.vector_pointer = "ptr" if opaque_pointers else f"{self.vector}*"
        self.lines = [
            f"declare {self.vector} @llvm.{function}.v{lanes}f64({self.vector})" for function in ("sqrt", "fabs")
        ]
        self.count = 0
        self.per_pose = self._per_pose()
        self.shared = self._shared()

    # what is computed for every pose, and what is the same for all

    def _per_pose(self) -> list[bool]:
        """Return for every value whether it differs from pose to pose."""
        differs = [number < len(self.program.inputs) for number in range(self.program.first_line)]
        for _, operands in self.program.lines:
            differs.append(any(differs[number] for number in operands))
        return differs

    def _shared(self) -> dict[int, int]:
        """Return places in the table of values that are the same for all poses and are used by one that is not."""
        first_constant = len(self.program.inputs) + len(self.program.parameters)
        used = list(self.program.results)
        for number, (_, operands) in enumerate(self.program.lines, start=self.program.first_line):
            if self.per_pose[number]:
                used.extend(operands)
        places: dict[int, int] = {}
        for number in used:
            if not self.per_pose[number] and not first_constant <= number < self.program.first_line:
                places.setdefault(number, len(places))
        return places

    # instructions

    def emit(self, instruction: str) -> str:
        """Append an instruction and return the name of its result."""
        self.count += 1
        name = f"%t{self.count}"
        self.lines.append(f"  {name} = {instruction}")
        return name

    def do(self, instruction: str) -> None:
        """Append an instruction without a result."""
        self.lines.append(f"  {instruction}")

    def label(self, name: str) -> None:
        self.lines.append(f"{name}:")

    def splat(self, value: float) -> str:
        bits = f"double 0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"
        return f"<{', '.join([bits] * self.lanes)}>"

    def splat_integer(self, value: int) -> str:
        return f"<{', '.join([f'i64 {value}'] * self.lanes)}>"

    def address(self, pointer: str, index: str | int) -> str:
        return self.emit(f"getelementptr double, {self.pointer} {pointer}, i64 {index}")

    def load(self, pointer: str, index: str | int) -> str:
        return self.emit(f"load double, {self.pointer} {self.address(pointer, index)}, align 8")

    def store(self, value: str, pointer: str, index: str | int) -> None:
        self.do(f"store double {value}, {self.pointer} {self.address(pointer, index)}, align 8")

    def vector_address(self, pointer: str, index: str | int) -> str:
        return self.emit(f"bitcast {self.pointer} {self.address(pointer, index)} to {self.vector_pointer}")

    def load_vector(self, pointer: str, index: str | int, align: int = 8) -> str:
        address = self.vector_address(pointer, index)
        return self.emit(f"load {self.vector}, {self.vector_pointer} {address}, align {align}")

    def store_vector(self, value: str, pointer: str, index: str | int, align: int = 8) -> None:
        address = self.vector_address(pointer, index)
        self.do(f"store {self.vector} {value}, {self.vector_pointer} {address}, align {align}")

    def spread(self, scalar: str, kind: str = "double") -> str:
        """Return a vector with the scalar in all lanes."""
        vector = f"<{self.lanes} x {kind}>"
        first = self.emit(f"insertelement {vector} poison, {kind} {scalar}, i32 0")
        return self.emit(f"shufflevector {vector} {first}, {vector} poison, <{self.lanes} x i32> zeroinitializer")

    # arithmetic on vectors

    def binary(self, instruction: str, a: str, b: str) -> str:
        flag = "" if instruction == "fdiv" else " contract"
        return self.emit(f"{instruction}{flag} {self.vector} {a}, {b}")

    def add(self, a: str, b: str) -> str:
        return self.binary("fadd", a, b)

    def subtract(self, a: str, b: str) -> str:
        return self.binary("fsub", a, b)

    def multiply(self, a: str, b: str) -> str:
        return self.binary("fmul", a, b)

    def compare(self, relation: str, a: str, b: str) -> str:
        return self.emit(f"fcmp {relation} {self.vector} {a}, {b}")

    def select(self, condition: str, a: str, b: str) -> str:
        return self.emit(f"select {self.truths} {condition}, {self.vector} {a}, {self.vector} {b}")

    def call(self, function: str, a: str) -> str:
        return self.emit(f"call {self.vector} @llvm.{function}.v{self.lanes}f64({self.vector} {a})")

    def bits(self, a: str) -> str:
        return self.emit(f"bitcast {self.vector} {a} to {self.integers}")

    def from_bits(self, a: str) -> str:
        return self.emit(f"bitcast {self.integers} {a} to {self.vector}")

    def on_bits(self, instruction: str, a: str, b: str | int) -> str:
        other = self.splat_integer(b) if isinstance(b, int) else b
        return self.emit(f"{instruction} {self.integers} {a}, {other}")

    def flip_sign(self, a: str, sign: str) -> str:
        """Change the sign of `a` in lanes in which the highest bit of the integers `sign` is set, their only one."""
        return self.from_bits(self.on_bits("xor", self.bits(a), sign))

    def polynomial(self, z: str, coefficients: tuple[float, ...]) -> str:
        value = self.splat(coefficients[-1])
        for coefficient in reversed(coefficients[:-1]):
            value = self.add(self.multiply(value, z), self.splat(coefficient))
        return value

    def sine_and_cosine(self, angle: str) -> tuple[str, str]:
        """Emit both: reduction to [-pi/4, pi/4] in three parts, two polynomials, exchanged and turned by quadrant."""
        inside = self.compare("ole", self.call("fabs", angle), self.splat(ANGLE_RANGE))
        x = self.select(inside, angle, self.splat(float("nan")))
        sum_ = self.add(self.multiply(x, self.splat(2.0 / 3.141592653589793)), self.splat(_ROUND))
        quarters = self.subtract(sum_, self.splat(_ROUND))
        for part in _HALF_PI:
            x = self.subtract(x, self.multiply(quarters, self.splat(part)))
        z = self.multiply(x, x)
        sine = self.add(x, self.multiply(self.multiply(x, z), self.polynomial(z, _SIN)))
        half = self.multiply(z, self.splat(0.5))
        near = self.subtract(self.splat(1.0), half)
        lost = self.subtract(self.subtract(self.splat(1.0), near), half)
        cosine = self.add(near, self.add(lost, self.multiply(self.multiply(z, z), self.polynomial(z, _COS))))
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
        angle = self.add(tangent, self.multiply(self.multiply(tangent, z), self.polynomial(z, _ATAN)))
        turned = self.emit(f"xor {self.truths} {steep}, {left}")
        angle = self.select(turned, self.emit(f"fneg {self.vector} {angle}"), angle)
        eighths = self.select(diagonal, one, self.splat(0.0))
        eighths = self.select(steep, self.subtract(self.splat(2.0), eighths), eighths)
        eighths = self.select(left, self.subtract(self.splat(4.0), eighths), eighths)
        low = self.add(self.multiply(eighths, self.splat(_QUARTER_PI[1])), angle)
        return self.flip_sign(self.add(self.multiply(eighths, self.splat(_QUARTER_PI[0])), low), y_sign)

    def extreme(self, relation: str, a: str, b: str) -> str:
        """Emit the lesser ("olt") or greater ("ogt"): NaN where one of them is."""
        return self.select(self.compare("uno", a, a), a, self.select(self.compare(relation, a, b), a, b))

    def straight(self, numbers: Iterable[int], value: Callable[[int], str], keep: Callable[[int, str], None]) -> None:
        """Emit the lines of these numbers.

        Args:
            numbers: numbers of the values to make, ascending.
            value: gives the name that a value has, emitting what it takes to have it.
            keep: told the name of every value made.
        """
        angles: dict[int, tuple[str, str]] = {}
        for number in numbers:
            operation, operands = self.program.lines[number - self.program.first_line]
            if operation in ("sin", "cos"):
                if operands[0] not in angles:
                    angles[operands[0]] = self.sine_and_cosine(value(operands[0]))
                name = angles[operands[0]][operation == "cos"]
            else:
                name = self.operation(operation, [value(operand) for operand in operands])
            keep(number, name)

    def operation(self, operation: str, operands: list[str]) -> str:
        match operation:
            case "add" | "subtract" | "multiply" | "divide":
                instruction = {"add": "fadd", "subtract": "fsub", "multiply": "fmul", "divide": "fdiv"}[operation]
                return self.binary(instruction, *operands)
            case "negative":
                return self.emit(f"fneg {self.vector} {operands[0]}")
            case "sqrt":
                return self.call("sqrt", operands[0])
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
        linkage = "internal" if internal else "dso_local"
        self.lines.append(f"define {linkage} void @{name}({arguments}) {'noinline ' if internal else ''}#0 {{")
        self.label("entry")

    def end(self) -> None:
        self.do("ret void")
        self.lines.append("}")

    def prepare(self) -> None:
        """Emit the function that fills the table of what is the same for all poses."""
        program, first = self.program, len(self.program.inputs)
        first_constant = first + len(program.parameters)
        self.begin("prepare", f"{self.pointer} noalias %parameters, {self.pointer} noalias %shared")
        names: dict[int, str] = {}

        def value(number: int) -> str:
            if number not in names:
                constant = number >= first_constant
                names[number] = (
                    self.splat(program.constants[number - first_constant])
                    if constant
                    else self.spread(self.load("%parameters", number - first))
                )
            return names[number]

        everything = range(program.first_line, program.first_line + len(program.lines))
        self.straight(
            (number for number in everything if not self.per_pose[number]),
            value,
            lambda number, name: names.update({number: name}),
        )
        for number, place in self.shared.items():
            name = value(number)
            if self.is_condition(number):
                name = self.select(name, self.splat(1.0), self.splat(0.0))
            scalar = self.emit(f"extractelement {self.vector} {name}, i32 0")
            self.store(scalar, "%shared", place)
        self.end()

    def is_condition(self, number: int) -> bool:
        line = number - self.program.first_line
        return line >= 0 and self.program.lines[line][0] in ("less", "and", "or", "not")

    def straight_line(self) -> None:
        """Emit the function that computes a block of poses, one value of all lanes after the other."""
        program, lanes = self.program, self.lanes
        first_constant = len(program.inputs) + len(program.parameters)
        pointers = (f"{self.pointer} noalias %{name}" for name in ("inputs", "shared", "outputs"))
        self.begin("line", ", ".join(pointers))
        names: dict[int, str] = {}
        columns: dict[int, list[int]] = {}
        for column, number in enumerate(program.results):
            columns.setdefault(number, []).append(column)

        def value(number: int) -> str:
            if number in names:
                return names[number]
            if number in self.shared:
                vector = self.spread(self.load("%shared", self.shared[number]))
                return self.compare("une", vector, self.splat(0.0)) if self.is_condition(number) else vector
            if number < len(program.inputs):
                return self.load_vector("%inputs", lanes * number, 8 * lanes)
            return self.splat(program.constants[number - first_constant])

        def keep(number: int, name: str) -> None:
            names[number] = name
            for column in columns.pop(number, ()):
                self.store_vector(name, "%outputs", lanes * column, 8 * lanes)

        everything = range(program.first_line, program.first_line + len(program.lines))
        self.straight((number for number in everything if self.per_pose[number]), value, keep)
        for number in tuple(columns):
            keep(number, value(number))
        self.end()

    def evaluate(self) -> None:
        """Emit the loop over blocks of poses."""
        self.begin_function("evaluate", _ROWS)
        self.begin_blocks("loop")
        self.gather(self.rows_of("inputs"), len(self.program.inputs))
        self.call_line()
        self.scatter(self.rows_of("outputs"), len(self.program.results), "%block_outputs")
        self.end_blocks()

    def iterate(self) -> None:
        """Emit the loop over blocks of poses, and in it the loop over steps."""
        n = state_size(self.program)
        self.begin_function("iterate", _ROWS, _STEPS)
        tolerance = self.spread("%tolerance")
        self.begin_blocks("done")
        self.gather(self.rows_of("inputs"), len(self.program.inputs))
        self.do("br label %step")
        self.steps("loop", tolerance)
        self.store_vector("%residual_next", "%block_inputs", n * self.lanes)
        self.store_vector("%steps_next", "%block_inputs", (n + 1) * self.lanes)
        self.scatter(self.rows_of("outputs"), n + 2, "%block_inputs")
        self.end_blocks()

    def steps(self, before: str, tolerance: str) -> None:
        """Emit the loop over steps of a block, entered from the label `before`, and the label `done` after it."""
        n = state_size(self.program)
        self.label("step")
        zeros = "zeroinitializer"
        everywhere = f"<{', '.join(['i1 true'] * self.lanes)}>"
        self.do(f"%taken = phi i64 [ 0, %{before} ], [ %taken_next, %step ]")
        self.do(f"%active = phi {self.truths} [ {everywhere}, %{before} ], [ %active_next, %step ]")
        self.do(f"%residual = phi {self.vector} [ {zeros}, %{before} ], [ %residual_next, %step ]")
        self.do(f"%steps = phi {self.vector} [ {zeros}, %{before} ], [ %steps_next, %step ]")
        self.call_line()
        for k in range(n):
            old = self.load_vector("%block_inputs", k * self.lanes)
            new = self.load_vector("%block_outputs", k * self.lanes)
            self.store_vector(self.select("%active", new, old), "%block_inputs", k * self.lanes)
        fresh = self.load_vector("%block_outputs", n * self.lanes)
        self.do(f"%residual_next = select {self.truths} %active, {self.vector} {fresh}, {self.vector} %residual")
        one_more = self.add("%steps", self.splat(1.0))
        self.do(f"%steps_next = select {self.truths} %active, {self.vector} {one_more}, {self.vector} %steps")
        self.do("%taken_next = add i64 %taken, 1")
        above = self.compare("ogt", fresh, tolerance)
        self.do(f"%active_next = and {self.truths} %active, {above}")
        mask = self.emit(f"bitcast {self.truths} %active_next to i{self.lanes}")
        some = self.emit(f"icmp ne i{self.lanes} {mask}, 0")
        again = self.emit(f"and i1 {some}, {self.emit('icmp slt i64 %taken_next, %most')}")
        self.do(f"br i1 {again}, label %step, label %done")
        self.label("done")

    def march(self) -> None:
        """Emit the loop over blocks of lines, the loop along them, and in it the loop over steps."""
        n = state_size(self.program)
        size, lanes = n - 2, self.lanes
        names = ("current", *(f"previous_{back}" for back in range(1, HISTORY + 1)))
        self.begin_function("march", _LINES, _STEPS, _MARCH, **dict.fromkeys(names, size))
        tolerance, lower, upper, most = (self.spread(f"%{x}") for x in ("tolerance", "lower", "upper", "longest"))
        self.begin_blocks("closed")
        self.gather(self.rows_of("inputs"), size, "%current")
        for back in range(1, HISTORY + 1):
            is_known = self.emit(f"icmp slt i64 {back}, %known")
            place = self.emit(f"mul i64 {self.emit(f'select i1 {is_known}, i64 {-back}, i64 0')}, %inputs_step")
            self.gather(self.rows_of("inputs", place), size, f"%previous_{back}")
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
                ahead = self.add(ahead, self.multiply(self.subtract(points[0], point), share))
            self.store_vector(ahead, "%block_inputs", k * lanes)
            for back, point in enumerate(points[:-1], start=1):
                self.store_vector(point, f"%previous_{back}", k * lanes)
        self.store_vector(self.splat(1.0), "%block_inputs", size * lanes)
        self.store_vector(self.splat(0.0), "%block_inputs", (size + 1) * lanes)
        self.do("%given_place = mul i64 %index, %given_step")
        given = self.rows_of("given", "%given_place")
        self.gather(given, len(self.program.inputs) - n, self.address("%block_inputs", n * lanes))
        self.do("br label %step")
        self.steps("along", tolerance)
        margin, jump = (self.load_vector("%block_inputs", (size + k) * lanes) for k in range(2))
        accepted = self.compare("ole", "%residual_next", tolerance)
        for condition in (
            self.compare("ogt", margin, lower),
            self.compare("olt", margin, upper),
            self.compare("ole", jump, most),
        ):
            accepted = self.emit(f"and {self.truths} {accepted}, {condition}")
        for k in range(size):
            found = self.load_vector("%block_inputs", k * lanes)
            self.store_vector(self.select(accepted, found, self.splat(float("nan"))), "%current", k * lanes)
        self.do("%place = mul i64 %index, %inputs_step")
        self.scatter(self.rows_of("inputs", "%place"), size, "%current")
        self.do("%index_next = add i64 %index, 1")
        self.do("%further = icmp sle i64 %index_next, %count")
        self.do("br i1 %further, label %along, label %closed")
        self.label("closed")
        self.end_blocks()

    # loops over blocks of poses; past the end the last pose stands in the lanes, and is written once more

    def begin_function(self, name: str, *arguments: str, **buffers: int) -> None:
        """Begin a function on blocks of rows, with the table of what all poses share, and buffers of vectors."""
        program, p = self.program, self.pointer
        self.begin(name, ", ".join(arguments).replace("ptr", f"{p} noalias"), internal=False)
        sizes = {
            "shared": max(1, len(self.shared)),
            "block_inputs": self.lanes * (len(program.inputs) + 2),
            "block_outputs": self.lanes * max(1, len(program.results)),
            **{buffer: self.lanes * max(1, size) for buffer, size in buffers.items()},
        }
        for buffer, size in sizes.items():
            array = self.emit(f"alloca [{size} x double], align 64")
            typed = "ptr" if p == "ptr" else f"[{size} x double]*"
            self.do(f"%{buffer} = bitcast {typed} {array} to {p}")
        self.do(f"call void @prepare({p} %parameters, {p} %shared)")
        self.do("%last = sub i64 %n, 1")

    def begin_blocks(self, latch: str) -> None:
        """Begin the loop over blocks, whose last label is `latch`."""
        self.do("%some = icmp sgt i64 %n, 0")
        self.do("br i1 %some, label %loop, label %end")
        self.label("loop")
        self.do(f"%first = phi i64 [ 0, %entry ], [ %next, %{latch} ]")
        self.rows = []
        for lane in range(self.lanes):
            row = self.emit(f"add i64 %first, {lane}")
            inside = self.emit(f"icmp slt i64 {row}, %last")
            self.rows.append(self.emit(f"select i1 {inside}, i64 {row}, i64 %last"))

    def end_blocks(self) -> None:
        self.do(f"%next = add i64 %first, {self.lanes}")
        self.do("%more = icmp slt i64 %next, %n")
        self.do("br i1 %more, label %loop, label %end")
        self.label("end")
        self.end()

    def rows_of(self, array: str, offset: str = "0") -> list[str]:
        """Emit pointers to the rows of an array that belong to the lanes, some numbers further on."""
        places = [self.emit(f"mul i64 {row}, %{array}_stride") for row in self.rows]
        return [self.address(f"%{array}", self.emit(f"add i64 {place}, {offset}")) for place in places]

    def call_line(self) -> None:
        p = self.pointer
        self.do(f"call void @line({p} %block_inputs, {p} %shared, {p} %block_outputs)")

    def chunks(self, n: int) -> list[int]:
        """Return the first columns of square pieces that cover n columns; the last two may overlap."""
        return [*range(0, n - self.lanes + 1, self.lanes), *([n - self.lanes] if n % self.lanes else [])]

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

    def gather(self, pointers: list[str], n: int, block: str = "%block_inputs") -> None:
        """Emit reading n columns of the rows into a block, a vector for each column."""
        if n >= self.lanes:
            for first in self.chunks(n):
                columns = self.transpose([self.load_vector(pointer, first) for pointer in pointers])
                for k, column in enumerate(columns):
                    self.store_vector(column, block, (first + k) * self.lanes)
            return
        for k in range(n):
            vector = "poison"
            for lane, pointer in enumerate(pointers):
                vector = self.emit(f"insertelement {self.vector} {vector}, double {self.load(pointer, k)}, i32 {lane}")
            self.store_vector(vector, block, k * self.lanes)

    def scatter(self, pointers: list[str], n: int, block: str) -> None:
        """Emit writing a block of n vectors to n columns of the rows."""
        if n >= self.lanes:
            for first in self.chunks(n):
                columns = [self.load_vector(block, (first + k) * self.lanes) for k in range(self.lanes)]
                for pointer, row in zip(pointers, self.transpose(columns), strict=True):
                    self.store_vector(row, pointer, first)
            return
        for k in range(n):
            vector = self.load_vector(block, k * self.lanes)
            for lane, pointer in enumerate(pointers):
                self.store(self.emit(f"extractelement {self.vector} {vector}, i32 {lane}"), pointer, k)
