"""Names that C, MATLAB and CasADi accept, from names of models and signals."""

import keyword
import re
from collections.abc import Iterable

C_WORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while".split()
)


def identifier(name: str) -> str:
    """Return a name of letters, digits and single underscores that begins with a letter."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    # Names of CasADi, C and MATLAB begin with a letter; MATLAB also refuses a leading underscore.
    plain = plain if plain[:1].isalpha() else f"m_{plain}".rstrip("_")
    return f"{plain}_" if plain in C_WORDS or keyword.iskeyword(plain) else plain


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return a different identifier for every name."""
    names_in_use: dict[str, str] = {}
    for name in names:
        plain, k = identifier(name), 1
        # Two signals may differ only in characters that are left out, as a.b and a_b.
        while plain in names_in_use.values():
            k += 1
            plain = f"{identifier(name)}_{k}"
        names_in_use[name] = plain
    return names_in_use
