"""Linear experiments with errors correlated in time, fast enough for hundreds of repeats.

Part of `coverage_time.py`.

Plants with one to five outputs are flown with held commands; their parameters and initial states
are fitted by least squares weighted with the residual variances, which is what output error does
near its minimum, and the covariance is greybox's own (`colored_errors`), from the residuals and the
Jacobian.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import t as student

from greybox.assessment.checks.slow_errors import EVIDENCE, FEWEST_LINES
from greybox.data.files.arrays import Array, BoolArray
from greybox.engine.compiled.colored_errors import colored_errors

STEP = 0.05  # s
SENSOR = 0.05  # standard deviation of the white noise
BEFORE = 400  # samples, after which the errors are stationary
INPUTS = 5  # records of different commands
NOMINAL = (92.0, 98.0)  # per cent; outside, a number is marked
FEWEST = 10  # correlation times in a record below which no method holds
RELAXATIONS = 4  # of the weights


@dataclass(frozen=True)
class Plant:
    """A linear plant: matrices of its parameters, their values, and the states that wind pushes."""

    name: str
    values: tuple[float, ...]
    matrices: Callable[[NDArray], tuple]
    pushed: tuple[int, ...]

    def discrete(self, q: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return transition, input and output matrices for held inputs."""
        a, b, c = (np.array(m, dtype=complex) for m in self.matrices(q))
        n = len(a)
        both = np.zeros((n + 1, n + 1), dtype=complex)
        both[:n, :n] = a
        both[:n, n] = b
        both = expm(STEP * both)
        return both[:n, :n], both[:n, n], c

    def response(self, q: NDArray, initial: NDArray, u: Array) -> NDArray:
        """Return the outputs (k, n)."""
        transition, by_input, c = self.discrete(q)
        x = np.array(initial, dtype=complex)
        states = np.empty((len(x), u.size), dtype=complex)
        for t in range(u.size):
            states[:, t] = x
            x = transition @ x + by_input * u[t]
        return c @ states

    def jacobian(self, u: Array) -> tuple[Array, Array]:
        """Return the derivatives of the outputs by parameters (k, p, n) and states (k, s, n)."""
        q = np.array(self.values, dtype=complex)
        states = len(self.discrete(q)[0])
        tiny = 1e-30j  # complex step
        rest = np.zeros(states)
        by_parameter = [
            self.response(q + tiny * row, rest, u).imag / abs(tiny) for row in np.eye(len(q))
        ]
        by_state = [self.response(q, row, 0 * u).real for row in np.eye(states)]
        return np.array(by_parameter).transpose(1, 0, 2), np.array(by_state).transpose(1, 0, 2)


def _lag(q: NDArray) -> tuple:
    return [[-q[0]]], [q[1]], [[1]]


def _spring(q: NDArray) -> tuple:
    return [[0, 1], [-q[0], -q[1]]], [0, q[2]], np.eye(2)


def _cascade(q: NDArray) -> tuple:
    return [[-q[0], q[1]], [0, -q[2]]], [0, q[3]], np.eye(2)


def _lateral(q: NDArray) -> tuple:
    a = [[-q[0], q[1], 0, 0], [-q[2], -q[3], 0, 0], [0, 1, -0.2, 0], [q[4], 0, 0, -0.5]]
    return a, [0, q[5], 0, 0], np.vstack([np.eye(4), a[1]])


PLANTS = (
    Plant("lag, 1 output", (1.5, 2.0), _lag, (0,)),
    Plant("cascade, 2", (1.5, 2.0, 3.0, 4.0), _cascade, (0, 1)),
    Plant("spring, 2", (9.0, 1.2, 4.0), _spring, (1,)),
    Plant("lateral, 5", (1.0, 0.8, 2.0, 1.5, 0.7, 4.0), _lateral, (0, 1)),
)


@dataclass(frozen=True)
class Errors:
    """White sensor noise of 0.05, an AR(1) instead or in addition, or wind through the plant."""

    name: str
    phi: float = 0.0
    drift: float = 0.0
    wind: float = 0.0

    def drawn(self, plant: Plant, n: int, repeats: int, random: np.random.Generator) -> Array:
        """Return errors (repeats, k, n)."""
        transition, _, c = (m.real for m in plant.discrete(np.array(plant.values)))
        shape = (repeats, len(c), n + BEFORE)
        white = random.normal(size=shape)
        if self.wind:
            x = np.zeros((repeats, len(transition)))
            pushed = np.zeros(shape)
            for t in range(n + BEFORE):
                pushed[:, :, t] = x @ c.T
                x = x @ transition.T
                force = random.normal(size=(repeats, len(plant.pushed)))
                x[:, list(plant.pushed)] += self.wind * np.sqrt(STEP) * force
            return (SENSOR * white + pushed)[..., BEFORE:]
        root = np.sqrt(1 - self.phi**2)
        if self.drift:
            slow = lfilter([root], [1, -self.phi], random.normal(size=shape))
            return (SENSOR * white + self.drift * slow)[..., BEFORE:]
        return SENSOR * lfilter([root], [1, -self.phi], white)[..., BEFORE:]

    def time(self, plant: Plant) -> float:
        """Return the correlation time, samples.

        Of wind the plant's slowest time constant, of white noise 0.
        """
        if self.wind:
            return float(
                (
                    -1
                    / np.log(np.abs(np.linalg.eigvals(plant.discrete(np.array(plant.values))[0])))
                ).max()
            )
        return -1 / np.log(self.phi) if self.phi else 0.0


