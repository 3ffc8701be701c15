"""Whether a model explains its data, and if not, what it may lack: the answer."""

from dataclasses import dataclass, field
from typing import Any

from greybox.data.files.numbers_in_text import number, percent, with_error
from greybox.data.files.printed import Printed
from greybox.data.files.text_table import text_table
from greybox.modeling.added_terms import Formula

# Largest probability at which a model is called wrong. Of 959 right fits of simulated records,
# 0.6 % were below 0.003, and of 38 in gusts 8 between both; of 148 wrong ones none was.
FALSE_ALARMS = 0.001
NAMED = 0.003  # the same for a cause of a model that is called wrong
LARGE = 10  # times what noise leaves, beyond which a model describes nothing
# Share of the residuals that earlier samples predict, here more than twice the noise: sensors are
# seldom so slow, while a line, a parameter that varies, hysteresis, tanks that overflow and a drive
# with friction are, of which at three times the noise 0.82 to 0.86 are predicted. Errors with a
# correlation of 0.85 leave 0.64 to 0.74. And the share of the output that a reader would see.
DRIFTING, NOTICED = 0.8, 0.01
# Share from which residuals are called not white. A filter fitted to white ones predicts 0.01 of
# 1000 samples by chance, and 0.2 of few.
COLORED = 0.5
SLOW = 0.99  # such a share at values that gusts bias
MUCH = 0.25  # of the variance: residuals of half the standard deviation of an output
# Share of squares, a millionth of an output, below which no sensor has errors: a simulation without
# noise leaves rounding and integration errors, which may follow the input.
EXACT = 1e-12


@dataclass(frozen=True)
class Cause:
    """A term that the model may lack.

    Attributes
    ----------
    text, code : str
        What it is, and how the model gets it.
    value, error : float
        The factor on the term that a fit would estimate, to first order, and its standard error.
    share : float
        Share of the misfit that it explains, to first order, excluding the share that earlier
        samples predict. Where the misfit of records is far above the noise, the share of all of it
        counts if that is larger.
    p_value : float
        Probability of such a share if the model explains the data, times the number of terms that
        were tried for records; for responses that of terms of its kind, times the number of kinds.
    p_correlated : float
        The same if errors of neighboring points of a response may be correlated.
    alike : tuple of str
        Terms that have nearly the same effect, so that the data cannot tell them apart.
    added : (str, Formula) or None
        The state to whose derivative it adds, and the unit term; not stored with a fit.
    """

    text: str
    code: str
    value: float
    error: float
    share: float
    p_value: float
    p_correlated: float
    alike: tuple[str, ...] = ()
    added: tuple[str, Formula] | None = field(
        default=None, compare=False, metadata={"stored": False}
    )

    def __getstate__(self) -> dict[str, Any]:
        """Return what a pickle keeps: all but the function, as in the file of a fit."""
        return {**vars(self), "added": None}

    @property
    def explained(self) -> str:
        """What the term is, with the share of the misfit that it explains, and its test."""
        return f"{self.text} ({percent(self.share)} % of the misfit, {_chance(self.p_value)})"

    @property
    def remedy(self) -> str:
        """The term, how the model gets it, and what it cannot be told apart from."""
        also = f"; hardly distinct from {'; or '.join(self.alike)}" if self.alike else ""
        how = f": {self.code}" if self.code else ""
        return f"to add: {self.explained}{how}{also}"


@dataclass(frozen=True)
class Shape:
    """How the term that explains most depends on a signal, apart from what the parameters explain.

    Attributes
    ----------
    text, signal : str
        The term in words, and the state, input, rate of an input, or time, over which the
        residuals show it most clearly.
    at : tuple of float
        Values of the signal.
    values, errors : tuple of float
        What the model lacks there in the place of the term, such as the equation of a state,
        whatever its form, and its standard errors.
    by_term : tuple of float
        The same if the term is all that is missing.
    """

    text: str
    signal: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    errors: tuple[float, ...]
    by_term: tuple[float, ...]


