"""Text of LLVM IR for instructions on vectors of poses: arithmetic, and elementary functions of it.

Except for pointer types, only syntax common to LLVM 14 and later is used. There are no fast-math flags: the text
determines every rounding, and quickly compiled and optimised code give identical bits.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

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


class VectorText:
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

    def spread(self, scalar: str) -> str:
        """Return a vector with the scalar in all lanes."""
        vector = self.vector
        first = self.emit(f"insertelement {vector} poison, double {scalar}, i32 0")
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
