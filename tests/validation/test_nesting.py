"""Models are nested when the equations of one are those of the other with terms removed, whatever their names say."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from drag_flights import Drag, LinearDrag, QuadraticDrag, fitted, flight

import greybox as gb
from greybox.validation.nesting import (
    PARAMETER_SPREAD,
    NotNestedError,
    _beyond,
    _embedding,
    _Equations,
    _held_alike,
    _idle,
    _is_of_model,
    _left_null_space,
    _neutral,
    _on_bound,
    _require_fewer_terms,
    _same,
    _slope_of_tie,
    nesting,
)

NAMES = ("small", "large")


@pytest.fixture(scope="module")
def record():
    return flight({"a5": 0.2, "C_x": 0.05}, 8, duration=6.0)


FITS = {}


def place(record, small, large, removed_at=None, **options):
    """How one model lies within another, both fitted to a record, each only once."""
    fits = [
        fitted_once(record, model, **{k: v[i] for k, v in options.items() if v[i]})
        for i, model in enumerate((small, large))
    ]
    return nesting(*fits, NAMES, removed_at)


def fitted_once(record, model, **options):
    key = f"{type(model).__name__} {options}"
    if key not in FITS:
        FITS[key] = fitted(model, record, **options)
    return FITS[key]


class OtherDrag(Drag):
    """The parameters of `Drag`, and no value of `C_x` that makes it linear."""

    def derivative(self, x, u, p):
        return (gb.g * gb.tan(u.theta) - p.a5 * x.v - (p.C_x + 0.3) * abs(x.v) * x.v,)


class PositiveDrag(Drag):
    """Drag that is never linear, by its bounds."""

    C_x = gb.Parameter(0.05, bounds=(0.01, 2))


class PowerDrag(LinearDrag):
    """Drag with an exponent, which is one where the drag is linear."""

    n = gb.Parameter(1.5, bounds=(0.5, 3))

    def derivative(self, x, u, p):
        return (gb.g * gb.tan(u.theta) - p.a5 * x.v * gb.exp((p.n - 1) * gb.log(abs(x.v) + 1e-9)),)


class SaturatingDrag(LinearDrag):
    """Friction of Coulomb's kind, of which the width has no effect without its size."""

    c = gb.Parameter(0.1, bounds=(-2, 2))
    v_s = gb.Parameter(0.5, bounds=(0.01, 5))

    def derivative(self, x, u, p):
        return (gb.g * gb.tan(u.theta) - p.a5 * x.v - p.c * gb.tan(x.v / (20 * p.v_s)),)


class LaggedDrag(LinearDrag):
    """With a second state that a gain of zero removes."""

    states = ("v", "w")
    k = gb.Parameter(0.1, bounds=(-1, 1))

    def derivative(self, x, u, p):
        return (gb.g * gb.tan(u.theta) - p.a5 * x.v + p.k * x.w, x.v - 2 * x.w)


class RenamedDrag(Drag):
    """The same in a state of another name."""

    states = ("speed",)

    def derivative(self, x, u, p):
        return (gb.g * gb.tan(u.theta) - p.a5 * x.speed - p.C_x * abs(x.speed) * x.speed,)

    def output(self, x, u, p):
        return (x.speed,)


class LagLag(gb.TransferFunction):
    """Two lags without a delay."""

    K, T1, T2 = LagLagDelay.K, LagLagDelay.T1, LagLagDelay.T2

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1))


def test_a_term_that_is_zero_fixed_or_tied_makes_a_model_nested(record):
    removed = place(record, LinearDrag(), Drag())
    assert removed.terms == ("C_x",)
    assert removed.point[1] == 0.0
    assert removed.dof == 1
    held = place(record, Drag(), Drag(), fixed=({"C_x": 0.04}, None))
    assert held.point[1] == 0.04
    tied = place(record, Drag(), Drag(), tied=({"C_x": lambda p: 0.25 * p.a5}, None))
    along = float(tied.directions[:, 0] @ [1.0, 0.25])
    assert along == pytest.approx(0.0, abs=1e-9)  # the others leave the tie
    assert place(record, LinearDrag(), PowerDrag()).point[1] == 1.0
    assert place(record, QuadraticDrag(), Drag()).terms == ("a5",)


