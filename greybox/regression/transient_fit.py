"""Parameters from the Fourier integrals of manoeuvres: output error and equation error in the frequency domain.

With X, Y, U the integrals of the states, outputs and inputs over a manoeuvre of duration T, and exp(-jωT) = 1,

    jωX + x(T) - x(0) = A X + B U,    so    Y = [C (jωI - A)⁻¹ B + D] U + C (jωI - A)⁻¹ b,    b = x(0) - x(T).

A manoeuvre that ends elsewhere than it began has b ≠ 0, which biases a ratio Y/U. Here b is estimated along, linearly:
for given parameters it follows by least squares, and what remains of the errors depends on the parameters alone
(variable projection: Golub and Pereyra 2003, Inverse Problems 19, R1).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.data.text_table import one_line
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.linearization import jacobians
from greybox.modeling.model import Model, require_known
from greybox.modeling.realization import dynamics
from greybox.modeling.state_space import StateSpace
from greybox.modeling.trim import trim_function

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]

CRITERIA = ("output error", "equation error")
# Change of a noise size at which reweighting the outputs has converged, and how often it is done at most: each time
# reduces the change some ten times where the outputs determine the parameters.
SETTLED = 1e-4
REWEIGHTINGS = 20
# Negative log-likelihood above the best, below which a start has found the same minimum: half a unit is one standard
# error.
SAME_LIKELIHOOD = 0.01
# Smallest singular value of the Jacobian with columns of length one, over its largest: a finite difference, known to
# eps^(1/2) = 1.5e-8, does not tell less from zero.
UNDETERMINED = 1e-6


@dataclass(frozen=True, eq=False)
class TransientFit:
    """Estimates from the spectra of manoeuvres.

    Attributes
    ----------
    model : Model
    spectra : tuple of TransientSpectrum
    criterion : str
    estimate : mapping of name to float
        All parameters, the fixed ones too.
    standard_error : mapping of name to float
        Of the free ones; NaN where the data do not determine a value. They hold where the errors of every output (of
        output error), or of every equation (of equation error), are white over the band and the inputs are known.
    covariance : (p, p) array
        Of the free parameters, in the order of `standard_error`.
    noise : mapping of output to float
        Standard deviation of the errors of a sample, in the unit of the output, as far as they lie in the band; of
        equation error those of its equation.
    dof : int
        Real numbers in the spectra less unknowns.
    ends : tuple of (states,) arrays
        x(0) - x(T) of every manoeuvre, in the states of the model's realization.
    cost : float
        Sum of squares of the errors over their variances; about `dof`.
    converged : bool
    agreeing : (int, int)
        Starts that reached this minimum, and all.
    warnings : tuple of str
    """

    model: Model
    spectra: tuple[TransientSpectrum, ...]
    criterion: str
    estimate: Mapping[str, float]
    standard_error: Mapping[str, float]
    covariance: Array = field(repr=False)
    noise: Mapping[str, float]
    dof: int
    ends: tuple[Array, ...] = field(repr=False)
    cost: float
    converged: bool
    agreeing: tuple[int, int]
    warnings: tuple[str, ...] = ()

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return intervals of Student's t at a confidence `level`, by name; NaN where a value is not determined."""
        from scipy.stats import t as student  # noqa: PLC0415  (scipy.stats takes a third of a second to import)

        if not 0 < level < 1:
            raise ValueError(f"level {level!r} must lie between 0 and 1.")
        reach = float(student.ppf(0.5 + level / 2, self.dof))
        return {
            name: (self.estimate[name] - reach * error, self.estimate[name] + reach * error)
            for name, error in self.standard_error.items()
        }

    def __repr__(self) -> str:
        return one_line(self, self.model.label, self.criterion, f"{len(self.spectra)} manoeuvres", f"{self.dof} dof")

    def __str__(self) -> str:
        lines = [f"{self.model.label}, {self.criterion} over {sum(map(len, self.spectra))} frequencies"]
        lines.append(f"{self.agreeing[0]} of {self.agreeing[1]} starts agree, {self.dof} degrees of freedom")
        for name, value in self.estimate.items():
            unit = self.model.parameters[name].unit
            if name not in self.standard_error:
                error = "fixed"
            elif math.isnan(self.standard_error[name]):
                error = "not determined"
            else:
                error = f"± {self.standard_error[name]:.3g}"
            lines.append(f"  {name:12s} {value:12.6g} {error:16s} {unit}")
        return "\n".join([*lines, *(f"warning: {each}" for each in self.warnings)])


