"""The confidence band of a fitted response, to first order in the errors of the parameters."""

from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, real_and_imaginary, real_root
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.data.files.printed import one_line
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.modeling.linear_response import response_formulas
from greybox.modeling.model import Model, pick_signals
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import delay_order


@frozen
class ResponseBand:
    """A fitted frequency response with its errors, which follow from those of the parameters.

    If the model structure is right, the band contains the true response at any single frequency
    with the probability `level`. It does not include the noise of the measured points.

    Attributes
    ----------
    response : FrequencyResponse
        The fitted response, (n,).
    level : float
    dof : float
        Degrees of freedom of Student's t: the fewest of the parameters that the response depends
        on.
    covariance : (n, 2, 2) array
        Covariance of real and imaginary part; NaN where the response depends on something that the
        data of the fit do not determine.
    relative_error : (2, n) array
        Standard errors of the logarithm of the magnitude and of the phase in rad.
    bias : (n,) complex array
        Bias of the response, from the biases of its parameters (`Quantity.bias`). The band is
        centered on the response minus this bias.
    """

    response: FrequencyResponse
    level: float
    dof: float
    covariance: Array
    relative_error: Array
    bias: ComplexArray

    def __len__(self) -> int:
        return len(self.response)

    @property
    def omega(self) -> Array:
        """Frequencies (n,), rad/s."""
        return self.response.omega

    @property
    def _center(self) -> ComplexArray:
        """Middle (n,) of the band."""
        return self.response.response - self.bias

    @property
    def offset(self) -> Array:
        """Middle of the band less the response, (2, n): log magnitude, and phase in rad."""
        with np.errstate(all="ignore"):
            away: ComplexArray = np.log(self._center / self.response.response)
        return np.array([away.real, away.imag])

    @property
    def half_width(self) -> Array:
        """Half of the widths (2, n): logarithm of the magnitude, phase in rad."""
        return t_quantile(self.level, self.dof) * self.relative_error

    @property
    def magnitude(self) -> tuple[Array, Array]:
        """Lower and upper limit (n,) of the magnitude, symmetric in its logarithm."""
        size = np.abs(self._center)
        factor = np.exp(self.half_width[0])
        return size / factor, size * factor

    @property
    def phase(self) -> tuple[Array, Array]:
        """Lower and upper limit (n,) of the phase, rad."""
        phase = np.angle(self._center)
        return phase - self.half_width[1], phase + self.half_width[1]

    def ellipses(self) -> ComplexArray:
        """Return the confidence ellipse (n, 48) of every response in the complex plane."""
        angle = np.linspace(0, 2 * np.pi, 48)
        circle = np.array([np.cos(angle), np.sin(angle)]) * radius(self.level, self.dof)
        values, vectors = np.linalg.eigh(np.nan_to_num(self.covariance))
        root = vectors * real_root(values)[:, None, :]
        ellipse = root @ circle
        ellipse[np.isnan(self.covariance).any(axis=(1, 2))] = np.nan
        return self._center[:, None] + ellipse[:, 0] + 1j * ellipse[:, 1]

    def __repr__(self) -> str:
        return one_line(
            self,
            self.response.name,
            counted(len(self), "frequency", "frequencies"),
            f"{self.level:g}",
        )


def t_quantile(level: float, dof: float) -> float:
    """Return the two-sided quantile of Student's t at this level; `dof` may be infinite.

    Raises
    ------
    ValueError
        For a level outside 0 to 1.
    """
    require_level(level)
    from scipy.special import stdtrit  # noqa: PLC0415  (takes a tenth of a second to import)

    if not dof > 0:
        return float("nan")
    # SciPy accepts no infinity. With 1e9 degrees of freedom Student's t is the normal distribution
    # to all digits.
    return float(stdtrit(min(dof, 1e9), 0.5 + level / 2))


def require_level(level: float) -> None:
    """Raise ValueError for a confidence level outside 0 to 1, or a name in its place."""
    if isinstance(level, str) or not 0 < level < 1:
        raise ValueError(f"level {level!r} must lie between 0 and 1, e.g. 0.95.")


def radius(level: float, dof: float) -> float:
    """Return √(2 F), the radius for two components; F has (2, dof) degrees of freedom."""
    # With two numerator degrees of freedom the quantile of F has this closed form.
    tail = 1 - level
    squared = -2 * np.log(tail) if np.isinf(dof) else dof * (tail ** (-2 / dof) - 1)
    return float(np.sqrt(squared))


def band_of(
    response: FrequencyResponse,
    slope: ComplexArray,
    known: KnownDirections,
    level: float,
    dof: float,
    bias: Array,
) -> ResponseBand:
    """Return the band of a response (n,) from its derivatives `slope` (n, k) by k parameters.

    `known` is the covariance of these parameters, `bias` (k,) their bias.
    """
    # An undamped zero of the fitted response has no logarithm: its relative error is infinite.
    with np.errstate(all="ignore"):
        relative = slope / response.response[:, None]

    components = real_and_imaginary(slope[None])
    covariance = np.einsum("ink,kl,jnl->nij", components, known.covariance, components)
    is_unknown = np.isnan(known.errors(slope.real) + known.errors(slope.imag))
    return ResponseBand(
        response=response,
        level=level,
        dof=dof,
        covariance=np.where(is_unknown[:, None, None], np.nan, covariance),
        relative_error=np.array([known.errors(relative.real), known.errors(relative.imag)]),
        bias=slope @ bias,
    )


@one_thread_at_a_time
def response_and_slope(
    model: Model,
    values: Values,
    omega: Array,
    hold: float = 0.0,
    **signals: Any,
) -> tuple[FrequencyResponse, ComplexArray]:
    """Return the response at `omega` (n,) rad/s and its derivatives (n, k) in the parameters.

    The arguments are those of `greybox.modeling.linear_response.frequency_response`, and the `hold`
    of `response_formulas` there.
    """
    input, output = pick_signals(model, signals["input"], signals["output"])
    options = {"at": signals["at"], "pade": delay_order(signals["delay"])}
    p = [values[name] for name in model.parameters]

    # One small function mapped over the frequencies compiles several times faster than one
    # expression of all of them, or than the derivative of the mapped function.
    frequency = ca.SX.sym("omega")
    pairs = [(input, output)]
    [formula] = response_formulas(model, omega, pairs, frequency, hold=hold, **options)
    q, w, _ = formula.function.sx_in()
    parts = ca.vertcat(*formula.function(q, w, frequency))
    rows = ca.densify(ca.horzcat(parts, ca.jacobian(parts, q)))
    root = ca.DM() if formula.root is None else formula.root(p)
    mapped = ca.Function("slopes", [q, w, frequency], [rows]).map(omega.size)
    re, im = np.reshape(mapped(p, root, omega[None]).full(), (2, omega.size, -1))

    # The first column is the response, the others are its derivatives.
    columns = re + 1j * im
    response = FrequencyResponse(
        omega, columns[:, 0], input, output, name=model.label, source="model"
    )
    return response, columns[:, 1:]
