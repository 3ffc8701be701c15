"""Criteria for frequency responses: the mismatch between a model's response and a measured one.

A criterion is written once, in the arithmetic of `Complex`, for IPOPT and for numbers. It also has
its own statistics: with J the Jacobian of its 2n real residuals, the estimate has the covariance
B⁻¹ M B⁻¹ of an M-estimator (Huber 1981, Robust Statistics, chapter 6), with B = bread · JᵀJ and
M = Jᵀ diag(meat) J.
"""

import math
from abc import abstractmethod
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, real_and_imaginary
from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.formulation.criterion import AnyCriterion
from greybox.modeling.formulation.relative_score import ROUNDING, relative_score
from greybox.modeling.functions import exp, log, sqrt

_DB_PER_NEPER = 20 / math.log(10)  # dB per unit of natural logarithm of a magnitude


class Criterion(AnyCriterion):
    """A criterion for frequency responses; its `cost` is minimized.

    See `AnyCriterion` for the attributes of a subclass.

    Attributes
    ----------
    uses : tuple of str or None
        Columns of the data that it uses besides the response: "variance", "coherence"; None if
        unknown.
    weighs_alike : bool
        Whether the weights of all points are those of errors of one relative size.
    locator : Criterion or None
        Criterion to minimize first, if this one has local minima.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> criteria = [gb.RelativeError(), gb.MagnitudePhase()]
    >>> problems = [pitch_hover.problem().with_(criterion=c) for c in criteria]
    >>> [gb.fit(problem, starts=5).criterion for problem in problems]
    ['relative-error', 'magnitude-phase']
    """

    condition = "errors isotropic in the complex plane and of one relative size"
    uses: ClassVar[tuple[str, ...] | None] = None
    weighs_alike: ClassVar[bool] = False
    locator: "ClassVar[Criterion | None]" = None

    def condition_on(self, data: Any) -> str:
        """Return the condition, with the common errors of the data if there are any."""
        return (
            self.condition
            if data.common_errors is None
            else f"{self.condition}, and the common errors of the data"
        )

    def check(self, data: FrequencyResponse) -> None:
        """Raise ValueError if the data lack what the criterion needs."""
        zero = np.flatnonzero(data.response == 0)
        if zero.size:
            raise ValueError(
                f"the response {data.output and f'of {data.output} to {data.input} '}is zero at "
                f"omega = {data.omega[zero[0]]:g} rad/s, which {type(self).__name__} cannot divide "
                "by: leave that point out, or all of a zero response, or use MaximumLikelihood."
            )

    @abstractmethod
    def cost(self, model: Complex, data: FrequencyResponse, smoothing: Any = 0.0) -> Any:
        """Return the mismatch of the response `model` (n,) and `data`."""

    def scale(self, model: ComplexArray, data: FrequencyResponse) -> Array:
        """Return what the errors are divided by (n,): by default the model's magnitude."""
        return np.abs(model)

    def jacobian(
        self,
        model: ComplexArray,
        sensitivity: ComplexArray,
        data: FrequencyResponse,
    ) -> Array:
        """Return the Jacobian (2n, p) of the real residuals.

        `sensitivity` (n, p) are the derivatives of the response `model` (n,). The first n rows are
        along the response, the others across.
        """
        scale = self.scale(model, data) * np.exp(1j * np.angle(model))
        return real_and_imaginary(sensitivity / scale[:, None])

    @abstractmethod
    def spread(
        self, model: ComplexArray, data: FrequencyResponse, correction: float
    ) -> tuple[float, Array]:
        """Return `bread` and `meat` (2n,).

        With the Jacobian J, the curvature of the cost is B = bread · JᵀJ and the covariance of its
        gradient is M = Jᵀ diag(meat) J, for errors in proportion to the sizes of the residuals; the
        estimate has the covariance B⁻¹ M B⁻¹. `correction` scales the size of the noise for the
        number of estimated parameters.
        """

    def score_correlation(self, correlation: Array) -> Array:
        """Return the correlation of the gradients at two points from that of their errors.

        For sums of squares, both are equal.
        """
        return correlation

    def error_size(self, model: ComplexArray, data: FrequencyResponse) -> Array:
        """Return the relative sizes of the errors (n,): by default the model's magnitude."""
        return np.abs(model)

    def noise(self, model: ComplexArray, data: FrequencyResponse, correction: float = 1.0) -> float:
        """Return the standard deviation of one component of the relative errors.

        The errors are those about the biased gain. `correction` scales the result for the number of
        estimated parameters.
        """
        # At a bound a model may be zero, and its distance from the data is then not noise.
        least = 0.01 * np.abs(data.response)
        ratio = data.response / np.where(np.abs(model) < least, least, model)
        size = self.size_of(ratio - 1, correction)
        # The bias depends on the noise, and the noise on the errors about the biased gain.
        for _ in range(6):
            previous = size
            size = self.size_of(ratio / (1 - self.gain_bias(size, len(data))) - 1, correction)
            if abs(size - previous) <= 1e-3 * size:
                break

        return size

    def size_of(self, errors: ComplexArray, correction: float) -> float:
        """Return the standard deviation of one component of errors (n,), from their squares."""
        return correction * math.sqrt(np.mean(np.abs(errors) ** 2) / 2)

    def noise_ratio(self, model: ComplexArray, data: FrequencyResponse) -> float:
        """Return the squared residuals over the given variances; only for `known_noise`."""
        return float(self.cost(Complex(model.real, model.imag), data)) / len(data)


