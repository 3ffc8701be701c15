"""The command `greybox bootstrap`: errors and intervals of a saved fit from resampled data."""

import argparse
from typing import Any

from greybox.cli.output import Answer
from greybox.cli.saved_fits import stated_fit
from greybox.cli.workers import stated_executor
from greybox.workflows.study.bootstrap import bootstrap

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 --replicates 400 --out replicates --workers 2",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = """
result RESULT
    a fit that greybox fit --out wrote
--problem
--model
--replicates N
    number of fits (default: 1000)
--seed K
    seed of the random draws (default: 0)
--level
--out DIR
    store the replicates in this folder; the same command continues there
--trust
--workers
--scheduler
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and repeat it."""
    # Before the fit is read: a wrong folder should not cost the time of compiling.
    fit, problem = stated_fit(options)
    trust: dict[str, Any] = {"trust": True} if options.trust else {}
    try:
        with stated_executor(options) as executor:
            result = bootstrap(
                fit,
                options.replicates,
                problem=problem,
                seed=options.seed,
                executor=executor,
                folder=options.out,
                **trust,
            )
    # Replicates in a folder survive Ctrl-C; without a folder all of them are lost.
    except KeyboardInterrupt:
        resume = "" if options.out is None else f"; the same command continues in {options.out}"
        return ({"error": f"interrupted{resume}."},)

    answer = result.summary(options.level)
    if result.failed > len(result.values) - 2:  # fewer than two values have no spread
        answer["error"] = result.warnings[0]
    return answer, result.text(options.level)