def test_biases_and_gains_of_a_criterion_are_terms_that_are_zero(record):
    output = gb.OutputError()
    found = place(record, Drag(), Drag(), criterion=(output, gb.PredictionError()))
    assert found.terms == ("K_v_v",)
    assert found.point[-1] == 0.0
    assert (
        place(
            record, LinearDrag(), Drag(), criterion=(output, gb.OutputError(biases=["theta"]))
        ).dof
        == 2
    )
    with pytest.raises(NotNestedError, match="differ in their noise") as caught:
        place(record, LinearDrag(), Drag(), criterion=(output, gb.OutputError(noise={"v": 0.1})))
    assert caught.value.undecided
    with pytest.raises(NotNestedError, match="run differently between samples"):
        place(record, LinearDrag(), Drag(), criterion=(output, gb.OutputError(inputs="held")))
    with pytest.raises(NotNestedError, match="small has gains or biases that large has not"):
        place(record, LinearDrag(), Drag(), criterion=(gb.PredictionError(), output))


def test_names_alone_do_not_make_models_nested(record):
    with pytest.raises(NotNestedError, match="large is not small where C_x is 0 or 1") as caught:
        place(record, LinearDrag(), OtherDrag())
    assert not caught.value.undecided
    with pytest.raises(NotNestedError, match="large holds a5 fixed and small has a5 free"):
        place(record, LinearDrag(), QuadraticDrag())
    with pytest.raises(
        NotNestedError, match=r"C_x = 0, as in small, is outside the bounds \(0.01, 2\) of large"
    ):
        place(record, LinearDrag(), PositiveDrag())
    with pytest.raises(NotNestedError, match="every free parameter of large is free in small"):
        place(record, LinearDrag(), LinearDrag())
    # What the user says is taken on trust.
    assert place(record, LinearDrag(), OtherDrag(), removed_at={"C_x": -0.3}).point[1] == -0.3
    with pytest.raises(ValueError, match="large has no free parameter 'k'"):
        place(record, LinearDrag(), Drag(), removed_at={"k": 0.0})


def test_states_are_met_by_their_names(record):
    found = place(record, LinearDrag(), LaggedDrag())
    assert found.terms == ("k",)
    assert found.initial_states == 1
    assert found.dof == 2
    with pytest.raises(NotNestedError, match="large is not small where C_x is 0 or 1"):
        place(record, LinearDrag(), RenamedDrag())
    assert place(record, LinearDrag(), RenamedDrag(), removed_at={"C_x": 0.0}).dof == 1


def test_a_term_without_effect_where_another_is_zero_is_told(record):
    with pytest.raises(
        NotNestedError, match="v_s of large has no effect where c is as in small"
    ) as caught:
        place(record, LinearDrag(), SaturatingDrag())
    assert caught.value.undecided
    with pytest.raises(NotNestedError, match="v_s of large has no effect where c is as in small"):
        place(record, SaturatingDrag(), SaturatingDrag(), fixed=({"c": 0.0, "v_s": 0.5}, None))
    assert place(record, LinearDrag(), SaturatingDrag(), fixed=(None, {"v_s": 0.5})).terms == ("c",)


def test_a_parameter_of_every_record_is_one_of_all_where_they_are_equal(record):
    records = [record, flight({"a5": 0.2, "C_x": 0.05}, 9, duration=12.0)]
    one, own = (
        gb.fit(gb.several(Drag(), records, own=names), starts=1, progress=False)
        for names in ((), ("C_x",))
    )
    found = nesting(one, own, NAMES)
    assert found.terms == ("C_x_1", "C_x_2")
    assert found.dof == 1
    alike = np.array([name.startswith("C_x") for name in own.free], dtype=float)
    along = float(found.directions[:, 0] @ alike)
    assert along == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(NotNestedError):
        nesting(own, one, NAMES)


def test_models_of_responses_are_nested_by_their_responses():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)
    large = gb.fit(gb.Problem(LagLagDelay(), data), starts=10)
    small = gb.fit(gb.Problem(LagLagDelay(), data, fixed={"tau": 0.05}), starts=10)
    assert nesting(small, large, NAMES).terms == ("tau",)
    with pytest.raises(NotNestedError):
        nesting(gb.fit(gb.Problem(Lag(), data), starts=10), large, NAMES)
    found = nesting(gb.fit(gb.Problem(LagLag(), data), starts=10), large, NAMES)
    assert found.terms == found.on_bound == ("tau",)


class EqualAtOneFrequency(LagLag):
    """At 1 rad/s a gain like another, and nowhere else."""

    def response(self, s, p):
        return super().response(s, p) * (1 + 0.3 * (s * s + 1))


