"""Of a grid of rational transfer functions the one that made the data is chosen, and not a larger one."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import measured

import greybox as gb
from greybox.files.text_table import number
from greybox.identification.orders import _linear_starts
from greybox.models.polynomial import Polynomial
from greybox.regression.poles_and_zeros import near_pairs


class Plant(gb.TransferFunction):
    """An integrator with lag and delay, of a gain far from one."""

    K = gb.Parameter(900.0)

    def response(self, s, p):
        return p.K / (s * (0.2 * s + 1)) * gb.exp(-0.05 * s)


@pytest.fixture(scope="module")
def found():
    data = measured(Plant(), np.geomspace(0.5, 30, 20), noise=0.02, seed=1)
    return gb.identification.select_orders(
        data, n=(1, 2), integrators=(1,), delays=(0.0, 0.2), starts=1
    )


def test_the_structure_of_the_truth_is_chosen(found):
    assert (found.chosen.n, found.chosen.m, found.chosen.integrators, found.chosen.delay) == (
        2,
        0,
        1,
        True,
    )
    estimate = found.fit.estimate
    assert estimate["b0"] == pytest.approx(900 / 0.2, rel=0.03)
    assert estimate["a1"] == pytest.approx(5.0, rel=0.03)
    assert estimate["T_delay"] == pytest.approx(0.05, rel=0.05)
    assert found.verdict.startswith(
        "n = 2, m = 0, 1 integrator, delay (3 free) is supported: it has the least BIC, by "
    )
    assert "<- chosen" in str(found)
    for c in found.candidates:
        assert c.bic == pytest.approx((c.parameters + 1) * math.log(40) + 2 * c.fit.cost)
    # More parameters of a larger structure never cost more: every fit has found its minimum.
    costs = {(c.n, c.m, c.delay): c.fit.cost for c in found.candidates}
    assert costs[2, 1, True] <= costs[2, 0, True] + 1e-6 < costs[2, 0, False]


def test_the_table_has_every_structure_that_was_fitted(found):
    """By number of parameters and BIC, with poles and zeros that nearly cancel."""
    lines = str(found).splitlines()
    assert lines[0].split() == "n m integrators delay free -ln L BIC above pairs".split()
    assert [(c.parameters, c.bic) for c in found.candidates] == sorted(
        (c.parameters, c.bic) for c in found.candidates
    )
    least = min(c.bic for c in found.candidates)
    for line, c in zip(lines[2:], found.candidates, strict=False):
        cells = [
            str(c.n),
            str(c.m),
            str(c.integrators),
            *(["yes"] if c.delay else []),
            str(c.parameters),
        ]
        cells += [
            number(c.fit.cost, 5),
            number(round(c.bic - least, 2), 4),
            *([str(len(c.pairs))] if c.pairs else []),
        ]
        assert line.split() == [*cells, *(["<-", "chosen"] if c is found.chosen else [])]
        estimate = c.fit.estimate
        assert c.parameters == c.n - c.integrators + c.m + 1 + c.delay == len(c.fit.free)
        zeros = np.roots([estimate[f"b{k}"] for k in range(c.m, -1, -1)])
        poles = np.roots([1.0, *(estimate[f"a{k}"] for k in range(c.n - 1, c.integrators - 1, -1))])
        assert list(map(str, c.pairs)) == list(map(str, near_pairs(zeros, poles)))
    assert any(c.m for c in found.candidates)
    assert lines[2 + len(found.candidates) :] == ["", found.verdict]
    assert (
        repr(found)
        == f"<OrderSelection {len(found.candidates)} structures, n = 2, m = 0, 1 integrator, delay>"
    )
    assert str(replace(found, failed=2)).endswith("2 structures had no fit.")


def test_polynomials_have_several_integrators_and_a_delay():
    omega = np.array([0.5, 3.0])
    s = 1j * omega
    model = Polynomial(3, 1, 2, delay=0.2)
    assert model.label == "Polynomial(3, 1, 2 integrators, delay)"
    made = gb.frequency_response(
        model, {"b0": 2.0, "b1": 3.0, "a2": 4.0, "T_delay": 0.1}, omega
    ).response
    np.testing.assert_allclose(made, (3 * s + 2) / (s**2 * (s + 4)) * np.exp(-0.1 * s), rtol=1e-12)
    with pytest.raises(
        ValueError, match=r"integrator = 4 and delay = 0\.0: give from 0 to n = 3 integrators"
    ):
        Polynomial(3, 1, 4)


def test_a_grid_without_a_structure_is_told():
    data = measured(Plant(), np.array([1.0, 2.0]))
    with pytest.raises(
        ValueError, match="no structure of the grid has fewer unknowns than 4 real numbers: lower n"
    ):
        gb.identification.select_orders(data, n=(4,))


def test_linear_least_squares_begins_at_the_truth_where_its_share_of_the_delay_is_right():
    """(3 s + 2) / (s (s² + 4 s + 5)) with a delay of a fifth of the longest; and where there is none to find."""
    omega = np.geomspace(0.3, 10, 9)
    s = 1j * omega
    data = gb.FrequencyResponse(omega, (3 * s + 2) / (s * (s**2 + 4 * s + 5)) * np.exp(-0.1 * s))
    shares = list(_linear_starts(data, 3, 1, 1, 0.5))
    assert [start["T_delay"] for start in shares] == [0.0, 0.1, 0.25]
    exact = {"b0": 2.0, "b1": 3.0, "a1": 5.0, "a2": 4.0, "T_delay": 0.1}
    assert shares[1] == pytest.approx(exact, rel=1e-6)
    assert shares[0]["a1"] != pytest.approx(5.0, rel=1e-3)
    bare = gb.FrequencyResponse(omega, data.response * np.exp(0.1 * s))
    assert list(_linear_starts(bare, 3, 1, 1, 0.0)) == [
        pytest.approx({k: exact[k] for k in ("b0", "b1", "a1", "a2")})
    ]
    assert list(_linear_starts(bare, 3, 2, 1, 0.0)) == []
    assert list(_linear_starts(bare, 1, 0, 1, 0.0)) == []
    assert len(list(_linear_starts(bare, 2, 0, 1, 0.0))) == 1


def test_a_grid_of_which_no_structure_has_a_fit_is_told(monkeypatch):
    monkeypatch.setattr(
        "greybox.identification.orders.fit", lambda *_, **__: SimpleNamespace(converged=False)
    )
    data = measured(Plant(), np.geomspace(0.5, 30, 20))
    with pytest.raises(
        ValueError, match="none of 3 structures has a fit: look at the response first"
    ):
        gb.identification.select_orders(data, n=(1, 2), integrators=(0,), delays=(0.0,), starts=1)
