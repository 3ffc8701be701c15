"""Outliers among the points of a response, among the samples of a record, and unequal errors.

Let z be the residuals of a response over the expected sizes of its errors (real parts, then
imaginary parts), M = I - H the projection that removes the parameters, and k the two rows of a
point. Q = (Mz)_kᵀ M_kk⁻¹ (Mz)_k is the decrease of the sum of squares without that point. For
normal errors of these sizes, up to a common factor, Q/2 over the mean square of the other points
has an F distribution with 2 and the remaining degrees of freedom. The largest of n points is judged
by n times its probability (Cook and Weisberg (1982), Residuals and Influence in Regression, section
2.2, for real data). The test concerns the errors, not the criterion: the residuals of any criterion
are projected like those of least squares.

Samples of a record are judged by their residuals over a robust standard deviation, since records
have many more samples than parameters. They matter where bounding them reduces the variance of the
estimate. Errors whose size follows that of the output are named in their place.
"""

import math
from collections.abc import Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.diagnostics.repeated import Findings
from greybox.estimate.fitted_part import FittedRecord
from greybox.files.arrays import Array, ComplexArray, FloatPair, frozen, nans, real_and_imaginary
from greybox.files.text_table import Sentences, listed, number, p_text, percent
from greybox.statistics.column_space import column_basis
from greybox.statistics.huber import bounded, robust_deviation
from greybox.statistics.metrics import is_resolved, size_test

# Share of fits to clean data in which any point is called an outlier.
SIZE = 0.01

# Share of a point's residual that is a rounding error.
ROUNDING = 1e-9


@frozen
class Deviation:
    """The point of a response that deviates most.

    Attributes
    ----------
    index : int
        Index of the point in the data.
    probability : float
        Probability of a deviation as unlikely as this one at a point of clean data.
    relative : float
        The deviation over the model's magnitude.
    """

    index: int
    probability: float
    relative: float


def outlying_points(nlp: CompiledProblem, x: Array, *, explained: bool) -> Sentences:
    """Name outliers of responses at `x` (p,), and errors whose sizes are not as assumed.

    The sizes are judged only if the model explains the data.
    """
    values = nlp.all_values(x)
    responses = nlp.parts_of(ResponsePart)
    points = sum(len(part.data) for part in responses)
    for part in responses:
        deviation = largest_deviation(part, values, len(nlp.free))
        if deviation and points * deviation.probability < SIZE:
            omega = part.data.omega[deviation.index]
            one_in = number(1 / max(points * deviation.probability, 1e-12), 2)
            yield (
                f"the point at {omega:.4g} rad/s of {part.name!r} is an outlier, "
                f"{percent(deviation.relative)} % from the model: fewer than one in {one_in} fits "
                "to clean data have such a point. Fit again without it to see its effect."
            )
        if explained:
            yield from _unequal_sizes(part, values, len(nlp.free), len(responses))


def _unequal_sizes(part: ResponsePart, values: Array, free: int, responses: int) -> Sentences:
    """Say whether errors are larger in a part of the band than assumed.

    The `responses` share the `free` parameters.
    """
    model, data, criterion = part.response(values), part.data, part.criterion
    size, known = criterion.error_size(model, data), criterion.known_noise
    order = np.argsort(data.omega)
    order = order[size[order] > ROUNDING * size.max()]
    # With fewer degrees of freedom, parameters that fit some points exactly leave large errors at
    # the others: of right models with 7 parameters and 8 points, 6 % were named.
    if 2 * len(order) - free / responses < 12:
        return
    squares = (np.abs(data.response - model)[order] / size[order]) ** 2
    dof = math.inf if data.dof is None or not known else data.dof[order]
    probability = size_test(squares, dof)
    thirds = [np.mean(third) for third in np.array_split(squares, 3)]
    place = ("low", "medium", "high")[np.argmax(thirds)]
    # Below this factor on the variances of half a band, intervals of 95 % contain the truth in
    # 89 % and more. Given variances that are too large do no harm, and those of a spectrum
    # include more than the scatter where leakage matters.
    is_louder = max(thirds) > 1.5 * max(np.mean(squares), known)
    # What the parameters leave of equal errors is named up to twice as often as these.
    if is_louder and probability * responses < SIZE / 2:
        yield (
            f"the size of the errors of {part.name!r} changes with frequency beyond what "
            f"the criterion assumes (they are largest at {place} frequencies, "
            f"{p_text(probability)}), so that intervals may be wrong: give larger "
            f"variances at {place} frequencies to MaximumLikelihood(), or fit a part of the band."
        )


