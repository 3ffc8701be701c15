"""Rational functions from a measured response by linear least squares, (3.17), and the choice of their orders.

Multiplying (2.13) = P by the denominator makes every frequency one complex equation that is linear in the unknown
coefficients: b(jω) - P [a(jω) - (jω)ⁿ] = P (jω)ⁿ. It needs no start, and so gives one. It minimizes |a(jω)| times the
error and not the error itself, which favors high frequencies.

Sources: Levy, Complex-curve fitting, IRE Trans. Automatic Control 4 (1959) 37-43 (who sets a0 = 1 where (2.13) sets
the highest coefficient to 1). Sanathanan and Koerner, Transfer function synthesis as a ratio of two complex
polynomials, IEEE Trans. Automatic Control 8 (1963) 56-58. Akaike, A new look at the statistical model identification,
IEEE Trans. Automatic Control 19 (1974) 716-723.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.text_table import counted, number, one_line, text_table
from greybox.formulation.frequency_criteria import RelativeError, evaluate

NEAR = 0.1  # relative distance below which a pole and a zero obviously cancel
RANK = 1e-12  # singular values smaller than this part of the largest are rounding


@dataclass(frozen=True)
class NearPair:
    """A zero and a pole (the upper ones of complex pairs), rad/s; `distance` is |zero - pole| / max(|zero|, |pole|)."""

    zero: complex
    pole: complex
    distance: float

    @property
    def stable(self) -> bool:
        """Whether both lie in the open left half plane; only then may they be cancelled."""
        return self.zero.real < 0 and self.pole.real < 0

    def __str__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        return f"{kind} zero {_root(self.zero)} and pole {_root(self.pole)}, {100 * self.distance:.2g} % apart"


@dataclass(frozen=True)
class Factored:
    """The factored form of (3.18) to (3.20): stable real poles as (T s + 1), all other factors monic.

    `zeros` holds c (rad/s) of every real factor (s + c) of the numerator, `zero_quadratics` (c1, c0) of every
    s² + c1 s + c0. In the denominator there are `integrators` factors s, `time_constants` T (s), smallest first,
    `unstable` c < 0 of (s + c), and `quadratics` like those of the numerator.
    """

    gain: float
    zeros: tuple[float, ...]
    zero_quadratics: tuple[tuple[float, float], ...]
    integrators: int
    time_constants: tuple[float, ...]
    unstable: tuple[float, ...]
    quadratics: tuple[tuple[float, float], ...]

    def __str__(self) -> str:
        above = [_factor(c) for c in self.zeros] + [_factor(*c) for c in self.zero_quadratics]
        below = ["s"] * self.integrators + [f"({number(T, 4)} s + 1)" for T in self.time_constants]
        below += [_factor(c) for c in self.unstable] + [_factor(*c) for c in self.quadratics]
        return " ".join([number(self.gain, 4), *above]) + (f" / [{' '.join(below)}]" if below else "")


@dataclass(frozen=True, eq=False)
class RationalFit:
    """A rational function (2.13) fitted by `levy`.

    `numerator` (m + 1,) and monic `denominator` (n + 1,) have the highest power of s first; with `integrator` the last
    coefficient of the denominator is 0. `data` is what was fitted, `iterations` the number of reweightings.
    `cost` is the sum of relative errors (4.26), which is not what was minimized; NaN when the data hold a zero.
    `aic` is 2 n_ω ln(Σ|e|² / n_ω) + 2 k of the relative errors e = P/P̂ - 1, for k coefficients: Akaike's -2 ln L + 2 k
    for circular complex normal errors of one unknown relative size, without what is the same for all orders. The
    estimate does not minimize Σ|e|², so read small differences with care, and compare on the same data only.
    `condition` is the condition number of the equations with normalized columns, inf when one unknown is superfluous.
    """

    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]
    integrator: bool
    data: FrequencyResponse
    iterations: int
    cost: float
    aic: float
    condition: float

    @property
    def n(self) -> int:
        """Order of the denominator, the integrator included."""
        return len(self.denominator) - 1

    @property
    def m(self) -> int:
        """Order of the numerator."""
        return len(self.numerator) - 1

    @property
    def zeros(self) -> NDArray[np.complex128]:
        """Zeros, (m,) or fewer when leading coefficients vanish, rad/s."""
        return np.roots(self.numerator).astype(complex)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles, (n,), rad/s."""
        return np.roots(self.denominator).astype(complex)

    @property
    def factored(self) -> Factored:
        """Gain, zeros, time constants and quadratics as (3.18) prints them."""
        return factored(self.numerator, self.denominator)

    @property
    def near_pairs(self) -> tuple[NearPair, ...]:
        """Poles and zeros closer than `NEAR`, stable or not, the closest first."""
        return near_pairs(self.zeros, self.poles)

    @property
    def determined(self) -> bool:
        """False when the data leave the coefficients open, as orders above those of noise-free data do."""
        return self.condition < 1 / RANK

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients by the names of the model `Polynomial(n, m, integrator)`: a start for its fit."""
        b = {f"b{k}": float(value) for k, value in enumerate(self.numerator[::-1])}
        a = {f"a{k}": float(value) for k, value in enumerate(self.denominator[:0:-1])}
        return b | {name: value for name, value in a.items() if not (self.integrator and name == "a0")}

    def response(self, omega: ArrayLike) -> FrequencyResponse:
        """Evaluate P(jω) at `omega` (k,) in rad/s."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        values = np.polyval(self.numerator, 1j * omega) / np.polyval(self.denominator, 1j * omega)
        names = self.data.input, self.data.output, f"least squares ({self.n}, {self.m})"
        return FrequencyResponse(omega, values, input=names[0], output=names[1], name=names[2], source="model")

    def __repr__(self) -> str:
        return one_line(self, f"n = {self.n}, m = {self.m}", f"cost {number(self.cost)}")

    def __str__(self) -> str:
        how = f"reweighted {counted(self.iterations, 'time')}" if self.iterations else "not reweighted"
        roots = [("zero", z) for z in _upper(self.zeros)] + [("pole", p) for p in _upper(self.poles)]
        damping = [number(-root.real / abs(root), 3) if root else "-" for _, root in roots]
        rows = [(kind, _root(r), number(abs(r), 4), d) for (kind, r), d in zip(roots, damping, strict=True)]
        lines = [
            f"linear least squares (3.17), n = {self.n}, m = {self.m}"
            f"{', with integrator' if self.integrator else ''}, {len(self.data)} frequencies, {how}",
            f"P(s) = {self.factored}",
            text_table(("", "rad/s", "size", "damping"), rows),
            f"cost (4.26) {number(self.cost)}, AIC {number(self.aic, 4)}",
            *(f"nearly cancel: {pair}" for pair in self.near_pairs),
        ]
        if not self.determined:
            lines.append("the data leave the coefficients open: the equations are rank deficient, lower n and m.")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class OrderPath:
    """The `steps` of `order_path`, why each was left or is the last, and the distance below which a pair counts."""

    steps: tuple[RationalFit, ...]
    reasons: tuple[str, ...]
    tolerance: float = NEAR

    @property
    def pairs(self) -> tuple[tuple[NearPair, ...], ...]:
        """The nearly cancelling pairs of every step, stable or not."""
        return tuple(near_pairs(step.zeros, step.poles, self.tolerance) for step in self.steps)

    @property
    def fit(self) -> RationalFit:
        """Where the path ends."""
        return self.steps[-1]

    @property
    def orders(self) -> tuple[tuple[int, int], ...]:
        """(n, m) of every step."""
        return tuple((step.n, step.m) for step in self.steps)

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.steps), "step"), f"ends at (n, m) = {self.orders[-1]}")

    def __str__(self) -> str:
        marks = [""] * (len(self.steps) - 1) + [f"<- ends here: {self.reasons[-1]}"]
        stable = [sum(pair.stable for pair in pairs) for pairs in self.pairs]
        counted = [(str(k), str(len(pairs) - k)) for k, pairs in zip(stable, self.pairs, strict=True)]
        rows = [
            (*map(str, (step.n, step.m)), number(step.cost), number(step.aic, 4), *counts, mark or reason)
            for step, counts, reason, mark in zip(self.steps, counted, self.reasons, marks, strict=True)
        ]
        header = ("n", "m", "cost (4.26)", "AIC", "stable pairs", "unstable", "lowered because of")
        return text_table(header, rows, left=(6,)) + f"\nP(s) = {self.fit.factored}"


