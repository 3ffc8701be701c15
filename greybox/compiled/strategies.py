"""The settings of the record solver: the numbers of a run, and what follows the starts."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Strategies:
    """Limits of a run of the solver for records, e.g. `Strategies(max_iterations=1000)`.

    `benchmarks/ablation.py` measures on 29 hard problems what each setting contributes; the kept
    output is `benchmarks/results/ablation.txt` (20 November 2026, one seed, for some problems two:
    156 to 209 runs). It also has the strategies that can no longer be switched off, whose
    contributions stand beside their code. The numbers inside the solver's files were varied there
    as well, to about a tenth and ten times, without a significant change of the success rate.
    """

    continued_runs: bool = True
    """An unfinished run at a lower cost than the best so far is continued from its last iterate.

    Bennett5 is found only with it.
    """

    max_iterations: int = 100
    """Iterations of a run.

    With 10 of them 48 % of runs end at the best minimum instead of 72 %; with 1000 it is 81 %, in
    three times the time.
    """
    tolerance: float = 1e-8
    """Of half the squared length of a step in standard errors, and of the decrease of the cost."""


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
