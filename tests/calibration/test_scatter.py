"""Scatter of positions, orientations and drives separated, in errors drawn with known covariances."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from pm3dof_pin.calibration.scatter import Scatter

POSES = 3000
# drives of two kinds, with similar effects on the tool, twice as large for the first; or of one kind, with equal ones
EVERYWHERE, KINDS = (
    np.array([4e-12, 9e-12]),
    {("m", "rad"): np.array([9e-12, 36e-12]), ("m", "m"): np.array([16e-12, 16e-12])},
)


def drawn(
    generator: np.random.Generator, shown: np.ndarray, drives: np.ndarray, everywhere: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return measured errors, their known covariance, projections, and the motions by two drives."""
    control = generator.standard_normal((POSES, 6, 2)) * [1.0, 0.5]
    half = 3e-6 * generator.standard_normal((POSES, 6, 6))
    errors = np.sqrt(everywhere.repeat(3)) * generator.standard_normal((POSES, 6))
    errors += np.einsum("nij,nj->ni", control, np.sqrt(drives) * generator.standard_normal((POSES, 2)))
    errors += np.einsum("nij,nj->ni", half, generator.standard_normal((POSES, 6)))
    projections = np.tile(shown, (POSES, 1, 1))
    return errors @ shown, shown @ half @ np.swapaxes(half, 1, 2) @ shown, projections, control


@pytest.mark.parametrize("units", KINDS)
@pytest.mark.parametrize("seen", [6, 3])
def test_all_kinds_are_found(seen: int, units: tuple[str, str]) -> None:
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 6)))[0][:, :seen]
    everywhere = EVERYWHERE if seen == 6 else EVERYWHERE[[0, 0]]  # for parts of poses both are taken as equal
    found = Scatter.from_errors(*drawn(np.random.default_rng(2), turned @ turned.T, KINDS[units], everywhere), units)
    # a few hundred poses' worth of information: to a tenth
    np.testing.assert_allclose(found.everywhere, everywhere, rtol=0.1)
    np.testing.assert_allclose(found.drives, KINDS[units], rtol=0.1)
    assert found.tip_error == pytest.approx(np.sqrt(3 * everywhere.sum() + 6 * KINDS[units] @ [1.0, 0.25]), rel=0.05)


def test_where_all_is_explained_next_to_nothing_is_found() -> None:
    generator = np.random.default_rng(3)
    errors, known, shown, control = (a[:40] for a in drawn(generator, np.eye(6), np.zeros(2), np.zeros(2)))
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(known), generator.standard_normal((40, 6)))
    found = Scatter.from_errors(errors, known, shown, control, ("m", "m"))
    assert found.tip_error**2 < 0.2 * np.einsum("nii->n", known).mean()  # 2.4 standard errors of 40 poses
    assert Scatter.from_errors(0.5 * errors, known, shown, control, ("m", "m")).tip_error == 0.0


def test_projections_that_are_rounding_show_nothing() -> None:
    """Of a machine with six drives nothing is left across what these correct, but for 1e-16."""
    generator = np.random.default_rng(8)
    motions = generator.standard_normal((200, 6, 6))
    shown = np.eye(6) - motions @ np.linalg.inv(motions)
    assert 0.0 < np.abs(shown).max() < 1e-11
    known = shown @ (1e-10 * np.eye(6)) @ np.swapaxes(shown, 1, 2)
    errors = np.einsum("nij,nj->ni", shown, 1e-5 * generator.standard_normal((200, 6)))
    found = Scatter.from_errors(errors, known, shown, np.zeros((200, 6, 6)), ["m"] * 6)
    assert found.tip_error == 0.0


