"""Whether samples of a record are outliers, or have errors in proportion to the output."""

import math

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.largest_deviation import SIZE
from greybox.data.files.arrays import Array
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import listed
from greybox.statistics.error_distribution import robust_deviation
from greybox.statistics.huber import HuberErrors
from greybox.statistics.metrics import is_resolved

# Sizes of n normal residuals are judged by their median, which is as uncertain as the standard
# deviation of this share of them.
EFFICIENCY_OF_MEDIAN = 0.37
# Mean square of the residuals over that of bounded ones, above which outliers are named: standard
# errors are then 12 % larger than those of bounded errors. Normal errors have a ratio of 0.95.
NAMED_GAIN = 1.25


def outlying_samples(evidence: Evidence) -> Findings:
    """Name the outliers among the samples of records whose errors count as normal."""
    from scipy.special import stdtrit  # noqa: PLC0415  (takes a tenth of a second to import)

    if not evidence.has_errors:
        return

    for part in evidence.fit.records:
        if part.settings.get("errors") != "normal":
            continue
        for output in part.outputs:
            residual = part.residual(output)[None]
            measured = np.flatnonzero(np.isfinite(residual[0]))
            if not measured.size:
                continue
            size = np.nan_to_num(np.abs(residual) / robust_deviation(residual))[0]
            # Ranking 10⁶ samples would take a tenth of the time of the fit; 30 000 suffice.
            shown = measured[:: 1 + len(measured) // 30_000]
            r, chance = _rank_correlation(size[shown], np.abs(part.simulated[output][shown]))
            # Errors by rounding depend on the output as well, so that only errors larger than the
            # resolution count. Errors of one relative size have rank correlations of 0.3 to 0.8
            # with an output, and below 0.2 intervals hardly change.
            follows = r > 0.2 and chance < SIZE / len(part.outputs)
            if follows and is_resolved(residual[0], part.data[output]):
                yield Finding(
                    f"the size of the errors of {output} in {part.name!r} follows that of {output} "
                    f"(rank correlation {r:.2f}), so that intervals may be wrong: where an output "
                    "is positive, with errors in proportion to it, give its logarithm to model and "
                    "record.",
                    f"{output} sizes",
                    part.name,
                )
                continue
            # In exact fits all sizes are zero.
            samples = np.count_nonzero(size) or 1
            # The more samples, the larger is the largest of normal residuals.
            largest_normal = -stdtrit(EFFICIENCY_OF_MEDIAN * samples, SIZE / 2 / samples)
            count = np.count_nonzero(size > largest_normal)
            if not count:
                continue
            (bounded,) = HuberErrors().pseudo_errors([residual])
            gain = np.nanmean(residual**2) / np.nanmean(bounded**2)
            if gain > NAMED_GAIN:
                by_size = np.argsort(-size)
                largest = [f"{t:.4g}" for t in part.data.time[by_size[: min(count, 4)]]]
                yield Finding(
                    f"outliers are among the samples of {output} in {part.name!r} ({count}), up to "
                    f"{number(size.max(), 2)} standard deviations from the model, the "
                    f"largest at {listed(largest)} s: OutputError(errors='huber') bounds their "
                    f"effect, with standard errors about {100 * (1 - gain**-0.5):.0f} % smaller.",
                    output,
                    part.name,
                )


def _rank_correlation(a: Array, b: Array) -> tuple[float, float]:
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
