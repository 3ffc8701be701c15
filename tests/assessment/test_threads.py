"""Fits in several threads at once are the same as one after the other."""

import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor

from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from sampled_lag import lag_problem
from threadpoolctl import threadpool_info, threadpool_limits

import greybox as gb

RESPONSE = gb.Problem(
    LagLagDelay(), measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)
)


RECORDS = [lag_problem(seed, samples=80) for seed in range(2)]


def fitted(problem):
    fit = gb.fit(problem, starts=1, profiles=False, progress=False)
    return fit.cost, fit.estimate, fit.standard_error, [run.cost for run in fit.runs]


def test_fits_of_records_and_of_responses_in_four_threads():
    problems = [*RECORDS, RESPONSE]
    one_by_one = [fitted(problem) for problem in problems]
    with ThreadPoolExecutor(4) as threads:
        at_once = list(threads.map(fitted, problems))
    assert at_once == one_by_one


def test_fits_in_threads_leave_the_process_alive():
    script = textwrap.dedent(
        """
        from concurrent.futures import ThreadPoolExecutor
        import greybox as gb
        from greybox.problems import rotors

        problem = rotors.problem()
        with ThreadPoolExecutor(4) as threads:
            fits = list(threads.map(lambda _: gb.fit(problem, starts=1, progress=False), range(4)))
        print(len({fit.cost for fit in fits}))
        """
    )  # in a process of its own, which a crash of CasADi would end
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "1\n"


def test_matrix_products_have_one_thread_while_a_problem_is_fitted():
    seen = []

    def threads(*_):
        return {library["filepath"]: library["num_threads"] for library in threadpool_info()}

    with threadpool_limits(2, "blas"):
        before = threads()
        gb.fit(RECORDS[0], starts=2, progress=lambda *_: seen.append(threads()))
        assert max(before.values()) == 2
        assert before.items() <= threads().items()
    assert all(max(numbers.values()) == 1 for numbers in seen)
