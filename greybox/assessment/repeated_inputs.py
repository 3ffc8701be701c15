"""Tests that are repeated with the same inputs: noise does not repeat with these, a misfit does.

The errors of a coarse sensor repeat, too: where residuals are no more than these, a repeated test
shows nothing new.

Source: Pintelon and Schoukens (2012), System Identification: A Frequency Domain Approach, 2nd ed.,
section 4.3 (periodic inputs separate noise from nonlinear distortions).
"""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from greybox.assessment.missing_terms import Term
from greybox.data.files.arrays import Array
from greybox.engine.compiled.disturbances import DisturbedRecord
from greybox.statistics.autoregressive_likelihood import ORDER
from greybox.statistics.metrics import is_resolved

ROUNDING = 1e-6  # of the range of an input, within which it is the same


def repeated_residuals(
    records: Sequence[DisturbedRecord],
) -> Iterator[tuple[list[Term], Array]]:
    """Yield terms for every record: the residuals of the last test that had the same inputs.

    This test is the previous period, or an earlier stretch of this or of another record. The second
    value (outputs, samples) is zero where the residuals merely repeat those of this test.
    """
    earlier: list[tuple[tuple[str, ...], Array, Array]] = []
    for record in records:
        data = record.part.data
        outputs = record.part.outputs
        rows = []
        stretches = zip(*map(data.unpadded, (record.inputs, record.residuals)), strict=True)
        for u, e in stretches:
            n = period(u)
            previous = np.hstack([0 * e[:, :n], e[:, : e.shape[1] - n]])
            for names, inputs, residuals in earlier:
                if names == outputs and inputs.shape == u.shape and _are_same(inputs, u):
                    previous = residuals
            rows.append(previous)
            # Records with gaps have many shorter ones, which show nothing.
            if u.shape[1] > ORDER:
                earlier.append((outputs, u, e))
        values = data.padded(rows, 0.0)
        terms = [
            Term("repeated", values[k], partial(record.by_output, k), b=b)
            for k, b in enumerate(outputs)
        ]
        resolved = [
            [is_resolved(*pair)] for pair in zip(record.residuals, data.measured, strict=True)
        ]
        yield terms, np.maximum(values == 0, resolved)


def period(inputs: Array) -> int:
    """Return the samples after which inputs (m, n) repeat to the end, and n if they do not."""
    n = inputs.shape[1]
    near = ROUNDING * np.ptp(inputs, axis=1, keepdims=True)
    # Errors may be correlated over as many samples as they are predicted from.
    lags = np.arange(ORDER + 1, n // 2 + 1)
    # The first sample excludes most lags.
    possible = np.all(np.abs(inputs[:, lags] - inputs[:, :1]) <= near, axis=0) & near.any()
    for lag in lags[possible].tolist():
        if _are_same(inputs[:, lag:], inputs[:, :-lag]):
            return lag
    return n


def _are_same(a: Array, b: Array) -> bool:
    return bool(np.all(np.abs(a - b) <= ROUNDING * np.ptp(b, axis=1, keepdims=True)))
