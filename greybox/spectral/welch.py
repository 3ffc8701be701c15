"""Spectral estimates with windows of one length (Welch), their variance and coherence.

At a frequency ω, the transforms of the windows k obey Y_k = P U_k + Σ_d c_d U_k⁽ᵈ⁾ + V_k. The sum is
leakage: a window cuts off the past that the output remembers. An expansion of w(t + τ) in the
convolution gives the transforms U⁽ᵈ⁾ of the input under the d-th derivative of the window, with
c_1 = j dP/dω and c_2 = -½ d²P/dω². They are estimated together with P, which removes most of the
bias of short windows (the counterpart in time of the local polynomial method in frequency: Pintelon
and Schoukens, System Identification, 2nd ed., chapter 7). Without leakage terms, the direct estimate
is H1 = S_uy / S_uu = ΣU*Y / ΣU*U, and the joint input-output estimate with an instrument r from
outside the loop is S_ry / S_ru = ΣR*Y / ΣR*U. Noise that feedback returns to U biases the first
estimate, not the second (Tischler and Remple, 2nd ed., section 5.7).

With regressors X and instruments Z, the estimate is the first row a of A = (ZᴴX)⁻¹Zᴴ, applied to Y.
For stationary noise V whose spectrum is flat over the width of a window, E V_k V_l* = S_v C_kl,
where C contains the correlations of overlapping windows. So E|P̂ - P|² = S_v aCaᴴ, and the residuals
QV with Q = I - XA give S_v = |residuals|² / tr QCQᴴ with 2 (tr QCQᴴ)² / tr (QCQᴴ)² degrees of
freedom (Satterthwaite). If U has the same size in all windows, this is the (1 - γ²) / (γ² n) |P|² of
Bendat and Piersol (Random Data, 4th ed., chapter 9), with n the effective number of averages of
overlapping windows (Welch 1967). It also holds for a sweep, which excites each frequency in few
windows.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.files.text_table import counted
from greybox.spectral.uniform_stretches import UniformStretch

HZ = 2 * math.pi  # rad/s
EPS = np.finfo(float).eps

# Fewest periods in a window: half the width of the main lobe of the Hann window, so that neither the
# mean nor the negative frequency leaks into the estimate.
PERIODS = 2

# Fewest degrees of freedom of an estimate: from here on, Student's t has a finite variance.
LEAST_DOF = 3

# Power of the part of the input that the instrument explains, over the power of the noise in it. With
# less, the ratio is biased toward the direct estimate and its standard error is too small (Staiger
# and Stock (1997), Econometrica 65: the F statistic of the first stage).
STRONG = 10

COHERENT = 0.6  # least coherence of an automatic point: Tischler and Remple, section 5.5

# Largest condition number of ZᴴX with columns of length one. Rounding errors of the solution reach
# this times 2e-16; beyond, the leakage terms count as linearly dependent.
WORST_CONDITION = 1e6


class WindowedPoint(NamedTuple):
    """The estimate at one frequency; NaN if there are too few windows or the instrument is `weak`."""

    response: complex = complex("nan")
    variance: float = math.nan
    dof: float = math.nan
    coherence: float = math.nan
    weak: bool = False


class Transforms(NamedTuple):
    """Transforms (windows, frequencies) of input, output and instrument, and their equations.

    Attributes
    ----------
    u, y, r : (windows, frequencies) complex arrays
    regressors, instruments : lists of (windows, frequencies) arrays, X and Z
        First the input (or instrument), then the conditioned inputs, then the leakage terms.
    correlation : (windows, windows) sparse array, C
    inputs : int
        Number of regressors that are inputs, not leakage.
    """

    u: ComplexArray
    y: ComplexArray
    r: ComplexArray
    regressors: list[ComplexArray]
    instruments: list[ComplexArray]
    correlation: Any
    inputs: int


def transforms(
    stretches: Sequence[UniformStretch],
    length: float,
    overlap: float,
    omega: Array,
    taper: bool = True,
    leakage_terms: int = 0,
) -> Transforms:
    """Transform every window of every stretch; stretches shorter than a window are skipped.

    Parameters
    ----------
    stretches : sequence of UniformStretch
        Rows: input, output, instrument, and inputs to condition on.
    length : float, s
        Length of a window.
    overlap : float
        Share of a window that the next one repeats.
    omega : (n,) array, rad/s
    taper : bool
        Hann windows if true, rectangular ones otherwise.
    leakage_terms : 0, 1 or 2
    """
    from scipy.sparse import block_diag  # noqa: PLC0415  (slow import)

    per_stretch = []
    correlations = []
    for stretch in stretches:
        count = round(length / stretch.step)
        room = stretch.values.shape[1] - count
        if room < 0:
            continue

        # The hops fill the stretch, so that the last window reaches its end but for a few samples.
        hop = max(room // max(math.ceil(room / (count * (1 - overlap))), 1), 1)
        tapers = hann_tapers(count, leakage_terms) if taper else np.ones((1, count))
        frames = np.lib.stride_tricks.sliding_window_view(stretch.values, count, axis=1)[:, ::hop]
        wave = np.exp(-1j * np.outer(np.arange(count) * stretch.step, omega)) * stretch.step
        shift = np.exp(-1j * np.outer(np.arange(frames.shape[1]) * hop * stretch.step, omega))
        per_stretch.append(
            np.array([frames @ (window[:, None] * wave) * shift for window in tapers])
        )
        correlations.append(window_correlation(tapers[0], hop, frames.shape[1]) * stretch.step)

    (u, y, r, *conditioned), *leaked = np.concatenate(per_stretch, axis=2)
    regressors = [u, *conditioned, *(x for d in leaked for x in (d[0], *d[3:]))]
    instruments = [r, *conditioned, *(x for d in leaked for x in (d[2], *d[3:]))]
    correlation = block_diag(correlations, format="csr")
    return Transforms(u, y, r, regressors, instruments, correlation, 1 + len(conditioned))


def estimates(spectra: Transforms, radians: Array) -> list[WindowedPoint]:
    """Return one estimate per frequency; NaN where the window, `radians` long, is too short."""
    enough = radians >= PERIODS * HZ * (1 - 1e-9)
    return [estimate(spectra, k) if good else WindowedPoint() for k, good in enumerate(enough)]


def estimate(spectra: Transforms, k: int) -> WindowedPoint:
    """Solve instrumentsᴴ (Y - regressors P) = 0 at frequency k for P̂, of the first regressor.

    A periodic input in steady state has no leakage: its terms are then linearly dependent, and left
    out.
    """
    x = np.array([column[:, k] for column in spectra.regressors]).T
    z = np.array([column[:, k] for column in spectra.instruments]).T
    if not solvable(z, x):
        x = x[:, : spectra.inputs]
        z = z[:, : spectra.inputs]
        if not solvable(z, x):
            return WindowedPoint()

    y = spectra.y[:, k]
    c = spectra.correlation
    solution = np.linalg.solve(z.conj().T @ x, z.conj().T)
    trace, trace_of_square = traces(c, x, solution.conj().T.astype(complex))
    dof = 2 * trace**2 / trace_of_square
    # With as many unknowns as windows, the trace is a rounding error.
    if trace < 1e-9 * c.trace() or dof < LEAST_DOF:
        return WindowedPoint()

    spread = (solution[0] @ c @ solution[0].conj()).real
    if not np.array_equal(z, x) and STRONG * spread * unexplained(c, x[:, 0], z) > 1:
        return WindowedPoint(weak=True)
    noise = np.sum(np.abs(y - x @ (solution @ y)) ** 2) / trace
    variance = noise * spread
    response = complex(solution[0] @ y)
    rounding = (4 * EPS * abs(response)) ** 2  # the least variance, for data without noise
    return WindowedPoint(response, max(variance, rounding), dof, _coherence(x, z, y))


def response_at(
    omega: Array,
    estimates: Sequence[WindowedPoint],
    names: tuple[str, str, str],
    stretches: Sequence[UniformStretch],
) -> FrequencyResponse:
    """Return the points that could be estimated; `names` are those of input, output and response.

    Points where the instrument is too weak are left out, and `about` says so.

    Raises
    ------
    ValueError
        If no point could be estimated.
    """
    response, variance, dof, coherence, weak = (
        np.array(column) for column in zip(*estimates, strict=True)
    )
    good = np.isfinite(variance)
    input, output, name = names
    if not good.any() and weak.any():
        raise ValueError(
            f"the instrument hardly moves {input}: at no frequency is its effect {STRONG} times as "
            "strong as the noise; excite more strongly or longer, or use another instrument."
        )
    if not good.any():
        raise ValueError(
            "no frequency has enough windows for a variance: record longer, or use shorter windows."
        )
    return FrequencyResponse(
        omega[good],
        response[good],
        input,
        output,
        coherence[good],
        variance[good],
        dof[good],
        name,
        ", ".join(dict.fromkeys(s.source for s in stretches if s.source)),
        [s.origin for s in stretches if s.origin is not None],
        {n: u for s in stretches[:1] for n, u in s.units.items() if n in (input, output) and u},
        about={"dropped": _dropped(omega, weak, f"where the instrument hardly moves {input}")}
        if weak.any()
        else {},
    )


def without_incoherent(response: FrequencyResponse) -> FrequencyResponse:
    """Leave out points of low coherence and say so in `about`; if all are low, keep them."""
    coherent = response.coherence >= COHERENT  # type: ignore[operator]
    if not coherent.any() or coherent.all():
        return response
    text = _dropped(response.omega, ~coherent, f"of a coherence below {COHERENT}")
    earlier = [response.about["dropped"]] if "dropped" in response.about else []
    return replace(
        response.where(coherent), about={**response.about, "dropped": "; ".join([*earlier, text])}
    )


def _dropped(omega: Array, gone: BoolArray, why: str) -> str:
    """Return a sentence on the points that are left out, and the reason."""
    low, high = omega[gone].min(), omega[gone].max()
    place = f"{low:.4g} to {high:.4g} rad/s" if high > low else f"{low:.4g} rad/s"
    return f"{gone.sum()} of {counted(omega.size, 'point')}, {why}, at {place}"


def hann_tapers(count: int, derivatives: int) -> Array:
    """Return the Hann window and its derivatives by phase, (derivatives + 1, count)."""
    phase = HZ * (np.arange(count) + 0.5) / count
    return np.array(
        [0.5 - 0.5 * np.cos(phase), 0.5 * np.sin(phase), 0.5 * np.cos(phase)][: derivatives + 1]
    )


def window_correlation(window: Array, hop: int, count: int) -> Any:
    """Return Σ w_k w_l of windows that are some hops apart, (count, count), sparse."""
    from scipy.sparse import diags_array  # noqa: PLC0415  (slow import)

    lags = [
        window[: window.size - d] @ window[d:] for d in range(0, min(window.size, hop * count), hop)
    ]
    offsets: Any = range(1 - len(lags), len(lags))
    return diags_array([lags[abs(d)] for d in offsets], offsets=offsets, shape=(count, count))


def solvable(z: ComplexArray, x: ComplexArray) -> bool:
    """Return whether ZᴴX, with columns scaled to length one, is well conditioned."""
    tiny = np.finfo(float).tiny
    z_length, x_length = (
        np.maximum(np.sqrt(np.sum(np.abs(side) ** 2, axis=0)), tiny) for side in (z, x)
    )
    if len(x) <= x.shape[1]:
        return False
    return bool(np.linalg.cond((z / z_length).conj().T @ (x / x_length)) < WORST_CONDITION)


def unexplained(c: Any, input: ComplexArray, z: ComplexArray) -> float:
    """Return the spectral density of the part of an input that the instruments do not explain."""
    basis = np.linalg.qr(z)[0].astype(complex)
    residual = input - basis @ (basis.conj().T @ input)
    return float(np.sum(np.abs(residual) ** 2)) / traces(c, basis, basis)[0]


def traces(c: Any, left: ComplexArray, right: ComplexArray) -> tuple[float, float]:
    """Return tr M and tr M² of M = QCQᴴ with Q = I - left rightᴴ, without forming M."""
    cr = c @ right
    inner = right.conj().T @ cr
    factor = np.hstack([left, cr])
    identity = np.eye(left.shape[1])
    zero = np.zeros(inner.shape)
    core = np.block([[inner, -identity], [-identity, zero]])  # M = C + factor core factorᴴ
    gram = core @ (factor.conj().T @ factor)
    trace = c.trace() + np.trace(gram).real
    square_of_c = c.multiply(c).sum()
    mixed = np.trace(core @ (factor.conj().T @ (c @ factor))).real
    trace_of_square = square_of_c + 2 * mixed + np.trace(gram @ gram).real
    return float(trace), float(trace_of_square)


def _coherence(x: ComplexArray, z: ComplexArray, y: ComplexArray) -> float:
    """Return the partial γ² of the first instrument with output or first regressor, if lower."""
    basis = np.linalg.qr(x[:, 1:])[0]
    r, *signals = (v - basis @ (basis.conj().T @ v) for v in (z[:, 0], y, x[:, 0]))
    squares = (abs(np.vdot(r, v)) ** 2 / (np.vdot(r, r).real * np.vdot(v, v).real) for v in signals)
    return float(np.clip(min(squares), EPS, 1))
