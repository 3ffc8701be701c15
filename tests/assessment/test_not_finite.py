"""What a stranger reads where a model has no finite value at its starts: the state or output, when, and the cure."""

import numpy as np
import pytest
from stiff_lag import StiffLag
from unfolded import unfolded

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Tank(gb.StateSpace):
    """A root leaves its domain where the level is below the drain."""

    states, inputs, outputs = ("level", "flow"), ("u",), ("level",)
    c = gb.Parameter(1.0, bounds=(0.1, 5))
    h = gb.Parameter(0.5, bounds=(-3, 3), about="height of the drain")

    def derivative(self, x, u, p):
        return (x.flow + u.u, -p.c * gb.sqrt(x.level - p.h) - x.flow)

    def output(self, x, u, p):
        return (x.level,)


class Logarithm(gb.StateSpace):
    """Its output has no value where it rests."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(0.1, 5))
    h = gb.Parameter(50.0, bounds=(20, 60))

    def derivative(self, x, u, p):
        return (-p.a * x.x + u.u,)

    def output(self, x, u, p):
        return (gb.log(gb.sin(x.x) - p.h),)


class Explosive(gb.StateSpace):
    """Leaves all bounds within a sample, with finite values at first."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(500.0, bounds=(100, 1000))

    def derivative(self, x, u, p):
        return (p.a * x.x**2 + p.a + u.u,)

    def output(self, x, u, p):
        return (x.x,)


class Table(gb.StateSpace):
    """A logarithm whose argument is negative in the first rows."""

    states, inputs, outputs = (), ("u",), ("y",)
    h = gb.Parameter(2.0, bounds=(1, 5))

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return (gb.log(u.u - p.h),)


