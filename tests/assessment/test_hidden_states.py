"""A search that fails where most initial states are hidden says what helps, and that helps."""

import numpy as np
import pytest

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

LEVELS = 12
NAMES = tuple(f"h{k + 1}" for k in range(LEVELS))


class Chain(gb.StateSpace):
    """Tanks in a row, each emptying into the next; the last level is measured."""

    states, inputs, outputs = NAMES, ("q",), ("y",)
    state_starts = dict.fromkeys(NAMES, 1.0)
    k = gb.Parameter(0.8, bounds=(0.3, 3))
    A = gb.Parameter(1.3, bounds=(0.3, 3))

    def derivative(self, x, u, p):
        outflows = [p.k * gb.sqrt(getattr(x, name)) for name in NAMES]
        inflows = [u.q, *outflows[:-1]]
        return tuple((a - b) / p.A for a, b in zip(inflows, outflows, strict=True))

    def output(self, x, u, p):
        return (getattr(x, NAMES[-1]),)


@pytest.fixture(scope="module")
def record():
    random = np.random.default_rng(0)
    t, q = 0.25 * np.arange(300), np.repeat(random.uniform(0.5, 1.5, 15), 20)
    empty = gb.Record(t, {"q": q}, hold={"q": np.inf})
    full = dict.fromkeys(NAMES, 1.0)
    y = gb.simulate(Chain(), {"k": 1.0, "A": 1.0}, record=empty, initial=full)["y"]
    noisy = y + 0.01 * random.standard_normal(len(t))
    return gb.Record(t, {"q": q, "y": noisy}, hold={"q": np.inf, "y": 0.0})


def test_a_failed_search_with_hidden_states_asks_for_known_ones(record):
    problem = gb.Problem(Chain(), record)
    fit = gb.fit(problem, 1, progress=False)
    if fit.converged:
        pytest.skip("the search has become better than its advice")
    assert "OutputError(initial={'h1': ...})" in fit.warnings[0]


def test_with_known_levels_the_same_search_arrives(record):
    known = gb.OutputError(initial=dict.fromkeys(NAMES, 1.0))
    fit = gb.fit(gb.Problem(Chain(), record, known), 4, checks=(), progress=False)
    for name in ("k", "A"):
        assert abs(fit.estimate[name] - 1.0) < 4 * fit.standard_error[name] < 0.1