def outlying_samples(records: Sequence[FittedRecord]) -> Findings:
    """Name the outliers among the samples of records whose errors count as normal."""
    from scipy.special import stdtrit  # noqa: PLC0415  (takes a tenth of a second to import)

    for part in records:
        if part.settings.get("errors") != "normal":
            continue
        for output in part.outputs:
            residual = part.residual(output)[None]
            measured = np.flatnonzero(np.isfinite(residual[0]))
            if not measured.size:
                continue
            size = np.nan_to_num(np.abs(residual) / robust_deviation(residual))[0]
            # Of 10⁶ samples, ranks take a tenth of the fit, and 30 000 show the correlation.
            shown = measured[:: 1 + len(measured) // 30_000]
            r, chance = _rank_correlation(size[shown], np.abs(part.simulated[output][shown]))
            # Rounding follows what is rounded.
            # Errors of one relative size have rank correlations of 0.3 to 0.8 with an output, and
            # below 0.2 intervals hardly change.
            follows = r > 0.2 and chance < SIZE / len(part.outputs)
            if follows and is_resolved(residual[0], part.data[output]):
                yield (
                    f"{output} sizes",
                    part.name,
                    f"the size of the errors of {output} in {part.name!r} follows that of {output} "
                    f"(rank correlation {r:.2f}), so that intervals may be wrong: where an output "
                    "is positive, with errors in proportion to it, give its logarithm to model and "
                    "record.",
                )
                continue
            # The largest of many normal residuals is judged by their number. A median of their
            # sizes is as uncertain as the standard deviation of 37 % of them.
            samples = np.count_nonzero(size) or 1  # none in exact fits, which have no scale
            count = np.count_nonzero(size > -stdtrit(0.37 * samples, SIZE / 2 / samples))
            if not count:
                continue
            gain = np.nanmean(residual**2) / np.nanmean(bounded([residual])[0] ** 2)
            # At this factor on the variance standard errors are 12 % larger. Normal errors have
            # 0.95.
            if gain > 1.25:
                largest = [f"{t:.4g}" for t in part.data.time[np.argsort(-size)[:count][:4]]]
                yield (
                    output,
                    part.name,
                    f"outliers are among the samples of {output} in {part.name!r} ({count}), up to "
                    f"{number(size.max(), 2)} standard deviations from the model, the "
                    f"largest at {listed(largest)} s: OutputError(errors='huber') bounds their "
                    f"effect, with standard errors about {100 * (1 - gain**-0.5):.0f} % smaller.",
                )


def _rank_correlation(a: Array, b: Array) -> FloatPair:
    """Return Spearman's rank correlation of two series (n,), and its chance if independent.

    Slow series have fewer independent values: n (1 - c) / (1 + c), with c the product of their
    correlations from one sample to the next (Bartlett, J. R. Stat. Soc. 98, 1935).
    """
    if len(a) < 4:
        return 0.0, 1.0
    ranks = np.argsort(np.argsort([a, b]))
    r = np.corrcoef(ranks[0], ranks[1])[0, 1]
    c = np.prod([np.corrcoef(row[1:], row[:-1])[0, 1] for row in ranks])
    return r, math.erfc(abs(r) * math.sqrt(len(a) * (1 - c) / (1 + c) / 2))


def largest_deviation(part: ResponsePart, values: Array, free: int) -> Deviation | None:
    """Return the point that deviates most at all values (k,), of which the first `free` are free.

    Where the data give variances of few degrees of freedom, a residual is a bivariate Student's t
    and is judged as such. None if no point can be judged.
    """
    # The misfit leaves this point out, and a warning names it.
    return part.stored("deviation", values, lambda: _largest_deviation(part, values, free))


def _largest_deviation(part: ResponsePart, values: Array, free: int) -> Deviation | None:
    data, criterion = part.data, part.error_model
    model = part.response(values)
    size = criterion.error_size(model, data)
    points = np.flatnonzero(np.isfinite(size) & (size > ROUNDING * np.max(size, initial=0.0)))
    residual = (data.response - model)[points] / size[points]
    if criterion.known_noise and data.dof is not None:
        ratio = np.abs(residual) ** 2 / max(criterion.noise_ratio(model, data), 1.0)
        dof = data.dof[points]
    else:
        sensitivity = part.sensitivity(values)[points, :free] / size[points, None]
        # Each of the two components has half of a given variance.
        least = 0.5 if criterion.known_noise else 0.0
        ratio, dof = deletion_ratios(residual, sensitivity, least)

    probability = (1 + 2 * ratio / dof) ** (-dof / 2)  # of exceeding the ratio, by F with 2 and dof
    if not np.any(np.isfinite(probability)):
        return None

    worst = int(np.nanargmin(probability))
    index = int(points[worst])
    with np.errstate(divide="ignore"):  # a gain of zero ends at a response of zero
        relative = float(np.abs(data.response - model)[index] / np.abs(model[index]))
    return Deviation(index, float(probability[worst]), relative)


def deletion_ratios(
    residual: ComplexArray, sensitivity: ComplexArray, least: float
) -> tuple[Array, float]:
    """Return Q/2 over the mean square of the other points (n,), and their degrees of freedom.

    NaN for a point that the parameters fit exactly, and where no degrees of freedom remain.

    Parameters
    ----------
    residual, sensitivity : (n,) and (n, p) complex arrays
        Over the sizes of the errors.
    least : float
        Lower limit of the mean square.
    """
    n = residual.size
    basis = column_basis(real_and_imaginary(sensitivity))
    dof = 2 * n - basis.shape[1] - 2
    z = real_and_imaginary(residual)
    # Other criteria do not leave residuals orthogonal to the Jacobian; the test needs that.
    z = z - basis @ (basis.T @ z)
    total = float(z @ z)

    if dof < 2 or not total > 0:
        return nans(n), math.nan

    rows = np.stack([basis[:n], basis[n:]], axis=1)
    M = np.eye(2) - rows @ rows.mT
    is_judged = np.linalg.eigvalsh(M)[:, 0] > ROUNDING
    M[~is_judged] = np.eye(2)
    points = z.reshape(2, n).T
    q = np.sum(points * np.linalg.solve(M, points[..., None])[..., 0], axis=1)
    mean_square = np.maximum((total - q) / dof, max(least, ROUNDING * total))
    return np.where(is_judged, q / 2 / mean_square, math.nan), float(dof)
