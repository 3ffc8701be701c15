"""Runs that meet on excerpts of a record, and runs alone: how many end at the best minimum.

``python benchmarks/shared_runs.py --starts 12 --out benchmarks/results/shared_runs.txt`` runs both
from the same Sobol points of the problems of `ablation.py` of 300 samples and more, predictors left
out. Excerpts are asked for whatever the length, so that most of these records are far shorter than
those whose starts share runs by default: a hard case. Times are of the processor.
"""

import argparse
import time
import warnings
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from ablation import CASES  # which has one thread

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.shared_runs import SharedRuns

FEWEST = 300  # samples: excerpts of less are a few segments
ITERATIONS = 60  # of a run, so that those that fail take no longer than all others together


def ended(runner, starts):
    """Return the costs of converged runs, and the seconds that all took."""
    began = time.process_time()
    outcomes = [runner.run(start) for start in starts]
    costs = np.array([outcome.cost if outcome.converged else np.inf for outcome in outcomes])
    return costs, time.process_time() - began


def main():
    """Compare all problems."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=12)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    lines = [
        f"shared_runs.py, greybox {version('greybox-id')}, {time.strftime('%Y-%m-%d')}, "
        f"{options.starts} starts: runs",
        "at the best minimum, alone and shared; processor time; ends on excerpts from which runs "
        "went on",
    ]
    total = np.zeros(3, dtype=int)
    for name, case in CASES.items():
        problem = case.make()
        nlp = compile_problem(problem)
        samples = sum(part.samples for part in nlp.parts)
        settings = replace(
            nlp.method.strategies, short_record=samples - 1, max_iterations=ITERATIONS
        )
        solver = GaussNewton(nlp, settings=settings)
        shared = SharedRuns.of(solver) if samples >= FEWEST else None
        if shared is None:
            continue
        starts = gb.solve.Sobol(options.starts, 1).draw(
            {own: problem.parameters[own] for own in nlp.free}
        )
        (alone, seconds), (costs, shorter) = ended(solver, starts), ended(shared, starts)
        found = [int(np.sum(each <= case.best + case.within)) for each in (alone, costs)]
        total += [len(starts), *found]
        lines.append(
            f"{name:<28}{samples:6d} samples  {found[0]:3d} {found[1]:3d}  {seconds:6.2f} s "
            f"{shorter:6.2f} s  "
            f"{len(shared._known[0])}"
        )
        print(lines[-1], flush=True)
    lines.append(
        f"of {total[0]} runs {total[1]} alone and {total[2]} shared end at the best minimum"
    )
    print("\n".join([lines[0], lines[-1]]))
    if options.out is not None:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
