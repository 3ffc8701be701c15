"""A transfer function by its polynomial coefficients, (2.13), with or without an integrator."""

import math

import greybox as gb

LARGEST_ORDER = 100  # with the default radius, the bounds of the coefficients overflow at 177


class Polynomial(gb.TransferFunction):
    r"""Ratio of two polynomials of given orders, (2.13).

    $$P(s) = \frac{b_m s^m + \dots + b_0}{s^n + a_{n-1} s^{n-1} + \dots + a_0}, \qquad m < n$$

    With integrators the denominator has as many factors $s$: $a_0$ and so on are zero and not
    parameters. With `delay` it is multiplied by $e^{-s T_{delay}}$. The default orders are those of
    (3.18) and (3.19); (3.20) is ``Polynomial(4, 1, integrator=True)``.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (2.13).

    Parameters
    ----------
    n, m : int
        Orders of the denominator, integrators included, and of the numerator.
    integrator : bool or int
        How many factors s the denominator has.
    radius : float
        Magnitude of poles and zeros, in rad/s, that sets the bounds of the coefficients.
    starts : float
        Magnitude of poles and zeros, in rad/s, that sets the box in which starts are drawn.
    output, input : str
        Names in the data.
    delay : float
        The largest delay, s; zero is none.

    Raises
    ------
    ValueError
        Unless the orders are integers with 0 <= m < n, there are at most n integrators, 0 < starts
        <= radius, and the delay is not below zero.
    """

    def __init__(
        self,
        n=4,
        m=1,
        integrator=False,
        radius=50.0,
        starts=20.0,
        output="y",
        delay=0.0,
        *,
        input="u",
    ):
        _require_order("n", n, 1)
        _require_order("m", m, 0)
        if m >= n:
            raise ValueError(
                f"m = {m} is not below n = {n}: (2.13) needs m < n. Lower m or raise n."
            )
        if not 0 < starts <= radius < math.inf:
            raise ValueError(
                f"starts = {starts} and radius = {radius} must be finite with 0 < starts <= "
                f"radius, in rad/s."
            )
        if not isinstance(integrator, int) or not 0 <= integrator <= n or not 0 <= delay < math.inf:
            raise ValueError(
                f"integrator = {integrator} and delay = {delay}: give from 0 to n = {n} "
                f"integrators and a finite delay "
                "from 0 on, in s."
            )
        self.n = n
        self.m = m
        self.integrator = int(integrator)
        self.delay = delay
        self.input = input
        self.output = output
        numerator = {f"b{k}": _coefficient(k, m, n, radius, starts) for k in range(m + 1)}
        denominator = {
            f"a{k}": _coefficient(k, n, n, radius, starts) for k in range(self.integrator, n)
        }
        self.parameters = numerator | denominator
        if delay:
            self.parameters["T_delay"] = gb.Parameter(
                0.1 * delay, bounds=(0, delay), starts=(0, 0.5 * delay), unit="s", about="delay"
            )

    @property
    def label(self):
        factors = ("", ", integrator", f", {self.integrator} integrators")[min(self.integrator, 2)]
        return f"Polynomial({self.n}, {self.m}{factors}{', delay' if self.delay else ''})"

    def response(self, s, p):
        b = [p[f"b{k}"] for k in range(self.m + 1)]
        a = [p.get(f"a{k}", 0.0) for k in range(self.n)]
        value = _value(b, s) / _value([*a, 1.0], s)
        return value * gb.exp(-s * p.T_delay) if self.delay else value


def _coefficient(k, order, n, radius, starts):
    """One coefficient of s^k: at most C(order, k) r^(n-k) if no pole or zero is larger than r."""
    combinations = math.comb(order, k)
    power = n - k
    return gb.Parameter(
        combinations * (starts / 10) ** power,
        bounds=(-combinations * radius**power, combinations * radius**power),
        starts=(-combinations * starts**power, combinations * starts**power),
        unit="1/s" + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(d)] for d in str(power) if power > 1),
        about=f"coefficient of s^{k} in the {'denominator' if order == n else 'numerator'}",
        has_computed_bounds=True,
    )


def _value(coefficients, s):
    """Horner's rule, lowest power first."""
    result = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        result = result * s + c
    return result


def _require_order(name, order, least):
    if isinstance(order, bool) or not isinstance(order, int) or order < least:
        raise ValueError(
            f"{name} = {order!r} is not the order of a polynomial: give an integer of at least "
            f"{least}."
        )
    if order > LARGEST_ORDER:
        raise ValueError(
            f"{name} = {order} is too large: give an order of at most {LARGEST_ORDER}."
        )
