"""Terms are chosen as by textbook regression, none from noise, and what cannot be told apart is said."""

import re
from dataclasses import replace

import numpy as np
import pytest
from declared_models import measured
from drag_flights import QUADRATIC, Drag, flight
from scipy.signal import lfilter
from scipy.stats import f

import greybox as gb
from greybox.assessment.validation.stepwise import with_terms

POLES = {"c1": 1.0, "c3": 3.0, "c3b": 3.05, "c9": 9.0}
OMEGA = np.geomspace(0.3, 30, 20)


class Terms(gb.TransferFunction):
    """A gain and lags of known poles: linear in its parameters."""

    K = gb.Parameter(1.0, bounds=(-1e4, 1e4), starts=(-20, 20))
    c1 = gb.Parameter(0.0, bounds=(-1e4, 1e4), starts=(-20, 20), fixed=True)
    c3 = gb.Parameter(0.0, bounds=(-1e4, 1e4), starts=(-20, 20))
    c3b = gb.Parameter(0.0, bounds=(-1e4, 1e4), starts=(-20, 20), fixed=True)
    c9 = gb.Parameter(0.0, bounds=(-1e4, 1e4), starts=(-20, 20))

    def response(self, s, p):
        return p.K + sum(p[name] / (s + pole) for name, pole in POLES.items())


def problem(values, noise=0.03, seed=0):
    data = measured(Terms(), OMEGA, {"K": 2.0, **values}, noise=noise, seed=seed)
    return gb.Problem(Terms(), data, gb.SquaredRelativeError())


def squares(data, names):
    """The least sum of squared relative errors over the gain and some terms, by linear algebra."""
    s = 1j * data.omega
    columns = [np.ones(len(s)), *(1 / (s + POLES[name]) for name in names)]
    A = np.array(columns).T / np.abs(data.response)[:, None]
    b = data.response / np.abs(data.response)
    A, b = np.vstack([A.real, A.imag]), np.concatenate([b.real, b.imag])
    return float(np.sum((A @ np.linalg.lstsq(A, b, rcond=None)[0] - b) ** 2))


def removed(found, step):
    return [t.term for t in found.trials if (t.step, t.change, t.done) == (step, "remove", True)]


@pytest.fixture(scope="module")
def selection():
    stated = problem({"c3": 4.0, "c9": 12.0})
    return stated.data, gb.stepwise(stated, list(POLES), starts=1)


def test_the_terms_of_the_truth_are_chosen_and_tested_as_in_regression(selection):
    data, found = selection
    assert len(found.terms) == 2
    assert found.terms[1] == "c9"
    chosen = []
    for step in dict.fromkeys(t.step for t in found.trials):
        added = [t for t in found.trials if t.step == step and t.change == "add"]
        for trial in added:
            small, large = squares(data, chosen), squares(data, [*chosen, trial.term])
            dof = 2 * len(data) - len(chosen) - 2
            assert trial.cost == pytest.approx(large, rel=1e-6)
            if not trial.why_not:
                p = f.sf((small - large) / (large / dof), 1, dof)
                # Relative errors of size σ differ by a share of σ from those of linear regression.
                assert np.log(trial.p_value) == pytest.approx(np.log(p), rel=np.sqrt(large / dof))
            assert trial.limit == pytest.approx(0.05 / (len(POLES) - len(chosen)))
        chosen += [t.term for t in added if t.done]
        chosen = [name for name in chosen if name not in removed(found, step)]
    assert found.without.cost == pytest.approx(squares(data, []), rel=1e-6)
    assert found.fit.cost == pytest.approx(squares(data, found.terms), rel=1e-6)


def test_terms_are_tried_without_once_there_are_two(selection):
    _, found = selection
    tried = {
        step: [t.term for t in found.trials if (t.step, t.change) == (step, "remove")]
        for step in (1, 2)
    }
    assert tried == {1: [], 2: list(found.terms)}


