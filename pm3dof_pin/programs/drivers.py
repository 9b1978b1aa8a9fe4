"""The loops around a program, as LLVM IR: over blocks of poses, over steps, and along lines of a grid."""

from __future__ import annotations

from pm3dof_pin.programs.ir import StraightLine
from pm3dof_pin.programs.program import Program

HISTORY = 3
"""Number of poses before the last one that a march uses to predict the next."""

# arguments of the functions
_ROWS = "ptr %inputs, i64 %inputs_stride, ptr %parameters, ptr %outputs, i64 %outputs_stride, i64 %n"
_LINES = "ptr %inputs, i64 %inputs_stride, ptr %parameters, ptr %given, i64 %given_stride, i64 %n"
_STEPS = "double %tolerance, i64 %most"
_MARCH = (
    "i64 %inputs_step, i64 %given_step, i64 %known, i64 %count, ptr %shares, double %lower, double %upper, "
    "double %longest"
)


def module(program: Program, lanes: int, opaque_pointers: bool, fused: bool, attributes: str = "") -> str:
    """Return the text of a module with the function `evaluate` and, if the program permits, `iterate` and `march`.

    The first two take ``(inputs, stride, parameters, outputs, stride, n)``: rows of doubles, strides in doubles, counts
    and strides as 64-bit integers. `iterate` also takes a tolerance and the maximum number of steps; its rows of
    outputs are the last state, the residual at the start of the last step, and the number of steps. For `march` see
    :meth:`pm3dof_pin.programs.llvm.Compiled.march`.

    Args:
        program: the program.
        lanes: number of poses computed at once, a power of two.
        opaque_pointers: whether pointers are untyped, as LLVM 17 and later require.
        fused: whether the processor has a fused multiply-add, a b + c rounded once.
        attributes: attributes of all functions.
    """
    text = _Drivers(program, lanes, opaque_pointers, fused)
    text.prepare()
    text.straight_line()
    text.evaluate()
    if program.can_iterate:
        text.iterate()
    if program.can_march:
        text.march()
    text.copies()
    return "\n".join([*text.lines, f"attributes #0 = {{ nounwind {attributes} }}", ""])


class _Drivers(StraightLine):
    """The text under construction."""

    def __init__(self, program: Program, lanes: int, opaque_pointers: bool, fused: bool) -> None:
        super().__init__(program, lanes, opaque_pointers, fused)
        self._copies: set[tuple[str, int]] = set()

    def evaluate(self) -> None:
        """Emit the loop over blocks of poses."""
        self.begin_function("evaluate", _ROWS)
        self.begin_blocks("loop")
        self.gather("inputs", len(self.program.inputs))
        self.call_line()
        self.scatter("outputs", len(self.program.results), "%block_outputs")
        self.end_blocks()

    def iterate(self) -> None:
        """Emit the loop over blocks of poses, and in it the loop over steps."""
        n = self.program.state_size
        self.begin_function("iterate", _ROWS, _STEPS)
        tolerance = self.spread("%tolerance")
        self.begin_blocks("done")
        self.gather("inputs", len(self.program.inputs))
        self.do("br label %step")
        self.steps("loop", tolerance)
        self.store_vector("%residual_next", "%block_inputs", n * self.lanes)
        self.store_vector("%steps_next", "%block_inputs", (n + 1) * self.lanes)
        self.scatter("outputs", n + 2, "%block_inputs")
        self.end_blocks()

    def steps(self, before: str, tolerance: str) -> None:
        """Emit the loop over steps of a block, entered from the label `before`, and the label `done` after it."""
        n = self.program.state_size
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
        n = self.program.state_size
        size, lanes = n - 2, self.lanes
        names = ("current", *(f"previous_{back}" for back in range(1, HISTORY + 1)))
        self.begin_function("march", _LINES, _STEPS, _MARCH, **dict.fromkeys(names, size))
        tolerance, lower, upper, most = (self.spread(f"%{x}") for x in ("tolerance", "lower", "upper", "longest"))
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
        self.gather("given", len(self.program.inputs) - n, block, "%given_place")
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
        self.scatter("inputs", size, "%current", "%place")
        self.do("%index_next = add i64 %index, 1")
        self.do("%further = icmp sle i64 %index_next, %count")
        self.do("br i1 %further, label %along, label %closed")
        self.label("closed")
        self.end_blocks()

    # loops over blocks of poses; lanes past the end repeat the last pose, which is written again

    def begin_function(self, name: str, *arguments: str, **buffers: int) -> None:
        """Begin a function on blocks of rows, with the table of values shared by all poses, and buffers of vectors."""
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

    def call_line(self) -> None:
        p = self.pointer
        self.do(f"call void @line({p} %block_inputs, {p} %shared, {p} %block_outputs)")

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