def fit_transients(
    model: Model,
    spectra: TransientSpectrum | Sequence[TransientSpectrum],
    criterion: str = "output error",
    *,
    fixed: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    at: Mapping[str, float] | None = None,
    starts: int = 10,
    seed: int = 0,
) -> TransientFit:
    """Estimate the parameters of `model` from the spectra of one or several manoeuvres.

    Constant trim values and sensor biases need not be known: they are nothing at the frequencies of a spectrum.

    Parameters
    ----------
    model : TransferFunction or StateSpace
        An ODE is linearized at its operating point. Inputs must be in the spectra; outputs that are not are left out.
    spectra : TransientSpectrum or sequence of them
    criterion : "output error" or "equation error"
        Output error: noise on the outputs. Equation error: the same errors times the characteristic polynomial
        det(jωI - A), which is for noise that enters the differential equation; noise on the outputs biases it.
    fixed : mapping of name to value
        Parameters held constant.
    free : sequence of str
        Parameters that the model declares fixed and that are to be estimated.
    at : mapping of name to value
        The operating point of an ODE: some states and inputs.
    starts : int
        How many starts: the declared one, and draws from the boxes of the parameters.
    seed : int

    Raises
    ------
    ValueError
        In one sentence with the value and the cure, for anything that does not fit together.

    Notes
    -----
    Klein and Morelli, Aircraft System Identification, chapter 7; the end term: Pintelon and Schoukens, System
    Identification, 2nd ed., section 6.3.
    """
    spectra = (spectra,) if isinstance(spectra, TransientSpectrum) else tuple(spectra)
    if criterion not in CRITERIA:
        raise ValueError(f"criterion {criterion!r} is not known: use 'output error' or 'equation error'.")
    if starts < 1:
        raise ValueError(f"starts {starts!r} must be at least 1.")
    errors = _Errors(model, spectra, criterion, dict(at or {}))
    names, values = _free_parameters(model, dict(fixed or {}), free)
    unknowns = len(names) + errors.end_unknowns
    dof = errors.rows - unknowns
    if dof < 1:
        raise ValueError(
            f"the spectra hold {errors.rows} real numbers for {unknowns} unknowns ({len(names)} parameters, "
            f"{errors.end_unknowns} end terms): widen the band, add a manoeuvre or fix parameters."
        )

    search = _Search(errors, model, names, values, dof)
    random = np.random.default_rng(seed)
    points = [[values[name] for name in names]]
    points += [[p.draw(random) for p in search.parameters] for _ in range(starts - 1)]
    with np.errstate(all="ignore"):
        found = [each for each in (search.minimum(np.array(point)) for point in points) if each is not None]
    if not found:
        raise ValueError(
            f"{model.label} could not be evaluated from any of {starts} starts: narrow the bounds or the start boxes "
            "of its parameters."
        )
    best = min(found, key=lambda each: (not each.converged, each.likelihood))
    agreeing = sum(each.converged and each.likelihood - best.likelihood < SAME_LIKELIHOOD for each in found)

    covariance, warnings = search.covariance(best)
    if not best.converged:
        warnings.insert(0, "no start converged: these are no estimates.")
        covariance = np.full_like(covariance, np.nan)
    everything = search.all_values(best.free)
    remaining, ends = errors.projected(everything, best.scale)
    present = [k for k in range(len(errors.outputs)) if search.present[k]]
    return TransientFit(
        model,
        spectra,
        criterion,
        estimate=dict(zip(values, everything.tolist(), strict=True)),
        standard_error=dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        noise={errors.outputs[k]: float(best.scale[k]) for k in present},
        dof=dof,
        ends=ends,
        cost=float(remaining @ remaining),
        converged=best.converged,
        agreeing=(agreeing, starts),
        warnings=tuple(warnings),
    )


def _free_parameters(
    model: Model, fixed: dict[str, float], free: Sequence[str]
) -> tuple[tuple[str, ...], dict[str, float]]:
    free = (free,) if isinstance(free, str) else tuple(free)
    for given in (fixed, free):
        require_known(given, tuple(model.parameters), "parameter", model.label)
    values = {name: float(fixed.get(name, p.start)) for name, p in model.parameters.items()}
    names = tuple(n for n, p in model.parameters.items() if n not in fixed and (n in free or not p.fixed))
    if not names:
        raise ValueError(f"all parameters of {model.label} are fixed: nothing is left to estimate.")
    for name in fixed:
        low, high = model.parameters[name].bounds
        if not low <= values[name] <= high:
            raise ValueError(f"fixed gives {name!r} the value {values[name]:g} outside its bounds ({low:g}, {high:g}).")
        if name in free:
            raise ValueError(f"{name!r} is both fixed and free: keep one of them.")
    return names, values