def test_what_the_data_cannot_tell_apart_is_said(selection):
    data, found = selection
    one, other = ("c3", "c3b") if "c3" in found.terms else ("c3b", "c3")
    assert list(found.alike) == [one]
    assert list(found.alike[one]) == [other]
    noise = found.fit.cost / found.fit.dof
    more = (squares(data, [other, "c9"]) - found.fit.cost) / noise
    assert found.alike[one][other] == pytest.approx(more, rel=np.sqrt(noise))
    assert f"These data cannot tell {one} from {other}" in str(found)
    assert "(Bonferroni)" in str(found)


def test_a_term_that_another_one_replaces_is_removed():
    """One term alone is nearly the sum of two others: it comes first, and goes when both are there."""
    found = gb.stepwise(problem({"c1": 6.0, "c9": 30.0}, noise=0.01), ["c1", "c3", "c9"], starts=1)
    assert found.trials[[t.done for t in found.trials].index(True)].term == "c3"
    assert [t.term for t in found.trials if t.done and t.change == "remove"] == ["c3"]
    assert found.terms == ("c1", "c9")
    # The words of the table begin below one another.
    words = [re.search(" (add|remove) ", line) for line in str(found).splitlines()]
    assert len({word.start() for word in words if word}) == 1


def test_noise_brings_in_no_term():
    found = [gb.stepwise(problem({}, seed=k), ["c1", "c9"], starts=1) for k in range(1, 3)]
    assert [selection.terms for selection in found] == [()] * 2
    assert found[0].verdict.startswith("None of 2 candidates is supported")
    assert found[0].fit.cost == pytest.approx(found[0].without.cost)


def test_parts_of_a_sum_and_records_have_terms_too():
    one, two = problem({"c9": 12.0}), problem({"c9": 6.0}, seed=1)
    both = one + two.with_(rename={"c9": "c9_two", "K": "K_two"})
    assert gb.stepwise(both, ["c1", "c9", "c9_two"], starts=1).terms == ("c9", "c9_two")
    record = flight(QUADRATIC, 1, duration=10.0)
    found = gb.stepwise(gb.Problem(Drag(), record, fixed={"a5": 0.0}), ["a5"], starts=1)
    assert found.terms == ()


def test_mistakes_are_told():
    with pytest.raises(ValueError, match="has no parameter 'c7'"):
        gb.stepwise(problem({}), ["c7"])
    with pytest.raises(ValueError, match=r"fixed gives 'K' the value 100000 outside its bounds"):
        gb.stepwise(problem({}), {"K": 1e5})
    with pytest.raises(ValueError, match="has no parameter 'c7'"):
        gb.stepwise(problem({}), "c7")
    with pytest.raises(ValueError, match="no candidates: name at least one parameter"):
        gb.stepwise(problem({}), [])
    with pytest.raises(TypeError, match=r"problem is 'a\.h5': give a Problem"):
        gb.stepwise("a.h5", ["c1"])


def test_candidates_are_free_or_at_the_values_where_they_are_absent():
    """Whether they are declared fixed, freed by the problem, or fixed by it; others stay as they are."""
    made = problem({}).with_(fixed={"c3": 1.0}, free=["c1"], rename={"c9": "c9_b"})
    some = with_terms(
        made, frozenset({"c3", "c3b"}), {"c1": 0.5, "c3": 0.0, "c3b": 0.0, "c9_b": -1.0}
    )
    assert some.fixed_values == {"c1": 0.5, "c9": -1.0}
    assert {name for name, p in some.parameters.items() if not p.fixed} == {"K", "c3", "c3b"}
    none = with_terms(made, frozenset(), {"c9_b": 3.0})
    assert none.fixed_values == {"c3": 1.0, "c9": 3.0}
    assert {name for name, p in none.parameters.items() if not p.fixed} == {"K", "c1"}


def test_a_problem_without_a_fit_is_told():
    made = problem({}).with_(constraints=[lambda p: -1 - p.K**2])
    with pytest.raises(ValueError, match=r"the problem 'made' has no fit without any of c1, c9"):
        gb.stepwise(made.with_(name="made"), ["c1", "c9"], starts=1)


class Scales(gb.TransferFunction):
    """Two terms of one effect, of which one is nearly the effect of the gain."""

    K = gb.Parameter(1.0, bounds=(-1e4, 1e4), starts=(0.5, 20))
    near = gb.Parameter(0.0, bounds=(-1e4, 1e4), starts=(-20, 20))
    far = gb.Parameter(0.0, bounds=(-1e4, 1e4), starts=(-20, 20))

    def response(self, s, p):
        lag = 1 / (s + 3)
        return p.K + p.near * (1 + 0.05 * lag) + p.far * lag


