"""Programs compiled for this processor with LLVM, with as many poses at once as a vector register has numbers."""

from __future__ import annotations

import ctypes
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import InvalidValueError, ProgramError, ShapeError
from pm3dof_pin.programs import llvm_ir
from pm3dof_pin.programs.processors import processors
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.walk import NEARLY_CLOSED, SHORTEST_LEG, STEPS, Walk
from pm3dof_pin.tolerances import CLOSED
from pm3dof_pin.typing import Array, Mask

try:
    import llvmlite
    from llvmlite import binding
except ImportError as error:
    raise ProgramError(llvm_ir.NO_COMPILER) from error

_LOG = logging.getLogger(__name__)

_STEPS_AT_ONCE = 32  # of walks, before those that have ended are set aside
_USUAL_STEPS = 8  # of these until a walk ends
_ALIGNED = 64  # bytes
_OPERATIONS_A_PART = 5_000_000  # fewer, a fifth of a millisecond, do not justify a thread

_SECONDS_EACH = 3e-10  # of an operation for one pose in code compiled quickly
WORTH_OPTIMISING = 5e-6
"""Seconds of processor time, per operation of the program, from which it is compiled with full optimisation.

That takes twenty times as long, but large batches seldom come alone, and the code is cached. Long programs, for which
one would wait, must run for up to six times as long, and very long ones for as long as that takes.
"""
_SHORT = 5_000  # operations, which are optimised in half a second
_LONG = 60_000  # operations, after which that takes more than in proportion


class Target(NamedTuple):
    """The target processor."""

    name: str
    features: str
    lanes: int
    fuses: bool  #: whether it has a fused multiply-add


class Walked(NamedTuple):
    """The ends of walks."""

    q: Array  #: the last accepted configurations, shape=(n, nq) [m, rad]
    status: Array  #: see :data:`~pm3dof_pin.programs.walk.REACHED`, shape=(n,)


@cache
def target() -> Target:
    """Return this processor, with the number of poses it computes at once; ProgramError if LLVM does not support it."""
    try:
        binding.initialize_native_target()
        binding.initialize_native_asmprinter()
        features = binding.get_host_cpu_features()
        lanes = 8 if features.get("avx512f") else 4 if features.get("avx") else 2
        fuses = features.get("fma", not binding.get_process_triple().startswith("x86"))
        return Target(binding.get_host_cpu_name(), features.flatten(), lanes, fuses)
    except RuntimeError as error:
        raise ProgramError(f"LLVM cannot compile for this processor: {error}") from error


def versions() -> tuple[str, str]:
    """Return the versions of llvmlite and of LLVM, on which machine code depends."""
    return llvmlite.__version__, ".".join(map(str, binding.llvm_version_info))


def compile(program: Program | Walk, lanes: int | None = None, optimized: bool = True) -> Compiled:
    """Compile for `lanes` poses at once, a power of two, by default the target's; ProgramError on failure."""
    return Compiled(program, object_code(program, lanes or target().lanes, optimized))


def object_code(program: Program | Walk, lanes: int, optimized: bool) -> bytes:
    """Return the compiled program as an object file; ProgramError if LLVM does not compile it.

    Without `optimized` it takes a quarter of the time, for code a third as fast, with bitwise identical results.
    """
    machine = _machine(optimized)
    try:
        opaque_pointers = binding.llvm_version_info[0] >= 17
        text = llvm_ir.module(program, lanes, opaque_pointers, target().fuses, _attributes(lanes))
        parsed = binding.parse_assembly(text, binding.create_context())
        parsed.triple = machine.triple
        parsed.data_layout = str(machine.target_data)
        return bytes(machine.emit_object(parsed))
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise ProgramError(f"program '{program.name}': LLVM does not compile it: {reason}") from error


def _attributes(lanes: int) -> str:
    """Return attributes that keep vectors whole, and omit a second scheduling pass, which has no benefit."""
    width = f'"prefer-vector-width"="{64 * lanes}" "min-legal-vector-width"="{64 * lanes}"'
    return f'{width} "tune-cpu"="icelake-server"' if binding.get_process_triple().startswith("x86_64") else width


def _machine(optimized: bool = False) -> Any:
    processor = target()
    try:
        return binding.Target.from_default_triple().create_target_machine(
            cpu=processor.name, features=processor.features, opt=2 if optimized else 0, jit=True
        )
    except RuntimeError as error:
        raise ProgramError(f"LLVM cannot compile for this processor: {error}") from error


