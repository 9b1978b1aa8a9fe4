"""Compiled programs: elementary functions, rows and lanes, threads, iteration, errors."""

from __future__ import annotations

import gc
import math
from fractions import Fraction

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError, ProgramError
from pm3dof_pin.programs import llvm, llvm_ir
from pm3dof_pin.programs.graph import Graph, absolute, atan2, cos, sin, sqrt
from pm3dof_pin.programs.llvm_vectors import ANGLE_RANGE

LANES = (2, 4, 8)


def compiled(function, n_inputs, lanes=None):
    graph = Graph()
    inputs = [graph.input(f"x{k}", [0.5]) for k in range(n_inputs)]
    return llvm.compile(graph.program("f", {"y": function(*inputs)}), lanes)


def units(actual, exact):
    """Return errors in units of the last place."""
    return np.abs(actual - exact).astype(float) / np.spacing(np.abs(exact.astype(float)))


@pytest.fixture(scope="module")
def angles():
    rng = np.random.default_rng(1)
    quarters = np.arange(-4000, 4000) * (math.pi / 4)
    near = [np.nextafter(quarters, np.inf), quarters, quarters * (1 + 1e-9)]
    return np.concatenate([rng.uniform(-a, a, 100_000) for a in (1e-6, 1.0, 4.0, 100.0, ANGLE_RANGE)] + near)


def test_sine_and_cosine_are_exact_to_two_last_places(angles):
    values = compiled(lambda x: [sin(x), cos(x)], 1)(angles[:, None])
    if np.finfo(np.longdouble).nmant < 63:
        pytest.skip("no extended precision on this machine")
    long = angles.astype(np.longdouble)
    for column, function in enumerate((np.sin, np.cos)):
        errors = units(values[:, column], function(long))
        assert errors.max() < 2.5
        assert errors[np.abs(angles) < 3.0].max() < 1.5


def test_sine_and_cosine_beyond_their_range_are_nan():
    angles = np.array([[ANGLE_RANGE], [np.nextafter(ANGLE_RANGE, np.inf)], [-1e300], [np.inf], [np.nan]])
    values = compiled(lambda x: [sin(x), cos(x)], 1)(angles)
    assert np.isfinite(values[0]).all()
    assert np.isnan(values[1:]).all()


def test_arctangent_is_exact_to_two_last_places():
    if np.finfo(np.longdouble).nmant < 63:
        pytest.skip("no extended precision on this machine")
    rng = np.random.default_rng(2)
    points = rng.normal(size=(200_000, 2)) * 10.0 ** rng.uniform(-8, 8, size=(200_000, 2))
    values = compiled(lambda y, x: atan2(y, x), 2)(points)[:, 0]
    assert units(values, np.arctan2(*points.astype(np.longdouble).T)).max() < 2.0


def test_arctangent_of_zeros_and_infinities_is_that_of_ieee():
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan]
    points = np.array([[y, x] for y in special for x in special])
    values = compiled(lambda y, x: atan2(y, x), 2)(points)[:, 0]
    expected = np.arctan2(*points.T)
    assert np.allclose(values, expected, rtol=3e-16, atol=0.0, equal_nan=True)
    assert np.array_equal(np.signbit(values[~np.isnan(values)]), np.signbit(expected[~np.isnan(values)]))


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("n_outputs", [1, 3, 8, 11])
def test_rows_and_lanes(lanes, n_outputs):
    """Any number of rows, with any stride, also in place; memory next to them is unchanged."""
    evaluate = compiled(lambda *x: [sqrt(absolute(sum(x))) * k + x[k % len(x)] for k in range(n_outputs)], 9, lanes)
    table = np.random.default_rng(3).normal(size=(40, 12))
    for n in (0, 1, 7, 8, 9, 31):
        inputs = table[:n, 1:10]
        out = np.full((n + 1, n_outputs + 2), -1.0)
        evaluate(inputs, out=out[:n, 1:-1])
        assert np.allclose(out[:n, 1:-1], evaluate.program.evaluate(inputs), rtol=1e-15)
        assert (out[:, [0, -1]] == -1.0).all()
        assert (out[n] == -1.0).all()
        assert np.array_equal(evaluate(np.asfortranarray(inputs)), out[:n, 1:-1])


def test_bits_do_not_depend_on_lanes_calls_and_threads(monkeypatch):
    monkeypatch.setattr(llvm, "_OPERATIONS_A_PART", 10_000)
    evaluate = compiled(lambda x, y: [sin(x) / y, atan2(x, y) * sqrt(absolute(x)), cos(x * y)], 2)
    inputs = np.random.default_rng(4).normal(size=(20_011, 2))
    whole = evaluate(inputs, threads=1)
    assert np.array_equal(whole, evaluate(inputs))
    assert np.array_equal(whole, evaluate(inputs, threads=2))
    assert np.array_equal(whole, evaluate(inputs, threads=7))
    assert np.array_equal(whole[5:], evaluate(inputs[5:]))
    assert np.array_equal(whole[13:14], evaluate(inputs[13:14]))


