"""Structures side by side, by residuals and costs that are known: whether one explains, and which is chosen."""

from types import SimpleNamespace

import numpy as np
import pytest

from greybox.workflows.identification.selection import Candidate, held_by_bounds, select

N = 40
MEASURED = np.exp(1j * np.arange(N)) * np.geomspace(3, 0.1, N)


def candidate(misfit=0.1, noise=1.0, free=0, cost=10.0, remarks=(), label="S", converged=True):
    """Of residuals of one relative size, `noise` times their standard deviations; None if unknown."""
    variance = None if noise is None else (misfit / noise * np.abs(MEASURED)) ** 2
    part = SimpleNamespace(
        data=SimpleNamespace(response=MEASURED, variance=variance),
        response=MEASURED * (1 + misfit * np.exp(2j * np.arange(N))),
        relative_residuals=np.full(N, misfit),
        compared_numbers=2 * N,
        nuisances=0,
    )
    fit = SimpleNamespace(
        responses=[part], parts=[part], free=("p",) * free, cost=cost, converged=converged
    )
    return Candidate(label, fit, "about", remarks)


def test_residuals_are_compared_with_the_noise_less_what_parameters_take():
    """Of 2n real numbers, p parameters take p."""
    assert candidate(noise=1.3).noise == pytest.approx(1.3)
    assert candidate(noise=1.3, free=20).noise == pytest.approx(1.3 * np.sqrt(80 / 60))
    assert candidate(misfit=0.21).misfit == pytest.approx(0.21)
    for unknown in (candidate(noise=None), candidate(converged=False)):
        assert np.isnan(unknown.noise)


@pytest.mark.parametrize(
    ("misfit", "noise", "explains"),
    [
        (0.049, 49.0, True),  # useful, whatever the noise
        (0.051, 49.0, False),
        (0.2, 2.9, True),
        (0.2, 3.1, False),
        (0.36, 1.6, True),  # less the noise 0.36 √(1 - 1/1.6²) = 0.28
        (0.4, 1.6, False),  # 0.31
        (0.9, 1.4, True),
        (0.9, 0.5, True),
        (0.29, None, True),
        (0.31, None, False),
    ],
)
def test_a_structure_explains_what_noise_and_a_share_of_the_response_leave(misfit, noise, explains):
    chosen = candidate(misfit, noise)
    assert chosen.explains == explains
    selection = select([chosen])
    assert selection.explains == explains
    assert selection.verdict.startswith("No structure explains the data") == (not explains)


@pytest.mark.parametrize(
    ("noise", "inflation", "chosen"),
    # The BIC of A and C are within 2 of each other in the third case: the smaller one is chosen.
    [(0.5, 1, "C"), (1.0, 1, "C"), (2.0, 4, "A"), (None, 1, "C")],
)
def test_costs_over_the_least_noise_pay_for_parameters(noise, inflation, chosen):
    """By BIC, 2 cost / inflation + p log 2n; an unstable pole pays 6, and what failed has none."""
    unstable = ("unstable pole 2 rad/s",)
    candidates = [
        candidate(noise=noise, cost=30.0, free=0, label="A"),
        candidate(noise=noise and 2 * noise, cost=20.0, free=2, label="B"),
        candidate(noise=noise, cost=9.0, free=1, label="C", remarks=unstable),
        candidate(noise=None, cost=0.0, free=3, label="D", converged=False),
    ]
    selection = select(candidates)
    expected = np.array([60, 40, 18]) / inflation + np.array([0, 2, 1]) * np.log(80) + [0, 0, 6]
    assert selection.bic == pytest.approx([*expected, np.nan], nan_ok=True)
    assert selection.chosen.label == chosen
    (row,) = (line for line in str(selection).splitlines() if "  chosen" in line)
    assert row.split()[0] == chosen
    assert "no fit" in str(selection)


def test_without_a_fit_nothing_is_chosen():
    selection = select([candidate(converged=False)])
    assert (selection.chosen, selection.fit, selection.explains) == (None, None, False)
    assert "No structure has a fit" in str(selection)


def test_parameters_at_their_bounds_are_a_remark():
    def fit(*at_bound):
        return SimpleNamespace(at_bound=at_bound)

    assert held_by_bounds(fit()) == ()
    assert held_by_bounds(fit("b")) == ("b at its bound",)
    assert held_by_bounds(fit("a", "c")) == ("a and c at their bound",)
