"""Everything that ships gives the same bits in this process and in others: workers, a pool, Dask.

A case is tried on one executor: all receive the same bytes, and the next case has the next one.

The lists are those of greybox: included problems, criteria, methods, integrators, searches, solvers
and other runners. A user's solver has its own cases. What is added to one of them is tried here. Criteria, methods, searches and kinds
of data are combined by pairs: any two entries of different lists meet in a case.
"""

import importlib
import itertools
import math
import os
import pickle
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import fields
from functools import cache
from inspect import isabstract
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from recipes import OneBoard, Slsqp
from sampled_lag import SampledLag, lag_problem, lag_record

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.local_solver import LocalSolver, Runner
from greybox.engine.solve.response_solver import ResponseSolver
from greybox.engine.solve.search_method import SEARCHES, solver_for
from greybox.engine.solve.worker_task import run_starts
from greybox.modeling.formulation.included_criteria import (
    CRITERIA,
    SPECTRUM_CRITERIA,
    TIME_CRITERIA,
)
from greybox.modeling.formulation.starts import as_starts
from greybox.modeling.integrators import Integrator
from greybox.workflows.study.catalog import shipped, shipped_module

pytestmark = [
    pytest.mark.usefixtures("unjudged_file"),
    pytest.mark.filterwarnings("ignore"),  # of packages that are not ours
]


# --- what ships


@cache
def import_all():
    """Import the folders in which solvers, methods, integrators and other runners are declared."""
    top = Path(gb.__file__).parent
    for folder in ("modeling", "compiled", "solve", "study"):
        for file in sorted((top / folder).rglob("*.py")):
            module = ".".join(("greybox", *file.relative_to(top).with_suffix("").parts))
            importlib.import_module(module.removesuffix(".__init__"))


def included(kind):
    """Return the concrete classes of a kind in greybox."""
    import_all()
    found, waiting = [], [kind]
    while waiting:
        following = waiting.pop().__subclasses__()
        waiting += following
        found += [k for k in following if k.__module__.startswith("greybox.") and not isabstract(k)]
    return sorted(found, key=lambda k: k.__name__)


def methods():
    """Return every transcription, with every integrator if it takes one."""
    for method in included(Transcription):
        if "integrator" in [field.name for field in fields(method)]:
            yield from (method(integrator=integrator()) for integrator in included(Integrator))
        else:
            yield method()


def by_pairs(*lists):
    """Return few rows with an entry of each list, in which any two entries of two lists meet."""
    rows = [*itertools.product(*(range(len(items)) for items in lists))]

    def pairs(row):
        return {*itertools.combinations(enumerate(row), 2)}

    missing, chosen = set().union(*map(pairs, rows)), []
    while missing:
        chosen.append(max(rows, key=lambda row: len(pairs(row) & missing)))
        missing -= pairs(chosen[-1])
    return [[items[k] for items, k in zip(lists, row, strict=True)] for row in chosen]


# --- data

OMEGA = np.geomspace(0.3, 30, 12)


class Pair(gb.StateSpace):
    """Two lags that act on each other."""

    states, inputs, outputs = ("x", "y"), ("u", "w"), ("x", "y")
    a = gb.Parameter(2.0, bounds=(0.5, 8))
    b = gb.Parameter(3.0, bounds=(0.5, 8))
    k = gb.Parameter(0.5, bounds=(-2, 2))

    def derivative(self, x, u, p):
        return (u.u - p.a * x.x + p.k * x.y, u.w - p.b * x.y + p.k * x.x)

    def output(self, x, u, p):
        return x.x, x.y


