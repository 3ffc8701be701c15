"""The Fourier integrals of a manoeuvre with their model: errors, derivatives, end terms.

With X, Y, U the integrals of the states, outputs and inputs over a manoeuvre of duration T, and
exp(-jωT) = 1,

    jωX + x(T) - x(0) = A X + B U,    so
    Y = [C (jωI - A)⁻¹ B + D] U + C (jωI - A)⁻¹ b,    b = x(0) - x(T).

A manoeuvre that ends elsewhere than it began has b ≠ 0, which biases a ratio Y/U. Here b is
estimated too, linearly: for given parameters it follows by least squares, and what remains of the
errors depends on the parameters alone (variable projection: Golub and Pereyra 2003, Inverse
Problems 19, R1). The end term: Pintelon and Schoukens, System Identification, 2nd ed., section 6.3.

Where inputs are held, the transforms of sampled outputs differ from Y by aliasing: see
`folded_back`.

Output error compares the outputs. Equation error compares T Y, where T (jω) turns the outputs into
the forcing of the differential equation. The outputs then have the covariance of T⁻¹ times the
errors, which depends on the parameters.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import (
    Array,
    ComplexArray,
    all_finite,
    positive_or_one,
    real_and_imaginary,
)
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import grouped
from greybox.data.files.named_values import array_of
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.engine.compiled.information import ColoredErrors, Information
from greybox.engine.compiled.part import NO_NODES, Part, Trajectory
from greybox.engine.compiled.residual_covariance import (
    FEWEST,
    ResidualCovariance,
    residual_covariance_of,
)
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.formulation.spectrum_criteria import EquationError, outputs_in_spectrum
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.held_inputs import folded_back
from greybox.modeling.model_reference import reference
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.symbolic_reading import as_column, dense_jacobian, entries_by_name
from greybox.modeling.trim import trim_of
from greybox.statistics.column_space import column_basis, outside, pseudo_inverse
from greybox.statistics.disturbed_errors import disturbed_errors, in_time, louder_times
from greybox.statistics.uneven_errors import uneven_errors

TINY = 1e-300


@frozen
class Along:
    """The model of a manoeuvre at given parameters: outputs, errors, and their derivatives.

    Attributes
    ----------
    slopes, delay_slopes : (n + k, n + m, q) and (m, q) arrays
        Derivatives of [A, B; C, D] and of the delays with respect to the parameters.
    signals : (n + m, lines) complex array
        States with the end term, then delayed inputs.
    inverse : (lines, n, n) complex array
        Inverse of jωI - A.
    to_outputs : (lines, k, n + k) complex array
        Derivatives of the outputs with respect to additions to A X + B U, then to C X + D U.
    first_slopes : (k, 2 m, q) array
        Derivatives of [C B, D] with respect to the parameters.
    beside : (2 m, lines) complex array
        Effect of aliased inputs on the sampled outputs, per entry of [C B, D].
    by_delays : (k, m, lines) complex array
        Derivatives of the outputs with respect to the delays.
    modeled : (k, lines) complex array
        Outputs with the end term.
    transform : (lines, k, k) complex array
        T (jω) of equation error; the identity for output error.
    errors : (k, 2 lines) array
        Real parts, then imaginary parts, in units of the deviation of one sample.
    basis : (k, 2 lines, n) array
        Derivatives of the errors with respect to the end terms.
    ends : (n,) array
        x(0) - x(T).
    covariance : ResidualCovariance
    products : (k, k) array
        Sums of products of errors from which the covariance follows: the manoeuvre's own, or means
        of several manoeuvres.
    logarithms : float
        Sum of log |det T| over the lines.
    """

    slopes: Array
    delay_slopes: Array
    signals: ComplexArray
    inverse: ComplexArray
    to_outputs: ComplexArray
    first_slopes: Array
    beside: ComplexArray
    by_delays: ComplexArray
    modeled: ComplexArray
    transform: ComplexArray
    errors: Array
    basis: Array
    ends: Array
    covariance: ResidualCovariance
    products: Array
    logarithms: float

    @cached_property
    def weight(self) -> Array:
        """W (k, k) with WᵀW the inverse of the covariance of the errors."""
        return self.covariance.weight(self.products)

    @cached_property
    def taken(self) -> Array:
        """Orthonormal basis (2 k lines, n) of the weighted errors that end terms can explain."""
        basis = np.einsum("ka,aln->kln", self.weight, self.basis)
        return column_basis(basis.reshape(self.errors.size, -1))

    def with_products(self, products: Array) -> "Along":
        """Return the same model with the end terms that are best for other products."""
        weight = self.covariance.weight(products)
        change = _best_ends(weight, self.errors, self.basis)
        n = len(self.ends)
        by_change = self.inverse @ change
        return replace(
            self,
            signals=self.signals + np.pad(by_change.T, ((0, len(self.signals) - n), (0, 0))),
            modeled=self.modeled + np.einsum("lkn,n->kl", self.to_outputs[:, :, :n], change),
            errors=self.errors - self.basis @ change,
            ends=self.ends + change,
            products=products,
        )


class TransientPart(Part):
    """The spectrum of one manoeuvre.

    Attributes
    ----------
    data : TransientSpectrum
    outputs : tuple of str
        The outputs that are compared.
    system : Dynamics
    locate : casadi.Function
        (z) -> the declared parameters q, and their derivatives (q, p).
    """

    has_states = True  # the states at both ends are unknown

    def __init__(self, problem: Problem, expressions: Mapping[str, Any], z: ca.SX) -> None:
        """Compile the matrices of the model; `expressions` are all parameters by outside name."""
        super().__init__(problem)
        assert isinstance(problem.data, TransientSpectrum)
        assert isinstance(problem.criterion, TimeCriterion)
        self.data = problem.data
        self.locate = _locate(problem, expressions, z)
        self.outputs = outputs_in_spectrum(problem.criterion, problem.model, problem.data)
        system = dynamics(problem.model, delay_order(problem.delay)).observed(self.outputs)
        # A gust in every equation: as many gusts as outputs, with one time constant.
        colored = self.outputs if len(problem.declared) > len(problem.model.parameters) else ()
        gusts = tuple(f"gust_{name}" for name in colored)
        self.states, self.inputs = (*system.states, *gusts), system.inputs
        self.numbers = 2 * len(self.data) * len(self.outputs)
        self.unknown_initial_states = len(self.states)  # one end term for each state
        self._matrices = _matrices(problem, system, gusts)
        # The output of a Padé approximation responds at once, that of a delay does not.
        delayed = () if problem.delay == "exact" else getattr(problem.model, "delays", self.inputs)
        held = {*self.data.held} - {*delayed}
        self._held = np.array([[name in held] for name in self.inputs])
        self._is_equation_error = isinstance(problem.criterion, EquationError)
        # White noise with a deviation of one in every sample gives each component of an integral
        # this deviation.
        self._unit = math.sqrt(self.data.step * self.data.duration / 2)
        self.measured = array_of(self.data.outputs, self.outputs)
        self._covariance = residual_covariance_of(
            problem.criterion, self.outputs, self._real(self.measured)
        )
        # Degrees of freedom of each output that the end terms use up.
        self.lost = len(self.states) / len(self.outputs)
        self.few = self._covariance.few(self.lost)
        self._noise_group = repr((reference(problem.model), problem.criterion, self.outputs))

    def _real(self, values: ComplexArray) -> Array:
        """Return complex values (k, lines, ...) as real ones (k, 2 lines, ...).

        The result is in units of the standard deviation of one sample.
        """
        return real_and_imaginary(values, 1) / self._unit

    # --- the errors at given parameters

    def along(self, q: Array) -> Along | None:
        """Return the model at the parameters q; None where it is not finite."""
        matrices = [matrix.full() for matrix in self._matrices(q)]
        matrix, delays, first, slopes, delay_slopes, first_slopes = matrices
        n, k = len(self.states), len(self.outputs)
        A, B, C, D = matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:]
        delayed = [*map(self.data.delayed_input, self.inputs, delays.ravel().tolist())]
        # Each delayed input comes with its derivative with respect to the delay.
        pairs = np.array(delayed).reshape(-1, 2, len(self.data))
        inputs, input_slopes = pairs.swapaxes(0, 1)
        pencil = 1j * self.data.omega[:, None, None] * np.eye(n) - A

        try:
            inverse = np.linalg.inv(pencil)
            by_ends = C @ inverse
            # The errors of equation error drive the last states: all states, or the gusts. With
            # one output, the transform is the characteristic polynomial.
            outputs = np.broadcast_to(np.eye(k, dtype=complex), (len(pencil), k, k))
            transform: Any = outputs
            if self._is_equation_error and k == 1:
                transform = np.linalg.det(pencil)[:, None, None]
            elif self._is_equation_error:
                transform = np.linalg.inv(by_ends[:, :, -k:])
        except np.linalg.LinAlgError:
            # A pole lies on the imaginary axis, at one of the frequencies.
            return None

        step = self.data.step
        at_once, ramps, turned = self._held * folded_back(
            1j * self.data.omega * step, delays / step
        )
        beside = np.vstack([step * ramps, at_once]) * np.tile(inputs, (2, 1))
        transfer = by_ends @ B + D
        modeled = np.einsum("lkm,ml->kl", transfer, inputs) + first @ beside
        errors = self._transformed(transform, self.measured - modeled)
        basis = self._real((transform @ by_ends).swapaxes(0, 1))
        logarithms = float(np.linalg.slogdet(transform)[1].sum())
        if not all_finite(errors, basis, logarithms):
            return None

        covariance = self._covariance.along(self._transformed(transform, self.measured))
        errors, ends = _without_ends(errors, basis, covariance)
        states = np.einsum("lij,jl->il", inverse, B @ inputs + ends[:, None])
        by_delays = transfer.transpose(1, 2, 0) * input_slopes
        by_delays += (C @ B)[..., None] * (step * ramps * input_slopes + turned * inputs)
        return Along(
            # CasADi stacks the entries of a matrix column by column.
            slopes=slopes.reshape(*matrix.T.shape, len(q)).swapaxes(0, 1),
            delay_slopes=delay_slopes,
            signals=np.vstack([states, inputs]),
            inverse=inverse,
            to_outputs=np.concatenate([by_ends, outputs], 2),
            first_slopes=first_slopes.reshape(*first.T.shape, len(q)).swapaxes(0, 1),
            beside=beside,
            by_delays=by_delays,
            modeled=C @ states + D @ inputs + first @ beside,
            transform=transform,
            errors=errors,
            basis=basis,
            ends=ends,
            covariance=covariance,
            products=errors @ errors.T,
            logarithms=logarithms,
        )

    def located(self, names: Sequence[str]) -> ca.Function:
        """Return the function from these values to the declared parameters, as `locate`."""
        point = ca.SX.sym("x", len(names))
        return _locate(self.problem, entries_by_name(names, point), point)

    def _transformed(self, transform: ComplexArray, values: ComplexArray) -> Array:
        """Return T times complex values (k, lines), as real ones (k, 2 lines)."""
        return self._real(np.einsum("lab,bl->al", transform, values))

    def modeled_slopes(self, at: Along, by: Array) -> ComplexArray:
        """Return the derivatives (k, lines, x) of the modeled outputs by x, at fixed end values.

        `by` (q, x) are the derivatives of the parameters.
        """
        modeled = np.einsum("lkr,rcx,cl->klx", at.to_outputs, at.slopes @ by, at.signals)
        modeled += np.einsum("kcx,cl->klx", at.first_slopes @ by, at.beside)
        modeled += np.einsum("kml,mx->klx", at.by_delays, at.delay_slopes @ by)
        return modeled

    def derivatives(self, at: Along, by: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of the errors by x, at fixed end values.

        `by` (q, x) are the derivatives of the parameters.

        Returns
        -------
        mean : (k, 2 lines, x) array
            Derivatives of the errors through the modeled outputs, at a fixed transform.
        total : (k, 2 lines, x) array
            Derivatives of the errors through both the modeled outputs and the transform.
        transform : (lines, k, k, x) complex array
            dT T⁻¹; zeros for output error.
        """
        mean = -self._real(np.einsum("lab,blx->alx", at.transform, self.modeled_slopes(at, by)))

        relative = np.zeros((*at.transform.shape, by.shape[1]), complex)
        n, k = len(self.states), len(self.outputs)
        if self._is_equation_error:
            slopes = (at.slopes @ by)[:, :n]  # of A and C
            if k == 1:
                # d log det P = tr(P⁻¹ dP), with P = jωI - A.
                relative -= np.einsum("lij,jix->lx", at.inverse, slopes[:n])[:, None, None, :]
            else:
                # With T⁻¹ = C P⁻¹ E, dT T⁻¹ is -T (dC + C P⁻¹ dA) P⁻¹ E.
                left = at.transform @ at.to_outputs
                relative -= np.einsum("lar,rcx,lcb->labx", left, slopes, at.inverse[:, :, -k:])
        unexplained = np.einsum("lab,bl->al", at.transform, self.measured - at.modeled)
        return (
            mean,
            mean + self._real(np.einsum("labx,bl->alx", relative, unexplained)),
            relative,
        )

    def fisher_root(self, at: Along, mean: Array, change: Array) -> tuple[Array, Array, Array]:
        """Return a root of the Fisher information of x, for derivatives of mean and transform by x.

        Returns
        -------
        mean : (2 k lines, x) array
            Derivatives of the weighted errors, with the end term fitted too.
        variance : (r, x) array
            The information in the variances of the outputs where they depend on x, with the size of
            the noise fitted too.
        reach : (x,) array
            Lengths of the columns before the end term was fitted.
        """
        rows = np.einsum("ka,alx->klx", at.weight, mean).reshape(-1, mean.shape[-1])
        turned = np.einsum("ka,labx,bc->lkcx", at.weight, change, np.linalg.inv(at.weight))
        hermitian = turned + turned.conj().swapaxes(1, 2)
        variance = real_and_imaginary(hermitian, 1)
        # The fitted size of the noise explains the common part of all variances.
        variance = (variance - variance.mean(axis=0)).reshape(-1, mean.shape[-1])
        reach = np.linalg.norm(np.vstack([rows, variance]), axis=0)

        return outside(rows, at.taken), variance, reach

    # --- for Gauss-Newton

    def trajectory(
        self, z: Array, nodes: Array | None = None, *, simulated: bool = False
    ) -> Trajectory:
        """Return the point z, with the best end term; not finite where the model is not."""
        at = self.along(self.locate(z)[0].full().ravel())
        count = len(self.outputs)
        products = np.full((count, count), np.nan) if at is None else at.products
        return Trajectory(z, NO_NODES, NO_NODES, NO_NODES, products, simulated=True, detail=at)

    @property
    def noise_group(self) -> Any:
        """Equal for manoeuvres with one model, criterion and outputs."""
        return self._noise_group

    def with_products(self, trajectory: Trajectory, products: Array) -> tuple[Trajectory, Array]:
        """Return a trajectory whose noise follows from `products` (k, k), and its own products."""
        # The products are not finite where the model of any of these manoeuvres is not finite.
        if not (self.few.any() and all_finite(products)):
            return trajectory, trajectory.products
        at = trajectory.detail.with_products(products)
        return replace(trajectory, products=products, detail=at), at.errors @ at.errors.T

    def cost(self, trajectory: Trajectory, smoothing: float) -> float:
        """Return the negative log-likelihood of the outputs, with the best end term and noise."""
        at: Along | None = trajectory.detail
        return (
            math.inf if at is None else at.covariance.cost(trajectory.products) - 2 * at.logarithms
        )

    def linearize(self, trajectory: Trajectory, weight: Array) -> tuple[Array, Array]:
        """Return gradient (p,) and Fisher information (p, p); end term and noise follow."""
        at: Along = trajectory.detail
        mean, total, change = self.derivatives(at, self.locate(trajectory.z)[1].full())
        by_errors = np.einsum("kl,klz->z", at.weight.T @ at.weight @ at.errors, total)
        mean, variance, _ = self.fisher_root(at, mean, change)
        rows = np.vstack([mean, variance])

        return by_errors - 2 * np.einsum("laaz->z", change).real, rows.T @ rows

    def rows(self, trajectory: Trajectory) -> tuple[Array, Array]:
        """Return the residuals (m,) in standard deviations, with their derivatives (m, p) by z.

        The end term is fitted too. The cost of equation error also has logarithms. Its residuals
        are therefore changed, as little as possible, so that their product with the derivatives is
        the gradient of the cost.
        """
        at: Along = trajectory.detail
        mean, _, change = self.derivatives(at, self.locate(trajectory.z)[1].full())
        mean, variance, _ = self.fisher_root(at, mean, change)
        rows = np.vstack([mean, variance])
        errors = np.append((at.weight @ at.errors).ravel(), np.zeros(len(variance)))

        gradient, hessian = self.linearize(trajectory, at.weight)
        missing_gradient = gradient - rows.T @ errors
        correction = rows @ pseudo_inverse(hessian, 1e-14) @ missing_gradient
        return errors + correction, rows

    def signature(self, trajectory: Trajectory) -> Array:
        """Return the modeled outputs over the root mean square of the measured ones."""
        size = np.sqrt(np.mean(np.abs(self.measured) ** 2, axis=1, keepdims=True))
        values = trajectory.detail.modeled / positive_or_one(size)
        return real_and_imaginary(values.ravel())

    # --- for the covariance of the estimate

    @one_thread_at_a_time
    def information(
        self,
        names: tuple[str, ...],
        values: Array,
        uncertain: tuple[int, ...],
        trajectory: Trajectory | None,
        dz_dx: Array,
    ) -> Information:
        """Return the information on the values (k,) for white errors, the end term fitted too."""
        assert trajectory is not None
        at: Along = trajectory.detail
        _, slope = self.located(names)(values)
        mean, _, change = self.derivatives(at, slope.full())
        mean, variance, reach = self.fisher_root(at, mean, change)
        jacobian = np.vstack([mean, variance])
        fitted = column_basis(np.hstack([mean, at.taken]))
        # Response of the errors to slow gusts on each state and each output. Fast gusts are hardly
        # different from white errors.
        gusts = np.einsum("ij,ljk,lks->sil", at.weight, at.transform, at.to_outputs)
        errors = at.weight @ at.errors
        calm, by_line = disturbed_errors(errors, fitted, gusts / self.data.omega)
        shape = len(self.outputs), 2, len(self.data)
        errors, taken = errors.reshape(shape), at.taken.reshape(*shape, -1)
        steady, by_time = louder_times(in_time(errors), in_time(fitted.reshape(*shape, -1)))
        # White errors, a disturbance and louder times have equal prior probabilities. If the data
        # exclude white errors twice, both probabilities and the denominator underflow to zero.
        louder = calm * (1 - steady) / max(calm + steady - calm * steady, TINY)
        return ManoeuvreInformation(
            mean,
            variance,
            errors,
            taken,
            by_line,
            by_time,
            louder,
            part=self,
            jacobian=jacobian,
            numbers=self.numbers - len(self.states),
            reach=reach,
            # White errors are this improbable in 1 % of 2500 fits with right models, and in 91 % of
            # the output-error fits of manoeuvres in gusts.
            disturbed=calm < 0.2,
        )


