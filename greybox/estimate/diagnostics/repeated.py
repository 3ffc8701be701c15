"""A sentence that holds for many records is said once."""

from collections.abc import Iterable, Iterator

from greybox.files.text_table import some

Found = tuple[str, str, str]
"""What kind of thing was found, the name of the data, and the sentence."""

FEW = 3  # sets of data of which something is told of each


def once(found: Iterable[Found]) -> Iterator[str]:
    """Yield sentences; where many are of one kind the first, with how many more sets of data there are, and which."""
    kinds: dict[str, list[tuple[str, str]]] = {}
    for kind, name, text in found:
        kinds.setdefault(kind, []).append((name, text))
    for alike in kinds.values():
        if len(alike) <= FEW:
            yield from (text for _, text in alike)
            continue
        others = list(dict.fromkeys(repr(name) for name, _ in alike[1:]))
        yield f"{alike[0][1].removesuffix('.')}; the same holds for {len(alike) - 1} more ({some(others)})."