@frozen
class _Relative(Criterion):
    """Sum of |e|^`power` of the relative errors e = (P - P̂) / |P̂|, or over |P|."""

    normalized: Literal["measured", "model"] = "measured"
    power: ClassVar[int]
    uses = ()
    weighs_alike = True

    @property
    def variant(self) -> str:
        """Magnitude that divides the errors, if it is not the measured one."""
        return "" if self.normalized == "measured" else self.normalized

    @property
    def description(self) -> str:
        """The rule, with the magnitude that divides the errors if it is not the measured one."""
        return f"{self.rule}, over the {self.variant}'s magnitude" if self.variant else self.rule

    def __post_init__(self) -> None:
        """Check the normalization."""
        if self.normalized not in ("measured", "model"):
            raise ValueError(
                f"normalized {self.normalized!r} is not known: use 'measured' or 'model'."
            )

    def errors(self, model: Any, data: FrequencyResponse) -> Any:
        """Relative errors, (n,) complex, of numbers or of `Complex`."""
        return (model - data.response) / self.scale(model, data)

    def scale(self, model: Any, data: FrequencyResponse) -> Any:
        """Return what the errors are divided by (n,), of numbers or of `Complex`."""
        return np.abs(data.response) if self.normalized == "measured" else abs(model)

    def spread(
        self, model: ComplexArray, data: FrequencyResponse, correction: float
    ) -> tuple[float, Array]:
        """Return the mean curvature, and the variances of the gradient (2n,)."""
        score = relative_score(
            self.noise(model, data, correction), len(data), self.power, self.normalized
        )
        return score.curvature, np.repeat(score.variance, len(data))

    def gain_bias(self, noise: float, points: int) -> float:
        """Return a negative bias over the measured magnitude, a positive one over the model's."""
        return relative_score(noise, points, self.power, self.normalized).gain_bias


@public
@frozen
class RelativeError(_Relative):
    """Sum of relative errors, Σ |P - P̂| / |P̂|, with P the model and P̂ the measurement.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, (4.26).

    `normalized` by the "measured" magnitude as in the paper, or by that of the "model". With
    relative noise σ in each component, the first biases the gain by about -σ², the second by 2 σ².
    The standard errors are valid for errors that are isotropic in the complex plane and of one
    relative size, see `relative_score`. For small errors, Cov = (4/π) s² (JᵀJ)⁻¹, with s the
    standard deviation of one component. The minimum of n points and p parameters lies below the
    cost at the truth by p s √(π/2) / π, so that the mean |e| is too small; s is corrected for this.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> gb.fit(pitch_hover.problem().with_(criterion=gb.RelativeError()), starts=5).converged
    True
    """

    rule = "sum of relative errors"
    power = 1
    smoothed = True

    def cost(self, model: Complex, data: FrequencyResponse, smoothing: Any = 0.0) -> Any:
        """Return Σ sqrt(|e|² + smoothing)."""
        return total(sqrt(squared_magnitude(self.errors(model, data)) + smoothing))

    def size_of(self, errors: ComplexArray, correction: float) -> float:
        """Return the size from the mean |e|: s sqrt(π/2) (1 - p/(π n)) for isotropic errors."""
        share = 1 - 1 / correction**2  # p / (2n)
        return float(np.abs(errors).mean()) * math.sqrt(2 / math.pi) / (1 - 2 / math.pi * share)

    def score_correlation(self, correlation: Array) -> Array:
        """Return the correlation of the directions of errors, E e₁ e₂* / |e₁ e₂|.

        (E(k) - (1 - k²) K(k)) / k with the complete elliptic integrals, k the correlation of
        circular normal errors. Source: Middleton (1960), An Introduction to Statistical
        Communication Theory, section 9.1.
        """
        from scipy.special import ellipe, ellipkm1  # noqa: PLC0415  (imports slowly)

        # From 1 - k², since K is infinite at k = 1.
        k = np.clip(correlation, 1e-150, 1.0)
        m1 = 1 - k**2
        K_term = np.where(m1 > 0, m1 * ellipkm1(np.maximum(m1, 1e-300)), 0.0)
        # Below 1e-4, the difference of both terms is a rounding error.
        return np.where(k < 1e-4, math.pi / 4 * k, (ellipe(k**2) - K_term) / k)


