"""A run that raises an error fails alone, with its reason, here and on workers; the others stay."""

import os
from concurrent.futures import Executor, Future

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from sampled_lag import SampledLag, lag_problem

import greybox as gb
from greybox.assessment.fit import fingerprint
from greybox.engine.solve.executors import run_all
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.local_solver import Runner
from greybox.engine.solve.lost_workers import ExecutorLostError
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.engine.solve.runs import Outcome
from greybox.workflows.study.record_replicates import RecordReplicates
from greybox.workflows.study.stored_runs import StoredRuns

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(0.3, 30, 12)
NOISE = np.random.default_rng(0).normal(size=12)
RESPONSE = gb.Problem(
    SampledLag(),
    gb.FrequencyResponse(OMEGA, 2 / (1 + 0.3j * OMEGA) * (1 + 0.02 * NOISE), input="u", output="y"),
)
PROBLEMS = {"response": RESPONSE, "record": lag_problem(samples=30)}
# The searches that run each start by itself.
SEARCHES = {"response": "multistart", "record": "batched"}
STARTS = [{"K": 1.0, "T": 0.5}, {"K": 7.0, "T": 0.5}, {"K": 2.0, "T": 0.2}]


class Failing(Runner):
    """Doubles a number, but raises an error at 3: everywhere, or only in another process."""

    def __init__(self, home=None):
        self.home = home

    def run(self, start):
        if start[0] == 3 and self.home != os.getpid():
            raise ZeroDivisionError("three is not doubled")
        return Outcome(2 * start, "solved", 1, 1e-3, converged=True)


class Together(Failing):
    """The same for four numbers at once, which then fail together."""

    together = 4


def ends(runner, executor):
    runs = run_all(runner, enumerate(np.arange(12.0)[:, None]), 12, executor)
    return {number: outcome for number, _, outcome in runs}


@pytest.mark.parametrize("runner", [Failing, Together])
def test_a_run_that_raises_fails_alone_here_and_on_workers(runner):
    with gb.solve.WorkerPool(1) as workers:
        here, there = (ends(runner(), executor) for executor in (None, workers))
    for found in (here, there):
        assert [k for k, outcome in found.items() if not outcome.converged] == [3]
        assert "ZeroDivisionError: three is not doubled" in found[3].status
        assert found[3].cost == np.inf
        assert [found[k].estimate[0] for k in (2, 4, 11)] == [4, 8, 22]


def test_a_run_that_raises_only_on_a_worker_is_made_here_with_a_word():
    said = r"a worker could not make a run \(error: .*ZeroDivisionError: three is not doubled\)"
    with gb.solve.WorkerPool(1) as workers, pytest.warns(UserWarning, match=said) as warned:
        found = ends(Failing(os.getpid()), workers)
    assert len(warned) == 1
    assert all(outcome.converged for outcome in found.values())
    assert found[3].estimate[0] == 6


class Ours(Executor):
    """Does its tasks in this process, from the pickled solver, but loses those of a start."""

    def __init__(self, error=None):
        self.error = error

    def submit(self, function, /, payload, starts, *others):
        future = Future()
        if self.error is not None and 3 in starts:
            future.set_exception(self.error)
        else:
            future.set_result(function(payload, starts, *others))
        return future


def test_workers_that_dask_has_lost_cost_the_start_alone():
    KilledWorker = type("KilledWorker", (Exception,), {"__module__": "distributed.scheduler"})
    found = ends(Failing(os.getpid()), Ours(KilledWorker("died")))
    assert {k: outcome.status for k, outcome in found.items() if outcome.status != "solved"} == {
        3: "worker lost"
    }


def test_what_was_used_is_not_advised():
    with pytest.raises(ExecutorLostError, match="ModuleNotFoundError: no module") as raised:
        ends(Failing(), Ours(ModuleNotFoundError("no module")))
    assert "WorkerPool" not in str(raised.value)


@pytest.fixture
def fragile(monkeypatch):
    """Raise an error in the runs of both solvers that begin near K = 7."""
    for solver in (ResponseSolver, GaussNewton):
        run = solver.run

        def broken(self, start, *, run=run):
            if abs(start[0] - 7) < 0.1:
                raise ValueError("the user's formula has no value at K = 7")
            return run(self, start)

        monkeypatch.setattr(solver, "run", broken)