def levy(
    data: FrequencyResponse,
    n: int,
    m: int,
    integrator: bool = False,
    *,
    weight: ArrayLike | None = None,
    iterations: int = 0,
) -> RationalFit:
    """Fit (2.13) of chosen orders to `data` by linear least squares, (3.17), as the paper does.

    Real and imaginary part of b(jω) - P [a(jω) - (jω)ⁿ] = P (jω)ⁿ at the n_ω frequencies are 2 n_ω equations. Their
    columns are normalized before they are solved, which changes the rounding and not the solution. Where the equations
    are rank deficient the solution of least norm (of the normalized unknowns) is taken; see `determined`. The result is
    a start for the model: ``gb.fit(problem, starts=[levy(data, 4, 1).coefficients, gb.solve.Sobol(100)])``.

    Parameters
    ----------
    data : FrequencyResponse
        The measured response P = α + jβ.
    n, m : int
        Orders of denominator and numerator, 0 <= m < n. `n` counts the integrator: (3.20) is n=4, m=1 with integrator.
    integrator : bool
        Whether the denominator has the factor s, so that a0 = 0 is no unknown.
    weight : (n_ω,) array, optional
        Factors of the equations, above 0, e.g. ``1 / abs(data.response)``. Default: all one, as in the paper.
    iterations : int
        How often to solve again with the equations also divided by |a(jω)| of the solution before (Sanathanan and
        Koerner 1963), which leads from the equation error towards the error of the response.

    Raises
    ------
    ValueError
        For orders that are no whole numbers with 0 <= m < n, or that have as many unknowns as equations or more (the
        paper's 2 n_ω > n + m + 1; one unknown less with integrator), and for weights or iterations out of range.
    """
    _check_orders(data, n, m, integrator)
    weights = _check_weight(weight, data)
    _check_whole("iterations", iterations, 0)
    numerator, denominator, condition = _solve(data, n, m, integrator, weights)
    for _ in range(iterations):
        size = np.abs(np.polyval(denominator, 1j * data.omega))
        numerator, denominator, condition = _solve(data, n, m, integrator, weights / size)
    numerator.flags.writeable = denominator.flags.writeable = False
    model = np.polyval(numerator, 1j * data.omega) / np.polyval(denominator, 1j * data.omega)
    cost, aic = evaluate(RelativeError(), model, data), _aic(model, data, n + m + 1 - bool(integrator))
    return RationalFit(numerator, denominator, bool(integrator), data, iterations, cost, aic, condition)