@dataclass(frozen=True)
class Misfit(Printed):
    """Whether a model explains its data, and what it may lack. It prints itself.

    Attributes
    ----------
    left, noise : float
        Share of the squares of the outputs about straight lines that the model leaves, and that
        noise would leave; of responses, relative to the sizes of their errors. They are those of
        the output of a record, or of the responses, where both differ most.
    tried : int
        Number of terms.
    causes : tuple of Cause
        The best term of every family; the one that explains most comes first.
    p_common : float
        Probability of such residuals of several responses if one set of values serves all.
    drift : float
        Share of the squares of the residuals of records that earlier samples predict.
    is_unstable : bool
        Whether the model is unstable, so that the inputs of a record respond to its errors.
    shape : Shape or None
        The shape of the best term of records, where it is significant.
    level : float
        Probability below which the model does not explain the data.
    """

    left: float
    noise: float
    tried: int
    causes: tuple[Cause, ...]
    p_common: float
    drift: float
    is_unstable: bool
    shape: Shape | None = None
    level: float = FALSE_ALARMS

    @property
    def p_value(self) -> float:
        """Probability of such residuals if the model explains the data."""
        # Several responses test two hypotheses: common values, and missing terms.
        tests = 1 + (self.p_common < 1)
        return min(
            tests * min([self.p_common, *(cause.p_correlated for cause in self.causes)]), 1.0
        )

    @property
    def explains(self) -> bool:
        """Whether the residuals look like noise, or are rounding."""
        return self.is_exact or not self.p_value < self.level

    @property
    def is_exact(self) -> bool:
        """Whether less than a millionth of the outputs is left, as of data from a simulation."""
        return self.left < EXACT

    @property
    def is_large(self) -> bool:
        """Whether the model leaves more than ten times what noise would."""
        return not self.explains and self.left > LARGE * self.noise

    @property
    def likely(self) -> tuple[Cause, ...]:
        """The causes that are named: up to three, where the model may not explain the data."""
        if self.is_exact:
            return ()
        # Where drift alone, or correlated errors of a response, would excuse the model.
        excused = 0.05 if self.is_drifting else 0.001
        limit = excused if self.explains else max(self.level, NAMED)
        return tuple([cause for cause in self.causes if cause.p_value < limit][:3])

    @property
    def is_drifting(self) -> bool:
        """Whether large, slow residuals are all that is wrong, and no term is certain."""
        return self.explains and self.drift > DRIFTING and self.left > NOTICED

    @property
    def is_conditional(self) -> bool:
        """Whether it explains the data only if errors drift, are correlated, or are large."""
        return self.explains and (
            self.is_drifting or bool(self.likely) or (self.left > MUCH and not self.is_exact)
        )

    @property
    def may_be_gusts(self) -> bool:
        """Whether a right model may look like this.

        Gusts bias the values that a simulation fits, and through a controller they reach the
        inputs. At biased values, residuals are slow and follow the inputs.
        """
        return not (self.explains or self.is_unstable) and self.drift > SLOW

    @property
    def verdict(self) -> str:
        """Whether the model explains the data, in a few words."""
        if self.is_exact:
            return (
                "reproduces the data except for rounding and integration errors, as in a "
                "simulation without noise, so standard errors mean little"
            )
        left = f"{percent(self.left)} % of the variance is unexplained"
        noise = ""
        if self.noise < 0.9 * self.left:  # closer shares look alike with two digits
            noise = f"; noise alone would leave about {percent(self.noise)} %"
        if self.explains:
            return self._condition(left, noise)
        common = ""
        if self.p_common < self.level:
            common = "; one set of values does not serve all parts"
        gusts = ""
        if self.may_be_gusts:
            gusts = (
                "; gusts may look like this through a controller: compare with "
                "PredictionError(disturbance={state: 'colored'})"
            )
        return (
            f"does not explain the data: {left} and follows the excitation "
            f"({_chance(self.p_value)}){noise}{common}{gusts}"
        )

    def _condition(self, left: str, noise: str) -> str:
        """Return that the model explains the data, and on which condition."""
        if self.is_drifting:
            return (
                f"explains the data only if errors drift: {left} and follows from earlier samples; "
                f"no certain evidence of any of {self.tried} candidate terms"
            )
        if self.likely:
            return (
                "explains the data only if errors of neighboring points are correlated, or larger "
                f"at one end: otherwise, {left} and follows the excitation{noise}"
            )
        terms = f"no evidence of any of {self.tried} candidate terms"
        if self.drift > COLORED:
            share = percent(self.drift)
            terms += f"; earlier samples predict {share} % of these residuals, which are not white"
        # What is left may be noise, or a motion that no term of the test has.
        if self.left > MUCH:
            return f"is not contradicted by the data: {left}, with {terms}"
        return f"explains the data: {terms}"

    def __str__(self) -> str:
        header = ["term", "factor", "± error", "explains", "p", "how to add it"]
        rows = [
            [
                cause.text,
                *with_error(cause.value, cause.error),
                f"{percent(cause.share)} %",
                number(cause.p_value, 2),
                cause.code,
            ]
            for cause in self.causes
        ]
        return f"The model {self.verdict}.\n\n{text_table(header, rows, (0, 5))}"


def _chance(p_value: float) -> str:
    return "p < 1e-9" if p_value < 1e-9 else f"p = {p_value:.2g}"
