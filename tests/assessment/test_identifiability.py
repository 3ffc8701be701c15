"""Planted directions that the data do not determine: named with all that takes part, and nothing else harmed."""

import itertools

import numpy as np
import pytest

import greybox as gb
from greybox.assessment.identifiability import (
    DeterminedCombination,
    Identifiability,
    _condition,
    _products,
    _sums,
    identifiability,
)
from greybox.engine.covariance.known_directions import KnownDirections

pytestmark = pytest.mark.usefixtures("unjudged_file")

N, STEP = 1000, 0.02
RANDOM = np.random.default_rng(7)
U = np.repeat(RANDOM.normal(size=N // 20), 20)
NOISE = 0.02


class Integrator(gb.StateSpace):
    """A pure integrator."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    G = gb.Parameter(1.0, bounds=(-20, 20))

    def derivative(self, x, u, p):
        return (p.G * u.u,)

    def output(self, x, u, p):
        return (x.x,)


class TwoViews(Integrator):
    """Two sensors of one integral."""

    outputs = ("x", "y")

    def output(self, x, u, p):
        return (x.x, 2 * x.x)


class Drifting(gb.StateSpace):
    """A rate that is the sum of a parameter and of a constant of unknown size, seen through an integrator only."""

    states, inputs, outputs = ("x", "c"), ("u",), ("x",)
    G, rate = Integrator.G, gb.Parameter(0.1, bounds=(-5, 5))

    def derivative(self, x, u, p):
        return (p.G * u.u + x.c + p.rate, 0 * x.c)

    def output(self, x, u, p):
        return (x.x,)


class Gains(gb.StateSpace):
    """Two lags, each with two gains that are seen as their product alone, and a parameter without effect."""

    states, inputs, outputs = ("x", "z"), ("u",), ("x", "z")
    k1 = gb.Parameter(1.0, bounds=(0.1, 10))
    k2 = gb.Parameter(2.0, bounds=(0.1, 10))
    h1 = gb.Parameter(1.0, bounds=(0.1, 10))
    h2 = gb.Parameter(2.0, bounds=(0.1, 10))
    mass = gb.Parameter(1.0, bounds=(0.1, 10))
    a = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return p.k1 * p.k2 * u.u - p.a * x.x + 0 * p.mass, p.h1 * p.h2 * u.u - x.z

    def output(self, x, u, p):
        return x.x, x.z


class Lags(gb.StateSpace):
    """Two lags that may swap."""

    states, inputs, outputs = ("x", "z"), ("u",), ("z",)
    a = gb.Parameter(1.0, bounds=(0.1, 10))
    b = gb.Parameter(2.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return p.a * (u.u - x.x), p.b * (x.x - x.z)

    def output(self, x, u, p):
        return (x.z,)


def record(model, values, **initial):
    t = STEP * np.arange(N)
    known = {name: initial.get(name, 0.0) for name in model.states}
    clean = gb.simulate(model, values, gb.Record(t, {"u": U}), inputs="held", initial=known)
    noise = np.random.default_rng(3)
    return gb.Record(
        t, {"u": U} | {name: clean[name] + NOISE * noise.normal(size=N) for name in model.outputs}
    )


def fitted(model, data, starts=1, biases=(), **options):
    criterion = gb.OutputError(inputs="held", biases=biases)
    problem = gb.Problem(model, data, criterion, **options)
    return gb.fit(problem, starts=starts, progress=False, profiles=False)


def undetermined(fit):
    return [text for text in fit.warnings if "determine" in text]


def same_errors(fit, other, names):
    for name in names:
        assert fit.standard_error[name] == pytest.approx(other.standard_error[name], rel=1e-3), name


def test_a_bias_that_an_initial_state_makes_up_for_is_named_with_it_and_has_no_error():
    data = record(Integrator(), {"G": 1.5}, x=0.3)
    fit, known = (fitted(Integrator(), data, biases=biases) for biases in (("x",), ()))
    (text,) = undetermined(fit)
    assert text.startswith("x_bias and the initial state of x are not determined")
    assert "initial={'x': ...}" in text
    assert np.isnan(fit.standard_error["x_bias"])
    assert all(np.isnan(fit.interval()["x_bias"]))
    assert not any("ordering" in warning for warning in fit.warnings)
    same_errors(fit, known, ["G"])
    # By least squares with the initial state among the unknowns: the model is linear in both.
    regressors = np.column_stack([np.concatenate([[0.0], np.cumsum(U[:-1]) * STEP]), np.ones(N)])
    gain, *_ = np.linalg.lstsq(regressors, data["x"], rcond=None)[0]
    assert fit.estimate["G"] == pytest.approx(gain, rel=1e-6)


def test_the_same_bias_is_determined_once_the_initial_state_is_known():
    data = record(Integrator(), {"G": 1.5})
    data = data.with_signals(x=data["x"] + 0.3)
    criterion = gb.OutputError(inputs="held", biases=("x",), initial={"x": 0.0})
    fit = gb.fit(gb.Problem(Integrator(), data, criterion), starts=2, progress=False)
    assert not undetermined(fit)
    assert fit.estimate["x_bias"] == pytest.approx(0.3, abs=4 * fit.standard_error["x_bias"])
    assert fit.standard_error["x_bias"] < NOISE


def test_two_biases_of_one_state_are_named_together_once():
    fit = fitted(TwoViews(), record(TwoViews(), {"G": 1.5}), biases=("x", "y"))
    (text,) = undetermined(fit)
    assert "x_bias" in text
    assert "y_bias" in text
    assert "the initial state of x" in text
    assert np.isnan([fit.standard_error["x_bias"], fit.standard_error["y_bias"]]).all()
    # What one bias is beyond half the other is seen all the same.
    assert np.isfinite(fit.standard_error["G"])


@pytest.mark.parametrize("segment", [2, 20])
def test_a_rate_that_a_hidden_state_makes_up_for_is_named_with_it(segment):
    data = record(Drifting(), {"G": 1.5, "rate": 0.2})
    problem = gb.Problem(Drifting(), data, gb.OutputError(inputs="held"))
    method = gb.MultipleShooting(segment=segment)
    fit = gb.fit(problem, starts=1, method=method, progress=False, profiles=False)
    (text,) = undetermined(fit)
    assert text.startswith("rate and the initial state of c are not determined")
    assert np.isnan(fit.standard_error["rate"])
    same_errors(fit, fitted(Drifting(), data, fixed={"rate": 0.0}), ["G"])


def test_groups_that_share_nothing_are_told_apart_each_once():
    data = record(Gains(), {"k1": 1.0, "k2": 2.0, "h1": 1.0, "h2": 2.0, "mass": 1.0, "a": 1.0})
    fit = fitted(Gains(), data)
    texts = undetermined(fit)
    assert len(texts) == 3
    groups = [
        {
            name
            for name in fit.free
            if name in text.partition(" not determined")[0].replace(",", "").split()
        }
        for text in texts
    ]
    assert sorted(groups, key=sorted) == [{"h1", "h2"}, {"k1", "k2"}, {"mass"}]
    assert np.isnan([fit.standard_error[name] for name in ("k1", "k2", "h1", "h2", "mass")]).all()
    same_errors(fit, fitted(Gains(), data, fixed={"k1": 1.0, "h1": 1.0, "mass": 1.0}), ["a"])


class ManyProducts(gb.StateSpace):
    """Five outputs, each with a product of gains of its own."""

    states, inputs = ("x",), ("u",)
    outputs = tuple(f"y{k}" for k in range(5))
    locals().update(
        {f"{letter}{k}": gb.Parameter(1.0, bounds=(0.1, 10)) for k in range(5) for letter in "gh"}
    )

    def derivative(self, x, u, p):
        return (u.u - x.x,)

    def output(self, x, u, p):
        return tuple(p[f"g{k}"] * p[f"h{k}"] * x.x for k in range(5))


def test_of_a_flood_three_are_named_and_the_others_counted():
    model = ManyProducts()
    fit = fitted(model, record(model, dict.fromkeys(model.parameters, 1.0)), starts=2)
    texts = [text for text in fit.warnings if "determined" in text]
    assert len(texts) == 4
    assert texts[-1].startswith("2 more combinations of parameters")
    for k in range(5):
        assert sum(f"g{k}" in text and f"h{k}" in text for text in texts) == 1


def test_lags_that_swap_are_an_ordering_and_no_direction():
    fit = fitted(Lags(), record(Lags(), {"a": 1.0, "b": 4.0}), starts=8)
    assert not undetermined(fit)
    assert any("give this same response" in text for text in fit.warnings)
    assert np.isfinite([fit.standard_error["a"], fit.standard_error["b"]]).all()


@pytest.mark.parametrize("biases", [(), ("z",)])
def test_what_is_determined_raises_no_alarm(biases):
    """A lag forgets its initial state, so that a bias is seen after it."""
    fit = fitted(
        Lags(),
        record(Lags(), {"a": 1.0, "b": 4.0}, x=0.5, z=-0.5),
        starts=2,
        biases=biases,
        fixed={"b": 4.0},
    )
    assert not undetermined(fit)
    assert all(np.isfinite(list(fit.standard_error.values())))
    for name in biases:
        assert abs(fit.estimate[f"{name}_bias"]) < 4 * fit.standard_error[f"{name}_bias"]


def test_what_is_known_is_the_inverse_within_the_directions_that_are():
    """In multiples of the sizes; of a direction that is not seen the pseudoinverse has nothing."""
    size = np.array([10.0, 0.1, 1.0])
    scaled = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]])
    unseen = np.array([[0.0], [0.0], [1.0]])
    known = KnownDirections(scaled * np.outer(size, size), unseen, size, np.ones(3))
    np.testing.assert_allclose(known.matrix, np.linalg.pinv(scaled), atol=1e-12)


def judged(jacobian, value, at_bound=(), held=()):
    """What is told of parameters a, b, c whose data have this Jacobian, with errors of deviation one."""
    size = 1 / np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    covariance[[*held]] = covariance[:, [*held]] = 0
    known = KnownDirections(covariance, np.zeros((3, 0)), size, value)
    return identifiability(tuple("abc"), ("s", "s", "1"), known, at_bound)


def test_errors_insensitivities_and_correlations_are_those_of_the_jacobian():
    random = np.random.default_rng(0)
    jacobian = random.normal(size=(40, 3)) * np.array([3.0, 5.0, 1.0])
    jacobian[:, 1] += 8 * jacobian[:, 0]
    value = np.array([-2.0, 0.5, 4.0])
    found = judged(jacobian, value)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    errors = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.error, errors / np.abs(value))
    np.testing.assert_allclose(
        found.insensitivity, 1 / np.linalg.norm(jacobian, axis=0) / np.abs(value)
    )
    r = covariance[0, 1] / errors[0] / errors[1]
    assert r < -0.9
    assert [(one, other) for one, other, _ in found.correlated] == [("a", "b")]
    assert found.correlated[0][2] == pytest.approx(r)
    assert found.condition == pytest.approx(
        np.linalg.cond(jacobian / np.linalg.norm(jacobian, axis=0))
    )
    assert found.combinations == ()
    text = str(found)
    assert f"correlation of a and b: {r:.4f}" in text
    assert (
        "guidelines: 20 % error (Cramér-Rao bound), 10 % insensitivity (the error if all others were known)"
        in text
    )

    # Errors of the others are those without the bound, unless it holds its parameter.
    released = judged(jacobian, value, ("b",))
    np.testing.assert_allclose(released.insensitivity[[0, 2]], found.insensitivity[[0, 2]])
    assert released.correlated == found.correlated
    assert np.isnan(released.error[1])
    assert "b" not in released.beyond

    held = judged(jacobian, value, ("b",), held=[1])
    assert np.isnan([held.error[1], held.insensitivity[1]]).all()
    np.testing.assert_allclose(held.error[[0, 2]], found.error[[0, 2]])
    assert held.correlated == ()
    assert "b" not in held.beyond
    assert "at its bound" in str(held)


@pytest.mark.parametrize(
    ("error", "insensitivity", "beyond"),
    [(0.2, 0.1, ()), (0.21, 0.05, ("a",)), (0.15, 0.11, ("a",)), (np.nan, 0.0, ("a",))],
)
def test_what_is_beyond_a_guideline(error, insensitivity, beyond):
    found = Identifiability(("a",), np.array([error]), np.array([insensitivity]), (), (), 1.0, ())
    assert found.beyond == beyond
    assert repr(found) == f"<Identifiability 1 parameter, {len(beyond)} beyond a guideline>"


@pytest.mark.parametrize(
    ("powers", "value", "formula", "result"),
    [
        ((1, -1, 0), (6.0, 2.0, 1.0), "a/b", 3.0),
        ((1, -1, 0), (2.0, 6.0, 1.0), "b/a", 3.0),
        ((1, 1, 0), (2.0, -6.0, 1.0), "a b", -12.0),
        ((2, -1, 0), (3.0, 6.0, 1.0), "a²/b", 1.5),
        ((1, -3, 0), (4.0, 2.0, 1.0), "b³/a", 2.0),
        ((1, -1, -1), (2.0, 6.0, 0.5), "b c/a", 1.5),
        ((1, 1, -1), (2.0, 6.0, 3.0), "a b/c", 4.0),
    ],
)
def test_a_product_that_is_determined_is_named_as_people_write_it(powers, value, formula, result):
    """Its members are open along all directions but that of the product, which is known to a part in a hundred."""
    value, powers = np.array(value), np.array(powers, dtype=float)
    gradient = powers / value
    direction = gradient / np.linalg.norm(gradient)
    used = powers != 0
    rest = np.linalg.svd(np.vstack([gradient, *np.eye(3)[~used]]))[2][1 + (~used).sum() :].T
    covariance = (0.01 / np.linalg.norm(gradient)) ** 2 * np.outer(direction, direction) + np.diag(
        1e-6 * ~used
    )
    known = KnownDirections(covariance, rest, np.ones(3), value)
    found = identifiability(tuple("abc"), ("s", "m", "1"), known, ())
    (one,) = found.combinations
    assert one.formula == formula
    assert one.value == pytest.approx(result)
    assert one.standard_error == pytest.approx(0.01 * abs(result))
    assert set(one.names) == {name for name, is_used in zip("abc", used, strict=True) if is_used}


@pytest.mark.parametrize(("sign", "formula"), [(1.0, "a + b"), (-1.0, "a - b")])
def test_a_sum_of_one_unit_that_is_determined_is_named(sign, formula):
    value = np.array([3.7, 1.0, 1.0])
    gradient = np.array([1.0, sign, 0.0]) / np.sqrt(2)
    covariance = 0.01**2 / 2 * np.outer(gradient, gradient) + np.diag([0, 0, 1e-6])
    known = KnownDirections(
        covariance, np.array([[1.0], [-sign], [0.0]]) / np.sqrt(2), np.ones(3), value
    )
    (one,) = identifiability(tuple("abc"), ("s", "s", "1"), known, ()).combinations
    assert (one.formula, one.value) == (formula, pytest.approx(3.7 + sign))
    assert one.standard_error == pytest.approx(0.01)
    assert str(one).startswith(f"{formula} = {3.7 + sign:.3f} ± 0.01")
    assert not identifiability(tuple("abc"), ("s", "m", "1"), known, ()).combinations


@pytest.mark.parametrize("members", [(0, 2, 3), (0, 1, 2, 4, 6), tuple(range(8)), tuple(range(9))])
def test_products_that_are_tried_are_all_of_small_powers(members):
    """Of two members all powers up to three without a common divisor; of three and four, and of few, first powers."""
    found = [tuple(sorted(powers.items())) for powers in _products(members)]
    wanted = set()
    for count in (2, 3, 4) if len(members) <= 8 else (2,):
        for group in itertools.combinations(members, count):
            for powers in itertools.product(
                (-3, -2, -1, 1, 2, 3) if count == 2 else (-1, 1), repeat=count
            ):
                if powers[0] > 0 and np.gcd.reduce(powers) == 1:
                    wanted.add(tuple(zip(group, powers, strict=True)))
    assert len(found) == len(set(found))
    assert set(found) == wanted


def test_sums_that_are_tried_are_of_two_members_of_one_unit():
    found = [*_sums((0, 1, 3), ("s", "m", "s", "s"))]
    assert found == [{0: 1, 3: 1}, {0: 1, 3: -1}]
    assert not [*_sums((1,), ("s", "m"))]


def told(logs, value, open_=None, elsewhere=None):
    """Errors of a and b whose logarithms have a covariance, and c, which is exact; `open_` directions are not seen."""
    value = np.array(value)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = np.array(logs) * np.outer(value[:2], value[:2])
    covariance[2, 2] = 1e-8
    return KnownDirections(
        covariance, np.zeros((3, 0)) if open_ is None else open_, np.ones(3), value, elsewhere
    )


def formulas(known, units=("s", "m", "1")):
    return [one.formula for one in identifiability(tuple("abc"), units, known, ()).combinations]


@pytest.mark.parametrize(
    ("member", "product", "is_told"), [(0.3, 0.059, True), (0.3, 0.061, False), (0.19, 0.01, False)]
)
def test_a_product_is_news_where_its_error_is_a_fifth_of_those_of_members_that_are_beyond_the_guideline(
    member, product, is_told
):
    apart = member**2 - product**2 / 2  # var of log a + log b
    known = told([[member**2, -apart], [-apart, member**2]], (2.0, 5.0, 1.0))
    assert formulas(known) == (["a b"] if is_told else [])


@pytest.mark.parametrize(("error", "is_told"), [(0.19, True), (0.21, False)])
def test_a_product_of_members_without_an_error_is_within_the_guideline_itself(error, is_told):
    value = np.array([2.0, 5.0, 1.0])
    gradient = np.array([0.5, 0.2, 0.0])
    direction = gradient / np.linalg.norm(gradient)
    covariance = (error / np.linalg.norm(gradient)) ** 2 * np.outer(direction, direction) + np.diag(
        [0, 0, 1e-8]
    )
    rest = np.array([[direction[1]], [-direction[0]], [0.0]])
    assert formulas(KnownDirections(covariance, rest, np.ones(3), value)) == (
        ["a b"] if is_told else []
    )
    # What is seen elsewhere too stays; an unseen product there is none.
    for unseen, stays in (
        (np.array([[0.0], [0.0], [1.0]]), True),
        (np.array([[1.0], [0.0], [0.0]]), False),
    ):
        beside = KnownDirections(covariance, unseen, np.ones(3), 1.1 * value)
        both = KnownDirections(covariance, rest, np.ones(3), value, beside)
        assert formulas(both) == (["a b"] if is_told and stays else [])


@pytest.mark.parametrize(
    ("sign", "error", "is_told"),
    [(1, 0.93, True), (1, 0.95, False), (-1, 0.73, True), (-1, 0.75, False)],
)
def test_a_sum_has_a_fifth_of_the_larger_of_itself_and_its_members(sign, error, is_told):
    value = np.array([3.7, 1.0, 0.0])
    gradient = np.array([1.0, sign, 0.0]) / np.sqrt(2)
    covariance = error**2 / 2 * np.outer(gradient, gradient) + np.diag([0, 0, 1e-8])
    rest = np.array([[1.0], [-sign], [0.0]]) / np.sqrt(2)
    known = KnownDirections(covariance, rest, np.ones(3), value)
    assert formulas(known, ("s", "s", "1")) == (
        [f"a {'+' if sign > 0 else '-'} b"] if is_told else []
    )


def test_correlations_above_nine_tenths_are_named_the_largest_first():
    matrix = np.array([[1.0, 0.91, -0.95], [0.91, 1.0, -0.89], [-0.95, -0.89, 1.0]])
    found = judged(np.linalg.inv(np.linalg.cholesky(matrix)), np.array([9.0, 9.0, 9.0]))
    assert [(one, other) for one, other, _ in found.correlated] == [("a", "c"), ("a", "b")]
    np.testing.assert_allclose([r for *_, r in found.correlated], [-0.95, 0.91])


def test_conditions_of_matrices_that_lack_a_direction():
    assert np.isnan(_condition(np.zeros((0, 0))))
    assert _condition(np.diag([4.0, 0.0])) == np.inf
    assert _condition(np.diag([4.0, 1e-6])) == pytest.approx(1)  # in columns of unit length
    assert _condition(np.array([[1.0, 0.28], [0.28, 1.0]])) == pytest.approx(4 / 3)
    assert _condition(np.ones((2, 2))) == np.inf


def test_a_parameter_without_effect_is_infinitely_insensitive():
    known = KnownDirections(
        np.diag([0.04, 0.0, 0.01]),
        np.array([[0.0], [1.0], [0.0]]),
        np.ones(3),
        np.array([2.0, 1.0, -1.0]),
    )
    found = identifiability(tuple("abc"), ("s", "m", "1"), known, ())
    np.testing.assert_allclose(found.error, [0.1, np.nan, 0.1])
    np.testing.assert_allclose(found.insensitivity, [0.1, np.inf, 0.1])
    assert found.condition == np.inf
    assert found.beyond == ("b",)
    assert str(found).splitlines()[3].split() == [
        "b",
        "-",
        "no",
        "effect",
        "beyond",
        "the",
        "guideline",
    ]


@pytest.mark.parametrize(("variance", "is_seen"), [(0.9e10, True), (1.1e10, False)])
def test_what_the_data_see_less_than_a_hundred_thousandth_of_has_no_effect(variance, is_seen):
    """Of the information in multiples of the sizes, which is the square of what is seen."""
    size, value = np.array([1.0, 10.0, 0.1]), np.array([1.0, 2.0, 4.0])
    known = KnownDirections(np.diag([1.0, 100 * variance, 0.01]), np.zeros((3, 0)), size, value)
    found = identifiability(tuple("abc"), ("s", "m", "1"), known, ())
    alone = 10 * np.sqrt(variance) / 2 if is_seen else np.inf
    np.testing.assert_allclose(found.insensitivity, [1.0, alone, 0.025])


def test_the_table_has_a_line_for_each_parameter_and_what_is_told_of_several():
    together = DeterminedCombination("a/b", ("a", "b"), (1, -1), 2.5, 0.025)
    pair = (("a", "b", -0.98765),)
    found = Identifiability(
        ("a", "bb", "c"),
        np.array([0.2, 0.3, np.nan]),
        np.array([0.1, np.inf, np.nan]),
        ("c",),
        pair,
        12.345,
        (together,),
    )
    assert [line.rstrip() for line in str(found).splitlines()] == [
        "parameter  error, %  insensitivity, %",
        "---------  --------  ----------------  --------------------",
        "a                20                10",
        "bb               30         no effect  beyond the guideline",
        "c                 -                 -  at its bound",
        "",
        "guidelines: 20 % error (Cramér-Rao bound), 10 % insensitivity (the error if all others were known)",
        "condition number of the scaled Jacobian: 12.3",
        "correlation of a and b: -0.9877",
        "determined together: a/b = 2.500 ± 0.025",
    ]
