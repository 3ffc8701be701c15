"""A record as a regression of its residuals on the parameters and on missing terms."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from greybox.assessment.misfit.answer import Cause
from greybox.assessment.misfit.causes.constants import Constants, constants_of_record
from greybox.assessment.misfit.regression import TINY, Regression, labeled
from greybox.assessment.misfit.shortened_record import FEWEST
from greybox.assessment.misfit.term import RecordTerm
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.engine.compiled.disturbances import UNSTABLE
from greybox.engine.compiled.record_sensitivity import sensitivity
from greybox.statistics.beta_share import chance
from greybox.statistics.column_space import column_basis, outside
from greybox.statistics.score_statistics import score_tests

PIECES = 10  # of a record, whose means show an offset
# Samples of an output between long gaps, on average: every piece loses its first ones.
BETWEEN_GAPS = 80


def regression_of_record(
    flight: TestedRecord, terms: Sequence[RecordTerm], by_x: Array, count: int
) -> Regression:
    """Return the regression of one of `count` records, on the q parameters that move.

    The derivatives of the solver's variables by them are `by_x` (q, p).
    """
    rows = _Rows(flight)
    record, constants = flight.record, flight.once(constants_of_record)
    slopes = sensitivity(record.part, record.trajectory, record.weight)
    fitted = np.einsum("ab,bpn->apn", rows.noise, by_x @ slopes.weighted)
    initial = np.einsum("ab,bmn->amn", rows.noise, slopes.by_initial)

    # A wrong initial state is a cause of its own, beside which all terms are tested. An offset or a
    # trend cannot be distinguished from a drift of the errors.
    starts = [column_basis(stretch) for stretch in rows.by_stretch(initial)]
    known = rows.by_stretch(constants.effects[:, constants.initial])
    lines = [_lines(measured) for measured in rows.present]
    drifts = [
        column_basis(np.hstack(columns)) for columns in zip(starts, known, lines, strict=True)
    ]

    def changes(terms: Sequence[RecordTerm]) -> Array:
        pairs = [(term.effect, row) for term in terms for row in term.rows]
        return rows.outside(record.followed_by(pairs), drifts)

    with_effects = np.hstack([record.residuals[:, None], constants.effects])
    measured = (record.outputs / record.spread + record.residuals)[:, None]
    offsets = _offsets(
        constants,
        rows.outside(with_effects, starts),
        rows.outside(fitted, starts),
        len(flight.outputs),
        count,
    )
    return Regression(
        rows.outside(measured, [column_basis(line) for line in lines]),
        rows.outside(record.residuals[:, None], drifts),
        rows.outside(fitted, drifts),
        labeled(terms),
        changes,
        outputs=rows.by_output(),
        causes=[*offsets],
        is_unstable=record.growth > UNSTABLE,
        lost=sum(basis.shape[1] for basis in drifts),
        signals=lambda: _signals(flight),
    )


class _Rows:
    """The rows of a regression: the measured samples of all outputs, stretch by stretch.

    Only outputs with enough samples are tested.
    """

    def __init__(self, flight: TestedRecord) -> None:
        record, data = flight.record, flight.part.data
        counts = np.sum(record.present, axis=1, keepdims=True)
        is_tested = counts >= FEWEST * len(data.stretches)
        self.data, self.weight = data, record.weight
        self.noise = np.linalg.inv(self.weight.T @ self.weight)
        self.present = [row > 0 for row in data.unpadded(record.present * is_tested)]

    def by_stretch(self, values: Array) -> list[Array]:
        """Return values (outputs, c, samples) as rows (n, c) of every stretch."""
        stretches = []
        for piece, measured in zip(self.data.unpadded(values), self.present, strict=True):
            weighted = self.weight @ piece.transpose(2, 0, 1)
            weighted = np.where(measured.T[..., None], weighted, 0.0)
            stretches.append(weighted.reshape(measured.size, -1))
        return stretches

    def outside(self, values: Array, taken: Sequence[Array]) -> Array:
        """Return all rows, less what is fitted in each stretch by itself."""
        pairs = zip(self.by_stretch(values), taken, strict=True)
        return np.vstack([outside(stretch, basis) for stretch, basis in pairs])

    def by_output(self) -> list[list[IntArray]]:
        """Return the rows of every output, between gaps."""
        firsts = np.cumsum([0, *(measured.size for measured in self.present)])
        outputs = []
        for k in range(len(self.present[0])):
            rows = []
            for first, measured in zip(firsts, self.present, strict=False):
                for places in _between_gaps(measured[k]):
                    rows.append(first + k + len(measured) * places)
            outputs.append(rows)
        return outputs


def _signals(flight: TestedRecord) -> Mapping[str, Array]:
    """Return the states, inputs with their rates, and the time of a record, (samples,)."""
    signals = dict(flight.states)
    for u in flight.all_inputs:
        signals |= {u.name: u.values, f"rate of {u.name}": flight.rate(u.values)}
    return signals | {"time, s": flight.time}


def _between_gaps(measured: BoolArray) -> list[IntArray]:
    """Return the places of measured samples (n,), by pieces between the longest gaps.

    Slow errors jump over a long gap, and the jumps would look like a missing term: of right models
    with four gaps of 5 to 30 samples in slow errors, half were called wrong. Every piece loses its
    first samples.
    """
    places = np.flatnonzero(measured)
    steps = np.diff(places)
    longest = np.sort(np.argsort(-steps, kind="stable")[: len(places) // BETWEEN_GAPS])
    # An output with a rate of its own has no gaps.
    is_gap = steps[longest] * len(places) > 2 * len(measured)
    return np.split(places, 1 + longest[is_gap])


def _offsets(
    constants: Constants, columns: Array, fitted: Array, outputs: int, count: int
) -> Iterator[Cause]:
    """Yield the constants that residuals follow, judged by their slow errors.

    These look like a constant, too, but then pieces of the record differ as much. A constant that
    one piece alone determines, such as one before a step, cannot be distinguished from them. A
    random walk from zero has an offset of p < 0.001 in one of 2000 simulated records, and each of
    `count` records may have one. The first of the columns (N, 1 + c) has the residuals, and the
    others the effects of the terms. What the parameters explain is removed from both: if a gain
    compensates for a constant, the residuals do not look like a constant.
    """
    basis = column_basis(fitted)
    tests = score_tests(columns[:, 0], basis, columns[:, 1:]).T.tolist()
    columns = outside(columns, basis)
    pieces = np.arange(len(columns)) * PIECES // len(columns)
    # The numbers of a sample, one for each of the outputs, follow one another.
    firsts = outputs * (np.arange(1, PIECES) * len(columns) // (PIECES * outputs))
    rows = zip(constants.terms, constants.initial, tests, columns.T[1:], strict=True)
    for term, is_initial, (decrease, p_one, value, _), column in rows:
        if np.isnan(p_one):
            continue
        squares = np.bincount(pieces, column**2)
        if is_initial:
            # An autoregression expects a transient after a few large samples, and would see none.
            # But errors follow it as much where another piece begins.
            later = [columns[k:, 0] @ column[: len(column) - k] for k in firsts]
            determined, spread = float(PIECES), np.linalg.norm(later) / PIECES
        else:
            spread = np.linalg.norm(np.bincount(pieces, column * (columns[:, 0] - value * column)))
            determined = float(squares.sum() ** 2 / (squares @ squares))
        error = determined**0.5 * float(spread / squares.sum()) + TINY
        left = 1 / (1 + (value / error) ** 2 / determined)
        p_value = min(float(count * len(constants.terms) * chance(left, determined - 1)), 1.0)
        share = decrease / len(columns)
        yield Cause(*term.described(value, error), value, error, share, p_value, p_value)


def _lines(measured: BoolArray) -> Array:
    """Return a constant and a straight line (n k, 2 k) for every output of a stretch (k, n)."""
    outputs, samples = measured.shape
    line = np.vander(np.linspace(-1, 1, samples), 2)
    return np.kron(line, np.eye(outputs)) * measured.T.reshape(-1, 1)
