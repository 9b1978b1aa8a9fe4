"""A program as a straight line of LLVM IR on vectors of poses, cut into stages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from pm3dof_pin.programs.llvm_vectors import VectorText
from pm3dof_pin.programs.program import Program

WHOLE = 4000
"""Greatest number of operations of a program that is one function."""

STAGE = 1000
"""Number of operations in a function of a longer one."""

STORES = 128
"""Greatest number of results in a function that are not computed there, such as the zeros of a Jacobian."""


class Line:
    """A program as two functions: one fills a table of values shared by all poses, one is the straight line.

    Long ones are cut into stages, functions of their own: the frame of a function has room for all its values that do
    not fit into registers, and the time that LLVM takes grows as the square of its length, or of the number of results
    that it stores. Values that outlive a stage are kept in a workspace.
    """

    def __init__(self, text: VectorText, name: str, program: Program) -> None:
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
        size, own = STAGE if len(lines) > WHOLE else WHOLE, set(lines)
        # values to be computed, then others and the columns where these are stored
        stages: list[list[tuple[int, int | None]]]
        stages = [[(number, None) for number in lines[k : k + size]] for k in range(0, len(lines), size)] or [[]]
        given = [(number, column) for number, places in columns.items() if number not in own for column in places]
        stages[-1] += given[:STORES]
        stages += [[*given[k : k + STORES]] for k in range(STORES, len(given), STORES)]
        last = {
            operand: k
            for k, stage in enumerate(stages)
            for number, column in stage
            if column is None
            for operand in self._operands(number)
        }
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

            for number, column in stage:
                if column is not None:
                    store(leaf(number), column)
                    continue
                names[number] = self._emitted(number, value, angles)
                for place in columns.get(number, ()):
                    store(self._as_number(number, names[number]), place)
                if last.get(number, k) > k:
                    slots[number] = free.pop() if free else len(slots)
                    kept = self._as_number(number, names[number])
                    text.store_vector(kept, "%workspace", width * slots[number], 8 * width)
            self.workspace = max(self.workspace, len(slots) + len(free))
            for number in [number for number in slots if last[number] == k]:
                free.append(slots.pop(number))
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
