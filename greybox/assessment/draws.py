"""Parameter sets from the distribution of an estimate, for simulators and predictions.

Begin with `draws`.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from string import Template

import numpy as np

from greybox.assessment.fitted_problem import compiled_again
from greybox.assessment.result import Fit, require_fit
from greybox.data.files.argument_checks import require_whole
from greybox.data.files.arrays import Array, positive_or_one, real_root
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.safe_files import write_text
from greybox.data.files.spelling import alternatives
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, some
from greybox.data.pandas_frames import Frame, frame_of
from greybox.engine.solve.objective import objective_near
from greybox.modeling.formula_arguments import Names
from greybox.modeling.formulation.starts import sobol_shares
from greybox.modeling.parameter import lower_and_upper

# Largest factor by which a step is lengthened: for a lag with an error of half its value, the upper
# error is larger by this factor.
LONGEST = 4.0


@public
@frozen
class Draws(Printed):
    """Parameter sets from the distribution of an estimate, made by `draws`; they print themselves.

    ``draws[0]`` is the first set, by name, and ``gb.simulate(model, draws[0], record)`` runs it.

    Attributes
    ----------
    name : str
        Name of the problem.
    names : tuple of str
        Free, fixed and tied parameters, as `Fit.names`.
    columns : mapping of name to (n,) array
        Parameters in the units of the fit, then derived quantities of the models.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> draws = gb.draws(gb.fit(pitch_hover.problem(), starts=5), 50)
    >>> sorted(draws[0]) == sorted(draws.names)
    True
    """

    name: str
    names: tuple[str, ...]
    columns: dict[str, Array]

    def __len__(self) -> int:
        return len(self.columns[self.names[0]])

    def __getitem__(self, row: int) -> dict[str, float]:
        return {name: float(self.columns[name][row]) for name in self.names}

    def to_pandas(self) -> Frame:
        """Return a row for every set and a column for every quantity as a pandas data frame."""
        return frame_of(self.columns, range(len(self)), "draw", {"name": self.name})

    def write(self, template: str | Path, folder: str | Path) -> list[Path]:
        """Write a parameter file for every set, from a file of the simulator as the template.

        The template is any text file (XML, JSON, Python, parameters) with ``$name`` or ``${name}``
        in place of a value, and ``$$`` for a dollar sign. The template quad.xml makes quad_000.xml,
        quad_001.xml ... in `folder`.

        Raises
        ------
        ValueError
            If the template names a quantity that the draws do not have, or names none.
        OSError
            If the template cannot be read, or a file not be written.
        """
        source = Path(template)
        text = Template(source.read_text(encoding="utf-8"))
        fields = text.get_identifiers()
        missing = [name for name in fields if name not in self.columns]
        if missing or not fields:
            what = f"names {some(missing)}" if missing else "has no $name in it"
            raise ValueError(
                f"the template {source} {what}: the draws have "
                f"{alternatives(missing[0] if missing else '', self.columns)}"
            )

        Path(folder).mkdir(parents=True, exist_ok=True)
        paths = []
        for row in range(len(self)):
            paths.append(Path(folder) / f"{source.stem}_{row:03d}{source.suffix}")
            numbers = {name: repr(float(self.columns[name][row])) for name in fields}
            write_text(paths[-1], text.substitute(numbers))
        return paths

    def __str__(self) -> str:
        rows = []
        for name, column in self.columns.items():
            quantiles = np.quantile(column, (0.5, 0.025, 0.975))
            rows.append((name, *(number(value, 4) for value in quantiles)))
        table = text_table(("", "median", "2.5 %", "97.5 %"), rows)
        return f"{counted(len(self), 'draw')} from the fit {self.name!r}\n\n{table}"


@public
def draws(fit: Fit, count: int = 200, seed: int = 0) -> Draws:
    """Draw parameter sets from the distribution of an estimate.

    The spread of predictions with them is the uncertainty that the fit leaves. The draws have the
    covariance of the estimate, the tails of Student's t, and stay within the bounds, but may pass
    constraints. Along every draw the distance follows the likelihood, as a profile does, if the
    problem can be compiled again (without priors, ties, constraints and values of earlier fits).
    Noise of sensors and gusts are not included.

    Parameters
    ----------
    fit : Fit
    count : int
        Number of sets; 200 give a 95 % range to a tenth of its width.
    seed : int

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, its data do not determine a parameter, or for
        less than one set.
    LookupError
        If a loaded fit does not know its model, whose derived quantities are needed.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> draws = gb.draws(fit, 100)
    >>> len(draws), draws[0]["T_delay"]
    (100, 0.0042)
    >>> draws.to_pandas().shape
    (100, 8)
    """
    require_fit(fit)
    require_whole("count", count, 1)
    require_whole("seed", seed, 0)
    if fit.known_directions(fit.names).unseen.size:
        unknown = [q.name for q in fit.quantities if math.isnan(q.standard_error)]
        raise ValueError(
            f"the data of {fit.name!r} do not determine {some(unknown)}, so that draws would "
            "have no end: fix parameters, or estimate the combination that is determined."
        )

    columns = dict(zip(fit.names, drawn_values(fit, count, fit.names, seed).T, strict=True))
    # A model is needed only for derived quantities.
    parts = fit.parts if fit.derived else ()
    for k, part in enumerate(parts):
        model = fit.model_of(k)
        parameters = Names({name: columns[part.outside(name)] for name in model.parameters})
        for name in fit.derived.keys() & model.derived.keys() - columns.keys():
            columns[name] = np.broadcast_to(model.derived[name](parameters), count)
    return Draws(fit.name, fit.names, columns)


def drawn_values(fit: Fit, count: int, names: Sequence[str], seed: int = 0) -> Array:
    """Return draws (count, k) from the distribution of the parameters, in the order of `Fit.names`.

    Their tails are those of the fewest degrees of freedom among `names`.
    """
    from scipy.special import chdtri, ndtri  # noqa: PLC0415  (takes a tenth of a second to import)

    # The cost depends on every parameter of the fit, also on those of its other parts.
    known = fit.known_directions(fit.names)
    quantities = [fit.by_name[name] for name in fit.names]
    variances, axes = np.linalg.eigh(known.covariance)
    root = axes * real_root(variances)
    # Rounding gives a parameter at its bound, which has no variance, a share of the others.
    root[np.diag(known.covariance) == 0] = 0
    dof = fit.fewest_degrees(names)

    # The last share is that of the chi-square variable in Student's t.
    shares = np.clip(sobol_shares(count, len(quantities) + 1, seed), 1e-9, 1 - 1e-9)
    normal = ndtri(shares[:, :-1]) @ root.T
    widening = np.sqrt(dof / chdtri(dof, shares[:, -1])) if math.isfinite(dof) else np.ones(count)
    steps = normal * widening[:, None] - np.array([quantity.bias for quantity in quantities])
    limits = lower_and_upper(quantities)

    def drawn(steps: Array) -> Array:
        return _within(limits, known.at + steps, known.covariance)

    return drawn(_by_likelihood(fit, steps, drawn))


def _by_likelihood(fit: Fit, steps: Array, drawn: Callable[[Array], Array]) -> Array:
    """Return steps (draws, k) from the estimate, lengthened or shortened to their likelihood.

    At the end of a changed step, the cost has risen as much as the standard errors predict for the
    original step. Along one parameter, the draws then follow its profile, also where errors are not
    symmetric, or a pole cannot pass zero. Fits whose problem cannot be compiled again keep their
    steps. `drawn` returns the values (m, k) at steps (m, k).
    """
    if fit.white is None:
        return steps
    try:
        problem = compiled_again(fit)
    except (ValueError, LookupError):
        return steps

    p = len(fit.free)
    # The size is one for a parameter on which the data contain no information.
    size = positive_or_one(np.sqrt(np.diag(fit.white)))
    variances, axes = np.linalg.eigh(fit.white / np.outer(size, size))
    is_determined = variances > 1e-12 * variances.max()
    scale = np.sqrt(variances[is_determined])
    axes = axes[:, is_determined]
    # The square of a step in these coordinates is twice the rise of a quadratic cost.
    coordinates = steps[:, :p] / size @ axes / scale
    predicted = np.sum(coordinates**2, axis=1) / 2

    has_records = len(fit.responses) < len(fit.parts)
    estimate = drawn(np.zeros((1, steps.shape[1])))[0, :p]
    objective = objective_near(problem, estimate)

    def costs(steps: Array) -> Array:
        values = objective.value(drawn(steps)[:, :p])
        return np.where(np.isfinite(values), values, math.nan)

    lowest = costs(np.zeros((1, steps.shape[1])))

    def ratio(steps: Array, predicted: Array) -> Array:
        """Return the root of the ratio of the true rise of the cost to the predicted one."""
        # A model without a finite response is very unlikely: its rise counts as large. For a
        # record, where no predictor is stable, only the standard error is known.
        rise = np.nan_to_num((costs(steps) - lowest) / predicted, nan=1.0 if has_records else 1e6)
        return real_root(rise)

    if not has_records:
        return _roots(ratio, steps, predicted)[:, None] * steps

    # Costs of records take simulations. Therefore only the points at two standard errors along
    # every axis, in both directions, are evaluated.
    length = 2 * np.sqrt(np.mean(coordinates**2, axis=0))
    ends = np.zeros((2 * len(length), steps.shape[1]))
    ends[:, :p] = np.kron([[1], [-1]], (size[:, None] * axes * scale * length).T)
    expected = np.tile(length**2 / 2, 2)
    rates = ratio(ends, expected)
    # Where the ratio differs much from one, the cost is not a parabola, not even an asymmetric one.
    is_irregular = np.abs(rates - 1) > 1 / 3
    factors = _roots(ratio, ends[is_irregular], expected[is_irregular])
    rates[is_irregular] = 1 / np.maximum(factors, 1 / LONGEST)
    upward, downward = rates.reshape(2, -1)
    rate = np.where(coordinates > 0, upward, downward)
    # Each axis is changed by itself: one of many parameters, such as a gain at its stability limit,
    # may hardly be free to move, and should not shorten the steps of the others.
    change = (coordinates / rate - coordinates) * scale @ axes.T * size
    return steps + change @ np.eye(p, steps.shape[1])


def _roots(ratio: Callable[[Array, Array], Array], steps: Array, predicted: Array) -> Array:
    """Return the factors of steps (n, k) at which `ratio` is one."""
    from scipy.optimize import elementwise  # noqa: PLC0415  (takes a tenth of a second to import)

    def excess(lengths: Array, places: Array) -> Array:
        rows = places.astype(int)
        return ratio(lengths[:, None] * steps[rows], predicted[rows]) - 1

    places = np.arange(len(steps))
    ends = 0.0 * places, LONGEST + 0.0 * places
    root = elementwise.find_root(excess, ends, args=(places,), tolerances={"xatol": 0.01})
    # A step without a root is lengthened as far as allowed: it reaches a bound, or the data have no
    # information along it.
    return np.nan_to_num(root.x, nan=LONGEST)


def _within(limits: Array, values: Array, covariance: Array) -> Array:
    """Move values (n, p) to the bounds (2, p) that they pass, and correlated ones with them."""
    # If a parameter were clipped alone, combinations that the data determine would change.
    for _ in range(2):
        for k, (low, high) in enumerate(limits.T):
            beyond = values[:, k] - np.clip(values[:, k], low, high)
            # A parameter at its bound has no variance, and no other one follows it.
            if beyond.any() and covariance[k, k] > 0:
                values = values - beyond[:, None] * covariance[k] / covariance[k, k]
    return np.clip(values, *limits)
