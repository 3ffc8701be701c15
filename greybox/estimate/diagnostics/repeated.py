"""One sentence in place of many alike, where a finding applies to many records."""

from collections.abc import Iterator
from operator import itemgetter

from greybox.files.grouping import grouped
from greybox.files.text_table import Sentences, some

Finding = tuple[str, str, str]
"""The kind of a finding, the name of the data, and the sentence."""
Findings = Iterator[Finding]


def once(findings: Findings) -> Sentences:
    """Yield up to three sentences of each kind; of more, the first and the other data by name."""
    for alike in grouped(findings, itemgetter(0)):
        if len(alike) <= 3:
            yield from (text for *_, text in alike)
            continue
        names = list(dict.fromkeys(repr(name) for _, name, _ in alike[1:]))
        yield (
            f"{alike[0][2].removesuffix('.')}; the same applies to {len(alike) - 1} more "
            f"({some(names)})."
        )
