"""A program's straight line as LLVM IR: shared values once per call, the rest on vectors of poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.vector_ir import VectorText


class StraightLine(VectorText):
    """A module with `prepare`, which fills the table of shared values, and `line`, for a block of poses."""

    def __init__(self, program: Program, lanes: int, opaque_pointers: bool, fused: bool) -> None:
        super().__init__(lanes, opaque_pointers, fused)
        self.program = program
        self.per_pose = self._per_pose()
        self.shared = self._shared()
        self.products = self._products() if fused else {}
        self._fused_products = frozenset(self.products.values())

    # values computed for each pose, and values shared by all

    def _per_pose(self) -> list[bool]:
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
            if self.per_pose[number]:
                used.extend(operands)
        places: dict[int, int] = {}
        for number in used:
            if not self.per_pose[number] and not first_constant <= number < self.program.first_line:
                places.setdefault(number, len(places))
        return places

    def _products(self) -> dict[int, int]:
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
                    if is_product and uses[operand] == 1 and self.per_pose[operand] == self.per_pose[number]:
                        products[number] = operand
                        break
        return products

    def straight(self, numbers: Iterable[int], value: Callable[[int], str], keep: Callable[[int, str], None]) -> None:
        """Emit the lines of ascending numbers; `value` returns the name of each, `keep` is called for each result."""
        angles: dict[int, tuple[str, str]] = {}
        for number in numbers:
            if number in self._fused_products:
                continue
            operation, operands = self.program.lines[number - self.program.first_line]
            if number in self.products:
                name = self.sum_with_product(operation, operands, self.products[number], value)
            elif operation in ("sin", "cos"):
                if operands[0] not in angles:
                    angles[operands[0]] = self.sine_and_cosine(value(operands[0]))
                name = angles[operands[0]][operation == "cos"]
            else:
                name = self.operation(operation, [value(operand) for operand in operands])
            keep(number, name)

    def sum_with_product(
        self, operation: str, operands: tuple[int, ...], product: int, value: Callable[[int], str]
    ) -> str:
        """Emit a sum or difference with a product as one fused operation."""
        x, y = map(value, self.program.lines[product - self.program.first_line][1])
        if operands[0] == product:
            other = value(operands[1])
            return self.multiply_add(x, y, other if operation == "add" else self.negative(other))
        return self.multiply_add(x if operation == "add" else self.negative(x), y, value(operands[0]))

    def operation(self, operation: str, operands: list[str]) -> str:
        """Emit one line of a program."""
        match operation:
            case "add" | "subtract" | "multiply" | "divide":
                instruction = {"add": "fadd", "subtract": "fsub", "multiply": "fmul", "divide": "fdiv"}[operation]
                return self.binary(instruction, *operands)
            case "negative":
                return self.negative(operands[0])
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

    def prepare(self) -> None:
        """Emit the function that fills the table of shared values."""
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
        """Return whether a value is a boolean."""
        line = number - self.program.first_line
        return line >= 0 and self.program.lines[line][0] in ("less", "and", "or", "not")

    def straight_line(self) -> None:
        """Emit the function that computes a block of poses, one value of all lanes at a time."""
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