class Spring(gb.StateSpace):
    """m x'' = u - c x' - k x: fast where m is small."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    m = gb.Parameter(1.0, bounds=(0.01, 20), unit="kg")
    c = gb.Parameter(1.0, bounds=(0.01, 50), unit="N s/m")
    k = gb.Parameter(10.0, bounds=(0.1, 1000), unit="N/m")

    def derivative(self, x, u, p):
        return (x.v, (u.u - p.c * x.v - p.k * x.x) / p.m)

    def output(self, x, u, p):
        return (x.x,)


# A run from the second of them needs finer steps than the others.
SPRING_STARTS = [{"m": 1.0, "c": 1.0, "k": 10.0}, {"m": 0.1, "c": 20.0, "k": 500.0}]


def spring():
    random, time = np.random.default_rng(0), np.arange(300) * 0.05
    drive = {"u": np.repeat(random.choice([-5.0, 5.0], 30), 10)}
    held = gb.Record(time, drive, hold={"u": math.inf})
    x = gb.simulate(Spring(), {"m": 1.5, "c": 0.8, "k": 20.0}, record=held)["x"]
    signals = {**drive, "x": x + 0.002 * random.normal(size=300)}
    return gb.Problem(Spring(), gb.Record(time, signals, hold={"u": math.inf, "x": 0.0}))


def response(seed=0, **options):
    re, im = np.random.default_rng(seed).normal(size=(2, 12))
    exact = 2 / (1 + 0.3j * OMEGA)
    variance = np.abs(0.02 * exact) ** 2
    data = gb.FrequencyResponse(
        OMEGA, exact * (1 + 0.02 * (re + 1j * im)), input="u", output="y", variance=variance
    )
    return gb.Problem(SampledLag(), data, **options)


def pair(criterion, **options):
    """Return four responses; with a constraint, they share one solve."""
    random, data = np.random.default_rng(5), []
    for input, output in itertools.product(Pair.inputs, Pair.outputs):
        values = {"a": 2.5, "b": 3.5, "k": 0.7}
        exact = gb.frequency_response(Pair(), values, OMEGA, input=input, output=output).response
        noise = random.normal(size=12) + 1j * random.normal(size=12)
        variance = np.abs(0.02 * exact) ** 2
        measured = exact * (1 + 0.02 * noise)
        data.append(
            gb.FrequencyResponse(OMEGA, measured, input=input, output=output, variance=variance)
        )
    return gb.several(Pair(), data, criterion=criterion, **options)


RESPONSES = {
    "one": lambda criterion: response(criterion=criterion),
    "two": lambda criterion: response(criterion=criterion) + response(1, criterion=criterion),
    "many": lambda criterion: pair(criterion, constraints=[lambda p: 20 - p.a - p.b]),
}
LAG = {"samples": 16}
RECORDS = {
    "one": lambda criterion: gb.Problem(SampledLag(), lag_record(**LAG), criterion),
    "two": lambda criterion: sum_of(
        gb.Problem(SampledLag(), lag_record(seed, **LAG), criterion) for seed in range(2)
    ),
    "with a response": lambda criterion: (
        gb.Problem(SampledLag(), lag_record(**LAG), criterion)
        + response(criterion=gb.RelativeLikelihood())
    ),
}


def sum_of(problems):
    first, *others = problems
    return sum(others, first)


def spectrum(criterion):
    data = gb.spectral.transient_spectrum(lag_record(), "u", "y", (2.0, 30.0))
    return gb.Problem(SampledLag(), data, criterion)


# --- executors


class InTurn(Executor):
    """Several executors, which do one task after the other."""

    def __init__(self, executors):
        self.executors = itertools.cycle(executors)

    def submit(self, function, /, *arguments):
        return next(self.executors).submit(function, *arguments)


@pytest.fixture(scope="module")
def executors():
    """WorkerPool, a pool of Python's, and a cluster of Dask's on this machine: a process each."""
    found = {}
    with gb.solve.WorkerPool(1) as workers, ProcessPoolExecutor(1, get_context("spawn")) as pool:
        found |= {"WorkerPool": workers, "ProcessPoolExecutor": pool}
        if importlib.util.find_spec("distributed") is None:
            yield found
            return
        from distributed import Client, LocalCluster

        with (
            LocalCluster(1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as c,
            Client(c) as client,
        ):
            yield found | {"Dask": client.get_executor()}


SEEN = set()
TURN = itertools.count()


def require_alike(executors, nlp, count=2, *, search="batched", most=None):
    """Make the runs here and on the executor whose turn it is, and compare all numbers of their outcomes.

    With at `most` so many iterations, a run need not converge.
    """
    solver = solver_for(nlp, {"max_iter": most} if most else {}, search)
    rule = as_starts(count, 0)
    starts = rule.draw({name: nlp.problem.parameters[name] for name in nlp.free})
    task = pickle.dumps(solver), starts, os.getpid(), math.inf
    name = [*executors][next(TURN) % len(executors)]
    future = executors[name].submit(run_starts, *task)
    here = solver.outcomes(starts)
    SEEN.add(type(solver))
    assert most or any(outcome.converged for outcome in here)
    for outcome, twin in zip(here, future.result(), strict=True):
        assert (outcome.status, outcome.iterations) == (twin.status, twin.iterations), name
        assert (outcome.converged, outcome.stage) == (twin.converged, twin.stage), name
        assert_array_equal(outcome.cost, twin.cost, name)
        assert_array_equal(outcome.estimate, twin.estimate, name)
        assert_array_equal(outcome.signature, twin.signature, name)
        for nodes, others in zip(outcome.nodes or (), twin.nodes or (), strict=True):
            assert_array_equal(nodes, others, name)


# --- cases


@pytest.mark.parametrize("name", shipped("problems"))
def test_problems(executors, name):
    module = shipped_module("problems", name)
    nlp = compile_problem(module.problem(), module.settings.get("method"))
    if nlp.has_states:  # long records: a few steps have all digits that could differ
        require_alike(executors, nlp, 1, most=5)
    elif ResponseSolver.serves(nlp):
        for search in SEARCHES:
            require_alike(executors, nlp, search=search)
    else:  # whole runs of problems whose responses share one solve take too long
        require_alike(executors, nlp, 1, most=1)


@pytest.mark.parametrize(
    ("criterion", "search", "data"), by_pairs(CRITERIA, SEARCHES, [*RESPONSES])
)
def test_criteria_of_responses(executors, criterion, search, data):
    count = 8 if search == "batched" else 2  # fewer starts are not improved together
    require_alike(executors, compile_problem(RESPONSES[data](criterion)), count, search=search)


@pytest.mark.parametrize(
    ("criterion", "method", "data"),
    by_pairs([*TIME_CRITERIA, gb.OutputError(noise=OneBoard())], [*methods()], [*RECORDS]),
)
def test_criteria_and_methods_of_records(executors, criterion, method, data):
    # IPOPT takes long to build the derivatives of these problems, and a run need not end.
    count, most = (1, 5) if method.by_ipopt else (2, None)
    require_alike(executors, compile_problem(RECORDS[data](criterion), method), count, most=most)


@pytest.mark.parametrize("criterion", SPECTRUM_CRITERIA)
def test_criteria_of_manoeuvres(executors, criterion):
    require_alike(executors, compile_problem(spectrum(criterion)))


@pytest.mark.parametrize("data", ["response", "record", "manoeuvre"])
def test_a_solver_of_the_users(executors, data):
    problems = {
        "response": response(),
        "record": lag_problem(samples=16),
        "manoeuvre": spectrum(gb.OutputError()),
    }
    require_alike(executors, compile_problem(problems[data]), search=Slsqp())


def test_every_solver_had_a_case():
    missing = {*included(LocalSolver)} - SEEN
    assert not missing or len(SEEN) < 2  # a single test was chosen


def require_same(fit, other):
    assert len(fit.runs) == len(other.runs)
    for run, twin in zip(fit.runs, other.runs, strict=True):
        assert_array_equal(run.start, twin.start)
        assert_array_equal(run.estimate, twin.estimate)
        assert (run.status, run.cost, run.iterations) == (twin.status, twin.cost, twin.iterations)
    assert (fit.cost, fit.estimate) == (other.cost, other.estimate)
    assert fit.standard_error == other.standard_error


def test_a_start_that_needs_finer_steps(executors):
    starts = [SPRING_STARTS[0], *3 * SPRING_STARTS[1:]]

    def fit(executor=None):
        return gb.fit(spring(), starts, executor=executor, profiles=False, progress=False)

    alone = fit()
    assert {run.status for run in alone.runs} == {"converged"}
    require_same(fit(InTurn(executors.values())), alone)


@pytest.mark.parametrize("data", ["response", "record"])
def test_a_fit_its_study_and_its_bootstrap(tmp_path, executors, data):
    problem = response() if data == "response" else lag_problem(samples=30)
    pool = InTurn(executors.values())
    options = {"profiles": False, "progress": False, "search": "multistart"}
    alone, together = (gb.fit(problem, 4, executor=each, **options) for each in (None, pool))
    require_same(together, alone)

    members = [
        gb.study.Member(problem, 4, seed=k, name=str(k), search="multistart") for k in (0, 1)
    ]
    study = gb.batch(members, tmp_path, executor=pool, progress=False)
    require_same(study["0"].fit, alone)

    count = 130 if data == "response" else 4  # replicates of responses are made 128 at a time
    drawn = [
        gb.bootstrap(alone, count, problem=problem, executor=each, progress=False)
        for each in (None, pool)
    ]
    assert_array_equal(drawn[0].values, drawn[1].values)
    assert drawn[0].statuses == drawn[1].statuses


def test_the_runners_of_these_cases_are_all_that_there_are():
    """Solvers, replicates of records and of responses, and whole members of a study."""
    others = {runner.__name__ for runner in included(Runner)} - {
        solver.__name__ for solver in included(LocalSolver)
    }
    assert others == {"RecordReplicates", "ResponseReplicates", "_WholeMembers"}