def test_what_is_the_same_for_all_poses():
    """Outputs and operands that depend on parameters and constants only."""
    graph = Graph()
    x, p, q = graph.input("x", [1.0]), graph.parameter("p", 2.0), graph.parameter("q", 3.0)
    graph.parameter("unused", 0.0)
    length = sqrt(p * p + q * q)
    program = graph.program("f", {"y": [length, x * length, 4.0, p, x, sin(q) - x]})
    values = llvm.compile(program)([[1.0], [2.0]], [3.0, 4.0, 0.0])
    assert np.allclose(values, [[5, k * 5, 4, 3, k, math.sin(4.0) - k] for k in (1, 2)], rtol=1e-15)


@pytest.mark.parametrize("optimized", [False, True])
def test_a_sum_with_a_product_is_rounded_as_the_text_says(optimized):
    """Fused if the processor supports it; the same with and without LLVM's optimisation."""
    graph = Graph()
    x, y, z = (graph.input(name, [0.5]) for name in "xyz")
    program = graph.program("f", {"values": [x * y + z, y * z - x, y - z * x, x * x + y * y]})
    inputs = np.random.default_rng(5).normal(size=(200, 3))
    outputs = llvm.compile(program, optimized=optimized)(inputs)
    assert np.array_equal(llvm.compile(program, optimized=not optimized)(inputs), outputs)
    if not llvm.target().fuses:
        assert np.array_equal(outputs, program.evaluate(inputs))
        return
    for (a, b, c), row in zip(inputs.tolist(), outputs, strict=True):
        u, v, w = map(Fraction, (a, b, c))
        assert row[:3].tolist() == [float(u * v + w), float(v * w - u), float(v - w * u)]
        assert row[3] in (float(u * u + Fraction(b * b)), float(Fraction(a * a) + v * v))


def root_finder(lanes=None):
    """Newton's method for the square root of `a`; a residual of NaN where the state is."""
    graph = Graph()
    x, a = graph.input("x", [1.0]), graph.input("a", [2.0])
    return llvm.compile(graph.program("root", {"x": 0.5 * (x + a / x), "residual": absolute(x * x - a)}), lanes)


@pytest.mark.parametrize("lanes", LANES)
def test_iteration_stops_lane_by_lane(lanes):
    squares = np.array([4.0, 2.0, 9.0, 1e4, np.nan, 5.0, 0.25, 1e-2, 3.0])
    starts = np.array([2.0, 1.0, 2.9, 1.0, 1.0, 1e9, 0.5, 0.3, np.nan])
    states, residuals = root_finder(lanes).iterate(np.column_stack([starts, squares]), tolerance=1e-5, max_steps=20)
    for start, square, state, residual in zip(starts, squares, states[:, 0], residuals, strict=True):
        x, taken, left = start, 0, math.inf
        while taken < 20 and left > 1e-5:
            left = abs(x * x - square)
            x, taken = 0.5 * (x + square / x), taken + 1
        assert state == pytest.approx(x, rel=1e-14, nan_ok=True)
        assert residual == pytest.approx(left, rel=1e-6, abs=1e-12, nan_ok=True)
    assert residuals[5] > 1.0  # 1e9 is too far away
    assert states[0, 0] == 2.0


def test_iteration_does_not_depend_on_neighbours_and_threads(monkeypatch):
    monkeypatch.setattr(llvm, "_OPERATIONS_A_PART", 10_000)
    rng = np.random.default_rng(5)
    inputs = rng.uniform(0.1, 100.0, size=(9_001, 2))
    find = root_finder()
    whole = find.iterate(inputs, tolerance=1e-6, max_steps=30, threads=1)
    assert np.allclose(whole[0][:, 0], np.sqrt(inputs[:, 1]), rtol=1e-15)
    again = find.iterate(inputs, tolerance=1e-6, max_steps=30, threads=3)
    part = find.iterate(inputs[3:10], tolerance=1e-6, max_steps=30)
    for k in range(2):
        assert np.array_equal(whole[k], again[k])
        assert np.array_equal(whole[k][3:10], part[k])


def line_of_roots(lanes=None):
    """A square root as a closing program: of regularity 0.5 where the number is above 0, with a kink at 0."""
    graph = Graph()
    x, margin, jump, a = (graph.input(name, [1.0]) for name in ("x", "margin", "jump", "a"))
    step = 0.5 * (x + a / x) - x
    outputs = {"q": [x + step], "margin": margin - 0.3, "jump": jump + absolute(step), "residual": absolute(x * x - a)}
    return llvm.compile(graph.program("line", outputs), lanes)