def test_parts_below_their_standard_error_are_left_out_on_request() -> None:
    """Without scatter, each of three estimates is positive in half the cases, and above its standard error in a sixth
    of them."""
    generator, found = np.random.default_rng(5), []
    for _ in range(60):
        _, known, shown, control = (a[:40] for a in drawn(generator, np.eye(6), np.zeros(2), np.zeros(2)))
        errors = np.einsum("nij,nj->ni", np.linalg.cholesky(known), generator.standard_normal((40, 6)))
        seen = (errors, known, shown, control, ("m", "m"))
        found.append([Scatter.from_errors(*seen, least=least).tip_error > 0.0 for least in (0.0, 1.0)])
    some, sure = np.mean(found, axis=0)
    assert 0.35 < some < 0.9
    assert sure < 0.4


def test_estimates_are_as_uncertain_as_they_say() -> None:
    """Propagation of the scatter by a gain, over random sets of 60 poses: actual spread against the stated one."""
    generator, gains, found = np.random.default_rng(6), np.eye(6)[None, :4], []
    for _ in range(80):
        errors, known, shown, control = (a[:60] for a in drawn(generator, np.eye(6), KINDS["m", "m"], EVERYWHERE))
        scatter, at = Scatter.from_errors(errors, known, shown, control, ("m", "m")), np.broadcast_to(gains, (60, 4, 6))
        square = np.einsum("nij,njk,nik->", at, scatter.covariances(control), at) / 60
        found.append([square, np.sqrt(scatter.mean_square_variance(at, control))])
    squares, deviations = np.transpose(found)
    assert np.mean(deviations) == pytest.approx(np.std(squares), rel=0.25)  # three standard errors of 80


def test_covariances_are_the_sum_of_all() -> None:
    control, drives = np.random.default_rng(4).standard_normal((5, 6, 2)), KINDS["m", "rad"]
    directions = np.diag(EVERYWHERE.repeat(3))
    one_by_one = [directions + c @ np.diag(drives) @ c.T for c in control]
    np.testing.assert_allclose(Scatter(EVERYWHERE, drives).covariances(control), one_by_one)
    np.testing.assert_allclose(Scatter(EVERYWHERE).covariances(control), [directions] * 5)


def test_bounds_hold_for_a_machine_whose_errors_have_long_tails() -> None:
    """One pose in eight is three times as far off as the others: a robust fit calls these outliers."""
    generator, count, sigma = np.random.default_rng(8), 4000, 2e-5
    far = np.where(np.arange(count) % 8 == 0, 3.0, 1.0)
    errors = sigma * far[:, None] * generator.standard_normal((count, 6))
    others = np.zeros((count, 6, 6)), np.tile(np.eye(6), (count, 1, 1)), np.zeros((count, 6, 2))
    usual = Scatter(np.full(2, sigma**2))
    first = np.arange(count) < 80
    held_out = (errors[first], *(each[first] for each in others))

    def within(scatter: Scatter) -> float:
        bound = scatter.tails * sigma * np.sqrt(scipy.stats.chi2.ppf(0.95, 6))
        return float(np.mean(np.linalg.norm(errors[~first], axis=1) <= bound))

    wide = usual.with_tails(*held_out)
    assert within(usual) < 0.88
    assert 0.93 < within(wide) < 0.98
    # a mistake of measuring is none of the machine
    held_out[0][3] = 1.0
    assert usual.with_tails(*held_out).tails == pytest.approx(wide.tails, rel=0.11)
    assert wide.long_tailed
    # nor are normal errors called so, and 4 of 80 beyond their bounds are as many as promised
    ordinary = np.zeros((80, 6))
    ordinary[:, 0] = sigma * np.sqrt(scipy.stats.chi2.ppf((np.arange(80) + 0.5) / 80, 6))
    assert usual.with_tails(ordinary, *(each[first] for each in others)) == usual
    # with 7, a chance of 11 %, the factor is what takes three of them within, without a complaint
    ordinary[73:76, 0] = 1.05 * sigma * np.sqrt(scipy.stats.chi2.ppf(0.95, 6))
    widened = usual.with_tails(ordinary, *(each[first] for each in others))
    assert widened.tails == pytest.approx(1.1)
    assert not widened.long_tailed
