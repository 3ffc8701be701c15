"""Frequency responses of sweeps, noise and multisines: averaged spectra of windows, several lengths combined.

At a frequency ω the transforms of the windows k obey Y_k = P U_k + Σ_d c_d U_k⁽ᵈ⁾ + V_k. The sum is leakage: a window
cuts off the past that the output remembers. Expanding w(t + τ) in the convolution gives the transforms U⁽ᵈ⁾ of the
input under the d-th derivative of the window, c_1 = j dP/dω, c_2 = -½ d²P/dω². They are estimated along, which removes
most of the bias of short windows (in time what the local polynomial method is in frequency: Pintelon and Schoukens,
System Identification, 2nd ed., chapter 7). Without them the direct estimate is H1 = S_uy / S_uu = ΣU*Y / ΣU*U, and the
joint input-output estimate with an instrument r from outside the loop is S_ry / S_ru = ΣR*Y / ΣR*U. Noise that is fed
back into U biases the first and leaves the second alone (Tischler and Remple, 2nd ed., section 5.7).

With regressors X and instruments Z the estimate is the first row a of A = (ZᴴX)⁻¹Zᴴ, applied to Y. With noise V that is
stationary and whose spectrum is flat over the width of a window, E V_k V_l* = S_v C_kl, where C holds the correlations
of overlapping windows. So E|P̂ - P|² = S_v aCaᴴ, and the residuals QV, Q = I - XA, give S_v = |residuals|² / tr QCQᴴ
with 2 (tr QCQᴴ)² / tr (QCQᴴ)² degrees of freedom (Satterthwaite). Where U has one size in all windows this is the
(1 - γ²) / (γ² n) |P|² of Bendat and Piersol (Random Data, 4th ed., chapter 9), n being the number of averages that
overlapping windows are worth (Welch 1967); it also holds for a sweep, which excites each frequency in few windows.
"""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Record

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

JITTER = 0.05  # of a step, which a uniform time base may deviate
PERIODS = 2  # a window holds so many periods at least: half the width of the Hann window's main lobe
LENGTHS, LONGEST, SHORTEST = 5, 3, 24  # window lengths, usually five with CIFER, as parts of the longest stretch
ORDER = 2  # leakage terms
COHERENT = 0.6  # below, a point of the automatic grid is left out: Tischler and Remple, section 5.5
LEAST_DOF = 3  # of an estimate that is used
WORST = 1e6  # condition of the equations
SAMPLES = 8  # in a window, at least
EXCITED = 0.01  # of the largest ω S(ω), which a logarithmic sweep keeps constant
HARMONIC = 0.03  # of the largest amplitude, for a multiple of the fundamental to be part of the excitation
SHARPNESS = 4  # weight of a window length by its relative random error ε: (ε / ε_min)**-4, COMPOSITE of CIFER
EPS, HZ = np.finfo(float).eps, 2 * math.pi


class _Estimate(NamedTuple):
    """One frequency, one window length; NaN where there are too few windows."""

    response: complex = complex("nan")
    variance: float = math.nan
    dof: float = math.nan
    coherence: float = math.nan


class _Spectra(NamedTuple):
    """Transforms (windows, frequencies) of all signals, and the correlations C (windows, windows)."""

    u: Complex
    y: Complex
    r: Complex
    regressors: list[Complex]
    instruments: list[Complex]
    correlation: Any  # sparse
    plain: int  # regressors that are not leakage


