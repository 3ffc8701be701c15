"""Numbers and tables as a person reads them in a terminal.

How notebooks show values that print themselves.
"""

import difflib
import math
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from numbers import Integral, Real
from textwrap import indent
from typing import Any

from greybox.files.arrays import Labels, StringPair, Strings, unique
from greybox.files.escapes import html_text, printable, sentence, terminal_text

Sentences = Iterator[str]


def all_printable(thing: Any) -> Any:
    """Return names and texts, at any depth, with control characters written out."""
    if isinstance(thing, str):
        return printable(thing)
    if isinstance(thing, dict):
        return {all_printable(name): all_printable(value) for name, value in thing.items()}
    if type(thing) in (tuple, list):
        return type(thing)(all_printable(item) for item in thing)
    return thing


def write_out(target: Any, *names: str) -> None:
    """Write out control characters in these attributes of a new object, at any depth."""
    for name in names:
        vars(target)[name] = all_printable(getattr(target, name))


def text_table(header: Labels, rows: Sequence[Labels], left: Sequence[int] = (0,)) -> str:
    """Align `rows` of text under `header`; columns in `left` are flush left, others right."""
    # Control characters are written out first: they have no width.
    cells = [[printable(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]

    def line(row: Labels) -> str:
        parts = (
            c.ljust(w) if k in left else c.rjust(w)
            for k, (c, w) in enumerate(zip(row, widths, strict=True))
        )
        return "  ".join(parts).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([line(cells[0]), rule, *map(line, cells[1:])])


def titled(title: str, lines: Iterable[str]) -> str:
    """Return a title, a blank line, and indented lines."""
    return terminal_text(f"{title}\n\n" + indent("\n".join(lines), "  "))


def number(value: float | None, digits: int = 5) -> str:
    """Format `value` with `digits` significant digits; NaN and None are a dash.

    Rounded numbers have no exponent where that is readable: 180, not 1.8e+02.
    """
    if value is None or math.isnan(value):
        return "-"
    return f"{float(f'{value:.{digits}g}'):.{max(digits, 6)}g}"


def percent(share: float) -> str:
    """Return a share in percent with two digits."""
    return number(100 * share, 2)


def probability(p: float) -> str:
    """Format a p-value with two digits; below 0.0001 they would say more than a test knows."""
    return "< 0.0001" if p < 1e-4 else number(p, 2)


def p_text(p: float) -> str:
    """Return a p-value as text for a sentence."""
    text = probability(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def counted(count: float, singular: str, plural: str = "") -> str:
    """Return "1 record" or "2 records"; `plural` is an irregular one."""
    amount = f"{count:g}" if isinstance(count, float) else f"{count}"
    return f"{amount} {singular if count == 1 else plural or singular + 's'}"


def listed(names: Labels) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def numbered_where_alike(names: Labels) -> list[str]:
    """Return the names, with numbers in those that several have: y/u 1, y/u 2."""
    return [
        f"{name} {names[:k].count(name)}" if names.count(name) > 1 else name
        for k, name in enumerate(names, 1)
    ]


def as_names(names: str | Iterable[str]) -> Strings:
    """Return one name or several as a tuple."""
    return (names,) if isinstance(names, str) else tuple(names)


def some(names: Labels, most: int = 4) -> str:
    """Return names as `listed` does; of many names, the first ones and the number of the others."""
    return (
        listed(names)
        if len(names) <= most + 1
        else f"{', '.join(names[:most])} and {len(names) - most} more"
    )


def nearest(name: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """Return the known name most like a misspelled one; None if no known name resembles it."""
    # Capitals are the most frequent mistake.
    spelled = {candidate.lower(): candidate for candidate in known}
    matches = difflib.get_close_matches(name.lower(), spelled, n=1, cutoff=likeness)
    return spelled[matches[0]] if matches else None


def require_kind(what: str, value: object, kinds: Any, cure: str) -> None:
    """Raise TypeError for a value that is not of these kinds; the message says to give `cure`."""
    if not isinstance(value, kinds):
        raise TypeError(f"{what} is {value!r:.80}: give {cure}.")


def is_finite_number(value: Any) -> bool:
    """Return whether a value is a finite real number, of Python or of numpy."""
    return isinstance(value, Real) and math.isfinite(value)


def require_whole(name: str, value: Any, least: int, most: float = math.inf) -> None:
    """Raise ValueError for anything but a whole number within these limits."""
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_whole or not least <= value <= most:  # type: ignore[operator]
        limits = f"of at least {least}" if math.isinf(most) else f"from {least} to {most}"
        raise ValueError(f"{name} is {value!r}: give a whole number {limits}.")


def checked_items(what: str, items: Any, kinds: Any, cure: str) -> tuple[Any, ...]:
    """Return one item or several as a tuple, each checked by `require_kind`."""
    is_single = isinstance(items, str) or not isinstance(items, Iterable)
    listed = (items,) if is_single else tuple(items)
    for item in listed:
        require_kind(what, item, kinds, cure)
    return listed


def alternatives(name: object, names: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: the known names, and the closest one."""
    # An output of a model may be a state, too.
    names = unique(names)
    near = nearest(str(name), names)
    return sentence(", ".join(names) or "none") + (f": did you mean {near!r}?" if near else ".")


def with_error(value: float, error: float) -> StringPair:
    """Format a standard error with two significant digits, and the value to its last digit.

    A value that this rounding would change by more than 5 % has two significant digits.
    """
    if not (math.isfinite(value) and math.isfinite(error)) or error <= 0:
        return number(value), "-"
    # With the digits of such an error, the value would have none, or more than a person reads.
    if error > 1e9 * abs(value) or error < 1e-9 * abs(value):
        return number(value if error < abs(value) else 0.0), number(error, 2)
    # Rounded first: 0.0996 has its two digits in 0.10, one place further left.
    decimals = 1 - math.floor(math.log10(float(f"{error:.1e}")))
    if not -4 <= decimals <= 7 or abs(value) >= 1e7:
        return (
            f"{value:.{max(2, math.floor(math.log10(abs(value))) + decimals + 1)}g}",
            f"{error:.2g}",
        )
    digits = decimals
    if abs(round(value, digits) - value) > 0.05 * abs(value):
        # 12 ± 340 and not 10 ± 340: the estimate belongs to the answer, however large its error.
        digits = 1 - math.floor(math.log10(abs(value)))

    return _rounded(value, digits), _rounded(error, decimals)


def _rounded(value: float, decimals: int) -> str:
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def greek(name: str) -> str:
    """Return the Greek letter of this name, as θ for ``theta``; any other name as it is."""
    size = "SMALL" if name.islower() else "CAPITAL" if name.istitle() else "no"
    try:
        # Unicode spells it "lamda".
        return unicodedata.lookup(f"GREEK {size} LETTER {name}".replace("ambda", "amda"))
    except KeyError:
        return name


def in_greek(name: str) -> str:
    """Return the name of a signal with Greek letters: theta is θ, u_phi is u_φ."""
    return re.sub(r"[^\W_]+", lambda word: greek(word[0]), name)


def one_line(value: object, *facts: str) -> str:
    """Return ``<Class fact, fact>`` for the `repr` of a value, in less than 120 characters."""
    text = printable(" ".join(f"<{type(value).__name__} {', '.join(facts)}".split()))
    return f"{text}>" if len(text) < 119 else f"{text[:115]}...>"


def preformatted(text: str) -> str:
    """Return lines of text as HTML."""
    # Names come from files, which must not write HTML into a notebook.
    return f"<pre>{escape(html_text(text))}</pre>"


class Printed:
    """A value that a notebook shows as its printed text; its `repr` is the first line of it."""

    def __repr__(self) -> str:
        return one_line(self, str(self).partition("\n")[0])

    def _repr_html_(self) -> str:
        return preformatted(str(self))
