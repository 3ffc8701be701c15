"""Numbers as a person reads them: rounded, with their errors, in percent."""

import math


def number(value: float | None, digits: int = 5) -> str:
    """Format `value` with `digits` significant digits; NaN and None are a dash.

    Rounded numbers have no exponent where that is readable: 180, not 1.8e+02.
    """
    if value is None or math.isnan(value):
        return "-"
    return f"{float(f'{value:.{digits}g}'):.{max(digits, 6)}g}"


def percent(share: float) -> str:
    """Return a share in percent with two digits."""
    return number(100 * share, 2)


def probability(p: float) -> str:
    """Format a p-value with two digits; below 0.0001 they would say more than a test knows."""
    return "< 0.0001" if p < 1e-4 else number(p, 2)


def p_text(p: float) -> str:
    """Return a p-value as text for a sentence."""
    text = probability(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def with_error(value: float, error: float) -> tuple[str, str]:
    """Format a standard error with two significant digits, and the value to its last digit.

    A value that this rounding would change by more than 5 % has two significant digits.
    """
    if not (math.isfinite(value) and math.isfinite(error)) or error <= 0:
        return number(value), "-"
    # With the digits of such an error, the value would have none, or more than a person reads.
    if error > 1e9 * abs(value) or error < 1e-9 * abs(value):
        return number(value if error < abs(value) else 0.0), number(error, 2)
    # Rounded first: 0.0996 has its two digits in 0.10, one place further left.
    decimals = 1 - math.floor(math.log10(float(f"{error:.1e}")))
    if not -4 <= decimals <= 7 or abs(value) >= 1e7:
        return (
            f"{value:.{max(2, math.floor(math.log10(abs(value))) + decimals + 1)}g}",
            f"{error:.2g}",
        )
    digits = decimals
    if abs(round(value, digits) - value) > 0.05 * abs(value):
        # 12 ± 340 and not 10 ± 340: the estimate belongs to the answer, however large its error.
        digits = 1 - math.floor(math.log10(abs(value)))

    return _rounded(value, digits), _rounded(error, decimals)


def _rounded(value: float, decimals: int) -> str:
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def is_number(cell: str) -> bool:
    """Return whether a cell of a table is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
