"""Recording numbers: recording, folding and sharing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.programs.graph import (
    Graph,
    Number,
    absolute,
    atan2,
    cos,
    less,
    maximum,
    minimum,
    select,
    sin,
    sqrt,
)
from pm3dof_pin.programs.program import Program

SAMPLES = np.array([[0.3, -1.2, 2.5, 1.0], [1.5, 0.7, -0.4, 1.0]])


@pytest.fixture
def graph():
    return Graph()


@pytest.fixture
def a(graph):
    return graph.input("a", SAMPLES[0])


@pytest.fixture
def b(graph):
    return graph.input("b", SAMPLES[1])


def test_zeros_and_ones_vanish(graph, a, b):
    zero, one = graph.constant(0.0), graph.constant(1.0)
    assert a + 0 is a
    assert zero + a is a
    assert a - 0.0 is a
    assert a * 1 is a
    assert one * a is a
    assert a / 1 is a
    assert (0 * a).is_zero
    assert (a - a).is_zero
    assert (0 / a).is_zero
    assert (a / a).value == 1.0
    assert (a * 0 + b) is b


def test_signs_move_outwards(a, b):
    opposite = -a
    assert -opposite is a
    assert (-a) * b is -(a * b)
    assert a * (-b) is -(a * b)
    assert (-a) * (-b) is a * b
    assert a - (-b) is a + b
    assert a + (-b) is a - b
    assert -(a - b) is b - a
    assert a * -1.0 is -a
    assert (-a) / b is -(a / b)
    assert cos(-a) is cos(a)
    assert sin(-a) is -sin(a)


def test_equal_work_is_shared(graph, a, b):
    assert a + b is b + a
    assert a * b is b * a
    assert sqrt(a * a + b) is sqrt(b + a * a)
    assert a - b is not b - a
    count = len(graph)
    b - a
    a * a + b
    assert len(graph) == count


def test_constants_fold(graph):
    two = graph.constant(2.0)
    assert (two * 3 + 1).value == 7.0
    assert sqrt(two * 2).value == 2.0
    assert atan2(graph.constant(1.0), graph.constant(1.0)).value == pytest.approx(math.pi / 4, rel=1e-15)
    assert math.isinf((two / 0).value)
    assert math.isnan(sqrt(graph.constant(-1.0)).value)
    assert graph.constant(-0.0) is graph.constant(0.0)


def test_numbers_work_in_arrays_and_with_floats_of_numpy(graph, a, b):
    A = np.array([[a, b], [-b, a]], dtype=object)
    product = A @ A + np.eye(2) * np.float64(3)
    expected = SAMPLES[0] ** 2 - SAMPLES[1] ** 2 + 3
    assert np.allclose(product[0, 0].samples, expected, rtol=1e-15)
    assert isinstance(np.float64(2) * a, Number)
    assert np.float64(2) * a is a * 2
    assert a**5 is ((a * a) * (a * a)) * a


def test_functions_take_floats():
    assert sin(0.3) == math.sin(0.3)
    assert cos(0.3) == math.cos(0.3)
    assert sqrt(4.0) == 2.0
    assert atan2(1.0, -1.0) == pytest.approx(0.75 * math.pi)
    assert minimum(1.0, 2.0) == 1.0
    assert maximum(1.0, 2.0) == 2.0
    assert absolute(-2.0) == 2.0
    assert select(less(1.0, 2.0), 5.0, 6.0) == 5.0
    assert select(~less(1.0, 2.0), 5.0, 6.0) == 6.0


def test_conditions(graph, a, b):
    positive = less(0.0, a)
    assert np.array_equal(positive.samples, SAMPLES[0] > 0)
    assert ~~positive is positive
    assert positive & np.True_ is positive
    assert np.True_ & positive is positive
    assert (positive | np.True_) == np.True_
    assert (positive & np.False_) == np.False_
    both = select(positive & less(0.0, b), 1.0, 0.0)
    assert np.array_equal(both.samples, (SAMPLES > 0).all(axis=0))
    assert select(~positive, a, b) is select(positive, b, a)
    assert select(positive, a, a) is a
    with pytest.raises(TypeError, match="use select"):
        bool(positive)


def test_samples_may_be_nan_without_a_warning(graph, a):
    parameter = graph.parameter("p", -1.0)
    assert np.isnan(sqrt(parameter).samples).all()
    assert sqrt(parameter).samples.shape == (4,)
    assert np.isinf((a / (parameter + 1.0)).samples).all()


def test_nothing_dead_is_output(graph, a, b):
    sin(a) * 3 + b
    program = graph.program("f", {"sum": a + b, "both": [[a, 0.0], [b, b]]})
    assert [operation for operation, _ in program.lines] == ["add"]
    assert program.inputs == ("a", "b")
    assert program.outputs == {"sum": (), "both": (2, 2)}
    outputs = program.split(program.evaluate(SAMPLES.T))
    assert np.array_equal(outputs["sum"], SAMPLES.sum(axis=0))
    assert np.array_equal(outputs["both"][1], [[SAMPLES[0, 1], 0.0], [SAMPLES[1, 1]] * 2])


def test_errors_name_the_thing(graph, a):
    with pytest.raises(InvalidValueError, match="name = 'a'"):
        graph.parameter("a", 1.0)
    with pytest.raises(InvalidValueError, match=r"samples of c of .* \(4,\)"):
        graph.input("c", [1.0])
    with pytest.raises(InvalidValueError, match="same graph"):
        a + Graph().input("a", [1.0])
    with pytest.raises(InvalidValueError, match="expected a number"):
        graph.program("f", {"x": ["one"]})


def test_program_to_bytes_and_back(graph, a, b):
    stiffness = graph.parameter("k", 2.0)
    program = graph.program("f", {"x": [sin(a) * stiffness + 0.1, select(less(a, b), a, b)], "y": atan2(a, b)})
    again = Program.from_bytes(program.content)
    assert again.key == program.key
    assert again.lines == program.lines
    assert np.array_equal(again.evaluate(SAMPLES.T, [2.0]), program.evaluate(SAMPLES.T, [2.0]))
    for damaged in (program.content[:-1], program.content[1:], b""):
        with pytest.raises(InvalidValueError):
            Program.from_bytes(damaged)


FINITE = st.floats(-1e3, 1e3).map(lambda value: round(value, 3))


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 100), st.integers(0, 100)), max_size=30), FINITE, FINITE)
def test_folding_keeps_the_value(steps, first, second):
    """Folded and shared expressions have the value of the same expression in floats if everything is finite."""
    graph = Graph()
    recorded = [graph.input("a", [first]), graph.input("b", [second]), graph.constant(0.0), graph.constant(-1.0)]
    plain = [first, second, 0.0, -1.0]
    operations = [
        lambda a, b: a + b,
        lambda a, b: a - b,
        lambda a, b: a * b,
        lambda a, b: -a,
        lambda a, b: minimum(a, b),
        lambda a, b: maximum(a, b),
        lambda a, b: select(less(a, b), a, b),
        lambda a, b: sin(a) * cos(b),
    ]
    for code, i, j in steps:
        i, j = i % len(plain), j % len(plain)
        value = operations[code](plain[i], plain[j])
        if not abs(value) < 1e100:
            continue
        plain.append(value)
        recorded.append(operations[code](recorded[i], recorded[j]))
    program = graph.program("f", {"values": recorded})
    values = program.evaluate([[first, second]])[0]
    assert np.allclose(values, plain, rtol=1e-11, atol=1e-11)
    assert np.array_equal(values, [number.samples[0] for number in recorded], equal_nan=True)


def test_a_program_is_recorded_again_as_part_of_another(graph, a, b):
    """The sum of squares of a program's outputs, of which conditions and constants are part, against plain Python."""
    scale = graph.parameter("scale", 2.0)
    near = less(a, b) & ~less(b, 0.0)
    first = graph.program("first", {"pair": [select(near, sin(a) / scale, -sqrt(absolute(b))), atan2(b, a) - 0.5]})
    again = Graph()
    x, y = again.again(first, SAMPLES.T, [2.0])["pair"]
    second = again.program("second", {"sum": x * x + y * y})
    assert (second.inputs, second.parameters) == (("a", "b"), ("scale",))
    wanted = [
        (math.sin(p) / 3.0 if q >= 0.0 and p < q else -math.sqrt(abs(q))) ** 2 + (math.atan2(q, p) - 0.5) ** 2
        for p, q in SAMPLES.T.tolist()
    ]
    np.testing.assert_allclose(second.evaluate(SAMPLES.T, [3.0])[:, 0], wanted, rtol=1e-14)
    np.testing.assert_allclose((x * x).samples, first.evaluate(SAMPLES.T, [2.0])[:, 0] ** 2, rtol=1e-14)