class Compiled:
    """A program as machine code.

    Results do not depend on how poses are grouped into calls, on their order, or on the number of threads.
    """

    def __init__(
        self, program: Program | Walk, code: bytes | Callable[[], bytes], faster: Callable[[], bytes] | None = None
    ) -> None:
        """Load object code of the program, or take what makes it when the program is first run.

        Args:
            program: the program; or a walk, whose step is then the program.
            code: its object code, or what makes it; LLVM crashes on incomplete code.
            faster: makes code that replaces it once that is worth its compilation, if `code` was compiled quickly.

        Raises:
            ProgramError: it cannot be loaded. If it is made later, the first run raises this instead.
        """
        self.walk_program = program if isinstance(program, Walk) else None
        self.program = program.step if isinstance(program, Walk) else program
        self._faster = faster
        self._seconds = 0.0  # of running
        self._engines: list[Any] = []  # the first one is kept, since another thread may be running it
        self._functions: dict[str, Callable[..., None]] = {}
        self._make = code if callable(code) else lambda: code
        if not callable(code):
            self._load(code)

    def _load(self, code: bytes) -> None:
        program = self.program
        try:
            # in LLVM's global context: another one may be collected before the engine that needs it
            self._engines.append(binding.create_mcjit_compiler(binding.parse_assembly(""), _machine()))
            self._engines[-1].add_object_file(binding.ObjectFileRef.from_data(code))
            self._engines[-1].finalize_object()
            pointer, size = ctypes.c_void_p, ctypes.c_int64
            common = (pointer, pointer, size, pointer, pointer, size, size)
            number = ctypes.c_double
            steps = (*common, number, size)
            functions = {"evaluate": self._function("evaluate", *common)}
            if program.can_iterate:
                functions["iterate"] = self._function("iterate", *steps)
            if program.can_march:
                functions["march"] = self._function("march", *steps, size, size, size, size, pointer, number)
            if self.walk_program is not None:
                functions["start"] = self._function("start", *common)
                functions["walk"] = self._function("walk", *steps)
            self._workspace_size = int(self._function("workspace_size", result=size)())
            self._functions = functions
        except (RuntimeError, OSError) as error:
            raise ProgramError(f"program '{program.name}': cannot be loaded: {error}") from error

    def with_doubt(self, inputs: ArrayLike, parameters: ArrayLike, threads: int | None = None) -> tuple[Array, Mask]:
        """Evaluate a program whose last output is 1 if nothing is in doubt; return the others, and a mask of these."""
        rows = np.asarray(inputs, dtype=np.float64)
        sound = np.empty(len(rows), dtype=bool)
        outputs = self(
            rows, parameters, threads=threads, then=lambda part, done: np.equal(done[:, -1], 1.0, out=sound[part])
        )
        return outputs[:, :-1], sound

    def _function(self, name: str, *arguments: Any, result: Any = None) -> Callable[..., Any]:
        address = self._engines[-1].get_function_address(name)
        if not address:
            raise RuntimeError(f"no function '{name}'")
        return ctypes.CFUNCTYPE(result, *arguments)(address)

    def __call__(
        self,
        inputs: ArrayLike,
        parameters: ArrayLike = (),
        out: Array | None = None,
        threads: int | None = None,
        then: Callable[[slice, Array], object] | None = None,
    ) -> Array:
        """Evaluate the program at many poses.

        Args:
            inputs: shape=(n, number of inputs); rows may be strided, as in a slice of columns.
            parameters: shape=(number of parameters,).
            out: array for the results, shape=(n, number of outputs); rows may be strided.
            threads: maximum number of threads; the number of processors by default.
            then: called by each thread with the range and outputs of rows that are finished.

        Returns:
            Outputs, shape=(n, number of outputs); `program.split` names them.

        Raises:
            InvalidValueError: an array has another shape.
        """
        rows = _rows("inputs", inputs, len(self.program.inputs))
        n_outputs = len(self.program.results)
        outputs = np.empty((len(rows), n_outputs)) if out is None else _writable("out", out, len(rows), n_outputs)
        self._run("evaluate", rows, parameters, outputs, threads, then=then)
        return outputs

    def iterate(
        self,
        inputs: ArrayLike,
        parameters: ArrayLike = (),
        *,
        tolerance: float,
        max_steps: int,
        threads: int | None = None,
    ) -> tuple[Array, Array]:
        """Repeat the program, whose outputs are the next state and a residual, until the residual is small.

        The last step is the one that finds a residual of at most `tolerance` or NaN, or the last of `max_steps`. Inputs
        are the initial state, then the constant inputs, shape=(n, number of inputs). Returns the states, shape=(n, size
        of the state), and the residuals at the start of the last step, shape=(n,).

        Raises:
            InvalidValueError: an array has the wrong shape, or the program's outputs are not a state and a residual.
        """
        if not self.program.can_iterate:
            raise InvalidValueError("outputs", self.program.outputs, "a new value of the first inputs, then a residual")
        if max_steps < 1:
            raise InvalidValueError("max_steps", max_steps, "at least 1")
        n = self.program.state_size
        rows = _rows("inputs", inputs, len(self.program.inputs))
        results = np.empty((len(rows), n + 1))
        self._run("iterate", rows, parameters, results, threads, tolerance, max_steps)
        return results[:, :n], results[:, n]

    def walk(
        self,
        starts: ArrayLike,
        targets: ArrayLike,
        parameters: ArrayLike,
        *,
        shortest: float = SHORTEST_LEG,
        tolerance: float = CLOSED,
        threads: int | None = None,
    ) -> Walked:
        """Walk from starts to targets, see :class:`~pm3dof_pin.programs.walk.Walk`.

        Args:
            starts: closed configurations, shape=(n, nq).
            targets: numbers that the step takes after its state, shape=(n, m).
            parameters: shape=(number of parameters,).
            shortest: length of the shortest leg, relative to the usual one.
            tolerance: largest closure error of a pose that counts as reached [m, rad].
            threads: maximum number of threads; the number of processors by default.

        Raises:
            InvalidValueError: the program is no walk, or an array has the wrong shape.
        """
        walk = self.walk_program
        if walk is None:
            raise InvalidValueError("program", self.program.name, "a walk")
        goals = np.asarray(targets, dtype=float)
        begins = np.column_stack([starts, goals, np.full(len(goals), shortest), np.full(len(goals), tolerance)])
        states = np.empty((len(goals), len(walk.start.results)))
        self._run("start", _rows("starts", begins, len(walk.start.inputs)), parameters, states, threads)
        rows = np.arange(len(goals))
        while rows.size:  # those that have ended make room for others in the lanes
            ends = np.empty((len(rows), walk.status + 1))
            begins = states if len(rows) == len(states) else states[rows]
            self._run("walk", begins, parameters, ends, threads, 0.0, _STEPS_AT_ONCE, length=_USUAL_STEPS)
            states[rows, : walk.status + 1] = ends
            rows = rows[ends[:, walk.status] > 0.0]
        return Walked(states[:, walk.reached], states[:, walk.status])

    def march(
        self,
        lines: Array,
        given: Array,
        parameters: ArrayLike,
        shares: ArrayLike,
        *,
        mode: float,
        threads: int | None = None,
    ) -> None:
        """Iterate along lines, in place: each pose starts from a prediction by its predecessors.

        The prediction is the last pose plus, for each pose before it, a share of the difference from it to the last.

        Only for programs that close loops, :func:`~pm3dof_pin.programs.closing.closing_program`. A pose and all after
        it are NaN if it is not accepted, see :func:`~pm3dof_pin.programs.walk.acceptance_program`.

        Args:
            lines: q, shape=(n, m, nq), rows of q contiguous. The first poses of each line are known; all but the last
                of these may be NaN.
            given: the inputs after the state, shape=(n, m, number of them), rows contiguous.
            parameters: shape=(number of parameters,).
            shares: for each unknown pose, beginning with the pose before the last; zero for missing poses,
                shape=(number of unknown poses, :data:`~pm3dof_pin.programs.llvm_ir.HISTORY`).
            mode: assembly mode of home, see :func:`~pm3dof_pin.programs.closing.regularity_and_mode`.
            threads: maximum number of threads; the number of processors by default.

        Raises:
            InvalidValueError: the program does not close loops, or an array has the wrong shape.
        """
        program = self.program
        if not program.can_march:
            raise InvalidValueError("outputs", program.outputs, "q, margin, jump, residual")
        n, m, nq = lines.shape
        shares = np.ascontiguousarray(shares, dtype=np.float64)
        known = m - len(shares)
        expected = (n, m, len(program.inputs) - nq - 2), (m - known, llvm_ir.HISTORY)
        if nq != program.state_size - 2 or (given.shape, shares.shape) != expected or known < 1:
            raise InvalidValueError(
                "lines", problem=f"have shapes {lines.shape}, {given.shape}, {shares.shape}", expected=f"{expected}"
            )
        for name, values in (("lines", lines), ("given", given)):
            if values.dtype != np.float64 or (values.strides[2] != 8 and values.shape[2] > 1):
                raise InvalidValueError(
                    name, problem=f"is {values.dtype} with strides {values.strides}", expected="contiguous rows"
                )
        if not len(shares):
            return
        step = lines.strides[1] // 8
        self._run(
            "march",
            lines[:, known - 1],
            parameters,
            given[:, known - 1],
            threads,
            *(NEARLY_CLOSED, STEPS, step, given.strides[1] // 8, known, len(shares)),
            *(_address(shares), mode),
            length=2 * len(shares),
        )

    def _run(
        self,
        name: str,
        rows: Array,
        parameters: ArrayLike,
        outputs: Array,
        threads: int | None,
        *more: float,
        length: int = 1,
        then: Callable[[slice, Array], object] | None = None,
    ) -> None:
        """Call a function on the rows, in parts if there are threads; each row takes `length` evaluations."""
        shared = np.ascontiguousarray(parameters, dtype=np.float64)
        if shared.shape != (len(self.program.parameters),):
            expected = f"({len(self.program.parameters)},)"
            raise ShapeError("parameters", shared.shape, expected)
        if not self._functions:
            self._load(self._make())
        n = len(rows)
        ahead = n * length * len(self.program) * _SECONDS_EACH
        patience = min(max(1.0, (len(self.program) / _SHORT) ** 2), 6.0 * max(1.0, len(self.program) / _LONG))
        if self._faster is not None and self._seconds + ahead > WORTH_OPTIMISING * patience * len(self.program):
            faster, self._faster = self._faster, None
            try:
                self._load(faster())
            except ProgramError as error:
                _LOG.info("program '%s' keeps its quickly compiled code: %s", self.program.name, error)
        function = self._functions[name]
        strides = rows.strides[0] // 8, outputs.strides[0] // 8
        first_input, table, first_output = _address(rows), _address(shared), _address(outputs)

        def part(start: int, stop: int) -> None:
            begin = time.thread_time()
            room = np.empty(self._workspace_size + _ALIGNED // 8) if self._workspace_size else shared
            function(
                -(-_address(room) // _ALIGNED) * _ALIGNED,
                first_input + start * 8 * strides[0],
                strides[0],
                table,
                first_output + start * 8 * strides[1],
                strides[1],
                stop - start,
                *more,
            )
            self._seconds += time.thread_time() - begin
            if then is not None:
                then(slice(start, stop), outputs[start:stop])

        parts = n * length * len(self.program) // _OPERATIONS_A_PART
        if parts > 1:
            threads = threads or processors()
            parts = min(4 * threads, parts)
        if parts <= 1 or threads == 1:
            part(0, n)
            return
        ends = [n * k // parts for k in range(parts + 1)]
        list(_pool(threads).map(part, ends[:-1], ends[1:]))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Return a cached thread pool: starting threads takes as long as a thousand poses."""
    return ThreadPoolExecutor(threads)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def _address(array: Array) -> int:
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))  # three times as fast
    except (TypeError, ValueError):  # read-only, not contiguous, or empty
        address: int = array.__array_interface__["data"][0]
        return address


def _rows(name: str, values: ArrayLike, columns: int) -> Array:
    """Return an array with contiguous rows, without a copy if possible."""
    rows = np.asarray(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise ShapeError(name, rows.shape, f"(n, {columns})")
    if rows.strides[1] != 8 or rows.strides[0] % 8 or not rows.flags.aligned:
        rows = np.ascontiguousarray(rows)
    return rows


def _writable(name: str, rows: Array, n: int, columns: int) -> Array:
    fits = rows.shape == (n, columns) and rows.dtype == np.float64 and rows.flags.writeable and rows.flags.aligned
    if not fits or (columns > 1 and rows.strides[1] != 8) or rows.strides[0] % 8:
        raise InvalidValueError(
            name,
            problem=f"is {rows.dtype} of shape {rows.shape}",
            expected=f"a writable float64 array of shape ({n}, {columns})",
        )
    return rows