ERRORS = (
    Errors("white"),
    Errors("AR 0.3", phi=0.3),
    Errors("AR 0.6", phi=0.6),
    Errors("AR 0.9", phi=0.9),
    Errors("AR 0.97", phi=0.97),
    Errors("drift 0.02", phi=0.97, drift=0.02),
    Errors("drift 0.05", phi=0.97, drift=0.05),
    Errors("wind 0.05", wind=0.05),
    Errors("wind 0.3", wind=0.3),
)


@dataclass(frozen=True, eq=False)
class Cell:
    """Repeats of one experiment.

    Which intervals contain the truth (repeats, p), standardized errors, and warnings.
    """

    plant: Plant
    errors: Errors
    samples: int
    holds: BoolArray
    scaled: Array
    rough: BoolArray

    @property
    def times(self) -> float:
        """Return the length of the record in correlation times."""
        return self.samples / max(self.errors.time(self.plant), 1e-9)


def cell(plant: Plant, errors: Errors, samples: int, repeats: int, seed: int) -> Cell:
    """Repeat one experiment.

    If the standard errors are called rough, the interval of that row does not count.
    """
    holds, scaled, rough = [], [], []
    for error, residuals, weighted, initial in fits(plant, errors, samples, repeats, seed):
        size = np.sqrt(np.mean(residuals**2, axis=1))[:, None, None]
        profiled = without(weighted / size, initial / size)
        inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", profiled, profiled))
        root = np.linalg.cholesky(inverse)
        unit = np.linalg.inv(
            np.linalg.cholesky(np.einsum("ksn,ktn->st", initial / size, initial / size))
        )
        found = colored_errors(
            [profiled / size],
            root,
            [residuals],
            np.diag(1 / size.ravel()),
            initial.shape[1],
            initial=[np.einsum("st,ktn->ksn", unit, initial / size**2)],
            shocks=partial(np.asarray, initial),
        )
        z = error / np.sqrt(np.diag(root @ found.meat @ root.T))
        scaled.append(z)
        holds.append(np.abs(z) < student.ppf(0.975, found.dof))
        evidence, lines = found.slow_errors()
        rough.append(np.any((evidence > EVIDENCE) & (lines < FEWEST_LINES)))
    return Cell(plant, errors, samples, np.array(holds), np.array(scaled), np.array(rough))


def fits(
    plant: Plant, errors: Errors, n: int, repeats: int, seed: int
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield the errors of the parameters, the residuals, and both Jacobians."""
    random = np.random.default_rng([seed, n, *plant.name.encode(), *errors.name.encode()])
    for _ in range(INPUTS):
        size = random.choice([-1.0, 1.0], n // 10 + 1) * random.uniform(0.3, 1.0, n // 10 + 1)
        by_parameter, by_state = plant.jacobian(np.repeat(size, 10)[:n])
        A = np.concatenate([by_parameter, by_state], axis=1)
        for e in errors.drawn(plant, n, repeats // INPUTS, random):
            weight = 1 / np.mean(e**2, axis=1)
            for _ in range(RELAXATIONS):
                normal = np.einsum("k,kpn,kqn->pq", weight, A, A, optimize=True)
                estimate = np.linalg.solve(
                    normal, np.einsum("k,kpn,kn->p", weight, A, e, optimize=True)
                )
                residuals = e - np.einsum("kpn,p->kn", A, estimate)
                weight = 1 / np.mean(residuals**2, axis=1)
            yield estimate[: by_parameter.shape[1]], residuals, by_parameter, by_state


def without(sensitivity: Array, initial: Array) -> Array:
    """Return the sensitivities with the initial states following."""
    k, p, n = sensitivity.shape
    columns = sensitivity.transpose(0, 2, 1).reshape(k * n, p)
    basis, _ = np.linalg.qr(initial.transpose(0, 2, 1).reshape(k * n, -1))
    return (columns - basis @ (basis.T @ columns)).reshape(k, n, p).transpose(0, 2, 1)


def study(
    repeats: dict[int, int], plants: Sequence[Plant] = PLANTS, seed: int = 1
) -> Iterator[str]:
    """Yield the lines of the study; `repeats` by number of samples."""
    heads = f"{'samples':>7} {'times':>5} {'fits':>5} {'said':>4} {'unsaid':>6}"
    yield f"{'plant':14} {'errors':10} {heads}  coverage (rms) of every parameter"
    long: list[Cell] = []
    for plant in plants:
        for errors in ERRORS:
            for samples, count in repeats.items():
                found = cell(plant, errors, samples, count, seed)
                size = np.sqrt(np.mean(found.scaled**2, axis=0))
                words = " ".join(
                    f"{100 * share:.1f}{_mark(100 * share)}({rms:.2f})"
                    for share, rms in zip(found.holds.mean(axis=0), size, strict=True)
                )
                unsaid = (~found.holds & ~found.rough[:, None]).mean(axis=0).max()
                times = "-" if found.times > samples else f"{found.times:.0f}"
                yield (
                    f"{plant.name:14} {errors.name:10} {samples:7} {times:>5} {len(found.holds):5} "
                    f"{100 * found.rough.mean():3.0f}% {100 * unsaid:5.1f}%  {words}"
                )
                if found.times >= FEWEST:
                    long.append(found)
    if not long:
        return
    holds = np.concatenate([found.holds.ravel() for found in long])
    squares = np.concatenate([found.scaled.ravel() ** 2 for found in long])
    yield (
        f"Pooled, records of at least {FEWEST} correlation times: {100 * holds.mean():.1f} % of "
        f"{holds.size} intervals "
        f"hold, rms of standardized errors {np.sqrt(squares.mean()):.2f}."
    )


def _mark(percent: float) -> str:
    return " " if NOMINAL[0] <= percent <= NOMINAL[1] else "*"
