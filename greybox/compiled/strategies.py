"""The settings of the record solver: strategies that can be switched off, and a few numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Strategies:
    """What the solver for records does beyond plain Gauss-Newton steps, and the numbers of a run.

    `MultipleShooting(strategies=Strategies(second_order_correction=False))` switches one off.
    `benchmarks/ablation.py` measures on 29 hard problems what each contributes; the kept output is
    `benchmarks/results/ablation.txt` (20 November 2026, one seed, for some problems two: 156 to 209
    runs). It also has the strategies that can no longer be switched off, whose contributions stand
    beside their code. The numbers inside the solver's files were varied there as well, to about a
    tenth and ten times, without a significant change of the success.
    """

    # --- before the first iteration

    screened_starts: bool = True
    """Only promising default starts are run, from where short-segment prediction errors lead.

    Of 17 fits from the default starts ten take 1.5 to 8 times as long without it, and four of
    NIST's regressions more than 40 s; MGH17 takes half as long.
    """
    shared_runs: bool = True
    """All but the first of many starts are solved on excerpts; those that meet there merge.

    20 starts on 6000 samples take a third of their time. Of 180 runs on 15 problems, most of them
    far below `short_record`, 124 end at the best minimum with it and 106 without
    (`benchmarks/shared_runs.py`).
    """

    # --- within an iteration

    states_first: bool = True
    """The first iterations move the node states alone, at held parameters.

    The overflow is found only with it; elsewhere as many runs are won as lost.
    """
    continuity_homotopy: bool = True
    """Continuity is a quadratic penalty, whose weight grows until it is an exact constraint.

    70 % of runs end at the best minimum with it, 62 % without; Lorenz 6 of 6 instead of none.
    """
    second_order_correction: bool = True
    """Gaps left by curvature are closed before a step is judged (Maratos effect).

    Mixed: tanks, stiff and guarded tanks lose 4 runs without it, the tanh chain is solved without
    it.
    """

    # --- around the starts

    continued_runs: bool = True
    """An unfinished run at a lower cost than the best so far is continued from its last iterate.

    Bennett5 is found only with it.
    """

    # --- numbers

    max_iterations: int = 100
    """Iterations of a run.

    With 10 of them 48 % of runs end at the best minimum instead of 72 %; with 1000 it is 81 %, in
    three times the time.
    """
    tolerance: float = 1e-8
    """Of half the squared length of a step in standard errors, and of the decrease of the cost."""
    assumed_error: float = 0.1
    """Output error while continuity is a penalty, as a share of a signal's standard deviation."""
    long_record: int = 20000
    """Twice the samples of the longest excerpt on which runs from many starts are made."""
    short_record: int = 2000
    """Samples up to which runs from many starts are made on whole records, each by itself."""
    negligible_shift: float = 0.1
    """Shift of an estimate by twice the substeps, in standard errors, that is accepted."""


def with_options(settings: Strategies, options: Mapping[str, Any]) -> Strategies:
    """Return the settings with `max_iter` and `tol`, as IPOPT calls them.

    Raises
    ------
    ValueError
        For an option that only IPOPT has, or a value that is not valid.
    """
    names = {"max_iter": "max_iterations", "tol": "tolerance"}
    for name, value in options.items():
        if name not in names:
            raise ValueError(
                f"solver_options {name!r} is not an option of the Gauss-Newton solver: give "
                "max_iter or tol, or solve by IPOPT, method=MultipleShooting(ipopt=True)."
            )
        if not isinstance(value, int if name == "max_iter" else int | float) or not value > 0:
            kind = "a whole number of iterations" if name == "max_iter" else "a number above 0"
            raise ValueError(f"solver_options {name!r} is {value!r}: give {kind}.")

    return replace(settings, **{names[name]: value for name, value in options.items()})