def test_responses_that_meet_at_one_frequency_are_not_the_same():
    """The first of the data is where they do."""
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA / TWO_LAGS_OMEGA[0], TWO_LAGS, noise=0.02)
    assert data.omega[0] == 1.0
    large = gb.fit(gb.Problem(LagLagDelay(), data), starts=[TWO_LAGS], progress=False)
    with pytest.raises(NotNestedError):
        nesting(
            gb.fit(gb.Problem(EqualAtOneFrequency(), data), starts=1, progress=False), large, NAMES
        )


def test_loaded_fits_are_nested_by_their_names_or_by_the_models_given(record, tmp_path):
    for name, model, options in (
        ("linear", LinearDrag(), {}),
        ("drag", Drag(), {}),
        ("held", Drag(), {"fixed": {"C_x": 0.04}}),
        ("lagged", LaggedDrag(), {}),
    ):
        gb.save(fitted_once(record, model, **options), tmp_path / f"{name}.h5")
    linear, drag, held, lagged = (
        gb.load(tmp_path / f"{name}.h5") for name in ("linear", "drag", "held", "lagged")
    )
    assert nesting(held, drag, NAMES).point[1] == 0.04
    with pytest.raises(NotNestedError, match="their models are not available") as caught:
        nesting(linear, drag, NAMES)
    assert caught.value.undecided
    with pytest.raises(NotNestedError) as caught:
        nesting(drag, lagged, NAMES)
    assert not caught.value.undecided
    linear, drag = (
        gb.load(tmp_path / f"{name}.h5", models=[LinearDrag, Drag]) for name in ("linear", "drag")
    )
    assert nesting(linear, drag, NAMES).terms == ("C_x",)


def test_gains_that_are_free_are_no_gains_that_follow_from_process_noise():
    free = SimpleNamespace(gains=("K_x_y",), driven=(), biases=())
    follow = SimpleNamespace(gains=("K_x_y",), driven=("x",), biases=())
    for pair in ((free, follow), (follow, free)):
        with pytest.raises(
            NotNestedError,
            match="the gains of a and b are free in one and follow from process noise",
        ):
            _require_fewer_terms(*pair, ("a", "b"))
    _require_fewer_terms(free, free, ("a", "b"))


def test_a_free_parameter_without_any_effect_leaves_every_direction():
    slope = np.array(
        [[1.0, 0.0], [0.0, 0.0]]
    )  # of two parameters by two free ones, of which the second does nothing
    directions = _left_null_space(slope, np.ones(2))
    np.testing.assert_allclose(np.abs(directions), [[0.0], [1.0]], atol=1e-12)


class Third(gb.TransferFunction):
    """A lag beside a gain that is like one in no place."""

    K, T1, T2 = LagLagDelay.K, LagLagDelay.T1, LagLagDelay.T2
    c = gb.Parameter(0.5, bounds=(-1, 2))

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) + (p.c + 0.3) * s / (s + 50)


def test_transfer_functions_of_records_are_compared_in_the_plane():
    time = 0.02 * np.arange(150)
    u = np.sin(time) + np.sin(4 * time)
    made = gb.Record(time, {"u": u})
    y = gb.simulate(LagLag(), {"K": 2.0, "T1": 0.5, "T2": 0.1}, made)["y"]
    record = made.with_signals(y=y + 0.01 * np.random.default_rng(0).normal(size=150))

    def fit(model):
        return gb.fit(gb.Problem(model, record), starts=1, progress=False, profiles=False)

    small, delayed, third = map(fit, (LagLag(), LagLagDelay(), Third()))
    found = nesting(small, delayed, NAMES)
    assert (found.terms, found.on_bound) == (("tau",), ("tau",))
    with pytest.raises(NotNestedError, match="large is not small where c is 0 or 1"):
        nesting(small, third, NAMES)

    class InTime(gb.StateSpace):
        """A state where the other is a formula in s."""

        states, inputs, outputs = ("y",), ("u",), ("y",)
        K, T1, T2 = LagLag.K, LagLag.T1, LagLag.T2
        c = gb.Parameter(0.5, bounds=(-2, 2))

        def derivative(self, x, u, p):
            return ((p.K * u.u - x.y) / p.T1 + p.c * x.y + p.T2,)

        def output(self, x, u, p):
            return (x.y,)

    with pytest.raises(
        NotNestedError,
        match=r"the equations of small and large have different forms; if one is the other with c removed, state at",
    ) as caught:
        nesting(small, fit(InTime()), NAMES)
    assert caught.value.undecided


