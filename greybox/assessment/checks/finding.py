"""What a check found, and one sentence in place of many alike."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from greybox.data.files.grouping import grouped
from greybox.data.files.public import public
from greybox.data.files.wording import some


@public
@dataclass(frozen=True)
class Finding:
    """A sentence of a check.

    Attributes
    ----------
    text : str
        One sentence: what was found, what it means for the values, and what to do.
    kind : str
        Equal for sentences that say the same of several records or responses, of which more than
        three become one. By default, the sentence stands for itself.
    part : str
        Name of the record or response that it concerns.
    is_note : bool
        True for a remark, which is no reason to doubt the values.

    Examples
    --------
    >>> print(gb.Finding("the phase was looked at.", is_note=True).text)
    the phase was looked at.
    """

    text: str
    kind: str = ""
    part: str = ""
    is_note: bool = False


Findings = Iterator[Finding]


def once(findings: Iterable[Finding]) -> Findings:
    """Yield up to three findings of each kind; of more, the first and the other data by name."""
    for alike in grouped(findings, lambda finding: finding.kind or id(finding)):
        first, *others = alike
        if len(others) < 3:
            yield from alike
            continue
        names = dict.fromkeys(repr(finding.part) for finding in others)
        text = (
            f"{first.text.removesuffix('.')}; the same applies to {len(others)} more "
            f"({some(list(names))})."
        )
        yield Finding(text, first.kind, first.part, first.is_note)