@pytest.mark.parametrize("names", [("near", "far"), ("far", "near")])
def test_of_equal_costs_the_first_term_of_the_list_is_added(names):
    """Whatever rounding makes of the costs."""
    data = measured(Scales(), OMEGA, {"K": 2.0, "far": 6.0, "near": 0.0}, noise=0.03)
    stated = gb.Problem(Scales(), data, gb.SquaredRelativeError())
    found = gb.stepwise(stated, names, starts=1)
    assert found.terms == names[:1]
    assert list(found.alike[names[0]]) == [names[1]]


class Lead(gb.TransferFunction):
    """A lag with a zero that may be absent."""

    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    T = gb.Parameter(0.2, bounds=(0.01, 5))
    c = gb.Parameter(0.0, bounds=(-1, 1))

    def response(self, s, p):
        return p.K * (1 + p.c * s) / (p.T * s + 1)


@pytest.mark.parametrize(("rho", "zero", "doubtful"), [(0.8, 0.0, ["c"]), (0.0, 0.1, [])])
def test_a_term_that_correlated_errors_bring_in_is_doubted(rho, zero, doubtful):
    omega = np.geomspace(0.5, 20, 16)
    white = np.random.default_rng(4).normal(size=(66, 2)) @ [1, 1j] / np.sqrt(2)
    errors = lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)[50:]
    exact = gb.frequency_response(Lead(), {"K": 2.0, "T": 0.5, "c": zero}, omega).response
    data = gb.FrequencyResponse(omega, exact * (1 + 0.05 * errors), "u", "y")
    selection = gb.stepwise(gb.Problem(Lead(), data, gb.RelativeLikelihood()), ["c"], starts=1)
    assert selection.terms == ("c",)
    assert list(selection.doubtful) == doubtful
    assert ("c may be there by chance" in selection.verdict) == bool(doubtful)


class Spring(gb.StateSpace):
    """x'' = b u - k x - d x'."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    k = gb.Parameter(20.0, bounds=(0, 200))
    d = gb.Parameter(1.0, bounds=(0, 50))
    b = gb.Parameter(20.0, bounds=(0, 200))

    def derivative(self, x, u, p):
        return (x.v, p.b * u.u - p.k * x.x - p.d * x.v)

    def output(self, x, u, p):
        return (x.x,)


class Hardening(Spring):
    def derivative(self, x, u, p):
        v, a = super().derivative(x, u, p)
        return (v, a - 20 * x.x**3)


def flown(plant):
    random, time = np.random.default_rng(0), 0.04 * np.arange(200)
    u = sum(np.sin(w * time + random.uniform(0, 6)) for w in (1, 2, 3.3, 4.7, 6.1, 9)) / 2.5
    record = gb.Record(time, {"u": u}, hold={"u": np.inf})
    x = gb.simulate(plant(), {"k": 25.0, "d": 2.0, "b": 25.0}, record)["x"]
    record = record.with_signals(x=x + 0.02 * random.normal(size=200))
    return gb.Problem(Spring(), record)


def test_the_causes_of_a_misfit_are_candidates():
    """Those of the user; the acceleration below has greybox's own."""
    wrong = flown(Hardening)
    plain = gb.fit(wrong, starts=1, progress=False)
    misfit = gb.misfit(plain, candidates={"hardening": lambda x, u, p: x.x**3 - x.x})
    # Two of its causes: every further one costs a fit a step.
    found = gb.stepwise(wrong, replace(misfit, causes=misfit.causes[:2]), starts=1)
    (term,) = found.terms
    assert term == "hardening_in_v"
    assert found.fit.misfit.explains
    for name, truth in {term: -20.0, "d": 2.0}.items():
        assert found.fit.estimate[name] == pytest.approx(
            truth, abs=3 * found.fit.standard_error[name]
        )


