"""What travels to another process: compiled functions, without the user's classes."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.search_method import solver_for

TIME = np.arange(200) * 0.02
INPUT = np.sign(np.sin(2 * TIME))


def drawn(process_noise):
    rng = np.random.default_rng(3)
    y = [0.0]
    for k in range(len(TIME) - 1):
        y.append(y[-1] + 0.02 * (2.0 * INPUT[k] - y[-1]) / 0.3 + process_noise * rng.normal())
    return gb.Record(TIME, {"u": INPUT, "y": y + 0.01 * rng.normal(size=len(TIME))})


def lag():
    class Local(gb.StateSpace):  # not importable, and so not picklable
        states, inputs, outputs = ("y",), ("u",), ("y",)
        K = gb.Parameter(1.0, bounds=(0.1, 10))
        T = gb.Parameter(1.0, bounds=(0.01, 10))

        def derivative(self, x, u, p):
            return ((p.K * u.u - x.y) / p.T,)

        def output(self, x, u, p):
            return (x.y,)

    return Local()


OMEGA = np.geomspace(0.3, 30, 12)
RESPONSE = gb.FrequencyResponse(
    OMEGA, 2.1 / (1 + 0.31j * OMEGA) * (1 + 0.01j), input="u", output="y"
)
PROBLEMS = {
    "response": lambda: gb.Problem(lag(), RESPONSE, constraints=[lambda p: p.K - p.T]),
    "record": lambda: gb.Problem(
        lag(), drawn(0.0), gb.OutputError(initial={"y": lambda p: 0 * p.K})
    ),
    "predictor": lambda: gb.Problem(lag(), drawn(0.02), gb.PredictionError()),
    "both": lambda: gb.Problem(lag(), drawn(0.0)) + gb.Problem(lag(), RESPONSE),
}


OWN, IPOPT = gb.MultipleShooting(), gb.SingleShooting()


@pytest.mark.parametrize(
    ("which", "method"), [*((which, OWN) for which in PROBLEMS), ("record", IPOPT), ("both", IPOPT)]
)
def test_a_compiled_problem_solves_alike_where_the_model_is_not_known(which, method):
    nlp = compile_problem(PROBLEMS[which](), method)
    with pytest.raises(TypeError, match="cannot be imported by its name"):
        pickle.dumps(nlp.problem)
    sent = pickle.loads(pickle.dumps(nlp))
    for compiled in (sent, *sent.parts):
        with pytest.raises(
            RuntimeError, match="name is needed of a value that stayed where it was"
        ):
            _ = compiled.problem.name
    start = np.clip([3.0, 0.5, *[0.1] * (len(nlp.free) - 2)], nlp.lower, nlp.upper)
    here, there = (solver_for(each).run(start) for each in (nlp, sent))
    assert here.converged
    assert (here.status, here.iterations) == (there.status, there.iterations)
    assert_array_equal(here.estimate, there.estimate)


@pytest.mark.parametrize("which", ["record", "predictor"])
def test_finer_steps_and_excerpts_of_a_record_are_made_there_too(which):
    nlp = compile_problem(PROBLEMS[which]())
    sent = pickle.loads(pickle.dumps(nlp))
    start = np.clip([3.0, 0.5, *[0.1] * (len(nlp.free) - 2)], nlp.lower, nlp.upper)
    for changed in (
        lambda each: each.refined(2),
        lambda each: replace(each, parts=tuple(part.excerpt(120) for part in each.parts)),
    ):
        here, there = (solver_for(changed(each)).run(start) for each in (nlp, sent))
        assert here.converged
        assert_array_equal(here.estimate, there.estimate)