@frozen
class ManoeuvreInformation(Information):
    """The information of a manoeuvre, whose errors may be larger in a part of the band or the time.

    Attributes
    ----------
    mean, variance : (rows, k) arrays
        The information in the outputs, and in their variances.
    residuals, taken : (outputs, 2, n) and (outputs, 2, n, columns) arrays
        Weighted errors, real and imaginary parts, and a basis of what the end term explains.
    by_line, by_time : arrays
        Covariance of the sizes of the errors over the lines, and over the time.
    louder : float
        Probability that sizes differ over the time and not over the lines.
    """

    mean: Array
    variance: Array
    residuals: Array
    taken: Array
    by_line: Any
    by_time: Any
    louder: float

    def spread(self, correction: float) -> tuple[float, Array]:
        """Return the bread and a root of the meat; variances are estimated, and not corrected."""
        return 1.0, self.jacobian

    def colored(self, root: Array) -> ColoredErrors:
        """Return the effect of errors of unequal size over the lines, or over the time."""
        meat_by_line, dof_by_line = self._uneven(root, np.asarray, self.by_line)
        meat_by_time, dof_by_time = self._uneven(root, in_time, self.by_time)
        meat = meat_by_line + self.louder * (meat_by_time - meat_by_line)
        inverse_dof = (1 - self.louder) / dof_by_line + self.louder / dof_by_time
        return ColoredErrors(meat, 1 / inverse_dof if inverse_dof else math.inf)

    def _uneven(
        self, root: Array, view: Callable[[Array], Array], covariance: Any
    ) -> tuple[Array, float]:
        """Return middle matrix and degrees of freedom for unequal sizes in one view of the errors.

        The view is over the lines, or over the time.
        """
        rows = (self.mean[:, : len(root)] @ root).reshape(*self.residuals.shape, -1)
        certain = self.variance[:, : len(root)] @ root
        return uneven_errors(
            view(self.residuals),
            view(rows),
            root,
            view(self.taken),
            certain.T @ certain,
            covariance,
        )


