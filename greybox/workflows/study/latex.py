"""Tables for a paper: LaTeX with the package booktabs."""

import re
from collections.abc import Sequence

from greybox.data.files.escapes import latex_text
from greybox.data.files.greek_letters import greek
from greybox.data.files.numbers_in_text import with_error

ACCENTS = ("tilde", "hat", "bar", "dot")


def latex_table(header: Sequence[str], rows: Sequence[Sequence[str]], texts: int) -> str:
    """Return a table of cells in LaTeX; the first columns, `texts` of them, are flush left."""
    body = [" & ".join(row) + r" \\" for row in rows]
    columns = "l" * texts + "r" * (len(header) - texts)
    begin = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", " & ".join(header) + r" \\"]
    return "\n".join([*begin, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"])


def latex_symbol(name: str, unit: str = "") -> str:
    """Return the name of a parameter as mathematics, followed by its unit."""
    # omega_p is omega with the index p, a1 is a with the index 1.
    base, *indices = re.findall("[^_]+|^_+$", name)
    if numbered := re.fullmatch(r"([^\W\d]+)(\d+)", base):
        base, digits = numbered.groups()
        indices = [digits, *indices]
    letter = latex_text(base) if len(base) == 1 else _upright(base)
    if indices and indices[-1] in ACCENTS:
        letter = f"\\{indices.pop()}{{{letter}}}"
    index = ",".join(map(_upright, indices))
    symbol = f"${letter}_{{{index}}}$" if indices else f"${letter}$"
    powers = re.sub(r"\\textasciicircum\{\}(-?\d+)", r"$^{\1}$", latex_text(unit))
    return f"{symbol} ({powers})" if unit not in ("", "1") else symbol


def _upright(name: str) -> str:
    """Return the macro of a Greek letter, or other letters upright."""
    # In italics letters side by side are a product. LaTeX has no macro for Greek letters that look
    # like Latin ones.
    is_greek = name != greek(name) in "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΥΦΨΩ"
    return f"\\{name}" if is_greek else f"\\mathrm{{{latex_text(name)}}}"


def latex_number(value: float | None, error: float | None = None) -> str:
    """Return a value with its standard error, each with its significant digits."""
    if value is None:
        return "--"
    texts = with_error(value, error or 0.0)
    powers = [
        re.sub(r"e([+-]\d+)", lambda e: rf" \cdot 10^{{{int(e[1])}}}", text) for text in texts
    ]
    return f"${powers[0]}$" if texts[1] == "-" else rf"${powers[0]} \pm {powers[1]}$"