@pytest.mark.usefixtures("fragile")
@pytest.mark.parametrize("executor", [None, Ours()])
@pytest.mark.parametrize("kind", PROBLEMS)
def test_a_fit_goes_on_with_its_other_starts(kind, executor):
    problem = PROBLEMS[kind]
    options = {"search": SEARCHES[kind], "profiles": False, "progress": False}
    fit = gb.fit(problem, STARTS, executor=executor, **options)
    assert [run.converged for run in fit.runs] == [True, False, True]
    assert "the user's formula has no value at K = 7" in fit.runs[1].status
    others = gb.fit(problem, [STARTS[0], STARTS[2]], **options)
    assert fit.estimate == others.estimate
    assert fit.standard_error == others.standard_error


class Friction(ca.Callback):
    """A user's own function, which has no value near 5."""

    def __init__(self):
        ca.Callback.__init__(self)
        self.construct("friction", {"enable_fd": True})

    def eval(self, arg):
        if 4.9 < float(arg[0]) < 5.1:
            raise ZeroDivisionError("no friction is known near 5")
        return [arg[0]]


FRICTION = Friction()


class Slowing(gb.StateSpace):
    """x' = u - friction(k) x."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    k = gb.Parameter(1.0, bounds=(0.01, 20))

    def derivative(self, x, u, p):
        return (u.u - FRICTION(p.k) * x.x,)

    def output(self, x, u, p):
        return (x.x,)


def test_code_of_the_user_that_raises_is_the_reason():
    """Against the solution of x' = u - 1.5 x for a held input."""
    step, count = 0.05, 100
    u, x = np.sign(np.sin(0.1 * np.arange(count) + 0.01)), np.zeros(count)
    for k in range(count - 1):
        x[k + 1] = u[k] / 1.5 + (x[k] - u[k] / 1.5) * np.exp(-1.5 * step)
    noise = 0.01 * np.random.default_rng(0).normal(size=count)
    record = gb.Record(step * np.arange(count), {"u": u, "x": x + noise}, hold={"u": np.inf})
    starts = [{"k": 1.2}, {"k": 5.0}, {"k": 0.5}]
    fit = gb.fit(gb.Problem(Slowing(), record), starts, profiles=False, progress=False)
    assert [run.converged for run in fit.runs] == [True, False, True]
    assert "no friction is known near 5" in fit.runs[1].status
    assert abs(fit.estimate["k"] - 1.5) < 4 * fit.standard_error["k"]


@pytest.mark.usefixtures("fragile")
@pytest.mark.parametrize("kind", PROBLEMS)
def test_what_all_starts_raise_is_raised(tmp_path, kind):
    problem = PROBLEMS[kind]
    starts = [{"K": 7.0, "T": 0.5}, {"K": 7.05, "T": 0.2}]
    with pytest.raises(ValueError, match="no value at K = 7"):
        gb.fit(problem, starts, search=SEARCHES[kind], progress=False)
    members = [
        gb.study.Member(problem, starts, name="broken", search=SEARCHES[kind]),
        gb.study.Member(problem, STARTS, name="whole", search=SEARCHES[kind]),
    ]
    study = gb.batch(members, tmp_path, progress=False)
    assert [member.status for member in study.members] == ["failed", "done"]
    assert "no value at K = 7" in study["broken"].error


@pytest.mark.usefixtures("fragile")
def test_a_study_does_not_store_what_has_raised(tmp_path):
    member = gb.study.Member(lag_problem(samples=30), STARTS, name="lag")
    [done] = gb.batch([member], tmp_path, progress=False).members
    assert [run.converged for run in done.fit.runs] == [True, False, True]
    kept = StoredRuns(tmp_path, "lag").stored(fingerprint(member.problem, member.by))
    assert sorted(k for k in kept if k >= 0) == [0, 2]


def test_a_replicate_that_raises_has_no_value(monkeypatch):
    problem = lag_problem(samples=30)
    fit = gb.fit(problem, 2, profiles=False, progress=False)
    run = RecordReplicates.run

    def broken(self, start):
        if start[0] == 2:
            raise np.linalg.LinAlgError("singular")
        return run(self, start)

    whole = gb.bootstrap(fit, 5, problem=problem, progress=False)
    monkeypatch.setattr(RecordReplicates, "run", broken)
    samples = gb.bootstrap(fit, 5, problem=problem, progress=False)
    assert "singular" in samples.statuses[2]
    assert np.isnan(samples.values[2]).all()
    rest = [0, 1, 3, 4]
    assert_array_equal(samples.values[rest], whole.values[rest])