class _Errors:
    """The errors of a model over all spectra at given parameter values, before and after the end terms."""

    def __init__(
        self, model: Model, spectra: tuple[TransientSpectrum, ...], criterion: str, at: dict[str, float]
    ) -> None:
        """Compile the matrices of the model, and check that it meets the spectra."""
        if not spectra:
            raise ValueError("there are no spectra: give at least one.")
        for spectrum in spectra:
            if not isinstance(spectrum, TransientSpectrum):
                raise TypeError(
                    f"{spectrum!r:.60} is no TransientSpectrum: use gb.spectral.transient_spectrum(record, ...)."
                )
            missing = [name for name in model.input_names if name not in spectrum.inputs]
            if missing:
                raise ValueError(
                    f"{model.label} needs the input {missing[0]!r}, which the spectrum {spectrum.name!r} does not "
                    f"hold; its inputs are {', '.join(spectrum.inputs)}."
                )
            if not any(name in spectrum.outputs for name in model.output_names):
                raise ValueError(
                    f"the spectrum {spectrum.name!r} holds none of the outputs of {model.label}, "
                    f"{', '.join(model.output_names)}; its outputs are {', '.join(spectrum.outputs)}."
                )
        self.spectra = spectra
        self.weighs_equation = criterion == "equation error"
        self.inputs, self.outputs = model.input_names, model.output_names
        self.matrices = _matrices(model, at)
        self.states = self.matrices.size1_out(0)
        self.end_unknowns = self.states * len(spectra)
        self.rows = sum(2 * len(s) * sum(name in s.outputs for name in self.outputs) for s in spectra)
        # Which output each real row belongs to.
        self.owner = np.concatenate(
            [np.full(2 * len(s), k) for s in spectra for k, name in enumerate(self.outputs) if name in s.outputs]
        )

    def projected(self, values: Array, scale: Array) -> tuple[Array, tuple[Array, ...]]:
        """Return errors (rows,) over `scale` (outputs,) with the best end terms, and these."""
        matrices = [np.asarray(ca.DM(m)) for m in self.matrices(values)]
        remaining, ends = [], []
        for spectrum in self.spectra:
            error, basis = self._error_and_basis(spectrum, matrices, scale)
            if basis.shape[1]:
                size = np.linalg.norm(basis, axis=0)
                size[size == 0] = 1.0
                if not (np.all(np.isfinite(basis)) and np.all(np.isfinite(error))):
                    return np.full(self.rows, np.inf), ()
                solution = np.linalg.lstsq(basis / size, error, rcond=None)[0]
                error = error - (basis / size) @ solution
                ends.append(solution / size)
            remaining.append(error)
        return np.concatenate(remaining), tuple(ends)

    def _error_and_basis(self, spectrum: TransientSpectrum, matrices: list[Array], scale: Array) -> tuple[Array, Array]:
        a, b, c, d, delays = matrices
        omega = spectrum.omega
        delayed = [
            spectrum.delayed_input(name, float(delay)) for name, delay in zip(self.inputs, delays.ravel(), strict=True)
        ]
        u = np.array(delayed)
        pencil = 1j * omega[:, None, None] * np.eye(self.states) - a
        both = np.concatenate([np.broadcast_to(np.eye(self.states), pencil.shape), (b @ u).T[:, :, None]], axis=2)
        try:
            solved = np.linalg.solve(pencil, both) if self.states else both
        except np.linalg.LinAlgError:
            solved = np.full(both.shape, np.nan)
        # White noise of deviation one in a sample gives each component of an integral this one.
        unit = math.sqrt(spectrum.step * spectrum.duration / 2)
        factor = np.linalg.det(pencil) if self.weighs_equation else np.ones(len(omega))
        errors, bases = [], []
        for k, name in enumerate(self.outputs):
            if name not in spectrum.outputs:
                continue
            weight = factor / (unit * scale[k])
            error = weight * (spectrum.outputs[name] - solved[:, :, -1] @ c[k] - d[k] @ u)
            basis = weight[:, None] * np.einsum("j,wji->wi", c[k], solved[:, :, : self.states])
            errors.append(np.concatenate([error.real, error.imag]))
            bases.append(np.vstack([basis.real, basis.imag]))
        return np.concatenate(errors), np.vstack(bases)


def _matrices(model: Model, at: dict[str, float]) -> ca.Function:
    """Return the function from all parameters to A, B, C, D and the delays of the inputs."""
    p = ca.MX.sym("p", len(model.parameters))
    system = dynamics(model)
    if isinstance(model, StateSpace):
        x, u = trim_function(model, at)(p)
        blocks = jacobians(model)(p, x, u)
        return ca.Function("matrices", [p], [*blocks, system.delay(p)])
    if at:
        raise ValueError(f"{model.label} has no operating point: leave out at={at}.")
    q = ca.SX.sym("p", len(model.parameters))
    x = ca.SX.sym("x", len(system.states))
    u = ca.SX.sym("u", len(system.inputs))
    f, h = system.derivative(x, u, q), system.output(x, u, q)
    blocks = [ca.jacobian(f, x), ca.jacobian(f, u), ca.jacobian(h, x), ca.jacobian(h, u)]
    return ca.Function("matrices", [q], [*blocks, system.delay(q)])


