"""Whether a constant acts from the beginning of a record, or from some time on."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from greybox.assessment.misfit.term import RecordTerm, Wording
from greybox.assessment.misfit.tested_record import TestedRecord
from greybox.data.files.arrays import Array, IntArray, positive_or_one
from greybox.data.files.frozen_values import frozen

INITIAL = Wording(
    "an initial {target} that is larger by {size} ± {error}",
    "no initial={{'{target}': ...}} in the criterion, which then estimates it",
    opposite="an initial {target} that is smaller by {size} ± {error}",
)
OFFSET = Wording(
    "an offset of {target} by {size}",
    "the output {target} + p.offset",
    opposite="an offset of {target} by -{size}",
)
JUMP = Wording(
    "an offset of {target} by {size} from {level} s on",
    "two records, {target} with an offset in the second",
    opposite="an offset of {target} by -{size} from {level} s on",
)
CONSTANT = Wording(
    "a constant {size} in the equation of {target}",
    "the derivative of {target} gets + p.new",
    opposite="a constant -{size} in the equation of {target}",
)
LOAD = Wording(
    "a constant {size} in the equation of {target} from {level} s on, such as a load",
    "the derivative of {target} gets + p.load * u.is_loaded, an input that is 1 from {level} s on",
    opposite="a constant -{size} in the equation of {target} from {level} s on, such as a load",
)
INPUT_OFFSET = Wording(
    "a constant {size} added to {target}",
    "a record whose input {target} has this constant added",
    opposite="a constant -{size} added to {target}",
)
INPUT_LOAD = Wording(
    "a constant {size} added to {target} from {level} s on, such as a load",
    "a record whose input {target} has this constant added",
    opposite="a constant -{size} added to {target} from {level} s on, such as a load",
)
LATER = {OFFSET: JUMP, CONSTANT: LOAD, INPUT_OFFSET: INPUT_LOAD}
# Parts of a record, in each of which the best beginning of a load is looked for, and how many of
# these, the likeliest ones, are simulated: that of all would take a fifth of the test's time.
PARTS, BEGINNINGS = 20, 5


@frozen
class Constants:
    """Terms that act from the beginning of a record, and how outputs (k, c, samples) follow."""

    terms: Sequence[RecordTerm]
    effects: Array

    @property
    def initial(self) -> list[bool]:
        """Whether each term is an error of a known initial state."""
        return [term.wording is INITIAL for term in self.terms]


def constants_of_record(flight: TestedRecord) -> Constants:
    """Return what acts from the beginning of a record."""
    terms = [*_constants(flight)]
    changes = [(term.effect, term.values) for term in terms]
    return Constants(terms, flight.record.followed_by(changes))


def _constants(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield errors of known initial states, offsets, and constants in equations or at the input."""
    states, ones = flight.part.system.states, flight.ones
    # As an impulse that lasts half of the first step.
    impulse = flight.record.by_stretch(_impulse, ones)
    for i in np.flatnonzero(flight.part.known_states.any(axis=0)).tolist():
        place = flight.at_state(i)
        yield RecordTerm(INITIAL, target=states[i], values=impulse, effect=place)

    for y in flight.outputs:
        yield RecordTerm(OFFSET, target=y.name, values=ones, effect=y.place)

    if flight.has_equations:
        for equation in flight.equations:
            place = flight.at_state(equation.index)
            yield RecordTerm(CONSTANT, target=equation.state, values=ones, effect=place)
    else:
        u = flight.all_inputs[0]
        yield RecordTerm(INPUT_OFFSET, target=u.name, values=ones, effect=u.place)


def _impulse(piece: Array, step: float) -> Array:
    return 2 / step * (np.arange(len(piece)) == 0)


def loads(flight: TestedRecord) -> Iterator[RecordTerm]:
    """Yield constants and offsets from some sample on."""
    constants, time = flight.once(constants_of_record), flight.time
    for constant, effect in zip(constants.terms, constants.effects.swapaxes(0, 1), strict=True):
        wording = LATER.get(constant.wording)
        if wording is None:
            continue
        for level in time[_onsets(flight, effect)].tolist():
            yield replace(
                constant,
                wording=wording,
                values=1.0 * (time >= level),
                level=level,
                tries=1 + len(time) // PARTS,
                count=PARTS // BEGINNINGS,
            )


def _onsets(flight: TestedRecord, effect: Array) -> IntArray:
    """Return the likeliest samples at which a constant of this effect (k, samples) may begin.

    From a later sample on, the effect is that from the first one, shifted.
    """
    residuals = flight.record.residuals * flight.record.present
    # Slow errors, an offset and a trend hardly change from sample to sample.
    e, effect = np.diff([residuals, effect], prepend=0)
    n, weight = e.shape[1], 1 / positive_or_one(np.var(e, axis=1, keepdims=True))
    pairs = zip(weight * e, effect, strict=True)
    along = sum(np.correlate(*pair, "full")[n - 1 :] for pair in pairs)
    following = np.cumsum(np.sum(weight * effect**2, axis=0))[::-1]
    # What begins in the last part would be a few samples, which may be outliers.
    parts = np.array_split(np.arange(n), min(PARTS, n))[:-1]
    share = along**2 / (following + 1e-300)
    best = np.array([part[np.argmax(share[part])] for part in parts])
    return np.sort(best[np.argsort(-share[best], kind="stable")[:BEGINNINGS]])
