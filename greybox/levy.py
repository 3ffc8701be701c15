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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.criterion import RelativeError, evaluate
from greybox.frequency_response import FrequencyResponse
from greybox.table import number, text_table

NEAR = 0.1  # relative distance below which a pole and a zero obviously cancel
RANK = 1e-12  # singular values smaller than this part of the largest are rounding


@dataclass(frozen=True)
class NearPair:
    """A zero and a pole that nearly cancel.

    Attributes
    ----------
    zero, pole : complex, rad/s
        Of a complex pair the one with positive imaginary part.
    distance : float
        |zero - pole| / max(|zero|, |pole|).
    """

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

    Attributes
    ----------
    gain : float
        The number in front of the factors.
    zeros : tuple of float, rad/s
        c of every real factor (s + c) of the numerator.
    zero_quadratics : tuple of (float, float)
        (c1, c0) of every factor s² + c1 s + c0 of the numerator, rad/s and rad²/s².
    integrators : int
        How many poles are zero.
    time_constants : tuple of float, s
        T of every stable real pole (T s + 1), smallest first.
    unstable : tuple of float, rad/s
        c < 0 of every unstable real pole (s + c).
    quadratics : tuple of (float, float)
        (c1, c0) of every factor s² + c1 s + c0 of the denominator, rad/s and rad²/s².
    """

    gain: float
    zeros: tuple[float, ...]
    zero_quadratics: tuple[tuple[float, float], ...]
    integrators: int
    time_constants: tuple[float, ...]
    unstable: tuple[float, ...]
    quadratics: tuple[tuple[float, float], ...]

    def __str__(self) -> str:
        above = [_monic(c) for c in self.zeros] + [_quadratic(*c) for c in self.zero_quadratics]
        below = ["s"] * self.integrators + [f"({number(T, 4)} s + 1)" for T in self.time_constants]
        below += [_monic(c) for c in self.unstable] + [_quadratic(*c) for c in self.quadratics]
        return " ".join([number(self.gain, 4), *above]) + (f" / [{' '.join(below)}]" if below else "")


@dataclass(frozen=True, eq=False)
class RationalFit:
    """A rational function (2.13) fitted by `levy`.

    Attributes
    ----------
    numerator, denominator : arrays (m + 1,), (n + 1,)
        Coefficients, highest power of s first; the denominator is monic and, with `integrator`, ends in 0.
    integrator : bool
        Whether the denominator was given the factor s, which `n` counts.
    points : int
        Number of frequencies of the data.
    iterations : int
        How often the equations were reweighted.
    cost : float
        Sum of relative errors (4.26) on the data, which is not what was minimized; NaN when the data hold a zero.
    aic : float
        Akaike's criterion 2 n_ω ln(Σ|e|² / n_ω) + 2 k of the relative errors e = P/P̂ - 1, for k coefficients: minus
        twice the log likelihood of circular complex normal errors of one unknown relative size, plus twice the number
        of unknowns, without what is the same for all orders. The estimate does not minimize Σ|e|², so read small
        differences with care, and compare on the same data only.
    condition : float
        Condition number of the equations, their columns normalized; inf when one is exactly superfluous.
    """

    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]
    integrator: bool
    points: int
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

    def response(self, omega: ArrayLike) -> NDArray[np.complex128]:
        """Evaluate P(jω) at `omega` (k,) in rad/s."""
        s = 1j * np.atleast_1d(np.asarray(omega, dtype=float))
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)

    def __str__(self) -> str:
        how = f"reweighted {self.iterations} times" if self.iterations else "not reweighted"
        rows = [("zero", *_root_cells(z)) for z in _upper(self.zeros)]
        rows += [("pole", *_root_cells(p)) for p in _upper(self.poles)]
        lines = [
            f"linear least squares (3.17), n = {self.n}, m = {self.m}"
            f"{', with integrator' if self.integrator else ''}, {self.points} frequencies, {how}",
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
    """The orders that `order_path` visited.

    Attributes
    ----------
    steps : tuple of RationalFit
        One for each pair of orders, in the order visited.
    reasons : tuple of str
        Why each step was left; for the last, why it is the last.
    tolerance : float
        Relative distance below which a pair counts.
    """

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

    def __str__(self) -> str:
        marks = [""] * (len(self.steps) - 1) + [f"<- ends here: {self.reasons[-1]}"]
        rows = [
            (str(step.n), str(step.m), number(step.cost), number(step.aic, 4), *_counts(pairs), mark or reason)
            for step, pairs, reason, mark in zip(self.steps, self.pairs, self.reasons, marks, strict=True)
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
    are rank deficient the solution of least norm (of the normalized unknowns) is taken; see `determined`.

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

    Returns
    -------
    RationalFit
        Its `coefficients` are a start: ``gb.fit(problem, starts=[levy(data, 4, 1).coefficients, gb.Sobol(100)])``.

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
    return _rational_fit(data, numerator, denominator, integrator, iterations=iterations, condition=condition)


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
    close is obvious; nothing here looks at cost or AIC, which the table shows beside.

    Parameters
    ----------
    data, n, m, integrator
        As for `levy`; the highest orders to begin with.
    tolerance : float
        Relative distance |zero - pole| / max(|zero|, |pole|) below which a pair obviously cancels, in (0, 1].
    unstable : bool
        Whether unstable pairs count as well. The paper names stable ones only, since cancelling an unstable pole hides
        it; but a pair that fits the noise falls to either side of the axis by chance.
    **options
        `weight` and `iterations` of `levy`.

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
    kind = "pair" if unstable else "stable pair"
    return OrderPath(tuple(steps), (*reasons, reason or f"no {kind} within {100 * tolerance:g} %"), tolerance)


def near_pairs(zeros: ArrayLike, poles: ArrayLike, tolerance: float = NEAR) -> tuple[NearPair, ...]:
    """Match zeros and poles that are closer than `tolerance`, each used once, the closest first.

    Complex ones are matched in the upper half plane, one `NearPair` for a conjugate pair. Since the distance is
    relative, a zero near the origin does not cancel an integrator unless it is zero itself.
    """
    above, below = _upper(zeros), _upper(poles)
    found = [NearPair(complex(z), complex(p), _distance(z, p)) for z in above for p in below]
    taken: list[NearPair] = []
    free_zeros, free_poles = list(above), list(below)
    for pair in sorted(found, key=lambda pair: pair.distance):
        if pair.distance < tolerance and pair.zero in free_zeros and pair.pole in free_poles:
            taken.append(pair)
            free_zeros.remove(pair.zero)
            free_poles.remove(pair.pole)
    return tuple(taken)


def factored(numerator: Sequence[float] | NDArray[Any], denominator: Sequence[float] | NDArray[Any]) -> Factored:
    """Factor a ratio of real polynomials (highest power of s first) into the form of (3.18)."""
    above, below = np.trim_zeros(np.asarray(numerator, float), "f"), np.asarray(denominator, float)
    zeros, poles = _upper(np.roots(above)), _upper(np.roots(below))
    real = [float(p.real) for p in poles if p.imag == 0]
    constants = tuple(sorted(-1 / p for p in real if p < 0))
    lead = float(above[0] / below[0]) if above.size else 0.0
    return Factored(
        gain=lead * math.prod(constants),
        zeros=_offsets(z.real for z in zeros if z.imag == 0),
        zero_quadratics=_quadratics(zeros),
        integrators=real.count(0.0),
        time_constants=constants,
        unstable=_offsets(p for p in real if p > 0),
        quadratics=_quadratics(poles),
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
    solution, _, _, singular = np.linalg.lstsq(matrix / scale, right, rcond=RANK)
    solution = solution / scale
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else math.inf
    return solution[: m + 1], np.concatenate([[1.0], solution[m + 1 :], np.zeros(int(integrator))]), condition


def _rational_fit(
    data: FrequencyResponse,
    numerator: NDArray[np.float64],
    denominator: NDArray[np.float64],
    integrator: bool,
    **about: Any,
) -> RationalFit:
    s = 1j * data.omega
    model = np.polyval(numerator, s) / np.polyval(denominator, s)
    unknowns = len(numerator) + len(denominator) - 1 - integrator
    for values in (numerator, denominator):
        values.setflags(write=False)
    return RationalFit(
        numerator,
        denominator,
        integrator=bool(integrator),
        points=len(data),
        cost=evaluate(RelativeError(), model, data),
        aic=_aic(model, data, unknowns),
        **about,
    )


def _aic(model: NDArray[np.complex128], data: FrequencyResponse, unknowns: int) -> float:
    """-2 ln L of circular complex normal relative errors at their most likely size is 2 n ln(mean |e|²) + const."""
    if np.any(data.response == 0):
        return math.nan
    mean = float(np.mean(np.abs(model / data.response - 1) ** 2))
    return 2 * len(data) * math.log(mean) + 2 * unknowns if mean > 0 else -math.inf


def _superfluous(fit: RationalFit, tolerance: float, unstable: bool) -> str:
    """Say why the orders are obviously too high; empty when they are not."""
    pairs = [p for p in near_pairs(fit.zeros, fit.poles, tolerance) if p.stable or unstable]
    if not fit.determined:
        return "rank deficient"
    return str(pairs[0]) if pairs else ""


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
    bad = np.flatnonzero(~(np.isfinite(weights) & (weights > 0)))
    if bad.size:
        raise ValueError(
            f"weight is {weights[bad[0]]:g} at omega = {data.omega[bad[0]]:g} rad/s: give finite numbers above 0, "
            "and leave out the points that shall not count."
        )
    return weights


def _upper(roots: ArrayLike) -> list[complex]:
    """Roots without the lower one of each conjugate pair, smallest first."""
    return sorted((complex(r) for r in np.atleast_1d(np.asarray(roots)) if r.imag >= 0), key=abs)


def _distance(zero: complex, pole: complex) -> float:
    return abs(zero - pole) / max(abs(zero), abs(pole)) if zero != pole else 0.0


def _offsets(roots: Iterable[float]) -> tuple[float, ...]:
    return tuple(0.0 - float(r) for r in roots)


def _quadratics(roots: list[complex]) -> tuple[tuple[float, float], ...]:
    return tuple((-2 * r.real, abs(r) ** 2) for r in roots if r.imag > 0)


def _term(value: float, power: str = "") -> str:
    return f" {'-' if value < 0 else '+'} {number(abs(value), 4)}{power}"


def _monic(c: float) -> str:
    return f"(s{_term(c)})" if c else "s"


def _quadratic(c1: float, c0: float) -> str:
    return f"(s²{_term(c1, ' s')}{_term(c0)})"


def _root(root: complex) -> str:
    return number(root.real, 4) + (f" ± {number(root.imag, 4)}j" if root.imag else "")


def _root_cells(root: complex) -> tuple[str, str, str]:
    size = abs(root)
    return _root(root), number(size, 4), number(-root.real / size, 3) if size else "-"


def _counts(pairs: tuple[NearPair, ...]) -> tuple[str, str]:
    stable = sum(pair.stable for pair in pairs)
    return str(stable), str(len(pairs) - stable)
