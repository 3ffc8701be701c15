"""The Fourier integrals of a manoeuvre with their model: errors, derivatives, end terms.

With X, Y, U the integrals of the states, outputs and inputs over a manoeuvre of duration T, and
exp(-jωT) = 1,

    jωX + x(T) - x(0) = A X + B U,    so
    Y = [C (jωI - A)⁻¹ B + D] U + C (jωI - A)⁻¹ b,    b = x(0) - x(T).

A manoeuvre that ends elsewhere than it began has b ≠ 0, which biases a ratio Y/U. Here b is
estimated along, linearly: for given parameters it follows by least squares, and what remains of the
errors depends on the parameters alone (variable projection: Golub and Pereyra 2003, Inverse
Problems 19, R1). The end term: Pintelon and Schoukens, System Identification, 2nd ed., section 6.3.

Output error compares the outputs. Equation error compares T Y, where T (jω) makes of the outputs
what drives the differential equation; then the outputs have the covariance of T⁻¹ times the errors,
which depends on the parameters.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.part import NO_NODES, Information, Part, Program, Trajectory
from greybox.compiled.residual_covariance import ResidualCovariance, require_independent
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.files.arrays import Array, ComplexArray
from greybox.formulation.problem import Problem
from greybox.formulation.spectrum_criteria import EquationError, outputs_in_spectrum
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.model import Model
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.state_space import StateSpace
from greybox.modeling.trim import trim_of

# Weights and end terms follow each other: the change of the cost at which they have, and how often
# at most. Each time the change falls to the share of the numbers that end terms take up, a tenth or
# less.
SETTLED = 1e-11
REWEIGHTINGS = 50
# Singular value of the end terms' basis, with columns of length one, over the largest: what is
# below cannot be told from rounding, as of a state that no output sees.
UNSEEN = 1e-10


@dataclass(frozen=True, eq=False)
class Matrices:
    """A, B, C, D and the delays (m,) of the inputs; or their derivatives, by a last axis."""

    A: Array
    B: Array
    C: Array
    D: Array
    delays: Array


@dataclass(frozen=True, eq=False)
class Along:
    """What follows from the parameters of the model.

    Attributes
    ----------
    q : (q,) array
    matrices : Matrices
    inputs : (m, lines) complex array
        Delayed.
    inverse : (lines, n, n) complex array
        Of jωI - A.
    states : (lines, n) complex array
        With the end term.
    modelled : (k, lines) complex array
        Outputs with the end term.
    errors : (k, 2 lines) array
        Real parts, then imaginary parts, in units of the deviation of one sample.
    basis : (k, 2 lines, n) array
        Of the end terms, likewise.
    ends : (n,) array
        x(0) - x(T).
    covariance : ResidualCovariance
    logarithms : float
        Sum of log |det T| over the lines.
    """

    q: Array
    matrices: Matrices
    inputs: ComplexArray
    inverse: ComplexArray
    states: ComplexArray
    modelled: ComplexArray
    errors: Array
    basis: Array
    ends: Array
    covariance: ResidualCovariance
    logarithms: float


class TransientPart(Part):
    """The spectrum of one manoeuvre.

    Attributes
    ----------
    data : TransientSpectrum
    outputs : tuple of str
        Those that are compared.
    system : Dynamics
    locate : casadi.Function
        (z) -> the declared parameters q, and their derivatives (q, p).
    """

    has_states = True  # the states at both ends are unknown

    def __init__(self, problem: Problem, locate: ca.Function) -> None:
        """Compile the matrices of the model."""
        super().__init__(problem)
        assert isinstance(problem.data, TransientSpectrum)
        assert isinstance(problem.criterion, TimeCriterion)
        self.data = problem.data
        self.locate = locate
        self.outputs = outputs_in_spectrum(problem.criterion, problem.model, problem.data)
        system = dynamics(problem.model, delay_order(problem.delay))
        self.states, self.inputs = system.states, system.inputs
        self.numbers = 2 * len(self.data) * len(self.outputs)
        self.unknown_initial_states = len(self.states)  # those of the end term
        self._matrices, self._slopes = _matrix_functions(
            problem.model, system, problem.at, self.outputs
        )
        self._is_equation_error = isinstance(problem.criterion, EquationError)
        self._noise = problem.criterion.noise
        # White noise of deviation one in a sample gives each component of an integral this one.
        self._unit = math.sqrt(self.data.step * self.data.duration / 2)
        if self._noise == "full":
            require_independent(self.outputs, self._real(self._measured))

    @cached_property
    def _measured(self) -> ComplexArray:
        return np.array([self.data.outputs[name] for name in self.outputs])

    def _real(self, values: ComplexArray) -> Array:
        """Return complex rows (..., lines) as real ones (..., 2 lines).

        In units of the deviation of one sample.
        """
        return np.concatenate([values.real, values.imag], axis=-1) / self._unit

    # --- the errors at given parameters

    def along(self, q: Array) -> Along | None:
        """Return what follows from the parameters q of the model; None where it is not finite."""
        blocks = [value.full() for value in self._matrices(q)]
        if not all(np.all(np.isfinite(block)) for block in blocks):
            return None
        matrices = Matrices(*blocks[:4], delays=blocks[4][:, 0])
        late = zip(self.inputs, matrices.delays.tolist(), strict=True)
        inputs = np.array([self.data.delayed_input(name, delay) for name, delay in late])
        pencil: Any = 1j * self.data.omega[:, None, None] * np.eye(len(self.states)) - matrices.A

        try:
            inverse: Any = np.linalg.inv(pencil)
            transform = self._transform(matrices, pencil)
        except np.linalg.LinAlgError:
            # A pole lies on the imaginary axis, at one of the frequencies.
            return None

        forced = np.einsum("lij,jl->li", inverse, matrices.B @ inputs)
        outputs = matrices.C @ forced.T + matrices.D @ inputs
        by_ends = matrices.C @ inverse
        errors, basis, logarithms = self._measured - outputs, by_ends, 0.0
        if transform is not None:
            errors, basis = np.einsum("lab,bl->al", transform, errors), transform @ by_ends
            logarithms = float(np.linalg.slogdet(transform)[1].sum())

        errors, basis = self._real(errors), self._stacked(basis.swapaxes(0, 1))
        if not (
            np.all(np.isfinite(errors)) and np.all(np.isfinite(basis)) and math.isfinite(logarithms)
        ):
            return None

        covariance = self._covariance(transform)
        errors, ends = _without_ends(errors, basis, covariance)
        return Along(
            q=q,
            matrices=matrices,
            inputs=inputs,
            inverse=inverse,
            states=forced + inverse @ ends,
            modelled=outputs + (by_ends @ ends).T,
            errors=errors,
            basis=basis,
            ends=ends,
            covariance=covariance,
            logarithms=logarithms,
        )

    def _transform(self, matrices: Matrices, pencil: ComplexArray) -> ComplexArray | None:
        """Return T (lines, k, k) of the equation error: of all states, or of the one output."""
        if not self._is_equation_error:
            return None
        if len(self.outputs) == 1:
            return np.linalg.det(pencil)[:, None, None]
        return pencil @ np.linalg.inv(matrices.C)

    def _covariance(self, transform: ComplexArray | None) -> ResidualCovariance:
        """Return how products of errors become a cost; a constant output's scale is its size."""
        measured = (
            self._measured
            if transform is None
            else np.einsum("lab,bl->al", transform, self._measured)
        )
        spread = np.sqrt(np.mean(self._real(measured) ** 2, axis=1))
        known = None
        if isinstance(self._noise, Mapping):
            known = np.array([float(self._noise[name]) for name in self.outputs])
        counts = np.full(len(self.outputs), 2 * len(self.data))

        return ResidualCovariance(
            counts, np.where(spread > 0, spread, 1.0), known, self._noise == "full"
        )

    def derivatives(self, at: Along) -> tuple[Array, Array, Array]:
        """Return how the errors follow the parameters q, the end term held.

        Returns
        -------
        mean : (k, 2 lines, q) array
            Of the errors, as far as the modelled outputs change.
        total : (k, 2 lines, q) array
            Of the errors.
        transform : (lines, k, k, q) complex array
            dT T⁻¹; zeros for output error.
        """
        m, omega = at.matrices, self.data.omega
        *slopes, late = (value.full() for value in self._slopes(at.q))
        pairs = zip(slopes, (m.A, m.B, m.C, m.D), strict=True)
        # CasADi stacks the entries of a matrix column by column.
        stacked = (slope.reshape(*M.shape[::-1], slope.shape[1]) for slope, M in pairs)
        d = Matrices(*(slope.swapaxes(0, 1) for slope in stacked), delays=late)
        late = np.array(
            [
                -np.exp(-1j * omega * tau)
                * (1j * omega * self.data.inputs[name] + self.data.change(name))
                for name, tau in zip(self.inputs, m.delays, strict=True)
            ]
        )
        later = late[:, :, None] * d.delays[:, None, :]  # of every input (m, lines, q)
        driven = np.einsum("ijq,lj->liq", d.A, at.states) + np.einsum("ijq,jl->liq", d.B, at.inputs)
        driven = driven + np.einsum("ij,jlq->liq", m.B, later)
        states = at.inverse @ driven
        modelled = np.einsum("kjq,lj->klq", d.C, at.states) + np.einsum("kj,ljq->klq", m.C, states)
        modelled = (
            modelled
            + np.einsum("kjq,jl->klq", d.D, at.inputs)
            + np.einsum("kj,jlq->klq", m.D, later)
        )

        if not self._is_equation_error:
            mean = self._stacked(-modelled)
            return mean, mean, np.zeros((len(omega), *m.C.shape[:1] * 2, len(at.q)), complex)

        pencil: Any = 1j * omega[:, None, None] * np.eye(len(self.states)) - m.A
        transform = self._transform(m, pencil)
        assert transform is not None
        if len(self.outputs) == 1:
            change = -np.einsum("lij,jiq->lq", at.inverse, d.A)[:, None, None, :]
        else:
            change = -np.einsum("ijq,ljk->likq", d.A, at.inverse)
            change = change - np.einsum("lij,jkq,lkn->linq", transform, d.C, at.inverse)

        unexplained = np.einsum("lab,bl->al", transform, self._measured - at.modelled)
        mean = -np.einsum("lab,blq->alq", transform, modelled)
        total = mean + np.einsum("labq,bl->alq", change, unexplained)
        return self._stacked(mean), self._stacked(total), change

    def _stacked(self, values: ComplexArray) -> Array:
        """Return complex values (k, lines, q) as real ones (k, 2 lines, q)."""
        return np.moveaxis(self._real(np.moveaxis(values, 1, -1)), -1, 1)

    def fisher_root(self, at: Along, mean: Array, change: Array) -> tuple[Array, Array, Array]:
        """Return a root of the Fisher information of x, for derivatives of mean and transform by x.

        Returns
        -------
        mean : (k, 2 lines, x) array
            Of the weighted errors, the end term fitted along.
        variance : (r, x) array
            What the outputs' variances say of x where they depend on it, with the size of the noise
            fitted along.
        reach : (x,) array
            Lengths of the columns before the end term was fitted along.
        """
        weight = at.covariance.weight(at.errors @ at.errors.T)
        weighted = np.einsum("ka,alx->klx", weight, mean)
        rows = weighted.reshape(-1, mean.shape[-1])
        directions = _directions(
            np.einsum("ka,aln->kln", weight, at.basis).reshape(rows.shape[0], -1)
        )
        projected = rows - directions @ (directions.T @ rows)
        turned = np.einsum("ka,labx,bc->lkcx", weight, change, np.linalg.inv(weight))
        variance = _hermitian_rows(turned)
        # Fitting the size of the noise takes up what all variances have in common.
        variance = (variance - variance.mean(axis=0)).reshape(-1, mean.shape[-1])
        reach = np.sqrt((rows**2).sum(axis=0) + (variance**2).sum(axis=0))

        return projected.reshape(weighted.shape), variance, reach

    def errors_by_output(self, z: Array) -> Iterator[tuple[str, ComplexArray, ComplexArray]]:
        """Yield every output with its errors (lines,) at z and their derivatives by z and end term.

        They are turned by the phase of the modelled output, as those of a response are: what a
        model leaves out is smooth only then.
        """
        at = self.along(self.locate(z)[0].full().ravel())
        if at is None:
            return
        total = np.tensordot(self.derivatives(at)[1], self.locate(z)[1].full(), axes=1)
        turned = np.exp(-1j * np.angle(at.modelled))
        rows = np.concatenate([at.errors[..., None], total, at.basis], axis=-1)

        for name, turn, of_output in zip(self.outputs, turned, rows, strict=True):
            values = turn[:, None] * (of_output[: len(turn)] + 1j * of_output[len(turn) :])
            yield name, values[:, 0], values[:, 1:]

    # --- for Gauss-Newton

    def trajectory(self, z: Array, nodes: Array, *, simulated: bool = False) -> Trajectory:
        """Return the point z, with the best end term; not finite where the model is not."""
        at = self.along(self.locate(z)[0].full().ravel())
        products = np.full((1, 1), np.nan) if at is None else at.errors @ at.errors.T
        return Trajectory(z, NO_NODES, NO_NODES, NO_NODES, products, simulated=True, detail=at)

    def cost(self, trajectory: Trajectory, smoothing: float) -> float:
        """Return the negative log-likelihood of the outputs, with the best end term and noise."""
        at: Along | None = trajectory.detail
        return (
            math.inf if at is None else at.covariance.cost(trajectory.products) - 2 * at.logarithms
        )

    def linearize(self, trajectory: Trajectory, weight: Array) -> tuple[Array, Array]:
        """Return gradient (p,) and Fisher information (p, p); end term and noise follow."""
        at: Along = trajectory.detail
        by_z: Any = [
            np.tensordot(d, self.locate(trajectory.z)[1].full(), 1) for d in self.derivatives(at)
        ]
        mean, total, change = by_z
        root = at.covariance.weight(trajectory.products)
        by_errors = np.einsum("kl,klz->z", root.T @ root @ at.errors, total)
        mean, variance, _ = self.fisher_root(at, mean, change)
        rows = np.vstack([mean.reshape(-1, mean.shape[-1]), variance])

        return by_errors - 2 * np.einsum("laaz->z", change).real, rows.T @ rows

    def signature(self, trajectory: Trajectory) -> Array:
        """Return the modelled outputs over the root mean square of the measured ones."""
        size = np.sqrt(np.mean(np.abs(self._measured) ** 2, axis=1, keepdims=True))
        values = trajectory.detail.modelled / np.where(size > 0, size, 1.0)
        return np.concatenate([values.real.ravel(), values.imag.ravel()])

    # --- for IPOPT and for the covariance of the estimate

    def program(self, z: ca.MX) -> Program:
        """Refuse: end terms are eliminated, and what remains is no expression for IPOPT."""
        raise ValueError(
            f"the method transcribes records for IPOPT and {self.name!r} is a TransientSpectrum: "
            "leave out method, or use MultipleShooting()."
        )

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
        point = ca.SX.sym("x", len(values))
        local = self.problem.local_values(dict(zip(names, ca.vertsplit(point), strict=True)))
        q = ca.vertcat(ca.SX(0, 1), *local.values())
        place = ca.Function("place", [point], [q, ca.densify(ca.jacobian(q, point))])
        located, slope = (value.full() for value in place(values))
        at = self.along(located.ravel())
        assert at is not None
        by_values: Any = [np.tensordot(d, slope, 1) for d in self.derivatives(at)]
        mean, _, change = by_values
        mean, variance, reach = self.fisher_root(at, mean, change)
        jacobian = np.vstack([mean.reshape(-1, len(values)), variance])
        # What the errors show may be other than what was given, or correlated between outputs.
        products = at.errors @ at.errors.T
        weight = at.covariance.weight(products)
        observed = weight @ products @ weight.T / (2 * len(self.data))
        lost = len(self.states) / max(self.numbers - len(self.states), 1)
        meat = (
            np.einsum("ka,klx,aly->xy", observed, mean, mean) * (1 + lost) + variance.T @ variance
        )

        def spread(correction: float) -> tuple[float, Array]:
            return 1.0, meat * correction**2

        numbers = self.numbers - len(self.states)
        return Information(self, jacobian, numbers, spread, reach)


