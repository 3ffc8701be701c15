"""Names that C and CasADi accept, from names of models."""

import keyword
import re

C_WORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while".split()
)


def identifier(name: str) -> str:
    """Return a name of letters, digits and single underscores that begins with a letter."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    # Names of CasADi begin with a letter.
    plain = plain if plain[:1].isalpha() else f"m_{plain}".rstrip("_")
    return f"{plain}_" if plain in C_WORDS or keyword.iskeyword(plain) else plain
