"""Profiles of the likelihood, against brute force, an F-test written out, and planted truths."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import brentq, least_squares
from scipy.stats import f as fisher
from scipy.stats import t as student

import greybox as gb
from greybox.compiled.response_part import ResponsePart
from greybox.estimate import profile as profile_module
from greybox.estimate.profiles import Contour, ProfileOf, Profiles
from greybox.files.text_table import number
from greybox.problems import pitch_hover, yaw_hover
from greybox.solve.ipopt import Ipopt

OMEGA = np.geomspace(0.3, 30, 15)


class OneSided(gb.TransferFunction):
    """A gain over a pole far above the band: the data bound the pole from below alone, and know their ratio."""

    input, output = "u", "y"
    b = gb.Parameter(100.0, bounds=(1, 1e9), starts=(10, 1000))
    a = gb.Parameter(100.0, bounds=(1, 1e6), starts=(10, 1000))
    derived = {"ratio": lambda p: p.b / p.a}

    def response(self, s, p):
        return p.b / (s + p.a)


def noisy(model, values, sigma, seed, omega=OMEGA):
    return measured(model, omega, values, noise=sigma, seed=seed)


def fitted(model, data, criterion=None, **options):
    return gb.fit(gb.Problem(model, data, criterion, **options), starts=12, progress=False)


def brute_force(fit, model, name, edge, level=0.95):
    """The end of the interval of squared relative errors, by scipy on the residuals, with the F-like threshold."""
    data, start = fit.parts[0].data, fit.estimate[name]
    others = {other: fit.estimate[other] for other in fit.free if other != name}
    names = [*others]

    def lowest(value):
        def residual(x):
            values = SimpleNamespace(**{name: value}, **dict(zip(names, x, strict=True)))
            error = model.response(1j * data.omega, values) / data.response - 1
            return np.concatenate([error.real, error.imag])

        return (
            2
            * least_squares(
                residual, list(others.values()), x_scale="jac", xtol=1e-12, ftol=1e-12
            ).cost
        )

    dof = 2 * len(data) - len(names) - 1
    bias = {q.name: q.bias for q in fit.quantities}[name] / fit.standard_error[name]
    root = student.ppf(0.5 + level / 2, dof) + (bias if edge < start else -bias)
    place = fit.free.index(name)
    limit = fit.cost + root**2 / 2 * fit.covariance_of([name])[0, 0] / fit.white[place, place]
    return brentq(lambda value: lowest(value) - limit, start, edge, rtol=1e-8)


def test_both_ends_are_those_of_brute_force():
    data = noisy(LagLagDelay(), TWO_LAGS, 0.1, 3, TWO_LAGS_OMEGA[::3])
    fit = fitted(LagLagDelay(), data, gb.SquaredRelativeError())
    low, high = gb.profile(fit, "K")["K"].interval
    best = fit.estimate["K"]
    for end, edge in ((low, 0.5 * best), (high, 1.7 * best)):
        expected = brute_force(fit, LagLagDelay(), "K", edge)
        assert_allclose(end, expected, atol=2e-3 * fit.standard_error["K"])


def test_with_little_noise_profiles_are_the_intervals_of_the_standard_errors():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.002, 0, TWO_LAGS_OMEGA)
    for criterion in (gb.RelativeError(), gb.SquaredRelativeError(), gb.RelativeLikelihood()):
        fit = fitted(Lag(), data, criterion)
        profiles = gb.profile(fit)
        for name, wald in fit.interval().items():
            # The sum of magnitudes of few points is not quadratic: its roots follow the standard
            # error to a tenth.
            width = 0.12 if isinstance(criterion, gb.RelativeError) else 0.02
            assert_allclose(
                profiles[name].interval,
                wald,
                atol=width * (wald[1] - wald[0]),
                err_msg=str(criterion),
            )


def test_an_open_end_is_said_and_the_ratio_is_known(monkeypatch):
    monkeypatch.setattr(
        ResponsePart, "neighbors", lambda *_: None
    )  # the brute force is that of independent errors
    data = noisy(OneSided(), {"b": 10000.0, "a": 5000.0}, 0.05, 1)
    fit = fitted(OneSided(), data, gb.SquaredRelativeError())
    profiles = gb.profile(fit)
    low, high = profiles["a"].interval
    assert high == np.inf
    assert_allclose(low, brute_force(fit, OneSided(), "a", 20.0), rtol=0.01)
    assert "no upper limit up to the bound 1e+06" in str(profiles["a"])
    assert_allclose(profiles["ratio"].interval, 2.0, rtol=0.1)


def test_the_yaw_damping_is_positive_and_has_no_upper_limit():
    profiles = gb.profile(
        gb.fit(yaw_hover.problem(), starts=20, profiles=False, progress=False), ["a2", "a3_tilde"]
    )
    low, high = profiles["a2"].interval
    assert (
        60 < low < 100
    )  # above 100 if the errors of neighboring points were independent, which they do not look
    assert high == np.inf
    assert profiles["a2"].ends == ("crossed", "bound")
    # a3 / a2 is determined, so that the upper end of a3 is made by the bound of a2.
    assert profiles["a3_tilde"].at_bound == ((), ("a2",))
    assert "the upper limit with a2 at its bound" in str(profiles)


def test_derived_quantities_follow_their_parameter():
    profiles = gb.profile(
        gb.fit(pitch_hover.problem(), starts=20, progress=False), ["a3", "a3_tilde"]
    )
    assert_allclose(
        profiles["a3_tilde"].interval, gb.g * np.array(profiles["a3"].interval), rtol=1e-3
    )


def test_intervals_hold_the_truth_as_often_as_they_say():
    # The one-sided model, whose standard error says nothing: of 10 intervals of 95 % at least 8
    # (98.8 % of the time).
    held = 0
    for seed in range(10):
        data = noisy(OneSided(), {"b": 800.0, "a": 400.0}, 0.05, seed)
        fit = gb.fit(gb.Problem(OneSided(), data), starts=3, profiles=False, progress=False)
        low, high = gb.profile(fit, "a", fresh_starts=0)["a"].interval
        held += low <= 400.0 <= high
    assert held >= 8


def test_a_saved_fit_is_profiled_too(tmp_path):
    fit = gb.fit(pitch_hover.problem(), starts=10, progress=False)
    gb.save(fit, tmp_path / "pitch.h5")
    again = gb.load(tmp_path / "pitch.h5")
    assert gb.profile(again, "a1")["a1"].interval == gb.profile(fit, "a1")["a1"].interval


def test_a_fit_profiles_what_its_standard_error_misleads_about(tmp_path):
    fit = gb.fit(yaw_hover.problem(), starts=10, progress=False)
    assert [profile.name for profile in fit.profiles.profiles] == [
        "a1_tilde",
        "a2",
        "a3_tilde",
    ]  # a4: 5.6 ± 0.3
    asked = gb.profile(fit, "a2", fresh_starts=0)["a2"]
    assert fit.profiles["a2"].interval == asked.interval
    said = str(fit)
    assert (
        f"a2        above {asked.interval[0]:.4g} 1/s, no upper limit up to the bound 2000" in said
    )
    gb.save(fit, tmp_path / "yaw.h5")
    again = gb.load(tmp_path / "yaw.h5")
    assert str(again) == said
    assert again.profiles.summary() == fit.profiles.summary()
    assert again.to_dict()["profiles"]["a2"]["high"] is None


def test_nothing_is_profiled_where_standard_errors_serve_or_it_is_not_asked_for():
    assert gb.fit(pitch_hover.problem(), starts=8, progress=False).profiles is None
    assert gb.fit(yaw_hover.problem(), starts=8, profiles=False, progress=False).profiles is None
    data = noisy(OneSided(), {"b": 10000.0, "a": 5000.0}, 0.05, 1)
    assert fitted(OneSided(), data, gb.MagnitudePhase()).profiles is None


def test_what_has_no_likelihood_ratio_is_refused():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.02, 0)
    with pytest.raises(ValueError, match="MagnitudePhase weighs the points"):
        gb.profile(fitted(Lag(), data, gb.MagnitudePhase()))
    tied = gb.Problem(
        LagLagDelay(), noisy(LagLagDelay(), TWO_LAGS, 0.02, 0), tied={"T1": lambda p: 3 * p.T2}
    )
    fit = gb.fit(tied, starts=10, progress=False)
    with pytest.raises(ValueError, match="give its problem="):
        gb.profile(fit)
    assert np.isfinite(gb.profile(fit, "T1", problem=tied)["T1"].interval).all()
    with pytest.raises(ValueError, match="there is no 'T' to profile"):
        gb.profile(fit, "T", problem=tied)


def test_what_follows_from_constants_alone_has_no_profile():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.02, 0)
    fit = fitted(Lag(), data, fixed={"T": 0.3})
    found = gb.profile(fit)
    assert [profile.name for profile in found.profiles] == ["K", "area"]
    assert_allclose(found["area"].interval, 0.09 * np.array(found["K"].interval), rtol=1e-3)
    with pytest.raises(ValueError, match="there is no 'bandwidth' to profile"):
        gb.profile(fit, "bandwidth")


def test_the_figure_has_a_panel_for_each():
    found = gb.profile(
        gb.fit(yaw_hover.problem(), starts=10, profiles=False, progress=False), ["a2", "a4"]
    )
    axes = gb.plotting.profiles(found)
    assert [ax.get_xlabel() for ax in axes] == ["a2 [1/s]", "a4 [1/s]"]


def test_profiles_do_not_depend_on_who_makes_them():
    fit = fitted(OneSided(), noisy(OneSided(), {"b": 500.0, "a": 200.0}, 0.05, 1))
    names = ["a", "ratio"]  # a parameter, held by its bounds, and a formula of the user's
    alone = gb.profile(fit, names, fresh_starts=0)
    with ThreadPoolExecutor(2) as threads:  # whose tasks are pickled as those of processes
        found = gb.profile(fit, names, fresh_starts=0, executor=threads)
    assert [profile.name for profile in found.profiles] == names
    for one, other in zip(found.profiles, alone.profiles, strict=True):
        assert_array_equal(one.costs, other.costs)
        assert one.interval == other.interval
    with pytest.raises(TypeError, match="executor is 3: give an instance such as"):
        gb.profile(fit, executor=3)


def test_a_contour_is_where_the_costs_of_a_dense_grid_cross_the_limit():
    data = noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.1, 4, TWO_LAGS_OMEGA[::4])
    fit = fitted(Lag(), data, gb.SquaredRelativeError())
    found = gb.contour(fit, "K", "T", directions=12)
    assert {*found.ends} == {"crossed"}
    # Of a model of two parameters nothing is fitted again: the cost gives the root on the contour
    # itself, and with the bias of the estimate, in the metric of the covariance, it is √(2 F) from
    # the truth.
    dof = 2 * len(data) - 2
    error = found.points[:, :1] / (1j * data.omega * found.points[:, 1:] + 1) / data.response - 1
    factor = np.mean(np.diag(fit.white) / np.diag(fit.covariance_of(["K", "T"])))
    roots = np.sqrt(2 * factor * ((np.abs(error) ** 2).sum(axis=1) - fit.cost))
    angle = 2 * np.pi * np.arange(12) / 12
    axes = np.linalg.cholesky(fit.covariance_of(["K", "T"]))
    bias = np.linalg.solve(axes, [q.bias for q in fit.quantities if q.kind == "free"])
    assert np.linalg.norm(bias) > 0.3
    distance = np.linalg.norm(
        roots[:, None] * np.array([np.cos(angle), np.sin(angle)]).T + bias, axis=1
    )
    assert_allclose(distance, np.sqrt(2 * fisher.ppf(0.95, 2, dof)), rtol=1e-3)


def test_a_contour_of_a_ratio_that_is_known_is_open_along_it():
    data = noisy(OneSided(), {"b": 10000.0, "a": 5000.0}, 0.05, 1)
    fit = fitted(OneSided(), data, gb.SquaredRelativeError())
    found = gb.contour(fit, "b", "a", directions=12)
    assert "open in" in str(found)
    ratio = found.points[:, 0] / found.points[:, 1]
    assert np.nanmax(np.abs(ratio / 2 - 1)) < 0.3
    axes = gb.plotting.contour(found)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("b [1]", "a [1]")
    with pytest.raises(ValueError, match="no free 'ratio'"):
        gb.contour(fit, "b", "ratio")


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0])
def test_a_level_is_a_share(level):
    fit = fitted(OneSided(), noisy(OneSided(), {"b": 100.0, "a": 100.0}, 0.02, 0))
    with pytest.raises(ValueError, match=f"level {level} must lie between 0 and 1"):
        gb.profile(fit, level=level)


def test_profiles_by_newtons_method_are_those_by_ipopt_which_is_built_once(monkeypatch):
    built = []

    class Counted(Ipopt):
        def __init__(self, *arguments):
            built.append(self)
            super().__init__(*arguments)

    fit = fitted(
        LagLagDelay(),
        noisy(LagLagDelay(), TWO_LAGS, 0.03, 2, TWO_LAGS_OMEGA),
        gb.SquaredRelativeError(),
    )
    monkeypatch.setattr("greybox.estimate.profile.Ipopt", Counted)
    found = gb.profile(fit, list(fit.free)[:2], fresh_starts=0)
    assert not built
    monkeypatch.setattr("greybox.estimate.profile.BatchedSolver.serves", lambda nlp: False)
    wanted = gb.profile(fit, list(fit.free)[:2], fresh_starts=0)
    assert len(built) == 1
    for one, other in zip(found.profiles, wanted.profiles, strict=True):
        assert one.interval == pytest.approx(other.interval, rel=1e-3)


def walk(cost, **options):
    """A search along a quantity of estimate 1 and size 0.1, of a cost that no other parameter lowers."""

    class Held:
        def solve(self, starts, values):
            return [(np.array([value]), cost(value)) for value in values]

    point, z = profile_module._Point, np.array([1.0])
    given = {
        "factor": 1.0,
        "numbers": np.inf,
        "limit": 1.96,
        "bounds": (-np.inf, np.inf),
        "size": 0.1,
        "first": 0.05,
    }
    given |= {
        "held": Held(),
        "best": point(1.0, z, cost(1.0)),
        "starts": np.zeros((0, 1)),
        **options,
    }
    return profile_module._Search(**given)


def parabola(value):
    return 0.5 * ((value - 1) / 0.1) ** 2


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_walk_ends_beyond_the_limit_at_a_bound_or_where_nothing_changes_any_more(direction):
    points, end = walk(parabola).side(direction)
    assert end == "crossed"
    roots = [abs(point.value - 1) / 0.1 for point in points]
    assert roots == sorted(roots)
    assert roots[-2] < 1.2 * 1.96 < roots[-1] < 1.6 * 1.96
    assert np.diff(roots[1:]) == pytest.approx(np.full(len(roots) - 2, 0.35 * 1.96))

    points, end = walk(parabola, bounds=(0.9, 1.1)).side(direction)
    assert (end, points[-1].value) == ("bound", 1 + direction * 0.1)

    points, end = walk(lambda value: 0.5 * np.tanh(parabola(value))).side(direction)
    assert end == "flat"
    assert 1e6 * 0.1 < abs(points[-1].value - 1) < 3.1e6 * 0.1


def test_roots_are_those_of_the_likelihood_ratio_or_of_the_f_statistic_with_their_sign():
    point = profile_module._Point
    assert walk(parabola).signed_root(point(0.8, None, parabola(0.8))) == pytest.approx(-2)
    assert walk(parabola, factor=4.0).root(point(1.2, None, parabola(1.2))) == pytest.approx(4)
    assert walk(parabola).root(point(1.2, None, -1.0)) == 0
    # Of 20 numbers whose variance is estimated: N (S / S0 - 1), the cost N / 2 log S, of S larger
    # by a tenth.
    ratio = walk(lambda value: 0.0, numbers=20.0).root(point(1.2, None, 10 * np.log(1.1)))
    assert ratio == pytest.approx(np.sqrt(20 * 0.1))


def test_a_jump_over_the_limit_is_approached_in_shorter_steps_and_what_has_no_cost_ends_the_walk():
    points, end = walk(lambda value: 9.0 if value > 1.3 else 0.1 * parabola(value)).side(1)
    assert end == "crossed"
    assert points[-1].cost == 9.0
    assert points[-1].value - points[-2].value < 1.01e-3 * 0.05 * 3
    points, end = walk(lambda value: np.inf if value > 1.04 else parabola(value)).side(1)
    assert end == "failed"
    assert all(point.cost < np.inf for point in points)
    points, end = walk(lambda value: 0.0, bounds=(-np.inf, 1.0)).side(1)
    assert (len(points), end) == (1, "bound")  # the estimate lies there


def test_points_take_a_lower_cost_from_their_neighbors():
    """Of two branches the one beyond 1.1 is lower, and only the last point found it."""

    class Branches:
        calls = 0

        def solve(self, starts, values):
            self.calls += 1
            return [
                (start, parabola(v) - 2 * start[0] * (v > 1.1))
                for start, v in zip(starts, values, strict=True)
            ]

    point, low, high = profile_module._Point, np.array([0.0]), np.array([1.0])
    held = Branches()
    search = walk(parabola, held=held, best=point(1.0, low, 0.0))
    points = [search.best, *(point(v, low, parabola(v)) for v in (1.05, 1.15, 1.2))]
    points.append(point(1.3, high, parabola(1.3) - 2))
    swept = search.swept(points)
    assert [p.value for p in swept] == [1.0, 1.05, 1.15, 1.2, 1.3]
    assert [p.z[0] for p in swept[2:]] == [1, 1, 1]
    assert swept[0] is search.best
    assert [p.cost for p in swept] == pytest.approx([0, 0.125, 1.125 - 2, 2 - 2, 4.5 - 2])
    held.calls = 0
    again = search.swept(swept)
    assert [p.cost for p in again] == [p.cost for p in swept]
    assert held.calls == 1  # all at once, and no more


@pytest.mark.parametrize(
    ("ray", "bounds", "reach", "end"),
    [
        ([0.1, 0.0], 99.0, 2.5, "crossed"),
        ([0.06, -0.08], 99.0, 2.5, "crossed"),
        ([0.1, 0.0], 1.2, 2.0, "bound"),
        ([-0.1, 0.05], 1.2, 4.0, "bound"),
    ],
)
def test_a_ray_is_followed_to_where_the_limit_is_crossed_or_to_a_bound(ray, bounds, reach, end):
    """In units of the deviations: of a cost that rises by a half of the squared distance over 0.1."""

    class Plane:
        def solve(self, starts, values):
            return [
                (start, 0.5 * np.sum((np.asarray(v) - 1) ** 2) / 0.01)
                for start, v in zip(starts, values, strict=True)
            ]

    limit = 10.0 if end == "bound" else 2.5
    point = profile_module._Point
    search = walk(parabola, held=Plane(), best=point(0.0, np.zeros(1), 0.0), limit=limit)
    low = 0.6 if end == "bound" else -99.0
    found, how = search.along(np.ones(2), np.array(ray), np.array([[low, bounds], [low, bounds]]))
    assert how == end
    assert found == pytest.approx(reach, rel=2e-3)


@pytest.mark.parametrize(
    ("cost", "reach", "end"), [(np.inf, np.nan, "failed"), (0.0, np.inf, "flat")]
)
def test_a_ray_on_which_nothing_is_found_or_nothing_changes(cost, reach, end):
    class Same:
        def solve(self, starts, values):
            return [(start, cost) for start in starts]

    search = walk(parabola, held=Same(), best=profile_module._Point(0.0, np.zeros(1), 0.0))
    found, how = search.along(np.ones(2), np.array([0.1, 0.0]), np.array([[-np.inf, np.inf]] * 2))
    assert found == pytest.approx(reach, nan_ok=True)
    assert how == end


class Bound:
    """A second parameter rises with the first, up to its bound of 3; the first has the parabola."""

    def solve(self, starts, values):
        return [(np.array([v, np.clip(2 + 8 * (v - 1), 1, 3)]), parabola(v)) for v in values]


@pytest.mark.parametrize("bias", [0.0, 0.5])
@pytest.mark.parametrize(
    ("bounds", "ends"), [((-9.0, 9.0), ("crossed", "crossed")), ((0.9, 9.0), ("bound", "crossed"))]
)
def test_a_profile_tells_all_of_its_points(bias, bounds, ends):
    same = SimpleNamespace(to_parameters=np.asarray)
    nlp = SimpleNamespace(
        scaling=same, free=("a", "b"), lower=np.array([-9.0, 0.0]), upper=np.array([9.0, 3.0])
    )
    best = profile_module._Point(1.0, np.array([1.0, 2.0]), 0.0)
    search = walk(
        parabola, held=Bound(), best=best, bounds=bounds, bias=bias, starts=np.zeros((0, 2))
    )
    line = SimpleNamespace(name="a", unit="s", value=1.0, standard_error=0.1, bounds=bounds)
    found = profile_module._profile_of(nlp, search, line)
    low = -np.inf if ends[0] == "bound" else 1 - 0.1 * (1.96 + bias)
    assert found.interval == pytest.approx((low, 1 + 0.1 * (1.96 - bias)), abs=2e-4)
    assert found.ends == ends
    assert (found.name, found.unit, found.estimate, found.standard_error) == ("a", "s", 1.0, 0.1)
    assert (found.bounds, found.bias, found.connected) == (bounds, bias, True)
    assert np.all(np.diff(found.values) > 0)
    assert_allclose(found.costs, parabola(found.values))
    assert_allclose(found.roots, (found.values - 1) / 0.1, atol=1e-9)
    assert_allclose(found.others[:, 0], found.values)
    assert_allclose(found.others[:, 1], np.clip(2 + 8 * (found.values - 1), 1, 3))
    assert found.at_bound == ((), ("b",))


@pytest.mark.parametrize(
    ("interval", "ends", "at_bound", "connected", "said"),
    [
        ((1.0, 2.5), ("crossed", "crossed"), ((), ()), True, "1 to 2.5 s"),
        ((1.0, 2.5), ("crossed", "crossed"), ((), ()), False, "1 to 2.5 s, in separate pieces"),
        (
            (1.0, np.inf),
            ("crossed", "bound"),
            ((), ()),
            True,
            "above 1 s, no upper limit up to the bound 9",
        ),
        (
            (-np.inf, 2.5),
            ("bound", "crossed"),
            ((), ()),
            True,
            "below 2.5 s, no lower limit down to the bound -3",
        ),
        (
            (-np.inf, 2.5),
            ("failed", "crossed"),
            ((), ()),
            True,
            "below 2.5 s, no lower limit that could be found: solves failed beyond",
        ),
        ((1.0, np.inf), ("crossed", "flat"), ((), ()), True, "above 1 s, no upper limit"),
        (
            (-np.inf, np.inf),
            ("flat", "bound"),
            ((), ()),
            True,
            "not limited by the data on either side",
        ),
        (
            (1.0, 2.5),
            ("crossed", "crossed"),
            (("k",), ("k", "c")),
            True,
            "1 to 2.5 s, the lower limit with k at its bound, the upper limit with k, c at their bounds",
        ),
    ],
)
def test_an_interval_in_words(interval, ends, at_bound, connected, said):
    one = ProfileOf(
        "T", "s", 1.5, 0.2, *np.zeros((3, 1)), np.zeros((1, 1)), interval, ends, (-3.0, 9.0)
    )
    one = replace(one, at_bound=at_bound, connected=connected)
    assert str(one) == said
    found = Profiles("step", 0.9, {"T": 1.7}, ("T",), (one,), ("a profile found more",))
    assert str(found) == (
        f"step: 90 % intervals by profile likelihood\n\n  T         1.5   {said}\n  warning: a profile found more"
    )
    low, high = (None if np.isinf(value) else value for value in interval)
    assert found.intervals_in_words() == {"T": {"low": low, "high": high, "text": said}}
    summary = found.summary()
    assert (summary["problem"], summary["level"], summary["limit"]) == ("step", 0.9, {"T": 1.7})
    assert summary["profiles"]["T"] == {
        "estimate": 1.5,
        "standard_error": 0.2,
        "low": low,
        "high": high,
        "ends": [*ends],
        "at_bound": [list(names) for names in at_bound],
        "connected": connected,
        "text": said,
        "values": [0.0],
        "costs": [0.0],
        "roots": [0.0],
        "others": {"T": [0.0]},
    }
    with pytest.raises(KeyError, match="'k' was not profiled"):
        found["k"]


@pytest.mark.parametrize(
    ("value", "error", "interval", "misleads"),
    [
        (-2.0, 0.99, (-4.0, -0.1), False),
        (-2.0, 1.01, (-4.0, -0.1), True),
        (2.0, 0.5, (-0.01, 3.0), True),
        (2.0, 0.5, (0.01, 5.01), True),
        (2.0, 0.5, (0.01, 4.99), False),
    ],
)
def test_an_error_beyond_half_the_value_or_an_interval_beyond_a_bound_misleads(
    value, error, interval, misleads
):
    bounds = (-9.0, 5.0) if value < 0 else (0.0, 5.0)
    line = SimpleNamespace(value=value, standard_error=error, bounds=bounds)
    assert profile_module._misleads(line, interval) == misleads


def test_the_factor_of_the_cost_is_that_of_both_variances_along_the_gradient():
    white, covariance = (
        np.array([[4.0, 1.0], [1.0, 9.0]]),
        np.array([[2.0, -0.5, 8.0], [-0.5, 3.0, 8.0], [8.0] * 3]),
    )
    accuracy = SimpleNamespace(white=white, covariance=covariance, size=np.array([1.0, 10.0, 7.0]))
    gradient = np.array([2.0, -1.0])
    assert profile_module._factor(accuracy, gradient) == pytest.approx((16 - 4 + 9) / (8 + 2 + 3))
    # Along what has no variance, what holds on average, in multiples of the sizes.
    accuracy.covariance = np.diag([2.0, 0.0, 8.0])
    assert profile_module._factor(accuracy, np.array([0.0, 3.0])) == pytest.approx((4 + 0.09) / 2)
    assert profile_module._factor(accuracy, np.array([3.0, 0.0])) == pytest.approx(2)


@pytest.fixture(scope="module")
def lag():
    return fitted(Lag(), noisy(Lag(), {"K": 2.0, "T": 0.3}, 0.02, 0), gb.SquaredRelativeError())


def test_a_region_needs_two_parameters_and_eight_directions(lag):
    with pytest.raises(
        ValueError, match=r"^a contour of 'K' needs another parameter: there are K, T\.$"
    ):
        gb.contour(lag, "K", "K")
    with pytest.raises(ValueError, match=r"^directions is 7: give at least 8\.$"):
        gb.contour(lag, "K", "T", directions=7)
    found = gb.contour(lag, "T", "K", directions=8, level=0.5)
    assert found.names == ("T", "K")
    assert found.limit == pytest.approx(np.sqrt(2 * fisher.ppf(0.5, 2, lag.dof)))
    assert_allclose(found.estimate, [lag.estimate["T"], lag.estimate["K"]])
    assert_allclose(found.covariance, lag.covariance_of(["T", "K"]))
    assert str(found).startswith("50 % region of T and K, closed: T ")


def test_an_ellipse_is_where_the_quadratic_form_is_the_square_of_the_limit():
    covariance = np.array([[4.0, -1.5], [-1.5, 1.0]])
    region = Contour(
        ("a", "b"),
        ("s", ""),
        0.9,
        np.array([3.0, -7.0]),
        covariance,
        2.5,
        np.array([[1.0, -9.0], [5.0, np.nan]]),
        ("crossed", "flat"),
    )
    away = region.ellipse(50) - [3.0, -7.0]
    assert away.shape == (50, 2)
    assert_allclose(np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away), 2.5**2)
    assert_allclose(away[0], away[-1])
    assert np.ptp(away[:, 0]) == pytest.approx(2 * 2.5 * 2, rel=0.01)
    assert (
        str(region) == "90 % region of a and b, open in 1 of 2 directions: a 1 to 5 s, b -9 to -9"
    )


def test_a_fit_without_an_estimate_and_one_with_a_prior_have_no_profile(lag):
    with pytest.raises(
        ValueError, match=r"^the fit 'run' has no estimate to profile around: no start converged"
    ):
        gb.profile(replace(lag, name="run", minima=()))
    with pytest.raises(
        ValueError,
        match=r"^the fit 'run' has a-priori knowledge, with which its cost is no likelihood: use",
    ):
        gb.profile(replace(lag, name="run", priors={"K": (2.0, 0.1)}))
    with pytest.raises(
        ValueError, match=r"^the fit 'run' has manoeuvres, of which no profiles are made: use"
    ):
        gb.profile(replace(lag, name="run", parts=(*lag.parts, SimpleNamespace())))


def test_a_lower_cost_than_the_fits_is_told(lag):
    assert gb.profile(lag, "K", fresh_starts=0).warnings == ()
    off = tuple(replace(q, value=1.2 * q.value) if q.name == "T" else q for q in lag.quantities)
    found = gb.profile(replace(lag, quantities=off), "K", fresh_starts=0)
    (said,) = found.warnings
    p = {q.name: q.value for q in off}
    data = lag.parts[0].data
    cost = np.sum(np.abs(p["K"] / (1j * data.omega * p["T"] + 1) / data.response - 1) ** 2)
    lowest = number(float(found["K"].costs.min()))
    assert (
        said
        == f"a profile found the cost {lowest} below the fit's {number(cost)}: fit from more starts."
    )