class _Minimum(NamedTuple):
    """Where one start ended: likelihood, values of the free parameters, noise sizes (outputs,), Jacobian over these."""

    likelihood: float
    free: Array
    scale: Array
    jacobian: Array
    converged: bool


class _Search:
    """Least squares from one start, with the noise sizes of the outputs estimated along."""

    def __init__(
        self, errors: _Errors, model: Model, names: tuple[str, ...], values: dict[str, float], dof: int
    ) -> None:
        """Keep what is searched."""
        self.errors, self.names, self.dof = errors, names, dof
        self.parameters = [model.parameters[name] for name in names]
        self.places = [list(values).index(name) for name in names]
        self.values = np.array(list(values.values()))
        self.bounds = np.array([p.bounds for p in self.parameters]).T
        rows = np.bincount(errors.owner, minlength=len(errors.outputs))
        self.present = rows > 0
        self.rows = np.maximum(rows, 1)

    def all_values(self, free: Array) -> Array:
        """Return the values of all parameters."""
        values = self.values.copy()
        values[self.places] = free
        return values

    def minimum(self, start: Array) -> _Minimum | None:
        """Return where a start ends; None where the model cannot be evaluated."""
        scale = self._noise(start, np.ones(len(self.errors.outputs)))
        new, settled = scale, False
        try:
            result = self._least_squares(start, scale)
            for _ in range(REWEIGHTINGS):
                new = self._noise(result.x, scale)
                # One output has the same minimum whatever its scale.
                change = np.abs(np.log(new / scale))[self.present]
                settled = change.size == 1 or bool(np.max(change) < SETTLED)
                if settled:
                    break
                scale = new
                result = self._least_squares(result.x, scale)
        except (ValueError, np.linalg.LinAlgError):  # not finite at the start or beside it
            return None
        if not np.all(np.isfinite(result.fun)):
            return None
        jacobian = result.jac * (scale / new)[self.errors.owner][:, None]
        likelihood = float((self.rows * np.log(new))[self.present].sum())
        return _Minimum(likelihood, result.x, new, jacobian, bool(result.status > 0 and settled))

    def _least_squares(self, start: Array, scale: Array) -> Any:
        from scipy.optimize import least_squares  # noqa: PLC0415  (takes a tenth of a second to import)

        return least_squares(
            lambda x: self.errors.projected(self.all_values(x), scale)[0],
            start,
            jac="2-point",
            bounds=tuple(self.bounds),
            x_scale="jac",
            xtol=1e-9,
            ftol=1e-12,
            gtol=1e-9,
        )

    def _noise(self, free: Array, scale: Array) -> Array:
        """Return the noise size of every output, the unknowns shared out in proportion to the numbers."""
        squares = self.errors.projected(self.all_values(free), scale)[0] ** 2
        sums = np.bincount(self.errors.owner, squares, minlength=len(self.rows))
        new = scale * np.sqrt(sums / self.rows * self.errors.rows / self.dof)
        # Data without noise leave rounding errors, or none.
        return np.where(self.present & np.isfinite(new), np.maximum(new, np.finfo(float).tiny ** 0.5), 1.0)

    def covariance(self, minimum: _Minimum) -> tuple[Array, list[str]]:
        """Return the covariance (p, p) of the free parameters, NaN where one is not known, and warnings."""
        low, high = self.bounds
        # trf stays inside of bounds, by about 1e-10 of what it moved.
        near = 1e-6 * np.maximum(np.abs(minimum.free), 1e-6)
        bound = (minimum.free - low <= near) | (high - minimum.free <= near)
        warnings = [
            f"{name} is at its bound: widen it, or fix the value."
            for name, b in zip(self.names, bound, strict=True)
            if b
        ]
        covariance = np.full((len(bound), len(bound)), np.nan)
        inside = np.flatnonzero(~bound)
        if not inside.size:
            return covariance, warnings
        jacobian = minimum.jacobian[:, inside]
        size = np.linalg.norm(jacobian, axis=0)
        size[size == 0] = 1.0
        _, singular, directions = np.linalg.svd(jacobian / size, full_matrices=False)
        weak = singular <= UNDETERMINED * singular[0]
        # What takes part in a direction that the data do not see.
        part = np.any(np.abs(directions[weak]) > 1e-3, axis=0)
        inverse = (directions[~weak].T / singular[~weak] ** 2) @ directions[~weak] / np.outer(size, size)
        inverse[part, :] = inverse[:, part] = np.nan
        covariance[np.ix_(inside, inside)] = inverse
        if np.any(part):
            lost = ", ".join(self.names[inside[k]] for k in np.flatnonzero(part))
            warnings.append(f"these data do not determine {lost}: fix one of them or add a manoeuvre.")
        return covariance, warnings
