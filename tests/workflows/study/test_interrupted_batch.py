"""Ctrl-C and SIGTERM in a batch and in a fit, at every stage of every kind of member.

A signal comes at a call of a function of Python: from the first tenth of all calls of an
uninterrupted batch to the last one, so that no clock decides.
"""

import os
import signal
from importlib import import_module

import numpy as np
import pytest
from nth_call import at_call
from numpy.testing import assert_array_equal
from sampled_lag import SampledLag, lag_problem

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.search_method import solver_for
from greybox.engine.solve.shared_solver import SharedSolver
from greybox.workflows.study.stored_runs import StoredRuns

pytestmark = pytest.mark.usefixtures("unjudged_file")

OMEGA = np.geomspace(0.3, 30, 12)


class Coupled(gb.StateSpace):
    """Six states, two inputs and two outputs."""

    states, inputs, outputs = tuple("abcdef"), ("u", "w"), ("a", "b")
    p1 = gb.Parameter(2.0, bounds=(0.5, 8))
    p2 = gb.Parameter(3.0, bounds=(0.5, 8))
    k = gb.Parameter(0.5, bounds=(-2, 2))

    def derivative(self, x, u, p):
        return (
            x.c - p.p1 * x.a + p.k * x.b,
            x.d - p.p2 * x.b + p.k * x.a,
            x.e - 4 * x.c,
            x.f - 5 * x.d,
            u.u - 6 * x.e,
            u.w - 7 * x.f,
        )

    def output(self, x, u, p):
        return x.a, x.b


def noisy(response, seed):
    re, im = np.random.default_rng(seed).normal(size=(2, len(response)))
    return response * (1 + 0.02 * (re + 1j * im))


def lag_response(seed=0):
    data = noisy(2.1 / (1 + 0.31j * OMEGA), seed)
    return gb.FrequencyResponse(OMEGA, data, input="u", output="y")


def coupled():
    truth = {"p1": 2.5, "p2": 3.5, "k": 0.7}
    responses = []
    for input, output in [(i, o) for i in Coupled.inputs for o in Coupled.outputs]:
        exact = gb.frequency_response(Coupled(), truth, OMEGA, input=input, output=output)
        data = noisy(exact.response, len(responses))
        responses.append(gb.FrequencyResponse(OMEGA, data, input=input, output=output))
    # With a constraint, no batch of expressions: the responses share one solve.
    return gb.several(Coupled(), responses, constraints=[lambda p: 20 - p.p1 - p.p2])


RESPONSE = gb.Problem(SampledLag(), lag_response())
LIKELIHOOD = gb.Problem(SampledLag(), lag_response(1), criterion=gb.RelativeLikelihood())
RECORD = lag_problem(samples=20)
KINDS = {
    "response": gb.study.Member(RESPONSE, 8),
    "response by IPOPT": gb.study.Member(RESPONSE, 3, search="multistart"),
    "two responses": gb.study.Member(RESPONSE + gb.Problem(SampledLag(), lag_response(2)), 4),
    "many responses": gb.study.Member(coupled(), 3),
    "record": gb.study.Member(RECORD, 2),
    "record by IPOPT": gb.study.Member(RECORD, 2, method=gb.Collocation()),
    "record and response": gb.study.Member(RECORD + LIKELIHOOD, 2),
}
SIGNALS = signal.SIGINT, signal.SIGTERM
SHARES = 0.03, 0.4, 0.7, 0.97


def batch(member, folder, executor=None):
    return gb.batch([member], folder, executor=executor, progress=False)


def send(number):
    return lambda: os.kill(os.getpid(), number)


def require_same(fit, other):
    for run, twin in zip(fit.runs, other.runs, strict=True):
        assert_array_equal(run.estimate, twin.estimate)
        assert (run.status, run.cost) == (twin.status, twin.cost)
    assert (fit.estimate, fit.standard_error) == (other.estimate, other.standard_error)


def test_one_of_the_kinds_shares_one_solve():
    assert isinstance(solver_for(compile_problem(KINDS["many responses"].problem)), SharedSolver)


@pytest.mark.usefixtures("press_ctrl_c")  # whose handler is then Python's
@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_raises_and_resumes_whenever_the_signal_comes(tmp_path, kind):
    member = KINDS[kind]
    batch(member, tmp_path / "first")  # what is built once in a process
    with at_call(0, None) as calls:
        [expected] = batch(member, tmp_path / "whole").members
    for k, share in enumerate(SHARES):
        folder = tmp_path / str(k)
        at = at_call(int(share * calls[0]), send(SIGNALS[k % 2]))
        with pytest.raises(KeyboardInterrupt) as stopped, at:
            batch(member, folder)
        study = stopped.value.study
        [status] = [m.status for m in study.members] if study else ["unfinished"]
        assert status == "unfinished" or share > 0.9  # the answer was stored already
        if share == 0.7:  # one is enough
            require_same(batch(member, folder)[member.name].fit, expected.fit)


@pytest.mark.usefixtures("press_ctrl_c")
@pytest.mark.parametrize("kind", ["response", "record", "many responses"])
def test_a_fit_raises_whenever_the_signal_comes(kind):
    member = KINDS[kind]

    def fit():
        return gb.fit(member.problem, member.starts, profiles=False, progress=False)

    with at_call(0, None) as calls:
        whole = fit()
    for k, share in enumerate(SHARES):
        at = at_call(int(share * calls[0]), send(SIGNALS[k % 2]))
        with pytest.raises(KeyboardInterrupt) as stopped, at:
            fit()
        partial = stopped.value.fit
        assert partial is None or len(partial.runs) <= len(whole.runs)
    assert partial.estimate == whole.estimate  # the last signal came while the fit was judged


def test_a_batch_on_workers_raises_and_resumes(tmp_path, monkeypatch, press_ctrl_c):
    # A small member would be fitted as a whole: its workers share the runs of a large one.
    monkeypatch.setattr(import_module("greybox.workflows.study.batch"), "UNWRITTEN", 1e-9)
    member, made = gb.study.Member(RESPONSE, 6, search="multistart"), []
    add = StoredRuns.add

    def noted(self, number, *others):
        add(self, number, *others)
        if type(self) is StoredRuns:  # not of the whole member, which took too long
            made.append(number)
            if len(made) == 3:
                press_ctrl_c()

    monkeypatch.setattr(StoredRuns, "add", noted)
    with gb.solve.WorkerPool(1) as workers:
        with pytest.raises(KeyboardInterrupt) as stopped:
            batch(member, tmp_path / "study", workers)
        assert [m.status for m in stopped.value.study.members] == ["unfinished"]
        [again] = batch(member, tmp_path / "study", workers).members
    assert sorted(made) == [*range(6)]  # none twice
    [expected] = batch(member, tmp_path / "whole").members
    require_same(again.fit, expected.fit)


@pytest.mark.usefixtures("press_ctrl_c")
def test_the_members_behind_the_interrupted_one_are_unfinished_too(tmp_path):
    members = [
        gb.study.Member(KINDS[kind].problem, 2, name=kind) for kind in ("response", "record")
    ]
    with at_call(0, None) as calls:
        gb.batch(members[:1], tmp_path / "one", progress=False)
    with pytest.raises(KeyboardInterrupt) as stopped, at_call(calls[0] // 3, send(signal.SIGINT)):
        gb.batch(members, tmp_path / "two", progress=False)
    assert [m.status for m in stopped.value.study.members] == ["unfinished", "unfinished"]