def compile_manoeuvres(
    problems: Sequence[Problem], expressions: Mapping[str, Any], z: ca.SX
) -> list[TransientPart]:
    """Compile manoeuvres for the point z; `expressions` are all parameters by outside name.

    Manoeuvres with few lines share one variance. If they have too few degrees of freedom together,
    the next larger manoeuvres share it too.
    """
    parts = [TransientPart(problem, expressions, z) for problem in problems]
    for group in grouped(parts, lambda part: part.noise_group):
        if not any(part.few.any() for part in group):
            continue
        degrees = 0.0
        for part in sorted(group, key=lambda part: part.numbers):
            if degrees >= FEWEST and not part.few.any():
                break
            part.few = np.full(len(part.outputs), 2 * len(part.data))
            degrees += 2 * len(part.data) - part.lost
    return parts


def _locate(problem: Problem, expressions: Mapping[str, Any], z: ca.SX) -> ca.Function:
    """Return the function from z to the declared parameters and their derivatives."""
    q = as_column(problem.local_values(expressions).values())
    return ca.Function("locate", [z], [q, dense_jacobian(q, z)])


def _matrices(problem: Problem, system: Dynamics, gusts: tuple[str, ...]) -> ca.Function:
    """Return (all parameters) -> [A, B; C, D], delays, [C B, D], and derivatives of all entries.

    In [C B, D], D is zero for inputs with delays: what sampling adds to a delayed step jumps where
    the delay is a whole number of holds, and its mean over all delays is zero.
    """
    model = problem.model
    declared = ca.MX.sym("p", len(problem.declared))
    p, times = ca.vertsplit(declared, [0, len(model.parameters), declared.numel()])
    x, u, q = system.symbols
    h = system.output(x, u, q)
    rates = system.derivative(x, u, q)
    g = ca.SX.sym("g", len(gusts))
    time = ca.SX.sym("T", times.numel())
    if gusts:
        # Each error drives its own equation, or a single one drives all states: the transform T is
        # the same.
        rates += g
    matrix = dense_jacobian(ca.vertcat(rates, -g / time, h), ca.vertcat(x, g, u))
    n = x.numel() + len(gusts)
    delays = system.delay(q)
    B, C, D = matrix[:n, n:], matrix[n:, :n], matrix[n:, n:]
    undelayed = ca.diag([float(delay.is_zero()) for delay in ca.vertsplit(delays)])
    entries = [matrix, ca.densify(delays), ca.densify(ca.horzcat(C @ B, D @ undelayed))]
    linear = ca.Function("linear", [q, time, x, u], entries)
    states, inputs = trim_of(model, problem.at).closed()(p)
    # The states of a Padé delay, or of a realized transfer function, follow those of the model.
    # They are linear and have no operating point.
    states = ca.vertcat(states, ca.DM.zeros(x.numel() - states.numel()))

    results = linear(p, times, states, inputs)
    slopes = [dense_jacobian(ca.vec(result), declared) for result in results]
    return ca.Function("matrices", [declared], [*results, *slopes])


