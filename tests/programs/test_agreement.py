"""Random programs: machine code, C and JavaScript compute what NumPy computes."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pm3dof_pin.programs import llvm, llvm_ir, llvm_line
from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.graph import Graph, absolute, atan2, cos, floor, less, maximum, minimum, select, sin, sqrt
from pm3dof_pin.programs.javascript import javascript
from pm3dof_pin.programs.program import OPERATIONS as MEANING
from pm3dof_pin.programs.program import Program

N_INPUTS, N_PARAMETERS = 3, 2
SPECIAL = (0.0, 1.0, -1.0, 0.5, -2.0, 3.75, 1e3, float("nan"), float("inf"), float("-inf"))

# every operation that is equally accurate on all machines, up to rounding of the last place
OPERATIONS = (
    lambda a, b, c: a + b,
    lambda a, b, c: a - b,
    lambda a, b, c: a * b,
    lambda a, b, c: a / b,
    lambda a, b, c: -a,
    lambda a, b, c: sqrt(a),
    lambda a, b, c: absolute(a),
    lambda a, b, c: sin(a),
    lambda a, b, c: cos(a),
    lambda a, b, c: atan2(a, b),
    lambda a, b, c: minimum(a, b),
    lambda a, b, c: maximum(a, b),
    lambda a, b, c: floor(a * 0.37),
    lambda a, b, c: select(less(a, b), c, a),
    lambda a, b, c: select(less(a, b) & less(b, c), a, c),
    lambda a, b, c: select(less(a, b) | ~less(c, b), b, c),
)


def program_of(steps: list[tuple[int, int, int, int]], name: str = "random_program") -> Program:
    """Record random operations in sequence, each on values recorded before; output all of them."""
    graph = Graph()
    values = [graph.input(f"x{k}", [0.5 + k]) for k in range(N_INPUTS)]
    values += [graph.parameter(f"p{k}", 0.25 - k) for k in range(N_PARAMETERS)]
    values += [graph.constant(0.75)]
    for operation, *operands in steps:
        values.append(OPERATIONS[operation % len(OPERATIONS)](*(values[k % len(values)] for k in operands)))
    return graph.program(name, {"values": values})


INDEX = st.integers(0, 1000)
PROGRAMS = st.lists(st.tuples(INDEX, INDEX, INDEX, INDEX), min_size=1, max_size=25).map(program_of)


def numbers(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs of n poses and parameters: ordinary ones, and some special ones."""
    rng = np.random.default_rng(seed)
    inputs = rng.normal(scale=2.0, size=(n, N_INPUTS))
    special = rng.random(inputs.shape) < 0.2
    inputs[special] = rng.choice(SPECIAL, special.sum())
    return inputs, rng.normal(size=N_PARAMETERS)