def test_the_slope_of_a_tie_follows_from_its_covariance_with_what_it_is_tied_to():
    """Of parameters of very different size, of which one has no error."""
    root = np.array([1e3, 1e-4, 0.0])
    free = np.outer(root, root) * np.array([[1, 0.9, 0], [0.9, 1, 0], [0, 0, 1]])
    slope = np.array([0.25, -3e5, 0.0])
    whole = np.block([[free, (free @ slope)[:, None]], [free @ slope, slope @ free @ slope]])
    fit = SimpleNamespace(free=("a", "b", "c"), covariance_of=lambda names: whole)
    np.testing.assert_allclose(_slope_of_tie(fit, "tied"), slope, rtol=1e-9)
    whole[0, -1] = np.nan
    assert np.isnan(_slope_of_tie(fit, "tied")).all()


def test_vectors_are_the_same_up_to_rounding_of_what_cancels():
    one = np.array([1.0, 1e-3, np.inf])
    assert _same(one, one * (1 + 0.9e-9), 1e-9)
    assert not _same(one, one * (1 + 1.1e-9), 1e-9)
    assert _same(np.array([1.0, 0.9e-14]), np.array([1.0, 0.0]), 1e-9)
    assert not _same(np.array([1.0, 1.1e-14]), np.array([1.0, 0.0]), 1e-9)
    assert not _same(one, np.array([1.0, 1e-3, 2.0]), 1e-9)
    assert _same(1j * one[:2], 1j * one[:2], 1e-9)
    assert not _same(1j * one[:2], -1j * one[:2], 1e-9)


def test_a_value_on_a_bound_is_not_beyond_it():
    quantity = SimpleNamespace(bounds=(-2.0, 4.0))
    for value, beyond, on in (
        (-2.0, False, True),
        (4.0, False, True),
        (0.0, False, False),
        (4.1, True, False),
    ):
        assert (_beyond(quantity, value), _on_bound(quantity, value)) == (beyond, on)
        assert _beyond(SimpleNamespace(bounds=(-4.0, 2.0)), -value) == beyond
    assert not _beyond(quantity, 4.0 * (1 + 1e-10))
    assert _beyond(quantity, -2.0 * (1 + 1e-8))
    assert not _on_bound(quantity, 4.0 * (1 - 1e-8))


def test_what_the_larger_model_holds_the_smaller_one_holds_alike():
    def held(kind, value=2.0):
        return SimpleNamespace(kind=kind, value=value)

    def with_tie(tie):
        return SimpleNamespace(parts=[SimpleNamespace(tied=tie)])

    one, other = with_tie({"a": "2 b"}), with_tie({"a": "3 b"})
    assert _held_alike(held("fixed"), held("fixed", 2.0 * (1 + 1e-10)), one, one)
    assert not _held_alike(held("fixed"), held("fixed", 2.0 * (1 + 1e-8)), one, one)
    assert not _held_alike(held("free"), held("fixed"), one, one)
    assert _held_alike(held("tied"), held("tied"), one, one)
    assert not _held_alike(held("tied"), held("tied"), one, other)
    assert not _held_alike(held("fixed"), held("tied"), one, one)


def test_draws_lie_about_the_smaller_estimate_within_its_bounds():
    bounds = {"one": (0.9, 1.1), "two": (-np.inf, np.inf), "three": (2.0, 2.0), "zero": (-9.0, 9.0)}
    estimate = {"one": 1.0, "two": -4.0, "three": 5.0, "zero": 0.0}
    made = SimpleNamespace(
        _slots=SimpleNamespace(small=[{f"{name}_inside": name for name in estimate}]),
        _small=SimpleNamespace(estimate=estimate),
        _kinds=dict.fromkeys(estimate, "free") | {"three": "fixed"},
        _bounds=bounds,
    )
    random = np.random.default_rng(0)
    drawn = [_Equations._draw(made, 0, random) for _ in range(50)]
    values = {name: np.array([one[f"{name}_inside"] for one in drawn]) for name in estimate}
    assert values["one"].min() == 0.9
    assert values["one"].max() == 1.1
    assert set(values["three"]) == {5.0}
    for name in ("two", "zero"):
        assert np.std(values[name]) == pytest.approx(
            PARAMETER_SPREAD * (abs(estimate[name]) or 1), rel=0.3
        )
        assert np.mean(values[name]) == pytest.approx(estimate[name], abs=np.std(values[name]) / 2)