@public
@frozen
class SquaredRelativeError(_Relative):
    """Sum of squared relative errors: Σ |P - P̂|² / |P̂|².

    `normalized` as in `RelativeError`. The standard errors are valid for errors of one relative
    size, see `relative_score`; for small errors, Cov = s² (JᵀJ)⁻¹. If the errors are divided by the
    measured magnitude, points that noise makes small have too much weight: with noise of 20 % in
    each component, the gain varies one and a half times as much as that of `RelativeLikelihood`,
    which has no such bias.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> squared = pitch_hover.problem().with_(criterion=gb.SquaredRelativeError())
    >>> gb.fit(squared, starts=5).converged
    True
    """

    rule = "sum of squared relative errors"
    power = 2

    def cost(self, model: Complex, data: FrequencyResponse, smoothing: Any = 0.0) -> Any:
        """Return Σ |e|²."""
        return total(squared_magnitude(self.errors(model, data)))


@public
@frozen
class RelativeLikelihood(Criterion):
    """Maximum likelihood for circular complex normal errors of one unknown relative variance.

    With errors of variance E|P̂ - P|² = σ² |P|², the negative log-likelihood is n log σ² + Σ log
    |P|² + Σ |P̂ - P|²/(σ² |P|²). At the best σ² this is

        n (log mean(|P̂ - P|² / |P|²) + 1) + Σ log (|P|² / v),

    up to a constant of the data. Here v are the variances of the data, for a comparison with
    `MaximumLikelihood`, or |P̂|² without variances. The gain has no bias: the term log |P|²
    balances the model's magnitude in the denominator. In a sum with a record, whose cost is a
    likelihood, too, it replaces `RelativeError`. The standard errors s² (JᵀJ)⁻¹ are those of errors
    of one relative size.

    Source: Pintelon and Schoukens, System Identification, 2nd ed., section 9.11, with σ²
    eliminated.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> likely = pitch_hover.problem().with_(criterion=gb.RelativeLikelihood())
    >>> gb.fit(likely, starts=5).converged
    True
    """

    rule = "maximum likelihood, one unknown relative variance"
    is_likelihood = True
    nuisances = 1
    uses = ()
    # It has nearly the same minimum, without a logarithm.
    locator = SquaredRelativeError()

    def cost(self, model: Complex, data: FrequencyResponse, smoothing: Any = 0.0) -> Any:
        """Return the negative log-likelihood at the best variance plus `smoothing`."""
        size = squared_magnitude(model)
        scale = np.abs(data.response) ** 2 if data.variance is None else data.variance
        variance = (
            total(squared_magnitude(model - data.response) / size) / len(data)
            + smoothing
            + 1e-18  # the relative variance of rounding errors, for an exact fit
        )
        return len(data) * (log(variance) + 1) + total(log(size / scale))

    def spread(
        self, model: ComplexArray, data: FrequencyResponse, correction: float
    ) -> tuple[float, Array]:
        """Weights of the variance that the cost took, and the corrected one of the errors."""
        s2 = max(self.size_of(1 - data.response / model, 1.0), ROUNDING) ** 2
        bread = 1 / s2
        return bread, np.full(2 * len(data), correction**2 * bread)