class Accelerometer(Spring):
    """The position and, in units of 10 m/s², the acceleration, which has all forces in it."""

    outputs = ("x", "acc")

    def output(self, x, u, p):
        return (x.x, self.derivative(x, u, p)[1] / 10)


class HardeningAccelerometer(Accelerometer):
    def derivative(self, x, u, p):
        v, a = super().derivative(x, u, p)
        return (v, a - 20 * x.x**3)


def test_a_force_that_is_missing_is_missing_in_the_measured_acceleration_too():
    time, random = 0.04 * np.arange(200), np.random.default_rng(1)
    u = sum(np.sin(w * time + w**2) for w in (1, 2, 3.3, 4.7, 6.1, 9)) / 2.5
    record = gb.Record(time, {"u": u}, hold={"u": np.inf})
    clean = gb.simulate(HardeningAccelerometer(), {"k": 25.0, "d": 2.0, "b": 25.0}, record)
    noisy = {name: clean[name] + 0.02 * random.normal(size=200) for name in ("x", "acc")}
    wrong = gb.Problem(Accelerometer(), record.with_signals(**noisy))
    misfit = gb.fit(wrong, starts=1, progress=False).misfit
    assert not misfit.explains
    cause = misfit.causes[0]
    assert "x**3 in the equation of v" in cause.text
    assert "and so does the output acc, 0.1 times" in cause.code
    assert cause.value == pytest.approx(-20, abs=4 * cause.error)

    selected = gb.stepwise(wrong, replace(misfit, causes=misfit.causes[:2]), starts=1)
    assert selected.terms == ("x_3_in_v",)
    assert selected.fit.misfit.explains
    for name, truth in {"x_3_in_v": -20.0, "k": 25.0, "d": 2.0}.items():
        error = selected.fit.standard_error[name]
        assert selected.fit.estimate[name] == pytest.approx(truth, abs=3 * error)


def test_a_misfit_without_a_significant_term_has_no_candidates():
    right = flown(Spring)
    misfit = replace(gb.fit(right, starts=1, progress=False).misfit, causes=())
    with pytest.raises(ValueError, match="no significant cause"):
        gb.stepwise(right, misfit)


def test_two_terms_that_are_missing_together_are_found():
    """Without one of them, what the other explains is small beside the misfit of another response."""

    class Rates(gb.StateSpace):
        states, inputs, outputs = ("p", "q"), ("lat", "lon"), ("p", "q", "ay")
        Lp, Mq, Llat, Mlon, Ylat, Yp = (
            gb.Parameter(0.7 * value, bounds=(-50, 50)) for value in (-4, -2, 20, 12, 4, -0.8)
        )
        Lq, Mp, Yq, Mlat = (gb.Parameter(0.1, bounds=(-50, 50)) for _ in range(4))

        def derivative(self, x, u, p):
            q = p.Mp * x.p + p.Mq * x.q + p.Mlon * u.lon + p.Mlat * u.lat
            return p.Lp * x.p + p.Lq * x.q + p.Llat * u.lat, q

        def output(self, x, u, p):
            return x.p, x.q, p.Yp * x.p + p.Yq * x.q + p.Ylat * u.lat

    truth = {"Lp": -4.0, "Mq": -2.0, "Llat": 20.0, "Mlon": 12.0, "Ylat": 4.0, "Yp": -0.8}
    truth |= {"Lq": 0.7, "Mp": 1.6, "Yq": 0.3, "Mlat": -5.0}
    omega, random = np.geomspace(0.3, 15, 12), np.random.default_rng(1)
    data = []
    for i in Rates.inputs:
        for o in Rates.outputs:
            exact = gb.frequency_response(Rates(), truth, omega, input=i, output=o).response
            errors = random.standard_normal((2, omega.size)) * 0.05 / np.sqrt(2)
            noisy = exact * (1 + errors[0] + 1j * errors[1])
            data.append(gb.FrequencyResponse(omega, noisy, input=i, output=o))
    problem = gb.several(Rates(), data, criterion=gb.SquaredRelativeError())
    chosen = gb.stepwise(problem, ["Mp", "Mlat"], starts=1)
    assert chosen.terms == ("Mp", "Mlat")
    assert all(trial.p_value < 1e-3 for trial in chosen.trials)