def spectral_response(  # noqa: PLR0913 - every choice that an analyst makes
    records: Record | Sequence[Record],
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] = (),
    omega: ArrayLike | None = None,
    points: int = 40,
    windows: Sequence[float] | None = None,
    overlap: float = 0.8,
    detrend: Literal["linear", "constant", "none"] = "linear",
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from sweeps or noise, by Hann windows of several lengths.

    Every length gives an estimate with its variance. A short window averages more but smears a resonance, which raises
    its residuals; a long one resolves it. They are combined at each frequency with the weights (ε / ε_min)⁻⁴ of their
    relative random errors ε, as in COMPOSITE of CIFER (Tischler and Remple, chapter 10; there the spectra, here the
    responses). Stretches between gaps or missing samples are transformed apart and averaged, as are several records.

    Parameters
    ----------
    records : Record or sequence of Record
        Uniformly sampled.
    input, output : str
    instrument : str, optional
        The injected signal, for the joint input-output estimate; without it, the direct one.
    conditioned : sequence of str
        Further inputs that act on the output, correlated with this one; their part is removed (partial coherence,
        Bendat and Piersol, section 7.3).
    omega : (n,) array, rad/s; by default `points` log spaced frequencies where the excitation is strong
    windows : sequence of float, s, optional
        Window lengths; by default five, from a third of the longest stretch to a 24th.
    overlap : float, the share of a window that the next one repeats
    detrend : {"linear", "constant", "none"}, what is removed from each stretch

    Returns
    -------
    FrequencyResponse
        With coherence, variance E|P̂ - P|² and its degrees of freedom; points that had too few windows are left out.
        The coherence is partial, without leakage and conditioned inputs; with an instrument it is the lower one of
        instrument with input and with output. The variance of the combination is that of fully correlated parts, an
        upper bound. It assumes noise that is as strong in the quiet windows as in the excited ones.

    Raises
    ------
    ValueError
        For records that are too short or not uniform, or frequencies below two periods of the longest window.
    KeyError
        For a signal that a record does not hold.
    """
    signals = [input, output, instrument or input, *conditioned]
    stretches = _stretches(records, signals, detrend)
    lengths = _lengths(stretches, windows)
    if not 0 <= overlap < 1:
        raise ValueError(f"overlap is {overlap:g}: it must be at least 0 and below 1.")
    grid = _grid(stretches, lengths, points) if omega is None else _checked(omega, lengths[0])
    per_length = [_estimates(_windowed(stretches, t, overlap, grid, order=ORDER), grid * t) for t in lengths]
    combined = [_combine(row) for row in zip(*per_length, strict=True)]
    response = _response(grid, combined, (input, output, name), stretches)
    good = response.coherence >= COHERENT  # type: ignore[operator]
    return response.where(good) if omega is None and good.any() else response


def periodic_response(
    records: Record | Sequence[Record],
    period: float,
    input: str = "u",
    output: str = "theta",
    *,
    instrument: str | None = None,
    conditioned: Sequence[str] = (),
    omega: ArrayLike | None = None,
    name: str = "",
) -> FrequencyResponse:
    """Estimate a frequency response from whole periods of a periodic signal in steady state, free of leakage.

    Each period is one window without taper; the variance comes from the scatter of the periods, taken as independent
    (Pintelon and Schoukens, System Identification, 2nd ed., chapter 2). A rest that is no whole period is left out at
    the beginning. Arguments not listed are those of `spectral_response`.

    Parameters
    ----------
    period : s, a whole number of samples
    omega : (n,) array, rad/s, optional
        Multiples of 2π / period; by default those that the excitation holds.

    Raises
    ------
    ValueError
        If the period is no whole number of samples, there are fewer than three, or `omega` holds other frequencies.
    """
    signals = [input, output, instrument or input, *conditioned]
    stretches = [_whole_periods(s, period) for s in _stretches(records, signals, "none")]
    stretches = [s for s in stretches if s.values.shape[1]]
    if sum(s.values.shape[1] * s.step for s in stretches) < 2.5 * period:
        raise ValueError(f"the records hold fewer than three periods of {period:g} s: record longer.")
    base = HZ / period
    grid = _harmonics(stretches, period) if omega is None else np.atleast_1d(np.asarray(omega, dtype=float))
    odd = np.flatnonzero((np.abs(grid / base - np.rint(grid / base)) > 1e-6) | (grid < 0.5 * base))
    if odd.size:
        raise ValueError(
            f"omega = {grid[odd[0]]:g} rad/s is no multiple of 2π / period = {base:g} rad/s: leave it out."
        )
    spectra = _windowed(stretches, period, 0.0, np.rint(grid / base) * base, taper=False)
    return _response(grid, _estimates(spectra, np.full(grid.size, np.inf)), (input, output, name), stretches)


class _Stretch(NamedTuple):
    """Uniform samples without gaps, (signals, n)."""

    values: Array
    step: float
    source: str


def _stretches(records: Record | Sequence[Record], signals: Sequence[str], detrend: str) -> list[_Stretch]:
    """Cut the records at gaps and missing samples."""
    if detrend not in ("linear", "constant", "none"):
        raise ValueError(f"detrend {detrend!r} is not known: use 'linear', 'constant' or 'none'.")
    found = []
    for record in [records] if isinstance(records, Record) else records:
        for piece in record.pieces:
            values = np.array([piece[name] for name in signals])
            present = np.flatnonzero(np.all(np.isfinite(values), axis=0))
            for rows in np.split(present, np.flatnonzero(np.diff(present) > 1) + 1):
                if rows.size > 1:
                    _check_uniform(piece.time[rows], record)
                    found.append(_Stretch(_detrended(values[:, rows], detrend), piece.step, record.source))
    still = [name for k, name in enumerate(signals) if all(np.ptp(s.values[k]) <= 1e-12 for s in found)]
    if found and still:
        raise ValueError(f"{still[0]} does not change in these records: choose a part that is excited.")
    if not found:
        raise ValueError(f"there are no samples in which {', '.join(dict.fromkeys(signals))} are all present.")
    return found


def _check_uniform(time: Array, record: Record) -> None:
    line = np.linspace(time[0], time[-1], time.size)
    off = np.abs(time - line)
    if off.max() > JITTER * (line[1] - line[0]):
        raise ValueError(
            f"{record.name or 'the record'} is not uniformly sampled ({1e3 * off.max():.2g} ms off at "
            f"{time[off.argmax()]:.2f} s): put it on one time base with gb.prepare(..., rate=...)."
        )


def _detrended(values: Array, detrend: str) -> Array:
    if detrend == "none":
        return values
    centered = values - values.mean(axis=1, keepdims=True)
    ramp = np.linspace(-1, 1, values.shape[1])
    return centered if detrend == "constant" else centered - np.outer(centered @ ramp / (ramp @ ramp), ramp)


def _whole_periods(stretch: _Stretch, period: float) -> _Stretch:
    """Keep the last whole periods."""
    count = round(period / stretch.step)
    if count < 2 or abs(count * stretch.step - period) > 1e-5 * stretch.step * count:
        raise ValueError(
            f"a period of {period:g} s is {period / stretch.step:.6g} samples: resample so that it is a whole number."
        )
    kept = stretch.values.shape[1] // count * count
    return stretch._replace(values=stretch.values[:, stretch.values.shape[1] - kept :], step=period / count)


def _lengths(stretches: Sequence[_Stretch], windows: Sequence[float] | None) -> list[float]:
    """Window lengths, s, the longest first."""
    longest = max(s.values.shape[1] * s.step for s in stretches)
    least = SAMPLES * max(s.step for s in stretches)
    if windows is None:
        windows = list(np.geomspace(longest / LONGEST, longest / SHORTEST, LENGTHS))
    if not windows or min(windows) < least or max(windows) > longest:
        raise ValueError(
            f"windows of {', '.join(f'{w:.4g}' for w in windows) or 'no'} s do not fit: give lengths from {least:.4g} "
            f"to {longest:.4g} s, from {SAMPLES} samples to the longest stretch, or record longer."
        )
    return sorted(windows, reverse=True)


def _checked(omega: ArrayLike, longest: float) -> Array:
    grid, lowest = np.atleast_1d(np.asarray(omega, dtype=float)), PERIODS * HZ / longest
    bad = grid[~(grid >= lowest * (1 - 1e-9))]
    if bad.size:
        raise ValueError(
            f"omega = {bad[0]:g} rad/s has fewer than {PERIODS} periods in the longest window of {longest:.4g} s: "
            f"leave out what is below {lowest:.4g} rad/s, lengthen the windows or record longer."
        )
    return grid


def _grid(stretches: Sequence[_Stretch], lengths: Sequence[float], points: int) -> Array:
    """Log spaced frequencies around the strongest excitation, as far as it reaches without a hole."""
    fine = np.geomspace(PERIODS * HZ / lengths[0], 0.4 * HZ / max(s.step for s in stretches), 200)
    power = np.sum(np.abs(_windowed(stretches, lengths[len(lengths) // 2], 0.8, fine).r) ** 2, axis=0) * fine
    power = np.convolve(np.pad(power, 4, mode="edge"), np.ones(9) / 9, mode="valid")  # noise has holes by chance
    weak = np.flatnonzero(power < EXCITED * power.max())
    top = int(power.argmax())
    first = int(max(weak[weak < top], default=-1)) + 1
    last = int(min(weak[weak > top], default=fine.size)) - 1
    return np.geomspace(fine[first], fine[last], points)


def _harmonics(stretches: Sequence[_Stretch], period: float) -> Array:
    """Multiples of 2π / period that stand out in the excitation."""
    count = round(period / max(s.step for s in stretches))
    grid: Array = HZ / period * np.arange(1.0, (count + 1) // 2)
    size = np.sqrt(np.sum(np.abs(_windowed(stretches, period, 0.0, grid, taper=False).r) ** 2, axis=0))
    return grid[size > HARMONIC * size.max()]


def _windowed(
    stretches: Sequence[_Stretch], length: float, overlap: float, omega: Array, taper: bool = True, order: int = 0
) -> _Spectra:
    """Transform every window of every stretch; a stretch shorter than a window has none."""
    from scipy.sparse import block_diag  # noqa: PLC0415 - scipy takes longer to import than this package

    transforms, blocks = [], []
    for stretch in stretches:
        count = round(length / stretch.step)
        room = stretch.values.shape[1] - count
        if room < 0:
            continue
        hop = max(room // max(math.ceil(room / (count * (1 - overlap))), 1), 1)  # the last window reaches the end
        tapers = _tapers(count, order) if taper else np.ones((1, count))
        frames = np.lib.stride_tricks.sliding_window_view(stretch.values, count, axis=1)[:, ::hop]
        wave = np.exp(-1j * np.outer(np.arange(count) * stretch.step, omega)) * stretch.step
        shift = np.exp(-1j * np.outer(np.arange(frames.shape[1]) * hop * stretch.step, omega))
        transforms.append(np.array([frames @ (window[:, None] * wave) * shift for window in tapers]))
        blocks.append(_correlation(tapers[0], hop, frames.shape[1]) * stretch.step)
    (u, y, r, *others), *rest = np.concatenate(transforms, axis=2)
    correlation = block_diag(blocks, format="csr")
    regressors = [u, *others, *(x for d in rest for x in (d[0], *d[3:]))]
    instruments = [r, *others, *(x for d in rest for x in (d[2], *d[3:]))]
    return _Spectra(u, y, r, regressors, instruments, correlation, 1 + len(others))


def _tapers(count: int, order: int) -> Array:
    """Return the Hann window and its derivatives by the phase of a whole window, (order + 1, count)."""
    phase = HZ * (np.arange(count) + 0.5) / count
    return np.array([0.5 - 0.5 * np.cos(phase), 0.5 * np.sin(phase), 0.5 * np.cos(phase)][: order + 1])


def _correlation(window: Array, hop: int, count: int) -> Any:
    """Σ w_k w_l of windows a number of hops apart, (count, count), sparse."""
    from scipy.sparse import diags_array  # noqa: PLC0415 - as above

    lags = [window[: window.size - d] @ window[d:] for d in range(0, min(window.size, hop * count), hop)]
    apart: Any = range(1 - len(lags), len(lags))
    return diags_array([lags[abs(d)] for d in apart], offsets=apart, shape=(count, count))


def _estimates(spectra: _Spectra, radians: Array) -> list[_Estimate]:
    """One estimate for each frequency; none where the window, `radians` long, holds too few periods."""
    enough = radians >= PERIODS * HZ * (1 - 1e-9)
    return [_estimate(spectra, k) if good else _Estimate() for k, good in enumerate(enough)]


def _estimate(spectra: _Spectra, k: int) -> _Estimate:
    """Solve instrumentsᴴ (Y - regressors P) = 0 at the frequency of column k; P̂ belongs to the first regressor.

    A periodic input in steady state has no leakage: where its terms are not independent they are left out.
    """
    x, z = (np.array([side[:, k] for side in sides]).T for sides in (spectra.regressors, spectra.instruments))
    if not _solvable(z, x):
        x, z = x[:, : spectra.plain], z[:, : spectra.plain]
        if not _solvable(z, x):
            return _Estimate()
    y, c = spectra.y[:, k], spectra.correlation
    solution = np.linalg.solve(z.conj().T @ x, z.conj().T)
    trace, squares = _traces(c, x, solution.conj().T.astype(complex))
    dof = 2 * trace**2 / squares
    if trace < 1e-9 * c.trace() or dof < LEAST_DOF:
        return _Estimate()
    noise = np.sum(np.abs(y - x @ (solution @ y)) ** 2) / trace
    variance = noise * (solution[0] @ c @ solution[0].conj()).real
    response = complex(solution[0] @ y)
    return _Estimate(response, max(variance, (4 * EPS * abs(response)) ** 2), dof, _coherence(x, z, y))


def _solvable(z: Complex, x: Complex) -> bool:
    """Tell whether ZᴴX, with columns scaled to length one, is well conditioned."""
    sizes = [np.maximum(np.sqrt(np.sum(np.abs(side) ** 2, axis=0)), np.finfo(float).tiny) for side in (z, x)]
    return len(x) > x.shape[1] and bool(np.linalg.cond((z / sizes[0]).conj().T @ (x / sizes[1])) < WORST)


def _traces(c: Any, left: Complex, right: Complex) -> tuple[float, float]:
    """Return tr M and tr M² of M = QCQᴴ with Q = I - left rightᴴ, without forming M."""
    cr = c @ right
    inner = right.conj().T @ cr
    factor = np.hstack([left, cr])
    one, zero = np.eye(left.shape[1]), np.zeros(inner.shape)
    core = np.block([[inner, -one], [-one, zero]])
    gram = core @ (factor.conj().T @ factor)
    trace = c.trace() + np.trace(gram).real
    squares = (
        c.multiply(c).sum() + 2 * np.trace(core @ (factor.conj().T @ (c @ factor))).real + np.trace(gram @ gram).real
    )
    return float(trace), float(squares)


def _coherence(x: Complex, z: Complex, y: Complex) -> float:
    """Return the partial γ² of first instrument and output, or and first regressor if that is lower."""
    basis = np.linalg.qr(x[:, 1:])[0]
    r, *both = (v - basis @ (basis.conj().T @ v) for v in (z[:, 0], y, x[:, 0]))
    squares = (abs(np.vdot(r, v)) ** 2 / (np.vdot(r, r).real * np.vdot(v, v).real) for v in both)
    return float(np.clip(min(squares), EPS, 1))


def _combine(estimates: Sequence[_Estimate]) -> _Estimate:
    """Weight the window lengths at one frequency by their random errors."""
    known = [e for e in estimates if math.isfinite(e.variance)]
    if not known:
        return _Estimate()
    response = np.array([e.response for e in known])
    error = np.sqrt([e.variance for e in known]) / np.abs(response)
    weight = (error / error.min()) ** -SHARPNESS
    weight /= weight.sum()
    spread = float(weight @ np.sqrt([e.variance for e in known]))
    dof, coherence = (float(weight @ [getattr(e, field) for e in known]) for field in ("dof", "coherence"))
    return _Estimate(complex(weight @ response), spread**2, dof, coherence)


def _response(
    omega: Array, estimates: Sequence[_Estimate], names: tuple[str, str, str], stretches: Sequence[_Stretch]
) -> FrequencyResponse:
    """Collect the points that could be estimated."""
    response, variance, dof, coherence = (np.array(column) for column in zip(*estimates, strict=True))
    if not (good := np.isfinite(variance)).any():
        raise ValueError("no frequency has enough windows for a variance: record longer, or give shorter windows.")
    source = ", ".join(dict.fromkeys(s.source for s in stretches if s.source))
    columns = (coherence[good], variance[good], dof[good])
    return FrequencyResponse(omega[good], response[good], *names[:2], *columns, *names[2:], source)