def test_three_points_are_compared_as_well():
    data = measured(LagLagDelay(), [0.5, 2.0, 8.0], TWO_LAGS, noise=0.02)
    large = gb.fit(
        gb.Problem(LagLag(), data), starts=[{"K": 5.0, "T1": 1.0, "T2": 0.1}], progress=False
    )
    small = gb.fit(gb.Problem(Lag(), data), starts=[{"K": 5.0, "T": 1.0}], progress=False)
    with pytest.raises(NotNestedError):
        nesting(small, large, NAMES)


def agreeing(*places):
    """Equations that agree at these values of a, b, ... alone."""
    return SimpleNamespace(agree=lambda values: tuple(values[n] for n in sorted(values)) in places)


def test_values_that_remove_terms_are_zero_or_one_in_any_combination_of_four():
    large = SimpleNamespace(estimate=dict(zip("abcde", (0.3, 0.7, 2.0, 5.0, 9.0), strict=True)))
    assert _neutral(agreeing((0.0, 1.0)), {"b": 1.0}, ["a"], large) == ({"a": 0.0, "b": 1.0}, ())
    four = dict(zip("abcd", (1.0, 0.0, 0.0, 1.0), strict=True))
    assert _neutral(agreeing((1, 0, 0, 1)), {}, [*"abcd"], large) == (four, ())
    assert _neutral(agreeing((1, 0, 0, 1, 0)), {}, [*"abcde"], large) is None
    assert _neutral(agreeing((1, 1, 1, 1, 1)), {}, [*"abcde"], large) == (
        dict.fromkeys("abcde", 1.0),
        (),
    )
    assert _neutral(agreeing((0.5,)), {}, ["a"], large) is None
    assert _neutral(agreeing((0.3,)), {}, ["a"], large) is None  # its own estimate removes nothing


def test_a_term_that_leaves_the_others_any_value_is_found_with_them():
    large = SimpleNamespace(estimate={"a": 0.3, "b": 0.7, "c": 2.0})
    found = _neutral(agreeing((0.3, 1.0, 2.0, 8.0)), {"d": 8.0}, [*"abc"], large)
    assert found == ({"a": 0.3, "b": 1.0, "c": 2.0, "d": 8.0}, ("a", "c"))


def test_a_parameter_is_idle_where_nothing_moves_with_it():
    """It is moved to its estimate, or by a tenth where it is there already; all parts have to be the same."""
    for value, estimate, moved in (
        (2.0, 5.0, 5.0),
        (2.0, 2.001, 2.2),
        (-3.0, -3.0, -2.7),
        (0.0, 0.0, 0.1),
    ):
        for parts in ([True, True], [True, False], [False, True]):
            seen = []

            def agrees(k, values, instead, parts=parts, seen=seen):
                seen.append((values, instead))
                return parts[k]

            made = SimpleNamespace(
                _large=SimpleNamespace(estimate={"a": estimate}),
                _slots=SimpleNamespace(small=(1, 2)),
                _part_agrees=agrees,
            )
            assert _Equations.is_idle(made, "a", {"a": value, "b": 7.0}) is all(parts)
            assert seen[0] == ({"a": pytest.approx(moved), "b": 7.0}, {"a": value, "b": 7.0})


def test_a_name_is_of_the_model_where_a_part_has_it_inside():
    model = SimpleNamespace(parameters={"k": None, "T": None})
    slots = SimpleNamespace(large=({"k": "k_1", "y_bias": "y_bias_1"},), models=((None, model),))
    names = ("k_1", "k", "y_bias_1", "T")
    assert [_is_of_model(slots, name) for name in names] == [True, False, False, False]
    assert not _is_of_model(SimpleNamespace(large=slots.large, models=None), "k_1")


@pytest.mark.parametrize(
    ("idle", "rest", "said"),
    [
        (["a"], ["c"], "a of large has no effect where c is as in small, and a nested test then lacks its nominal "
         "size; fix a at a value known beforehand to test c"),
        (["a", "b"], [], "a and b of large have no effect where the rest is as in small, and a nested test then lacks "
         "its nominal size; fix a and b at a value known beforehand to test the rest"),
    ],
)  # fmt: skip
def test_what_has_no_effect_is_said(idle, rest, said):
    error = _idle(idle, rest, NAMES)
    assert (str(error), error.undecided) == (said, True)


