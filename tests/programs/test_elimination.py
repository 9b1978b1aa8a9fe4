"""Elimination on recorded numbers against NumPy's and SciPy's decompositions of the same matrices."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from pm3dof_pin.programs.elimination import Doubt, eliminate, product, solve_upper, zeros
from pm3dof_pin.programs.graph import Graph

SAMPLES = 8


def recorded(graph: Graph, values: np.ndarray, name: str) -> np.ndarray:
    """Numbers with the values of matrices at sample poses, shape=(s, m, n); entries that are always zero are zeros."""
    matrix = np.empty(values.shape[1:], dtype=object)
    for index in np.ndindex(matrix.shape):
        entry = values[(slice(None), *index)]
        matrix[index] = graph.input(f"{name}{index}", entry) if entry.any() else 0.0
    return matrix


def evaluated(graph: Graph, **outputs: object) -> dict[str, np.ndarray]:
    """Values of numbers at the sample poses."""
    program = graph.program("test", outputs)  # type: ignore[arg-type]
    rows = np.column_stack([number.samples for number in graph._inputs.values()])
    return program.split(program.evaluate(rows))


def sparse_matrices(generator: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    pattern = generator.random((rows, columns)) < 0.6
    pattern[np.arange(columns), np.arange(columns)] = True
    return generator.standard_normal((SAMPLES, rows, columns)) * pattern


def least_squares(matrix: np.ndarray, right: np.ndarray, doubt: Doubt) -> np.ndarray:
    """Return x that minimises |A x - b|; undetermined unknowns are 0."""
    n = matrix.shape[1]
    b = right.reshape(len(matrix), -1)
    result = eliminate(np.hstack([matrix, b]), range(n), doubt)
    solution = zeros(n, b.shape[1])
    columns = list(result.columns)
    solution[columns] = solve_upper(result.pivot_rows[:, columns], result.pivot_rows[:, n:])
    return solution.reshape(n, *right.shape[1:])


@pytest.mark.parametrize(("rows", "columns"), [(3, 2), (4, 4), (6, 3), (9, 5), (5, 1)])
def test_least_squares(rows: int, columns: int) -> None:
    generator = np.random.default_rng(rows)
    graph, matrices = Graph(), sparse_matrices(generator, rows, columns)
    right = generator.standard_normal((SAMPLES, rows, 2))
    doubt = Doubt()
    x = least_squares(recorded(graph, matrices, "A"), recorded(graph, right, "b"), doubt)
    found = evaluated(graph, x=x, pivot=doubt.pivot)
    for k in range(SAMPLES):
        np.testing.assert_allclose(found["x"][k], np.linalg.lstsq(matrices[k], right[k], rcond=None)[0], atol=1e-11)
        assert found["pivot"][k] <= np.linalg.norm(matrices[k], axis=0).max()


def test_undetermined_unknowns_stay_at_zero_and_dependence_is_recorded() -> None:
    generator = np.random.default_rng(1)
    matrices = generator.standard_normal((SAMPLES, 5, 3))
    matrices[:, :, 2] = matrices[:, :, 0] - 2.0 * matrices[:, :, 1]
    right = generator.standard_normal((SAMPLES, 5))
    graph, doubt = Graph(), Doubt()
    x = least_squares(recorded(graph, matrices, "A"), recorded(graph, right[..., None], "b")[:, 0], doubt)
    found = evaluated(graph, x=x, dropped=doubt.dropped)
    for k in range(SAMPLES):
        best = matrices[k] @ np.linalg.lstsq(matrices[k], right[k], rcond=None)[0]
        np.testing.assert_allclose(matrices[k] @ found["x"][k], best, atol=1e-12)
        assert (found["x"][k] == 0.0).sum() == 1
    assert 0.0 < found["dropped"].max() < 1e-13


def test_a_pose_at_which_a_column_is_dependent_has_a_small_pivot_and_one_at_which_it_is_not_drops_something() -> None:
    generator = np.random.default_rng(2)
    matrices = generator.standard_normal((SAMPLES, 4, 2))
    graph, doubt = Graph(), Doubt()
    least_squares(recorded(graph, matrices, "A"), recorded(graph, np.ones((SAMPLES, 4, 1)), "b"), doubt)
    program = graph.program("test", {"pivot": doubt.pivot})
    pose = matrices[0].copy()
    pose[:, 1] = 3.0 * pose[:, 0] + 1e-9
    assert program.evaluate(np.append(pose.ravel(), np.ones(4))[None])[0, 0] < 1e-8

    matrices[:, :, 1] = 2.0 * matrices[:, :, 0]
    graph, doubt = Graph(), Doubt()
    least_squares(recorded(graph, matrices, "A"), recorded(graph, np.ones((SAMPLES, 4, 1)), "b"), doubt)
    program = graph.program("test", {"dropped": doubt.dropped})
    pose = matrices[0].copy()
    pose[:, 1] += 1e-3 * generator.standard_normal(4)
    assert program.evaluate(np.append(pose.ravel(), np.ones(4))[None])[0, 0] > 1e-5


def test_the_complement_spans_what_columns_leave() -> None:
    generator = np.random.default_rng(3)
    graph, matrices = Graph(), sparse_matrices(generator, 7, 4)
    system = recorded(graph, matrices, "A")
    result = eliminate(system, range(4), Doubt())
    rows = result.complement()
    found = evaluated(graph, rows=rows, zero=product(rows, system), triangle=result.pivot_rows)
    for k in range(SAMPLES):
        null = scipy.linalg.null_space(matrices[k].T)
        np.testing.assert_allclose(found["rows"][k] @ found["rows"][k].T, np.eye(3), atol=1e-13)
        np.testing.assert_allclose(found["rows"][k].T @ found["rows"][k], null @ null.T, atol=1e-13)
        np.testing.assert_allclose(found["zero"][k], 0.0, atol=1e-13)
        gram = found["triangle"][k].T @ found["triangle"][k]
        np.testing.assert_allclose(gram, matrices[k].T @ matrices[k], atol=1e-12)


def test_columns_wait_for_their_turn_unless_they_are_needed() -> None:
    """The two columns left free are those of the later turn, though sparser; but a column that is almost zero waits."""
    generator = np.random.default_rng(6)
    values = generator.standard_normal((SAMPLES, 2, 4))
    values[:, 1, 2], values[:, 0, 3] = 0.0, 0.0
    assert eliminate(recorded(Graph(), values, "A"), range(4), Doubt(), turns=[1, 1, 2, 2]).dropped == (2, 3)
    values[:, :, 1] = 2.0 * values[:, :, 0] + 1e-6 * values[:, :, 1]
    assert set(eliminate(recorded(Graph(), values, "A"), range(4), Doubt(), turns=[1, 1, 2, 2]).columns) & {2, 3}


def test_rows_apart_stay_apart() -> None:
    """Two systems without common columns cost no more together than separately."""
    generator = np.random.default_rng(4)
    graph = Graph()
    one = recorded(graph, generator.standard_normal((SAMPLES, 3, 2)), "A")
    two = recorded(graph, generator.standard_normal((SAMPLES, 3, 2)), "B")
    both = np.full((6, 4), 0.0, dtype=object)
    both[:3, :2], both[3:, 2:] = one, two
    together = eliminate(both, range(4), Doubt()).complement()
    apart = [eliminate(system, range(2), Doubt()).complement() for system in (one, two)]
    count = len(graph.program("together", {"rows": together}).lines)
    assert count == sum(len(graph.program("apart", {"rows": rows}).lines) for rows in apart)
    assert all(entry == 0.0 for entry in [*together[0, 3:], *together[1, :3]])


def test_solve_upper() -> None:
    generator = np.random.default_rng(5)
    matrices = np.triu(generator.standard_normal((SAMPLES, 4, 4))) + 3.0 * np.eye(4)
    right = generator.standard_normal((SAMPLES, 4, 3))
    graph = Graph()
    x = solve_upper(recorded(graph, matrices, "R"), recorded(graph, right, "b"))
    np.testing.assert_allclose(evaluated(graph, x=x)["x"], np.linalg.solve(matrices, right), atol=1e-13)
