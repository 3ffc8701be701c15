"""What options say of single parameters, in every part that has them."""

from argparse import ArgumentParser

import numpy as np
import pytest

import greybox as gb
from greybox.cli.options import declare
from greybox.cli.problem_options import PROBLEM_OPTIONS
from greybox.workflows.study.stated_problem import with_parameter_options


class Lag(gb.TransferFunction):
    """K / (T s + 1), with a gain that is fixed."""

    K = gb.Parameter(1.0, bounds=(0, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5))
    c = gb.Parameter(1.0, bounds=(0, 2), fixed=True)

    def response(self, s, p):
        return p.c * p.K / (p.T * s + 1)


def problem(name, **options):
    omega = np.array([0.5, 1.0, 2.0])
    data = gb.FrequencyResponse(omega, 3 / (0.2j * omega + 1), variance=np.full(3, 0.01), name=name)
    return gb.Problem(Lag(), data, gb.MaximumLikelihood(), **options)


def stated(made, *words):
    parser = ArgumentParser()
    declare(parser, PROBLEM_OPTIONS)
    return with_parameter_options(made, vars(parser.parse_args(words)))


def test_every_option_reaches_the_parts_that_have_the_parameter():
    both = problem("a", rename={"K": "K_a"}, fixed={"T": 0.3}) + problem(
        "b", fixed={"T": 0.3}, bounds={"K": (0, 7)}
    )
    words = "--fix K_a=2 --free T c --bounds T=0.1:4 --start T=0.4".split()
    words += "--starts-box T=0.2:1 --prior c=1+-0.1".split()
    first, second = stated(both, *words).parts
    assert first.fixed_values == {"K": 2.0}
    assert second.fixed_values == {}
    assert [set(part.free) >= {"T", "c"} for part in (first, second)] == [True, True]
    for part in (first, second):
        assert part.parameters["T"].bounds == (0.1, 4.0)
        assert part.parameters["T"].start == 0.4
        assert part.parameters["T"].box == (0.2, 1.0)
        assert [*part.prior] == ["c"]
    assert second.parameters["K"].bounds == (0, 7)
    assert stated(both) is both


def test_names_that_are_not_there_and_an_earlier_fit_as_prior_are_told():
    with pytest.raises(ValueError, match="a has no parameter 'tau'; it has"):
        stated(problem("a"), "--fix", "tau=1")
    fit = gb.fit(problem("earlier"), starts=1, progress=False, profiles=False)
    known = problem("a", prior=fit)
    assert stated(known, "--fix", "c=2").fixed_values == {"c": 2.0}
    with pytest.raises(
        ValueError,
        match=r"prior=\.\.\. is for single parameters, and the prior of a is an earlier fit: leave it",
    ):
        stated(known, "--prior", "K=3+-0.1")