def compile_spectrum(problem: Problem, expressions: Mapping[str, Any], z: ca.SX) -> TransientPart:
    """Compile a spectrum for the point z; `expressions` are all parameters by outside name."""
    q = ca.vertcat(ca.SX(0, 1), *problem.local_values(expressions).values())
    return TransientPart(problem, ca.Function("locate", [z], [q, ca.densify(ca.jacobian(q, z))]))


def _matrix_functions(
    model: Model, system: Dynamics, at: Mapping[str, float], outputs: tuple[str, ...]
) -> tuple[ca.Function, ca.Function]:
    """Return (all parameters) -> A, B, C, D and delays, and the derivatives of their entries."""
    p: Any = ca.MX.sym("p", len(model.parameters))
    x, u, q = (
        ca.SX.sym("v", len(names)) for names in (system.states, system.inputs, system.parameters)
    )
    f, h = system.derivative(x, u, q), system.output(x, u, q)
    h = h[[system.outputs.index(name) for name in outputs]]
    blocks = [ca.jacobian(f, x), ca.jacobian(f, u), ca.jacobian(h, x), ca.jacobian(h, u)]
    linear = ca.Function(
        "linear", [q, x, u], [*map(ca.densify, blocks), ca.densify(system.delay(q))]
    )
    point: Any = ca.DM.zeros(len(system.states)), ca.DM.zeros(len(system.inputs))

    if isinstance(model, StateSpace):
        states, inputs = trim_of(model, at).closed()(p)
        # The states of a Padé delay follow those of the model, and the linear delay has no
        # operating point.
        point = ca.vertcat(states, ca.DM.zeros(len(system.states) - len(model.states))), inputs

    matrices: Any = linear(p, *point)
    slopes = [ca.densify(ca.jacobian(ca.vec(block), p)) for block in matrices]
    return ca.Function("matrices", [p], matrices), ca.Function("slopes", [p], slopes)


