"""Progress bars with the remaining time, in terminals and notebooks, after two seconds."""

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

DELAY = 2  # s, before which no bar is worth a look


def bar(items: Iterable[Any] | None = None, *, is_shown: bool = True, **options: Any) -> Any:
    """Return the items under a bar; without items it moves by ``bar.update(count)``.

    The options, such as ``total``, ``desc`` and ``unit``, are those of tqdm.
    """
    # A file or a pipe gets no bar. A notebook is neither a terminal nor a file.
    hidden = (None if "ipykernel" not in sys.modules else False) if is_shown else True
    return tqdm(items, disable=hidden, delay=DELAY, leave=False, **options)
