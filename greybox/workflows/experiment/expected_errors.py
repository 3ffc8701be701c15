"""The standard errors that a test would give, before it is flown."""

from collections.abc import Mapping

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.covariance.accuracy import propagate
from greybox.engine.covariance.covariance import accuracy_at
from greybox.engine.solve.search_method import solver_for
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.sum import Sum
from greybox.modeling.model import require_known


@public
@frozen
class ExpectedErrors:
    """The standard errors that a test would give; printed, they are a table.

    Attributes
    ----------
    values : mapping of name to float
        Parameter values at which they were evaluated.
    standard_error : mapping of name to float
        Standard errors of the free parameters; NaN if the test would not determine it.
    information : (p, p) array
        Fisher information, in the order of `standard_error`: the inverse of the covariance, zero in
        directions that the test would not determine.
    undetermined : tuple of str
        Parameters in combinations that the test would hardly determine.
    units : mapping of name to str
    """

    values: Values
    standard_error: Values
    information: Array
    undetermined: tuple[str, ...]
    units: Mapping[str, str]

    def __str__(self) -> str:
        rows = [
            (
                name,
                f"{value:.4g}",
                f"± {error:.2g}",
                self.units[name],
                f"{100 * error / abs(value):.2g} %" if value and np.isfinite(error) else "",
            )
            for (name, error), value in zip(
                self.standard_error.items(), self.values.values(), strict=True
            )
        ]
        table = text_table(("", "value", "", "unit", "percent"), rows)
        lines = ["Standard errors that this test would give", "", table]
        if self.undetermined:
            lines += ["", f"The test would hardly separate {', '.join(self.undetermined)}."]
        return "\n".join(lines)


@public
def expected_errors(problem: Problem | Sum, values: Values) -> ExpectedErrors:
    """Return the standard errors that a fit of this problem would have if these were its estimates.

    They follow from the Fisher information as those of a fit do, with the noise of the residuals at
    `values`, but nothing is solved. Fly the test by `greybox.virtual_flight`, with the vehicle's
    controller, noise and wind, and state the problem as for a flown record.

    Parameters
    ----------
    problem : Problem or sum of problems
        Its data may be records of virtual flights, or responses with expected variances.
    values : mapping of name to float
        Rough estimates of the parameters; by default their declared starts.

    Raises
    ------
    ValueError
        If a name is not a parameter of the problem.
    """
    require_known(values, problem.parameters, "parameter", problem.name)
    nlp = compile_problem(problem)
    at = {name: float(values.get(name, nlp.problem.parameters[name].start)) for name in nlp.free}
    x = np.array(list(at.values()))
    accuracy = accuracy_at(nlp, x, solver_for(nlp).profile(x).trajectories)
    count = len(nlp.free)
    covariance = accuracy.covariance[:count, :count]
    scale = np.outer(accuracy.size[:count], accuracy.size[:count])
    # Below this share of the largest variance, in units that the data notice, is rounding.
    information = np.linalg.pinv(covariance / scale, rcond=1e-13, hermitian=True) / scale
    errors = propagate(accuracy, np.eye(count, len(nlp.names)))
    undetermined = unique(name for c in accuracy.combinations for name in c.names)
    units = {name: nlp.problem.parameters[name].unit for name in nlp.free}
    return ExpectedErrors(
        at, dict(zip(nlp.free, errors.tolist(), strict=True)), information, undetermined, units
    )
