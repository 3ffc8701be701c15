"""The limits of a run of the record solver, which `solver_options` set by the names of IPOPT."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Settings:
    """Limits of a run.

    `benchmarks/ablation.py` measures on 29 hard problems what they contribute; the kept output is
    `benchmarks/results/ablation.txt` (20 November 2026, one seed, for some problems two: 156 to 209
    runs). It also has the strategies that can no longer be switched off, whose contributions stand
    beside their code. The numbers inside the solver's files were varied there as well, to about a
    tenth and ten times, without a significant change of the success rate.

    Attributes
    ----------
    max_iter : int
        With 10 iterations 48 % of runs end at the best minimum instead of 72 %; with 1000 it is
        81 %, in three times the time.
    tol : float
        Tolerance on half the squared length of a step in standard errors, and on the decrease of
        the cost.
    """

    max_iter: int = 100
    tol: float = 1e-8


USUAL = Settings()


def settings(options: Mapping[str, Any]) -> Settings:
    """Return the settings with these options.

    Raises
    ------
    ValueError
        For an option that only IPOPT has, or a value that is not valid.
    """
    for name, value in options.items():
        if name not in ("max_iter", "tol"):
            raise ValueError(
                f"solver_options {name!r} is not an option of the Gauss-Newton solver: give "
                "max_iter or tol, or solve by IPOPT, method=MultipleShooting(ipopt=True)."
            )
        if not isinstance(value, int if name == "max_iter" else int | float) or not value > 0:
            kind = "a whole number of iterations" if name == "max_iter" else "a number above 0"
            raise ValueError(f"solver_options {name!r} is {value!r}: give {kind}.")

    return Settings(**options)