def allowance(program: Program, inputs: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return outputs, and the tolerance of each: a fraction of the effect of small changes of all operations.

    It is infinite where NaN or infinity depend on rounding or on the range of angles, and after numbers too large or
    too small for a fused operation to agree with two.
    """
    outputs = program.evaluate(inputs, parameters)
    reach = 1e-15 * np.abs(outputs)
    with np.errstate(all="ignore"):
        for seed in range(12):
            shaken = _shaken(program, inputs, parameters, seed)
            change = np.abs(shaken - outputs)
            change[(shaken == outputs) | (np.isnan(shaken) & np.isnan(outputs))] = 0.0
            reach = np.fmax(reach, np.where(np.isnan(change), np.inf, change))
        size = np.abs(outputs)
        extreme = (np.isfinite(size) & (size > 1e100)) | ((size > 0.0) & (size < 1e-100))
    reach[np.maximum.accumulate(extreme, axis=1)] = np.inf
    return outputs, 20.0 * reach


def assert_agree(actual: np.ndarray, program: Program, inputs: np.ndarray, parameters: np.ndarray) -> None:
    """Compare outputs with NumPy's evaluation of the program: the same NaNs, and the same numbers to rounding."""
    outputs, allowed = allowance(program, inputs, parameters)
    with np.errstate(invalid="ignore"):
        agree = np.abs(actual - outputs) <= allowed
    agree |= (actual == outputs) | (np.isnan(actual) & np.isnan(outputs)) | (allowed == np.inf)
    assert agree.all(), (actual[~agree], outputs[~agree], allowed[~agree], program.lines, program.results)


def _shaken(program: Program, inputs: np.ndarray, parameters: np.ndarray, seed: int) -> np.ndarray:
    """Evaluate with random errors of a few units of the last place in every operation."""
    rng = np.random.default_rng(seed)
    values = [*inputs.T, *parameters, *map(np.float64, program.constants)]
    for operation, operands in program.lines:
        value = MEANING[operation][1](*(values[k] for k in operands))
        if value.dtype == np.float64:
            value = value * (1.0 + 1e-15 * rng.choice([-1.0, 1.0], size=np.shape(value)))
        if operation in ("sin", "cos"):
            value = np.where(np.abs(values[operands[0]]) > 0.99e6, np.nan, value)
        values.append(value)
    flat = np.empty((len(inputs), len(program.results)))
    for column, number in enumerate(program.results):
        flat[:, column] = values[number]
    return flat


@settings(max_examples=40, deadline=None)
@given(PROGRAMS, st.sampled_from([1, 7, 8, 9, 33]), st.integers(0, 2**32 - 1))
def test_machine_code(program, n, seed):
    inputs, parameters = numbers(seed, n)
    outputs = llvm.compile(program, optimized=False)(inputs, parameters)
    assert_agree(outputs, program, inputs, parameters)
    assert np.array_equal(llvm.compile(program)(inputs, parameters), outputs, equal_nan=True)


def test_stages_compute_the_same_bits(many_programs, monkeypatch):
    """Values of all kinds outlive a stage of three operations, and results are stored two at a time."""
    inputs, parameters = numbers(8, 25)
    whole = [llvm.compile(program, optimized=False)(inputs, parameters) for program in many_programs]
    for name, size in (("WHOLE", 1), ("STAGE", 3), ("STORES", 2)):
        monkeypatch.setattr(llvm_line, name, size)
    staged = [llvm.compile(program, optimized=False) for program in many_programs]
    for compiled, expected in zip(staged, whole, strict=True):
        assert np.array_equal(compiled(inputs, parameters), expected, equal_nan=True)
    assert sum(compiled._workspace_size > 0 for compiled in staged) > 30


def test_no_function_stores_many_results():
    """LLVM takes the square of their number."""
    graph = Graph()
    x = graph.input("x", [0.5])
    program = graph.program("sparse", {"values": [x * x, *[graph.constant(0.0)] * 3000]})
    functions = llvm_ir.module(program, 8, True, True).split("define ")
    assert max(text.count("store") for text in functions) < 300
    assert np.array_equal(llvm.compile(program)([[3.0]], []), [[9.0, *[0.0] * 3000]])


def test_a_long_program_needs_little_of_the_stack():
    """Twelve thousand numbers, of which all are still needed when the last is known, and half a megabyte of stack."""
    graph = Graph()
    x = graph.input("x", [0.5])
    values = [x * (0.5 + k) + 1.0 / (1 + k) for k in range(12_000)]
    whole = values[-1]
    for value in reversed(values[:-1]):
        whole = whole * value * 1e-4
    program = graph.program("long", {"values": [whole, sum(values)]})
    compiled, results = llvm.compile(program, optimized=False), []
    before = threading.stack_size(2**19)
    try:
        thread = threading.Thread(target=lambda: results.append(compiled([[0.25], [1e-3]], threads=1)))
        thread.start()
        thread.join()
    finally:
        threading.stack_size(before)
    np.testing.assert_allclose(results[0], program.evaluate([[0.25], [1e-3]]), rtol=1e-9)


@pytest.fixture(scope="module")
def many_programs():
    """Programs that are printed and compiled all at once."""
    rng = np.random.default_rng(6)
    steps = rng.integers(0, 1000, size=(60, 30, 4)).tolist()
    return [program_of(some[: 1 + k % 30], f"program_{k}") for k, some in enumerate(steps)]


def test_c(many_programs, compiled_c):
    functions = compiled_c("\n".join(c99(program) for program in many_programs))
    pointer = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    for k, program in enumerate(many_programs):
        function = getattr(functions, program.name)
        function.argtypes, function.restype = (pointer, pointer, pointer), None
        inputs, parameters = numbers(k, 20)
        outputs = np.empty((20, len(program.results)))
        for row, out in zip(inputs, outputs, strict=True):
            function(row, parameters, out)
        assert_agree(outputs, program, inputs, parameters)


def test_javascript(many_programs, run_javascript):
    """Every other program with its parameters built in."""
    functions, calls = [], []
    for k, program in enumerate(many_programs):
        inputs, parameters = numbers(k, 20)
        functions.append(javascript(program, parameters if k % 2 else None))
        rows, given = (json.dumps(np.vectorize(repr)(array.tolist()).tolist()) for array in (inputs, parameters))
        p = "" if k % 2 else f"{given}.map(Number), "
        y = f"new Float64Array({len(program.results)})"
        calls.append(f"{rows}.map((row) => {{ const y = {y}; {program.name}(row.map(Number), {p}y); return [...y]; }})")
    results = run_javascript("\n".join(functions), f"[{', '.join(calls)}]".replace("inf", "Infinity"))
    for k, (program, rows) in enumerate(zip(many_programs, results, strict=True)):
        inputs, parameters = numbers(k, 20)
        assert_agree(np.array(rows, dtype=float), program, inputs, parameters)
