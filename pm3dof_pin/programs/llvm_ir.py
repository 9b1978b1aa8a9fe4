"""Programs as a module of LLVM IR: straight lines on vectors of poses, and the loops around them.

The loops go over blocks of poses, over steps, along lines of a grid, and over the legs of a walk. Except for pointer
types, only syntax common to LLVM 14 and later is used. There are no fast-math flags: the text determines every
rounding, and quickly compiled and optimised code give identical bits.
"""

from __future__ import annotations

from collections.abc import Sequence

from pm3dof_pin.programs.llvm_line import Line
from pm3dof_pin.programs.llvm_vectors import VectorText
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import Walk, acceptance_program

HISTORY = 3
"""Number of poses before the last one that a march uses to predict the next."""

NO_COMPILER = "programs are compiled by llvmlite, which is not installed: pip install llvmlite"
"""Why there are none without it."""

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
    lines = [line := Line(text, "step", program)]
    text.evaluate("evaluate", line)
    if program.can_iterate:
        text.iterate("iterate", [line], len(program.inputs), program.state_size)
    if program.can_march:
        lines.append(Line(text, "accept", acceptance_program()))
        text.march(line, lines[-1])
    if walk is not None:
        lines += (Line(text, name, each) for name, each in (("start", walk.start), ("control", walk.control)))
        text.evaluate("start", lines[-2])
        text.iterate("walk", [line, lines[-1]], len(walk.start.results), walk.status)
    text.copies()
    size = lanes * max(line.workspace for line in lines)
    text.lines.append(f"define dso_local i64 @workspace_size() #0 {{\n  ret i64 {size}\n}}")
    return "\n".join([*text.lines, f"attributes #0 = {{ nounwind {attributes} }}", ""])


class _Module(VectorText):
    """The text under construction."""

    def __init__(self, lanes: int, opaque_pointers: bool, fused: bool) -> None:
        super().__init__(lanes, opaque_pointers, fused)
        self._copies: set[tuple[str, int]] = set()

    def evaluate(self, name: str, line: Line) -> None:
        """Emit the loop over blocks of poses."""
        program = line.program
        self.begin_function(name, _ROWS, lines=[line], block_inputs=len(program.inputs))
        self.begin_blocks("loop")
        self.gather("inputs", len(program.inputs))
        self.call_line(line)
        self.scatter("outputs", len(program.results), "%block_outputs")
        self.end_blocks()

    def iterate(self, name: str, lines: Sequence[Line], inputs: int, n: int) -> None:
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

    def steps(self, before: str, lines: Sequence[Line], n: int, tolerance: str) -> None:
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

    def march(self, line: Line, accept: Line) -> None:
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

    def begin_function(self, name: str, *arguments: str, lines: Sequence[Line], **buffers: int) -> None:
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

    def call_line(self, line: Line, inputs: str = "%block_inputs", outputs: str = "%block_outputs") -> None:
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