def marched_root(roots, square, shares):
    """March one step in plain Python."""
    last = roots[-1]
    x = last + sum(share * (last - before) for share, before in zip(shares, roots[-2::-1], strict=False))
    margin, jump, left, steps = 1.0, 0.0, math.inf, 0
    while left > 1e-8 and steps < 6:
        left = abs(x * x - square)
        new = 0.5 * (x + square / x)
        x, margin, jump, steps = new, margin - 0.3, jump + abs(new - x), steps + 1
    return x if left < 1e-8 and margin > 1e-3 and jump < 0.1 else math.nan


@pytest.mark.parametrize("lanes", LANES)
def test_march_predicts_along_lines_and_ends_them_where_a_pose_is_not_accepted(lanes, monkeypatch):
    monkeypatch.setattr(llvm, "_OPERATIONS_A_PART", 100)
    n, m = 19, 12
    squares = np.linspace(1.0, 9.0, n)[:, None] + 1e-5 * np.arange(m)
    squares[4, 7] += 1.0  # a jump that no step can follow
    shares = np.zeros((m - 1, llvm_ir.HISTORY))
    shares[3:, :2] = 1.5, -0.25
    shares[5:, 2] = -0.1
    wide = np.full((n, m, 2), np.nan)
    wide[:, 0, 0] = np.sqrt(squares[:, 0])
    again = wide.copy()
    program = line_of_roots(lanes)
    program.march(wide[..., :1], squares[..., None], (), shares, mode=0.0, threads=1)
    program.march(again[..., :1], squares[..., None], (), shares, mode=0.0, threads=3)
    assert np.isnan(wide[..., 1]).all()
    assert np.array_equal(wide, again, equal_nan=True)
    roots = wide[..., 0]
    for line, numbers in zip(roots, squares, strict=True):
        expected = [line[0]]
        for k in range(1, m):
            expected.append(marched_root(expected, numbers[k], shares[k - 1]))
        np.testing.assert_allclose(line, expected, rtol=1e-14)
    assert np.isnan(roots[4, 7:]).all()
    assert np.isfinite(np.delete(roots, 4, axis=0)).all()
    back = roots.copy()
    back[:, :-3] = np.nan  # three known poses, of the fifth line only the last, and back along the lines
    back[4, -3] = np.sqrt(squares[4, -3])
    program.march(back[:, ::-1, None], squares[:, ::-1, None], (), shares[2:], mode=0.0, threads=1)
    np.testing.assert_allclose(np.delete(back, 4, axis=0), np.delete(roots, 4, axis=0), rtol=1e-14)
    np.testing.assert_allclose(back[4, 8:10], np.sqrt(squares[4, 8:10]), rtol=1e-14)
    assert np.isnan(back[4, :8]).all()


def test_errors():
    find = root_finder()
    with pytest.raises(InvalidValueError, match=r"inputs of shape \(3, 1\): expected \(n, 2\)"):
        find(np.zeros((3, 1)))
    with pytest.raises(InvalidValueError, match=r"parameters of shape .* expected \(0,\)"):
        find(np.zeros((3, 2)), [1.0])
    with pytest.raises(InvalidValueError, match=r"out is float32 of shape .* shape \(3, 2\)"):
        find(np.zeros((3, 2)), out=np.zeros((3, 2), dtype=np.float32))
    with pytest.raises(InvalidValueError, match="max_steps = 0"):
        find.iterate(np.zeros((3, 2)), tolerance=1.0, max_steps=0)
    with pytest.raises(InvalidValueError, match="margin, jump"):
        find.march(*np.zeros((2, 3, 4, 1)), (), np.zeros((3, llvm_ir.HISTORY)), mode=0.0)
    with pytest.raises(InvalidValueError, match=r"lines have shapes \(3, 4, 1\)"):
        line_of_roots().march(
            *(np.zeros((3, 4, 1)), np.zeros((3, 5, 1)), (), np.zeros((3, llvm_ir.HISTORY))),
            mode=0.0,
        )
    with pytest.raises(InvalidValueError, match="a residual"):
        compiled(lambda x: x, 1).iterate(np.zeros((3, 1)), tolerance=1.0, max_steps=1)


def test_what_llvm_does_not_compile_is_said(monkeypatch):
    program = root_finder().program
    monkeypatch.setattr(llvm_ir, "module", lambda *_: "this is no module")
    with pytest.raises(ProgramError, match="program 'root': LLVM does not compile it: "):
        llvm.compile(program)


def test_machine_code_in_a_circle_of_references_is_collected():
    """Whatever the garbage collector finalises first, the process survives."""
    for _ in range(5):
        program = compiled(lambda x: [x], 1)
        program.itself = program
        del program
        gc.collect()
