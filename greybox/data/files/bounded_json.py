"""Values of JSON, bounded in memory."""

import json
from typing import Any

# Values of JSON for every byte that they take in a file, and of small files. Fits that are stored
# compressed have at most 0.3. An object takes 250 bytes of memory at most, see SECURITY.md.
DENSITY = 1.0
FEW = 1000


def parsed(text: bytes, stored: int) -> Any:
    """Return the values of a JSON text that takes `stored` bytes of a file.

    Raises
    ------
    ValueError
        If it is no JSON, or has more values than a text of this size may have: as objects of
        Python they would take any memory.
    """
    # Before anything is parsed: every value but the first follows a comma or an opening bracket.
    # The commas of texts are counted, too, and are few.
    count = 1 + sum(map(text.count, (b",", b"[", b"{")))
    if count > DENSITY * stored + FEW:
        raise ValueError(f"it has {count} values in {stored} bytes, which is too many")
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deep") from None
