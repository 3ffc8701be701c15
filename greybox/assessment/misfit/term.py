"""A term that a model may lack: in words, with the code that adds it, and its effect."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number
from greybox.data.files.public import public
from greybox.engine.compiled.disturbances import Effect
from greybox.modeling.added_terms import Formula

KNOTS = 11  # of a function of any shape


@public
@dataclass(frozen=True)
class Wording:
    """A kind of term in words, and the code that adds it to a model.

    All are formats with the fields signal, target, level, size, error and code.

    Attributes
    ----------
    text, code : str
        For a positive factor on the term.
    opposite, opposite_code : str
        For a negative factor, where they differ.

    Examples
    --------
    >>> RIPPLE = gb.Wording("a ripple of {target}, {size}", "p.ripple * gb.sin(9 * u.{target})")
    >>> RIPPLE.text
    'a ripple of {target}, {size}'
    """

    text: str
    code: str = ""
    opposite: str = ""
    opposite_code: str = ""


@dataclass(frozen=True)
class Family:
    """Terms of one kind and of the same signals, which are one cause."""

    wording: Wording
    signal: str
    target: str


@frozen
class Term(ABC):
    """A term that a model may lack.

    Attributes
    ----------
    wording : Wording
    signal, target : str
        The signal or parameter that acts or changes, and the state, output, input or part on which
        it acts.
    level : float
        Where the term begins to act, such as the limit of a saturation.
    scale : float
        The size of the term is the size of its factor times this.
    is_doubted : bool
        Whether it is suspected whatever else is tried, such as a value at a bound: then only terms
        of its family count as tried with it.
    is_of_part : bool
        Whether it is a value that one of several parts needs for itself.
    has_shape : bool
        Whether another form in its place could be drawn, unlike that of a wrong value.
    count : int
        Number of terms that count as tried with it: of these, it is among the likeliest ones.
    """

    wording: Wording
    signal: str = ""
    target: str = ""
    level: float = 0.0
    scale: float = 1.0
    is_doubted: bool = False
    is_of_part: bool = False
    has_shape: bool = True
    count: int = 1

    @property
    def family(self) -> Family:
        """The terms with the same cause."""
        return Family(self.wording, self.signal, self.target)

    @property
    @abstractmethod
    def columns(self) -> int:
        """Number of columns that are tested together."""

    def worded(self, factor: float) -> Wording:
        """Return the wording for a factor, which may show another cause."""
        return self.wording

    def described(self, factor: float, error: float) -> tuple[str, str]:
        """Return the term in words for a factor with its error, and the code that adds it."""
        wording = self.worded(factor)
        text, code = wording.text, wording.code
        if factor < 0:
            text, code = wording.opposite or text, wording.opposite_code or code

        values = {
            **vars(self),
            "level": number(self.level, 2),
            "size": number(abs(factor) * self.scale, 2),
            "error": number(error * self.scale, 2),
        }
        return text.format(**values), code.format(**values)


def same_wording(size: float) -> None:
    """Return that a term of any size is what it was tried as."""


@public
@frozen
class RecordTerm(Term):
    """A term that the model of a record may lack.

    Attributes
    ----------
    values : (samples,) or (q, samples) array
        The unit term. Several rows are one term whose factors are estimated together.
    effect : function
        Returns the effect on the record of values (c, samples), such as in the equation of a state.
    other_wording : function
        Returns the wording of another cause that a term of a signed size shows, or None.
    addition : function or None
        The unit term, if it adds to the derivative of the state `target`.
    code : str
        Such a term as a model has it.
    outputs : mapping of str to float
        Outputs that have this derivative in them, such as accelerations, and its factor there.
    tries : int
        Number of samples from which the residuals chose that of the term.
    knots : int
        Number of knots of the function of these values that may be missing, whatever its shape, or
        zero for the values themselves.

    Examples
    --------
    >>> RIPPLE = gb.Wording("a ripple of {target}, {size}", "p.ripple * gb.sin(9 * u.{target})")
    >>> def ripples(flight):
    ...     for u in flight.inputs:
    ...         yield u.term(RIPPLE, np.sin(9 * u.values), scale=1.0)  # a RecordTerm
    >>> causes = [*gb.CAUSES, ripples]  # for gb.misfit(fit, causes=causes)
    """

    values: Array = field(kw_only=True)
    effect: Callable[[Array], Effect] = field(kw_only=True)
    other_wording: Callable[[float], Wording | None] = field(default_factory=lambda: same_wording)
    addition: Formula | None = None
    code: str = ""
    outputs: Values = field(default_factory=dict)
    tries: int = 1
    knots: int = 0

    @property
    def rows(self) -> Array:
        """The values as rows (q, samples)."""
        return np.atleast_2d(self.values)

    @property
    def columns(self) -> int:
        """Number of columns that are tested together."""
        return len(self.rows)

    def worded(self, factor: float) -> Wording:
        """Return the wording for a factor, which may show another cause."""
        return self.other_wording(factor * self.scale) or self.wording

    def described(self, factor: float, error: float) -> tuple[str, str]:
        """Return the term in words for a factor with its error, and the code that adds it."""
        text, code = super().described(factor, error)
        for output, share in self.outputs.items():
            code += f", and so does the output {output}"
            if f"{share:.3g}" != "1":
                code += f", {share:.3g} times"
        return text, code


@frozen
class ResponseTerm(Term):
    """A term that the model of a response, or of a manoeuvre at its lines, may lack.

    Attributes
    ----------
    values : (n,) array
        The factor of the unit term on the response.
    shapes : function or None
        Returns what the response may get, relative to it, (n,) each, if the term has levels that a
        fit can refine, such as a frequency and a damping.
    levels : tuple of float
        These levels, above zero.
    is_smooth : bool
        Whether it changes all of the band.
    """

    values: ComplexArray = field(kw_only=True)
    shapes: Callable[..., Sequence[ComplexArray]] | None = None
    levels: tuple[float, ...] = ()
    is_smooth: bool = False

    @property
    def columns(self) -> int:
        """Number of columns that are tested together."""
        return 1

    @property
    def start(self) -> Array:
        """Numbers of the term (q,) in a fit: factors of zero, and logarithms of the levels."""
        factors = self.shapes(*self.levels) if self.shapes else [self.values]
        return np.append(np.zeros(len(factors)), np.log(self.levels))

    def factor(self, numbers: Array) -> ComplexArray:
        """Return the factor (n,) on a response for such numbers."""
        factors, levels = np.split(numbers, [len(numbers) - len(self.levels)])
        shapes = self.shapes(*np.exp(levels)) if self.shapes else [self.values]
        return 1 + factors @ np.array(shapes)