@public
@frozen
class MagnitudePhase(Criterion):
    """Magnitude and phase errors weighted by coherence, the cost of CIFER.

    J = 20/n Σ W_γ [ W_g (|P| - |P̂|)² + W_p (∠P - ∠P̂)² ] with magnitudes in dB, phases in degrees,
    W_g = 1, W_p = 0.01745 and W_γ = [1.58 (1 - exp(-γ²))]². Where the data have no coherence, γ² =
    1.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., section
    11.2. Phases are compared on the circle, within ±180°. The minimum is located with the squared
    relative error first, since wrapping makes local minima. The standard errors propagate isotropic
    errors through the weights. These errors have the variances of the data; or else relative
    variances in proportion to (1 - γ²)/γ², as random errors of a spectral estimate (Bendat and
    Piersol, Random Data, 4th ed., section 9.2), or one relative size, both scaled by the residuals.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> gb.fit(pitch_hover.problem().with_(criterion=gb.MagnitudePhase()), starts=5).converged
    True
    """

    rule = "coherence-weighted magnitude (dB) and phase (deg), CIFER"
    condition = (
        "errors isotropic in the complex plane, of the given variances, else of relative sizes by "
        "the coherence, else of one relative size"
    )
    uses = ("coherence", "variance")
    # It has no phase that wraps.
    locator = SquaredRelativeError()

    def cost(self, model: Complex, data: FrequencyResponse, smoothing: Any = 0.0) -> Any:
        """Return the weighted sum of squares."""
        # The logarithm of the ratio has both errors; its imaginary part is within ±π.
        ratio = (model / data.response).log()
        magnitude, phase = self._weights(data)
        return total(magnitude**2 * ratio.re**2 + phase**2 * ratio.im**2)

    def jacobian(
        self,
        model: ComplexArray,
        sensitivity: ComplexArray,
        data: FrequencyResponse,
    ) -> Array:
        """Return the derivatives of weighted log magnitude and phase."""
        relative = sensitivity / model[:, None]
        magnitude, phase = self._weights(data)
        return np.vstack([magnitude[:, None] * relative.real, phase[:, None] * relative.imag])

    def spread(
        self, model: ComplexArray, data: FrequencyResponse, correction: float
    ) -> tuple[float, Array]:
        """Noise size of one component relative to the magnitude, times the weights."""
        shape = self._relative_variance(data)
        weights = self._weights(data)
        s2 = shape / 2
        if data.variance is None:
            # The size comes from the mean of the cost, in which a coherence that was rounded to 1
            # does not become a point without an error.
            power = weights[0] ** 2
            squares = np.abs(np.log(model / data.response)) ** 2
            s2 *= correction**2 * np.sum(power * squares) / np.sum(power * shape)

        return 2.0, 4 * np.concatenate([w**2 * s2 for w in weights])

    def error_size(self, model: ComplexArray, data: FrequencyResponse) -> Array:
        """Return the roots of the given variances, or of those by the coherence."""
        return np.abs(model) * np.sqrt(self._relative_variance(data))

    def _relative_variance(self, data: FrequencyResponse) -> Array:
        """Return the relative variances (n,) of both components together.

        Without variances of the data, they lack a common factor.
        """
        if data.variance is not None:
            return data.variance / np.abs(data.response) ** 2
        if data.coherence is None or np.all(data.coherence == 1):
            return np.ones(len(data))
        return (1 - data.coherence) / data.coherence

    def _weights(self, data: FrequencyResponse) -> tuple[Array, Array]:
        """Return the roots of the weights of log magnitude and phase, units and 20/n included."""
        coherence = np.ones(len(data)) if data.coherence is None else data.coherence
        common = math.sqrt(20 / len(data)) * 1.58 * (1 - exp(-coherence))
        # The weight of squared degrees, relative to squared dB.
        return common * _DB_PER_NEPER, np.degrees(common * math.sqrt(0.01745))