def record(output, start=7.0, n=100, **more):
    random = np.random.default_rng(0)
    values = 1 + 0.1 * np.sin(0.3 * np.arange(n)) + 0.01 * random.normal(size=n)
    signals = {"u": np.repeat(random.normal(size=n // 10), 10), output: values} | more
    return gb.Record(start + 0.1 * np.arange(n), signals)


def fit(problem, starts=4, **options):
    return gb.fit(problem, starts=starts, progress=False, **options)


@pytest.mark.parametrize(
    ("problem", "what", "why"),
    [
        (
            gb.Problem(Tank(), record("level"), fixed={"h": 2.5}),
            "4 × not finite at the start (the derivative of flow)",
            "at the start of run 0 the derivative of flow is not finite at 7 s, where level = 0, flow = 0, u = ",
        ),
        (
            gb.Problem(Logarithm(), record("y")),
            "4 × not finite at the start (the output y)",
            "at the start of run 0 the output y is not finite at 7 s, where x = 0, u = ",
        ),
        (
            gb.Problem(Explosive(), record("x")),
            "4 × not finite at the start (x, simulated)",
            "at the start of run 0 x is no longer finite at 7.1 s: start elsewhere, or bound the parameters",
        ),
    ],
    ids=["derivative", "output", "simulation"],
)
def test_where_no_start_is_finite_the_sentence_names_what_when_and_the_cure(problem, what, why):
    found = fit(problem)
    assert not found.converged
    assert found.status == f"no start converged ({what})"
    (said,) = found.warnings
    assert said.startswith(why)
    label, state = problem.model.label, problem.model.states[0]
    assert (
        f"bound the parameters to where {label} has finite values, or give known states, initial={{{state!r}"
        in said
    )
    assert "gb.sqrt(gb.maximum(h, 0))" in said
    assert said in unfolded(found)


class Friction(gb.StateSpace):
    """Dry friction behind a fast lag: no implicit step ends where the sign changes."""

    states, inputs, outputs = ("v", "f"), ("u",), ("v",)
    c = gb.Parameter(0.2, bounds=(0.1, 2))
    T = gb.Parameter(0.01, bounds=(0.005, 0.1))

    def derivative(self, x, u, p):
        return (x.f - p.c * gb.sign(x.v) - 0.5 * x.v, (u.u - x.f) / p.T)

    def output(self, x, u, p):
        return (x.v,)


def test_implicit_steps_that_fail_at_a_jump_name_it():
    problem = gb.Problem(Friction(), record("v"))
    method = gb.MultipleShooting(integrator=gb.Radau())
    (said,) = fit(problem, starts=1, method=method).warnings
    assert "v and f are no longer finite" in said
    assert "if a formula jumps, such as gb.sign(v), smooth it" in said
    assert "Radau" not in said


def test_a_table_names_the_row():
    rows = gb.Record(
        np.arange(30.0), {"u": np.repeat([0.1, 0.2, 3.0], 10), "y": np.ones(30)}, has_time=False
    )
    found = fit(gb.Problem(Table(), rows))
    assert found.status == "no start converged (4 × not finite at the start (the output y))"
    assert found.warnings[0] == (
        "at the start of run 0 the output y is not finite in row 1, where u = 0.1: start "
        "elsewhere, or bound the parameters to where Table has finite values."
    )


def test_the_cures_work():
    apart = record("y", y=np.log(0.5 + 0.2 * np.sin(0.3 * np.arange(100))))
    assert not fit(gb.Problem(Logarithm(), apart)).converged

    class Bounded(Logarithm):
        h = gb.Parameter(-2.0, bounds=(-3, -1.2))

    assert fit(gb.Problem(Bounded(), apart)).converged


def test_a_stiff_model_is_sent_to_the_method_for_it():
    data = record("y")
    problem = gb.Problem(StiffLag(), data, gb.OutputError(inputs="held"), fixed={"k": 1e4})
    found = fit(problem, 1, method=gb.MultipleShooting(integrator=gb.RungeKutta()))
    assert "1 × not finite at the start (x and f, simulated)" in found.status
    assert "MultipleShooting(integrator=Radau())" in found.warnings[0]
    chosen = fit(problem, 1)  # by itself
    assert chosen.converged
    assert "Radau" in chosen.records[0].method


class Root(gb.StateSpace):
    """A lag with a gain whose square is the parameter; an input may be too low for its sensor."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    h = gb.Parameter(1.0, bounds=(-3, 3))
    low = gb.Parameter(-9.0, fixed=True)

    def derivative(self, x, u, p):
        return (2 * (u.u - x.x),)

    def output(self, x, u, p):
        return (gb.sqrt(p.h) * x.x + 1e-9 * gb.log(u.u - p.low),)


def test_listed_starts_outside_the_domain_move_to_where_the_model_is_finite():
    data = record("y")
    output = gb.simulate(Root(), {"h": 2.0}, data, inputs="held")["y"]
    data = data.with_signals(y=output + 0.01 * np.random.default_rng(1).normal(size=len(data)))
    problem = gb.Problem(Root(), data, gb.OutputError(inputs="held"))
    found = fit(problem, [{"h": 1.0}, {"h": -0.9}, {"h": -2.0}, {"h": -2.9}])
    assert all(run.converged and run.start[0] > 0 for run in found.runs)
    assert len(found.minima) == 1
    assert abs(found.estimate["h"] - 2.0) < 4 * found.standard_error["h"]
    assert not any("not finite" in text for text in found.warnings)


def test_the_time_is_that_of_the_record_also_after_a_gap():
    data = record("y")
    time = np.concatenate([data.time[:47], data.time[47:] + 5.0])
    low = np.flatnonzero(data["u"] == data["u"].min())
    assert low[0] > 47
    after = gb.Record(time, data.signals)
    found = fit(
        gb.Problem(Root(), after, gb.OutputError(inputs="held"), fixed={"low": data["u"].min()}), 1
    )
    said = found.warnings[0].partition("the output y is not finite at ")[2]
    assert np.abs(time[low] - float(said.split(" s, where")[0])).min() < 1e-9


def test_a_solver_that_meets_an_invalid_number_has_the_same_reason():
    found = fit(gb.Problem(Logarithm(), record("y")), method=gb.SingleShooting())
    assert "the output y is not finite at 7 s" in found.warnings[0]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("starts", [4, [{}]])
def test_bounds_as_wide_as_numbers_raise_no_warning_of_numpy(starts):
    wide = {"bounds": (-1e300, 1e300)}
    random = np.random.default_rng(0)
    u = random.normal(size=30).repeat(3)
    record = gb.Record(np.arange(90) * 0.1, {"u": u, "y": random.normal(size=90)})

    class Wide(gb.StateSpace):
        states = outputs = ("y",)
        inputs = ("u",)
        g = gb.Parameter(3.0, **wide)
        tau = gb.Parameter(0.4, **wide, unit="s")

        def derivative(self, x, u, p):
            return ((p.g * u.u - x.y) / p.tau,)

        def output(self, x, u, p):
            return (x.y,)

    assert gb.fit(gb.Problem(Wide(), record), starts=starts, progress=False).status
