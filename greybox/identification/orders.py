"""The orders of a rational transfer function, by maximum likelihood fits of a grid."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.fit import fit
from greybox.estimate.result import Fit
from greybox.files.text_table import counted, number, one_line, text_table
from greybox.formulation.frequency_criteria import MaximumLikelihood, RelativeLikelihood
from greybox.formulation.problem import Problem
from greybox.formulation.starts import Sobol
from greybox.modeling.model_reference import included_model
from greybox.regression.levy import levy
from greybox.regression.poles_and_zeros import NearPair, near_pairs
from greybox.validation.parsimony import parsimony, smallest_supported
from greybox.validation.same_data import count_numbers, count_unknowns


@dataclass(frozen=True)
class OrderCandidate:
    """One structure of the grid.

    Attributes
    ----------
    n, m, integrators : int
    delay : bool
    fit : Fit or None
        None where no start converged.
    bic : float
        NaN without a fit.
    pairs : tuple of NearPair
        Poles and zeros that nearly cancel.
    """

    n: int
    m: int
    integrators: int
    delay: bool
    fit: Fit | None
    bic: float
    pairs: tuple[NearPair, ...] = ()

    @property
    def parameters(self) -> int:
        """How many parameters it has."""
        return self.n - self.integrators + self.m + 1 + self.delay

    @property
    def label(self) -> str:
        """The structure in words."""
        integrators = f", {counted(self.integrators, 'integrator')}" if self.integrators else ""
        return f"n = {self.n}, m = {self.m}{integrators}{', delay' if self.delay else ''}"


@dataclass(frozen=True, eq=False)
class OrderSelection:
    """All structures of the grid. Printing it gives the table and the verdict.

    Attributes
    ----------
    candidates : tuple of OrderCandidate
        Those that have a fit, by number of parameters and BIC.
    chosen : OrderCandidate
        The one with the fewest parameters of those whose BIC is within 2 of the least.
    failed : int
        How many structures had no fit.
    """

    candidates: tuple[OrderCandidate, ...]
    chosen: OrderCandidate
    failed: int

    @property
    def fit(self) -> Fit:
        """The fit of the chosen structure."""
        assert self.chosen.fit is not None
        return self.chosen.fit

    @property
    def least(self) -> OrderCandidate:
        """The structure with the least BIC."""
        return min(self.candidates, key=lambda c: c.bic)

    @property
    def verdict(self) -> str:
        """The structure that the data support, in one sentence, and whether it is too large."""
        of = self.candidates
        _, text = parsimony([c.label for c in of], [c.bic for c in of], [c.parameters for c in of])
        pairs = (
            f"; but {self.chosen.pairs[0]}"
            if self.chosen.pairs
            else ", and no pole and zero nearly cancel"
        )
        return f"{text.removesuffix('.')}{pairs}."

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.candidates), "structure"), self.chosen.label)

    def __str__(self) -> str:
        rows = [
            [
                *map(str, (c.n, c.m, c.integrators)),
                "yes" if c.delay else "",
                str(c.parameters),
                number(c.fit.cost, 5) if c.fit else "-",
                number(round(c.bic - self.least.bic, 2), 4),
                str(len(c.pairs) or ""),
                "<- chosen" if c is self.chosen else "",
            ]
            for c in self.candidates
        ]
        header = ["n", "m", "integrators", "delay", "free", "-ln L", "BIC above", "pairs", ""]
        failed = [f"{counted(self.failed, 'structure')} had no fit."] if self.failed else []
        return "\n".join([text_table(header, rows, left=(3, 8)), "", self.verdict, *failed])


def select_orders(
    data: FrequencyResponse,
    n: Sequence[int] = (1, 2, 3, 4),
    m: Sequence[int] | None = None,
    integrators: Sequence[int] = (0, 1),
    delays: Sequence[float] = (0.0,),
    *,
    starts: int = 8,
    seed: int = 0,
) -> OrderSelection:
    """Fit rational transfer functions (2.13) of all these orders, and choose the smallest supported.

    Every structure is fitted by maximum likelihood: `MaximumLikelihood` where the data have
    variances, otherwise `RelativeLikelihood`. Starts are those of linear least squares, `levy`, and
    some points besides.

    Parameters
    ----------
    data : FrequencyResponse
    n : sequence of int
        Orders of the denominator, integrators included.
    m : sequence of int, optional
        Orders of the numerator, of which those below n are taken; by default all.
    integrators : sequence of int
    delays : sequence of float
        Largest delays, s; zero is a structure without one: ``(0.0, 0.1)`` tries both.
    starts, seed : int
        Sobol points beside those of `levy`.

    Raises
    ------
    ValueError
        If no structure of the grid has fewer unknowns than the data have numbers, or none has a
        fit.
    """
    grid = [
        (order, zeros, count, delay)
        for order in n
        for zeros in (range(order) if m is None else m)
        for count in integrators
        for delay in delays
        if zeros < order
        and count <= order
        and order - count + zeros + 1 + (delay > 0) + 1 < 2 * len(data)
    ]
    if not grid:
        raise ValueError(
            f"no structure of the grid has fewer unknowns than {2 * len(data)} real numbers: lower n."
        )
    tried = [_fitted(data, *structure, starts, seed) for structure in grid]
    candidates = sorted(
        (c for c in tried if c.fit is not None), key=lambda c: (c.parameters, c.bic)
    )
    if not candidates:
        raise ValueError(
            f"none of {counted(len(tried), 'structure')} has a fit: look at the response first."
        )
    k = smallest_supported([c.bic for c in candidates], [c.parameters for c in candidates])
    return OrderSelection(tuple(candidates), candidates[k], len(tried) - len(candidates))


def _fitted(
    data: FrequencyResponse, n: int, m: int, integrators: int, delay: float, starts: int, seed: int
) -> OrderCandidate:
    polynomial: Any = included_model("greybox.models.polynomial", "Polynomial")
    # Poles and zeros more than ten times above the highest frequency are constants there.
    highest = float(data.omega.max())
    model = polynomial(n, m, integrators, 10 * highest, highest, data.output or "y", delay)
    # The model's bounds are those of poles and zeros, for a gain of one.
    gain = float(np.max(np.abs(data.response)))
    scaled = {name: p for name, p in model.parameters.items() if name.startswith("b")}
    problem = Problem(
        model,
        data,
        MaximumLikelihood() if data.variance is not None else RelativeLikelihood(),
        bounds={n: (10 * gain * p.bounds[0], 10 * gain * p.bounds[1]) for n, p in scaled.items()},
        starts={n: (gain * p.box[0], gain * p.box[1]) for n, p in scaled.items()},
    )
    points = []
    for start in _linear_starts(data, n, m, integrators, delay):
        bounds = {name: problem.parameters[name].bounds for name in start}
        points.append({name: float(np.clip(v, *bounds[name])) for name, v in start.items()})
    result = fit(problem, [*points, Sobol(starts, seed)], profiles=False, progress=False)
    if not result.converged:
        return OrderCandidate(n, m, integrators, delay > 0, None, math.nan)
    numbers = sum(map(count_numbers, result.parts))
    bic = count_unknowns(result) * math.log(numbers) + 2 * result.cost
    zeros = np.roots([result.estimate[f"b{k}"] for k in range(m, -1, -1)])
    poles = np.roots([1.0, *(result.estimate[f"a{k}"] for k in range(n - 1, integrators - 1, -1))])
    return OrderCandidate(n, m, integrators, delay > 0, result, bic, near_pairs(zeros, poles))


def _linear_starts(
    data: FrequencyResponse, n: int, m: int, integrators: int, delay: float
) -> Iterator[dict[str, float]]:
    """Yield estimates by linear least squares, without the integrators and a share of the delay."""
    s = 1j * data.omega
    order = n - integrators
    if m >= order:  # as many zeros as poles beside the integrators, which Levy's form has not
        return
    for share in (0.0, 0.2, 0.5) if delay else (0.0,):
        response = data.response * s**integrators * np.exp(s * share * delay)
        bare = FrequencyResponse(data.omega, response)
        try:
            # After five reweightings it nearly minimizes the error of the response.
            rational = levy(bare, order, m, weight=1 / np.abs(response), iterations=5)
        except ValueError:  # as many unknowns as equations
            continue
        start = {f"b{k}": float(v) for k, v in enumerate(rational.numerator[::-1])}
        denominator = rational.denominator[:0:-1]
        start |= {f"a{k + integrators}": float(v) for k, v in enumerate(denominator)}
        yield start | ({"T_delay": share * delay} if delay else {})