def order_path(
    data: FrequencyResponse,
    n: int,
    m: int,
    integrator: bool = False,
    *,
    tolerance: float = NEAR,
    unstable: bool = False,
    **options: Any,
) -> OrderPath:
    """Lower the orders from `n` and `m` until no stable pole and zero obviously cancel, the paper's way (section 3).

    Fit at the given orders. If a stable zero and a stable pole are closer than `tolerance`, or the equations are rank
    deficient (orders too high for noise-free data, where the place of the superfluous pair is arbitrary), lower both
    orders by one and fit again; otherwise, or at m = 0, end. So n - m stays what it was. The paper does not say how
    close is obvious; nothing here looks at cost or AIC, which the table shows beside. On the tables of the paper the
    rule does not lead down to the paper's (4, 1): look at several beginnings.

    Parameters
    ----------
    data, n, m, integrator, **options
        As for `levy`, with its `weight` and `iterations`; the highest orders to begin with.
    tolerance : float
        Relative distance |zero - pole| / max(|zero|, |pole|) below which a pair obviously cancels, in (0, 1].
    unstable : bool
        Whether unstable pairs count as well. The paper names stable ones only, since cancelling an unstable pole hides
        it; but a pair that fits the noise falls to either side of the axis by chance.

    Raises
    ------
    ValueError
        As `levy`, and for a tolerance out of range.
    """
    if not 0 < tolerance <= 1:
        raise ValueError(f"tolerance is {tolerance}: it is a relative distance, give a number above 0 and at most 1.")
    steps, reasons = [levy(data, n, m, integrator, **options)], []
    while reason := _superfluous(steps[-1], tolerance, unstable):
        if steps[-1].m == 0:
            reason += ", but m is 0"
            break
        reasons.append(reason)
        steps.append(levy(data, steps[-1].n - 1, steps[-1].m - 1, integrator, **options))
    end = f"no {'' if unstable else 'stable '}pair within {100 * tolerance:g} %"
    return OrderPath(tuple(steps), (*reasons, reason or end), tolerance)


def near_pairs(zeros: ArrayLike, poles: ArrayLike, tolerance: float = NEAR) -> tuple[NearPair, ...]:
    """Match zeros and poles that are closer than `tolerance`, each used once, the closest first.

    Complex ones are matched in the upper half plane, one `NearPair` for a conjugate pair. Since the distance is
    relative, a zero near the origin does not cancel an integrator unless it is zero itself.
    """
    above, below = _upper(zeros), _upper(poles)
    sizes = [(z, p, max(abs(z), abs(p))) for z in above for p in below]
    found = [NearPair(z, p, abs(z - p) / size if size else 0.0) for z, p, size in sizes]
    taken: list[NearPair] = []
    for pair in sorted(found, key=lambda pair: pair.distance):
        if pair.distance < tolerance and pair.zero in above and pair.pole in below:
            taken.append(pair)
            above.remove(pair.zero)
            below.remove(pair.pole)
    return tuple(taken)