@pytest.fixture(scope="module")
def response_fit():
    data = measured(Lag(), [0.5, 2.0, 8.0], {"K": 2.0, "T": 0.3}, noise=0.02)
    return gb.fit(
        gb.Problem(Lag(), data), starts=[{"K": 2.0, "T": 0.3}], progress=False, profiles=False
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"criterion_class": "mine:Other"}, "small and large have different criteria"),
        ({"delay": "pade:2"}, "small and large evaluate delays differently"),
        ({"at": {"v": 2.0}}, "small and large have different operating points"),
        ({"sine": 0.1}, "small and large have different operating points"),
    ],
)
def test_other_assumptions_make_other_models(response_fit, change, said):
    with pytest.raises(NotNestedError, match=said) as caught:
        nesting(
            response_fit,
            replace(response_fit, parts=(replace(response_fit.parts[0], **change),)),
            NAMES,
        )
    assert not caught.value.undecided


def quantity(name, kind="free", bounds=(-9.0, 9.0)):
    return SimpleNamespace(name=name, kind=kind, bounds=bounds)


def embedding(*, covariance=None, nuisances=(1, 3), value=0.5, bounds=(0.5, 9.0)):
    """a is free in both; b is tied to 3 a in the smaller one, c is absent there, and s is along."""
    covariance = np.array([[4.0, 12.0], [12.0, 36.0]]) if covariance is None else covariance
    small = SimpleNamespace(
        free=("a",),
        estimate={"a": 2.0, "b": 6.0},
        quantities=[quantity("a"), quantity("b", "tied")],
        parts=[SimpleNamespace(nuisances=nuisances[0])],
        covariance_of=lambda names: covariance,
    )
    large = SimpleNamespace(
        free=("a", "b", "c", "s"),
        quantities=[quantity("a"), quantity("b"), quantity("c", bounds=bounds), quantity("s")],
        parts=[SimpleNamespace(nuisances=nuisances[1])],
    )
    sources = {"a": "a", "b": "b", "c": None, "s": None}
    return _embedding(small, large, NAMES, ("b", "c"), sources, {"c": value, "s": 7.0})


def test_the_smaller_model_has_its_place_and_the_directions_that_leave_it():
    found = embedding()
    np.testing.assert_allclose(found.point, [2.0, 6.0, 0.5, 7.0])
    assert found.directions.shape == (4, 2)
    inside = np.array([[1.0, 3.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])  # along the tie, and along s
    np.testing.assert_allclose(inside @ found.directions, 0.0, atol=1e-12)
    assert np.linalg.matrix_rank(found.directions) == 2
    assert (found.terms, found.on_bound) == (("b", "c"), ("c",))
    assert (
        found.initial_states == 3 + 1 - 1
    )  # those of the two fits, and s, which the smaller one estimates apart
    assert found.dof == 5
    assert embedding(bounds=(0.4, 9.0)).on_bound == ()
    assert embedding(nuisances=(4, 3)).initial_states == 0


@pytest.mark.parametrize(
    ("options", "said", "undecided"),
    [
        (
            {"value": 0.4},
            r"c = 0\.4, as in small, is outside the bounds \(0\.5, 9\) of large",
            False,
        ),
        (
            {"covariance": np.full((2, 2), np.nan)},
            "the data do not determine what small ties to others",
            True,
        ),
        ({"nuisances": (5, 3)}, "large has 1 initial state less than small", False),
        ({"nuisances": (7, 3)}, "large has 3 initial states less than small", False),
    ],
)
def test_what_has_no_place_in_the_larger_model_is_said(options, said, undecided):
    with pytest.raises(NotNestedError, match=said) as caught:
        embedding(**options)
    assert caught.value.undecided is undecided


def test_directions_are_those_of_parameters_of_any_size():
    """Two that move together, one that does not and one with a column of its own: two directions leave them."""
    point = np.array([2e3, -4e-3, 5.0, 0.0])
    slope = np.array([[1e3, 0.0], [1e-3, 0.0], [0.0, 0.0], [0.0, 7.0]])
    directions = _left_null_space(slope, point)
    assert directions.shape == (4, 2)
    np.testing.assert_allclose(directions.T @ slope, 0.0, atol=1e-12)
    assert np.linalg.matrix_rank(directions * np.array([[2e3], [4e-3], [5.0], [1.0]])) == 2