def _without_ends(
    errors: Array, basis: Array, covariance: ResidualCovariance
) -> tuple[Array, Array]:
    """Return errors (k, 2 lines) less the best combination (n,) of the basis (k, 2 lines, n)."""
    ends = np.zeros(basis.shape[-1])
    last, remaining = math.inf, errors
    # Weights and end terms are computed in turn. In each pass, the change of the cost falls to the
    # share of the degrees of freedom that the end terms use up: a tenth or less.
    for _ in range(50):
        weight = covariance.weight(remaining @ remaining.T)
        ends = _best_ends(weight, errors, basis)
        remaining = errors - basis @ ends
        cost = covariance.cost(remaining @ remaining.T)
        # The negated comparison also ends the passes at a cost of NaN.
        if len(errors) == 1 or not last - cost > 1e-11 * errors.size:
            break
        last = cost

    return remaining, ends


def _best_ends(weight: Array, errors: Array, basis: Array) -> Array:
    """Return the combination (n,) of the basis (k, 2 lines, n) nearest to the weighted errors."""
    rows = np.einsum("ka,aln->kln", weight, basis).reshape(errors.size, -1)
    size = positive_or_one(np.linalg.norm(rows, axis=0))
    # Smaller singular values are rounding, as for a state that no output shows.
    return np.linalg.lstsq(rows / size, (weight @ errors).ravel(), rcond=1e-10)[0] / size