def factored(numerator: Sequence[float] | NDArray[Any], denominator: Sequence[float] | NDArray[Any]) -> Factored:
    """Factor a ratio of real polynomials (highest power of s first) into the form of (3.18)."""
    above, below = np.trim_zeros(np.asarray(numerator, float), "f"), np.asarray(denominator, float)
    zeros, poles = _upper(np.roots(above)), _upper(np.roots(below))
    quadratics = [tuple((-2 * r.real, abs(r) ** 2) for r in roots if r.imag > 0) for roots in (zeros, poles)]
    real = [float(p.real) for p in poles if p.imag == 0]
    constants = tuple(sorted(-1 / p for p in real if p < 0))
    return Factored(
        gain=float(above[0] / below[0]) * math.prod(constants) if above.size else 0.0,
        zeros=tuple(0.0 - z.real for z in zeros if z.imag == 0),
        zero_quadratics=quadratics[0],
        integrators=real.count(0.0),
        time_constants=constants,
        unstable=tuple(-p for p in real if p > 0),
        quadratics=quadratics[1],
    )


def _solve(
    data: FrequencyResponse, n: int, m: int, integrator: bool, weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return numerator (m + 1,), denominator (n + 1,) and condition number of the equations with `weights` (n_ω,)."""
    powers = (1j * data.omega[:, None]) ** np.arange(n, -1, -1) * weights[:, None]
    response = data.response[:, None] * powers
    equations = np.hstack([powers[:, n - m :], -response[:, 1 : n + 1 - integrator]])
    matrix, right = (np.concatenate([part.real, part.imag]) for part in (equations, response[:, 0]))
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    normalized, _, _, singular = np.linalg.lstsq(matrix / scale, right, rcond=RANK)
    solution = normalized / scale
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else math.inf
    return solution[: m + 1], np.concatenate([[1.0], solution[m + 1 :], np.zeros(int(integrator))]), condition


def _aic(model: NDArray[np.complex128], data: FrequencyResponse, unknowns: int) -> float:
    """-2 ln L of circular complex normal relative errors at their most likely size is 2 n ln(mean |e|²) + const."""
    if np.any(data.response == 0):
        return math.nan
    mean = float(np.mean(np.abs(model / data.response - 1) ** 2))
    return 2 * len(data) * math.log(mean) + 2 * unknowns if mean > 0 else -math.inf


def _superfluous(fit: RationalFit, tolerance: float, unstable: bool) -> str:
    """Say why the orders are obviously too high; empty when they are not."""
    if not fit.determined:
        return "rank deficient"
    return next((str(p) for p in near_pairs(fit.zeros, fit.poles, tolerance) if p.stable or unstable), "")


def _check_orders(data: FrequencyResponse, n: int, m: int, integrator: bool) -> None:
    _check_whole("n", n, 1)
    _check_whole("m", m, 0)
    if m >= n:
        raise ValueError(f"m = {m} is not below n = {n}: (2.13) needs m < n, lower m or raise n.")
    unknowns = n + m + 1 - bool(integrator)
    if 2 * len(data) <= unknowns:
        raise ValueError(
            f"{len(data)} frequencies give {2 * len(data)} equations for the {unknowns} unknowns of n = {n}, m = {m}: "
            "(3.17) needs more equations than unknowns, lower n and m or add frequencies."
        )


def _check_whole(name: str, value: int, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} is {value!r}: give a whole number of at least {least}.")


def _check_weight(weight: ArrayLike | None, data: FrequencyResponse) -> NDArray[np.float64]:
    weights = np.ones(len(data)) if weight is None else np.asarray(weight, dtype=float)
    if weights.shape != (len(data),):
        raise ValueError(f"weight has shape {weights.shape} for {len(data)} frequencies: give one number for each.")
    for omega, value in zip(data.omega, weights, strict=True):
        if not 0 < value < math.inf:
            raise ValueError(f"weight is {value:g} at omega = {omega:g} rad/s: it must be above 0, or omit the point.")
    return weights


def _upper(roots: ArrayLike) -> list[complex]:
    """Roots without the lower one of each conjugate pair, smallest first."""
    return sorted((complex(r) for r in np.atleast_1d(np.asarray(roots)) if r.imag >= 0), key=abs)


def _factor(*coefficients: float) -> str:
    """Write s + c, or s² + c1 s + c0, in brackets."""
    powers = ("",) if len(coefficients) == 1 else (" s", "")
    terms = [f" {'-' if c < 0 else '+'} {number(abs(c), 4)}{s}" for c, s in zip(coefficients, powers, strict=True) if c]
    text = ("s", "s²")[len(coefficients) - 1] + "".join(terms)
    return f"({text})" if terms else text


def _root(root: complex) -> str:
    return number(root.real, 4) + (f" ± {number(root.imag, 4)}j" if root.imag else "")
