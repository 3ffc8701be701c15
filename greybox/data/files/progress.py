"""Progress bars with the remaining time, in terminals and notebooks, after two seconds."""

import sys
from collections.abc import Iterable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

DELAY = 2  # s; shorter work needs no bar


def bar(items: Iterable[Any] | None = None, *, is_shown: bool = True, **options: Any) -> Any:
    """Return the items under a bar; without items it moves by ``bar.update(count)``.

    The options, such as ``total``, ``desc`` and ``unit``, are those of tqdm.
    """
    # A file or a pipe gets no bar. A notebook is neither a terminal nor a file.
    in_notebook = "ipykernel" in sys.modules
    hidden = (None if not in_notebook else False) if is_shown else True
    tqdm = import_module("tqdm.auto" if in_notebook and find_spec("ipywidgets") else "tqdm").tqdm
    # A terminal that states no size, as some remote ones do, would show no bar.
    return tqdm(items, disable=hidden, delay=DELAY, leave=False, nrows=24, **options)