@public
@frozen
class MaximumLikelihood(Criterion):
    """Maximum likelihood for circular normal errors of given variance: Σ |P - P̂|² / E|P̂ - P|².

    Needs data with `variance`. Source: Pintelon and Schoukens, System Identification, 2nd ed.,
    section 9.11.

    If a variance was itself estimated, with ν degrees of freedom (`FrequencyResponse.dof`), the
    errors over its root have a bivariate Student's t distribution. The cost of a point is then (ν +
    2)/2 · log(1 + 2 r²/ν), with r² as above, and its weight in the standard errors is ν/(ν + 2 r²),
    so that a variance that is small by chance does not get too much weight. The variance of the
    score of such a point is (ν + 2)/ν times its curvature. Source: Lange, Little and Taylor (1989),
    Robust statistical modeling using the t distribution, JASA 84.

    The standard errors are those of this likelihood. With 25 points of four degrees of freedom
    each, 95 % intervals contained the truth in 93 to 95 % of 150 fits; with two degrees in 87 to
    91 %, since few points then decide. If the residuals are larger than the variances, the standard
    errors are widened by the root of the ratio, the scale factor of the Particle Data Group (Review
    of Particle Physics, introduction). Several responses have the ratio of all together, unless
    theirs differ by Bartlett's test (5 %): each then has its own.

    Examples
    --------
    >>> from greybox.models.rate import DampedAngle
    >>> from greybox.problems import sitl_pitch
    >>> data = sitl_pitch.data()  # with variances
    >>> problem = gb.Problem(DampedAngle(), data, criterion=gb.MaximumLikelihood())
    >>> gb.fit(problem, starts=4).criterion
    'maximum-likelihood'
    """

    rule = "maximum likelihood, given variances"
    known_noise = True
    is_likelihood = True
    uses = ("variance",)
    condition = "circular errors of the given variances, scaled up if the residuals are larger"

    def check(self, data: FrequencyResponse) -> None:
        """Raise ValueError without variances."""
        if data.variance is None:
            raise ValueError(
                "MaximumLikelihood needs the variance of every point and these data have none: "
                "give FrequencyResponse(..., variance=...) or use RelativeError."
            )

    def cost(self, model: Complex, data: FrequencyResponse, smoothing: Any = 0.0) -> Any:
        """Return the sum of squared errors over their variances.

        Where the variances are estimates, the sum is that of Student's t.
        """
        squares = squared_magnitude(model - data.response) / _variance(data)
        if data.dof is None:
            return total(squares)
        # `log1p` has all digits of small residuals.
        logarithm = np.log1p if isinstance(squares, np.ndarray) else ca.log1p
        return total((data.dof + 2) / 2 * logarithm(2 * squares / data.dof))

    def scale(self, model: ComplexArray, data: FrequencyResponse) -> Array:
        """Return the standard deviations of the errors.

        Where they are estimates, large residuals count for less.
        """
        variance = _variance(data)
        if data.dof is not None:
            variance = variance * (1 + 2 * self._squares(model, data) / data.dof)
        return np.sqrt(variance)

    def spread(
        self, model: ComplexArray, data: FrequencyResponse, correction: float
    ) -> tuple[float, Array]:
        """Return the weights of errors with half of the variance in each component.

        The variance is that of the residuals, if it is larger.
        """
        ratio = max(self.noise_ratio(model, data) * correction**2, 1.0)
        few = np.ones(len(data)) if data.dof is None else (data.dof + 2) / data.dof
        return 2.0, 2 * ratio * np.tile(few, 2)

    def error_size(self, model: ComplexArray, data: FrequencyResponse) -> Array:
        """Return the roots of the given variances."""
        return np.sqrt(_variance(data))

    def noise_ratio(self, model: ComplexArray, data: FrequencyResponse) -> float:
        """Return the squared residuals over the given variances, by maximum likelihood."""
        squares = self._squares(model, data)
        if data.dof is None or not squares.any():
            return float(np.mean(squares))
        scale = 1.0
        # A fixed point; with two degrees of freedom, the worst case, each step halves the error.
        for _ in range(40):
            scale *= float(np.mean((data.dof + 2) * squares / (data.dof * scale + 2 * squares)))
        return scale

    def _squares(self, model: ComplexArray, data: FrequencyResponse) -> Array:
        return np.abs(model - data.response) ** 2 / _variance(data)


def evaluate(criterion: Criterion, model: ComplexArray, data: FrequencyResponse) -> float:
    """Return the cost of a response (n,); NaN if the data lack what the criterion needs."""
    try:
        criterion.check(data)
    except ValueError:
        return math.nan
    # The cost of a zero response is infinite: a division by zero, or its logarithm.
    with np.errstate(all="ignore"):
        return float(criterion.cost(Complex(model.real, model.imag), data))


def cost_of_zero(criterion: Criterion, data: FrequencyResponse) -> float:
    """Return the cost of a response that is zero everywhere; infinite if not finite.

    Relative to the measured magnitude every error is then 1, so that (4.26) has a wide attractor at
    zero gain.
    """
    cost = evaluate(criterion, np.zeros(len(data), dtype=complex), data)
    return cost if math.isfinite(cost) else math.inf


def _variance(data: FrequencyResponse) -> Array:
    assert data.variance is not None
    return data.variance


def squared_magnitude(value: Complex) -> Any:
    """Return |value|² (n,), in numbers or in CasADi expressions."""
    return value.re**2 + value.im**2


def total(values: Any) -> Any:
    """Return the sum of values (n,), in numbers or in CasADi expressions."""
    return np.sum(values) if isinstance(values, np.ndarray) else ca.sum1(values)