def _without_ends(
    errors: Array, basis: Array, covariance: ResidualCovariance
) -> tuple[Array, Array]:
    """Return errors (k, 2 lines) less the best combination (n,) of the basis (k, 2 lines, n)."""
    ends = np.zeros(basis.shape[-1])
    if not ends.size:
        return errors, ends
    last, remaining = math.inf, errors
    for _ in range(REWEIGHTINGS):
        weight = covariance.weight(remaining @ remaining.T)
        rows = np.einsum("ka,aln->kln", weight, basis).reshape(-1, len(ends))
        size = np.linalg.norm(rows, axis=0)
        size[size == 0] = 1.0
        ends = np.linalg.lstsq(rows / size, (weight @ errors).ravel(), rcond=UNSEEN)[0] / size
        remaining = errors - basis @ ends
        cost = covariance.cost(remaining @ remaining.T)
        if len(errors) == 1 or not last - cost > SETTLED * errors.size:
            break
        last = cost

    return remaining, ends


def _directions(rows: Array) -> Array:
    """Return orthonormal columns that span those of `rows` (r, n)."""
    if not rows.shape[1]:
        return rows
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    left, singular, _ = np.linalg.svd(rows / size, full_matrices=False)
    return left[:, singular > UNSEEN * singular[0]]


def _hermitian_rows(values: ComplexArray) -> Array:
    """Return V + Vᴴ of matrices (lines, k, k, x) as real rows (lines, k², x).

    Scalar products stay the same.
    """
    hermitian = values + values.conj().swapaxes(1, 2)
    diagonal = np.einsum("lkkx->lkx", hermitian).real
    a, b = np.triu_indices(values.shape[1], 1)
    between = math.sqrt(2) * hermitian[:, a, b]
    return np.concatenate([diagonal, between.real, between.imag], axis=1)
