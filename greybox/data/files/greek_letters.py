"""Greek letters for the names of parameters and signals."""

import re
import unicodedata


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
