"""Whether residuals repeat with the inputs: noise does not, what the model lacks does.

The errors of a coarse sensor repeat, too: where residuals are no more than these, a repeated test
shows nothing new.

Source: Pintelon and Schoukens (2012), System Identification: A Frequency Domain Approach, 2nd ed.,
section 4.3 (periodic inputs separate noise from nonlinear distortions).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.autoregressive_likelihood import ORDER
from greybox.statistics.metrics import is_resolved

REPEATED = Wording("an effect on {target} of unknown form, which repeats with the inputs")
ROUNDING = 1e-6  # of the range of an input, within which it is the same


@frozen
class Test:
    """A stretch of a record: inputs (m, n) and residuals (k, n) of the outputs."""

    outputs: tuple[str, ...]
    inputs: Array
    residuals: Array

    def repeats(self, other: "Test") -> bool:
        """Return whether another test has the same outputs and inputs."""
        is_alike = self.outputs == other.outputs and self.inputs.shape == other.inputs.shape
        return is_alike and _are_same(self.inputs, other.inputs)


def repeated_tests(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield the residuals of the last test with the same inputs, for every output.

    This test is the previous period, or an earlier stretch of this or of another record.
    """
    earlier = [test for other in flight.earlier for test in other.once(tests_of)]
    rows = []
    for test in flight.once(tests_of):
        rows.append(_previous(test, earlier))
        earlier.append(test)

    previous = flight.part.data.padded(rows, 0.0)
    for k, y in enumerate(flight.outputs):
        if is_resolved(flight.record.residuals[k], flight.part.data.measured[k]):
            yield RecordTerm(REPEATED, target=y.name, values=previous[k], effect=y.place)


def tests_of(flight: TestedRecord) -> list[Test]:
    """Return the stretches of a record."""
    record, data = flight.record, flight.part.data
    stretches = zip(data.unpadded(record.inputs), data.unpadded(record.residuals), strict=True)
    return [Test(flight.part.outputs, inputs, residuals) for inputs, residuals in stretches]


def _previous(test: Test, earlier: Sequence[Test]) -> Array:
    """Return the residuals (k, n) of the last test with the same inputs, or of the last period."""
    samples = test.inputs.shape[1]
    # Records with gaps have many shorter tests, which show nothing.
    if samples > ORDER:
        for other in reversed(earlier):
            if test.repeats(other):
                return other.residuals

    n = period(test.inputs)
    return np.hstack([0 * test.residuals[:, :n], test.residuals[:, : samples - n]])


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
