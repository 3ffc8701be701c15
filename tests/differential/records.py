"""Families of records: simulations and fits, against SciPy."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import greybox as gb
from differential.clocks import CLOCKS, Clock, Motion, motion, uniform
from differential.models import EMBEDDED, Plant, plant
from differential.references import Minimum, advance, least_squares_minimum, trajectory

# Of the range of an output. A delayed input that turns between two samples enters a step by its
# mean: 1e-4, where a delay that is wrong by half a sample makes 1e-1.
SIMULATED, DELAYED = 1e-5, 1e-3

# Standard errors between an estimate and the minimum: solvers stop at 1e-4, steps are chosen for
# errors well below one.
ESTIMATED = 0.05

EXACT = ("uniform", "jitter", "growing")


@dataclass(frozen=True)
class Experiment:
    """A plant, and one record of it with independent noise.

    Attributes
    ----------
    initial : (states,) array
        The true states at the first time.
    measured : (outputs, n) array
        With noise; NaN where a sample is missing.
    noise : (outputs,) array
        Standard deviations.
    """

    plant: Plant
    clock: Clock
    motion: Motion
    initial: np.ndarray
    measured: np.ndarray
    noise: np.ndarray

    @property
    def record(self) -> gb.Record:
        """The data, as the clock shows them."""
        rows = self.clock.rows
        outputs = dict(zip(self.plant.outputs, self.measured[:, rows], strict=True))
        return record(self.plant, self.clock.stamps[rows], self.motion, outputs, rows)

    def __str__(self) -> str:
        """Describe plant, clock and inputs."""
        missing = ", NaN" if np.isnan(self.measured).any() else ""
        return f"{self.plant}, {self.clock.name}, {self.motion}{missing}"


def record(
    system: Plant,
    time: np.ndarray,
    inputs: Motion,
    outputs: dict[str, np.ndarray] | None = None,
    rows: slice | np.ndarray = slice(None),
) -> gb.Record:
    """Return a record of the inputs at `rows`, and of outputs."""
    outputs = outputs or {}
    signals = dict(zip(system.inputs, inputs.values[:, rows], strict=True))
    hold = dict.fromkeys(system.inputs, np.inf if inputs.held else 0.0)
    return gb.Record(time, signals | outputs, hold=hold | dict.fromkeys(outputs, 0.0))


def columns(values: dict[str, float], number: int = 1) -> dict[str, np.ndarray]:
    """Return parameter values repeated as columns."""
    return {name: np.full(number, value) for name, value in values.items()}


def step_of(system: Plant) -> float:
    """Return a tenth of the plant's time scale, s."""
    return 0.1 / system.speed


def experiment(
    rng: np.random.Generator,
    system: Plant,
    clock: Clock,
    *,
    noise: float | None = None,
    initial: np.ndarray | None = None,
    missing: bool = False,
    gains: np.ndarray | None = None,
) -> Experiment:
    """Return a random experiment.

    Parameters
    ----------
    noise : float, optional
        Over the standard deviation of each output; 0.3 to 3 % by default.
    initial : (states,) array, optional
        Random by default, or zero under a delay, whose input is at rest at first.
    missing : bool
        Whether a tenth of each output's samples is missing.
    gains : (states, outputs) array, optional
        Innovations gains of the true system, whose innovations are then the noise.
    """
    inputs = motion(rng, clock, len(system.inputs), resting=30 if system.delays else 0)
    if initial is None:
        initial = rng.uniform(-0.5, 0.5, len(system.states)) * (not system.delays)
    values = columns(system.truth)
    clean = trajectory(system, values, initial[:, None], clock.time, inputs)[0][:, :, 0]
    share = noise or float(10 ** rng.uniform(-2.5, -1.5))
    sizes = share * clean.std(axis=1)
    errors = sizes[:, None] * rng.standard_normal(clean.shape)
    measured = clean + errors
    if gains is not None:
        measured = _innovated(system, clock, inputs, initial, gains, errors)
    if missing:
        measured = np.where(rng.random(measured.shape) < 0.1, np.nan, measured)
    return Experiment(system, clock, inputs, initial, measured, sizes)


def _innovated(system, clock, inputs, initial, gains, errors):
    """Return outputs whose innovations are the given errors."""
    values, x = columns(system.truth), initial[:, None]
    measured = np.empty_like(errors)
    for k in range(clock.time.size):
        u = inputs.values[:, k, None]
        measured[:, k] = system.output(x, u, values)[:, 0] + errors[:, k]
        x = x + (gains @ errors[:, k])[:, None]
        if k + 1 < clock.time.size:
            after = u if inputs.held else inputs.values[:, k + 1, None]
            x = advance(system, values, x, u, after, np.diff(clock.time)[k : k + 1])
    return measured


@dataclass(frozen=True)
class Question:
    """What is estimated from experiments, as greybox and as the reference are asked.

    Attributes
    ----------
    experiments : sequence of Experiment
        With one plant.
    noise : "diagonal", "full" or "given"
        Variances estimated, covariance estimated, or standard deviations known.
    known_start : bool
        Whether the initial states are known.
    priors : mapping of parameter to (mean, standard deviation)
    tied : mapping of parameter to (parameter, factor)
    own : sequence of parameters
        Those with a value for each record.
    gains : bool
        Whether innovations gains are estimated, by prediction errors.
    bias : bool
        Whether the first output has an unknown bias.
    """

    experiments: Sequence[Experiment]
    noise: str = "diagonal"
    known_start: bool = False
    priors: dict[str, tuple[float, float]] = field(default_factory=dict)
    tied: dict[str, tuple[str, float]] = field(default_factory=dict)
    own: Sequence[str] = ()
    gains: bool = False
    bias: bool = False

    @property
    def plant(self) -> Plant:
        """The plant of all experiments."""
        return self.experiments[0].plant

    def __str__(self) -> str:
        """Describe the question in a few words."""
        words = [str(self.experiments[0])]
        words += [f"{len(self.experiments)} records"] if len(self.experiments) > 1 else []
        words += [f"{self.noise} noise"] if self.noise != "diagonal" else []
        words += ["known initial states"] if self.known_start else []
        words += [f"prior of {name}" for name in self.priors]
        words += [f"tied {name}" for name in self.tied]
        words += [f"own {name}" for name in self.own]
        words += ["innovations"] if self.gains else []
        words += ["bias"] if self.bias else []
        return ", ".join(words)

    def problem(self) -> Any:
        """Return the problem for greybox."""
        parts = []
        for member in self.experiments:
            names = member.plant.outputs
            noise: Any = self.noise
            if noise == "given":
                noise = dict(zip(names, map(float, member.noise), strict=True))
            known = dict(zip(member.plant.states, map(float, member.initial), strict=True))
            kind = gb.PredictionError if self.gains else gb.OutputError
            criterion = kind(
                noise=noise,
                initial=known if self.known_start else {},
                biases=names[:1] if self.bias else (),
            )
            rename = {name: f"{name}_{len(parts) + 1}" for name in self.own}
            tied = {n: (lambda p, o=o, f=f: f * getattr(p, o)) for n, (o, f) in self.tied.items()}
            parts.append(
                gb.Problem(
                    member.plant.model,
                    member.record,
                    criterion,
                    tied=tied,
                    rename=rename,
                    # A prior that parts of a sum share counts once.
                    prior=self.priors,
                    name=f"record {len(parts) + 1}",
                )
            )
        return parts[0] if len(parts) == 1 else sum(parts[1:], parts[0])


# A parameter by its name; other unknowns are the initial state of a record, and the like.
Name = str | tuple[Any, ...]
Unknown = tuple[Name, float, float, float, float]


def _unknowns(question: Question) -> Iterator[Unknown]:
    """Yield the name of each unknown with its true value, its size, and its bounds."""
    system, members = question.plant, question.experiments
    for name, value in system.truth.items():
        owners = range(1, len(members) + 1) if name in question.own else ()
        for label in [f"{name}_{k}" for k in owners] or [name]:
            if name not in question.tied:
                yield label, value, abs(value), *system.model.parameters[name].bounds

    yield from _nuisances(question)


def _nuisances(question: Question) -> Iterator[Unknown]:
    """Yield the unknowns besides the parameters."""
    system, members, free = question.plant, question.experiments, (-np.inf, np.inf)
    for k, member in enumerate(members):
        if not question.known_start:
            for state, value in zip(system.states, member.initial, strict=True):
                yield ("initial", k, state), value, 0.3, *free
        if question.bias:
            yield ("bias", k), 0.0, 10 * member.noise[0], *free
    if question.gains:
        for output, signal in zip(system.outputs, members[0].measured, strict=True):
            for state in system.states:
                yield ("gain", state, output), 0.0, 0.3 / np.nanstd(signal), *free


class Reference:
    """The residuals of a question, for many vectors of its unknowns at once.

    The unknowns are the parameters, the initial states of each record, biases, and gains.
    """

    def __init__(self, question: Question) -> None:
        self.question = question
        unknowns = list(_unknowns(question))
        self.names = [name for name, *_ in unknowns]
        self.start, self.scale, low, high = np.array([numbers for _, *numbers in unknowns]).T
        self.bounds = low, high

    def residuals(self, vectors: np.ndarray) -> list[np.ndarray]:
        """Return the raw residuals (outputs, n, m) of each record, NaN where nothing is measured."""
        values = dict(zip(self.names, vectors, strict=True))
        return [self._residuals_of(k, values, vectors.shape[1]) for k in range(self.records)]

    @property
    def records(self) -> int:
        """The number of records."""
        return len(self.question.experiments)

    def _residuals_of(self, k: int, values: dict, number: int) -> np.ndarray:
        question, member = self.question, self.question.experiments[k]
        system = member.plant
        p = {
            n: values[f"{n}_{k + 1}" if n in question.own else n]
            for n in system.truth
            if n not in question.tied
        }
        p |= {name: factor * p[other] for name, (other, factor) in question.tied.items()}

        initial = np.tile(member.initial[:, None], number)
        if not question.known_start:
            initial = np.array([values["initial", k, state] for state in system.states])
        correction = None
        if question.gains:
            rows = [[values["gain", s, o] for o in system.outputs] for s in system.states]
            correction = np.array(rows), member.measured
        outputs, _ = trajectory(system, p, initial, member.clock.time, member.motion, correction)
        if question.bias:
            outputs[0] += values["bias", k]
        return outputs - member.measured[:, :, None]

    def cost(self, vector: np.ndarray) -> float:
        """Return minus the logarithm of the likelihood, and of the priors, at values (p,)."""
        question, total = self.question, 0.0
        pairs = zip(self.residuals(vector[:, None]), question.experiments, strict=True)
        for raw, member in pairs:
            e = raw[:, :, 0]
            count = np.isfinite(e).sum(axis=1)
            mean_squares = np.nanmean(e**2, axis=1)
            total += 0.5 * count.sum() * np.log(2 * np.pi)
            if question.noise == "given":
                total += 0.5 * (count * mean_squares / member.noise**2).sum()
                total += (count * np.log(member.noise)).sum()
            elif question.noise == "diagonal":
                total += 0.5 * (count * (np.log(mean_squares) + 1)).sum()
            else:
                total += 0.5 * e.shape[1] * np.linalg.slogdet(e @ e.T / e.shape[1])[1]
                total += 0.5 * count.sum()
        for name, (mean, deviation) in question.priors.items():
            z = (vector[self.names.index(name)] - mean) / deviation
            total += 0.5 * (z**2 + np.log(2 * np.pi))
        return float(total)

    def minimum(self, more: Callable[[np.ndarray], np.ndarray] | None = None) -> Minimum:
        """Return the minimum of the likelihood, with the variances at their best.

        `more` are further residuals of variance one, (p, m) to (r, m).
        """
        question, start = self.question, self.start
        roots = [np.diag(1 / member.noise) for member in question.experiments]
        for _ in range(8):

            def weighted(vectors, roots=roots):
                blocks = []
                for root, raw in zip(roots, self.residuals(vectors), strict=True):
                    block = np.einsum("ij,jnm->inm", root, np.nan_to_num(raw))
                    blocks.append(block.reshape(-1, vectors.shape[1]))
                for name, (mean, deviation) in question.priors.items():
                    blocks.append((vectors[[self.names.index(name)]] - mean) / deviation)
                if more is not None:
                    blocks.append(more(vectors))
                return np.vstack(blocks)

            best = least_squares_minimum(weighted, start, self.scale, self.bounds)
            if question.noise == "given" or not best.clear:
                break
            at_best = self.residuals(best.values[:, None])
            better = [self._root(raw[:, :, 0]) for raw in at_best]
            change = max(
                np.abs(b @ np.linalg.inv(r) - np.eye(len(b))).max()
                for b, r in zip(better, roots, strict=True)
            )
            start, roots = best.values, better
            if change < 1e-3:
                break
        return best

    def _root(self, raw: np.ndarray) -> np.ndarray:
        """Return a root of the inverse covariance of residuals (outputs, n)."""
        if self.question.noise == "full":
            covariance = raw @ raw.T / raw.shape[1]
            return np.linalg.inv(np.linalg.cholesky(covariance))
        return np.diag(1 / np.sqrt(np.nanmean(raw**2, axis=1)))


def difference_of_fit(fit: gb.Fit, reference: Reference, minimum: Minimum) -> str | None:
    """Return where the estimates of a fit are not those of the minimum."""
    for k, name in enumerate(reference.names):
        if not isinstance(name, str):
            continue
        estimate = fit.estimate[name]
        off = (estimate - minimum.values[k]) / minimum.error[k]
        if not abs(off) < ESTIMATED:
            return (
                f"{name} = {estimate:.6g} is {off:+.2g} standard errors from the minimum at "
                f"{minimum.values[k]:.6g}{_verdict(fit)}"
            )
    for name, (other, factor) in reference.question.tied.items():
        for kind in (fit.estimate, fit.standard_error):
            if not np.isclose(kind[name], factor * kind[other], rtol=1e-6, equal_nan=True):
                return (
                    f"{name} = {kind[name]:.6g} is tied to {factor:.6g} {other}, {kind[other]:.6g}"
                )
    return None


def _verdict(fit: gb.Fit) -> str:
    """Return whether the answer has a warning."""
    return "" if fit.warnings else ", without a warning"


def fitted(question: Question, starts: Any = 1, method: Any = None) -> str | None:
    """Fit a question, and return where the answer differs from the reference."""
    reference = Reference(question)
    minimum = reference.minimum()
    if not minimum.clear:
        return None
    problem = question.problem()
    how = f"{question}, starts {starts}" + (f", {type(method).__name__}" if method else "")
    values = {
        n: float(v)
        for n, v in zip(reference.names, minimum.values, strict=True)
        if n in problem.parameters
    }
    # One start may end in another minimum: then the search has to find this one. It takes long
    # where what is asked is not what the reference answers, which a fit from there shows at once.
    for attempt in (starts, [values], None):
        answer = gb.fit(problem, attempt, method=method, progress=False)
        if not answer.converged:
            found = "no start converged"
        else:
            found = difference_of_fit(answer, reference, minimum)
        if found is None and attempt is not values:
            return None
    # SciPy's minimum beside the truth may not be the lowest.
    if answer.converged and not question.gains and answer.cost < gb.cost(problem, values) - 0.01:
        return None
    return f"{how}: {found}"


# --- families


def _simulated(system: Plant, clock: Clock, rng: np.random.Generator) -> str | None:
    """Return where a simulation differs from SciPy's."""
    case = experiment(rng, system, clock)
    initial = case.initial
    want, _ = trajectory(system, columns(system.truth), initial[:, None], clock.time, case.motion)
    known = dict(zip(system.states, initial, strict=True))
    drive = record(system, clock.time, case.motion)
    motion_of = gb.simulate(system.model, system.truth, record=drive, initial=known)
    for name, exact in zip(system.outputs, want[:, :, 0], strict=True):
        error = np.abs(motion_of[name] - exact).max() / np.ptp(exact)
        if not error < (DELAYED if system.delays else SIMULATED):
            return f"{case}: {name} is off by {error:.2g} of its range"
    return None


def simulate(rng: np.random.Generator) -> str | None:
    """Return where a simulation at known times differs from SciPy's."""
    delayed = rng.random() < 0.3
    system = plant(rng, delayed=delayed)
    name = "uniform" if delayed else str(rng.choice(EXACT))
    return _simulated(system, CLOCKS[name](rng, step_of(system), int(rng.integers(60, 120))), rng)


def simulate_steps(rng: np.random.Generator) -> str | None:
    """Return where a simulation differs on clocks whose steps change, as those of a schedule."""
    system = plant(rng)
    name = str(rng.choice(["two rates", "schedule"]))
    return _simulated(system, CLOCKS[name](rng, step_of(system), int(rng.integers(20, 80))), rng)


def simulate_uneven_delays(rng: np.random.Generator) -> str | None:
    """Return where a simulation with a delay differs on clocks that are not uniform.

    A refusal is an answer, too: its sentence asks for uniform samples.
    """
    system = plant(rng, delayed=True)
    name = str(rng.choice(["jitter", "growing", "two rates"]))
    clock = CLOCKS[name](rng, step_of(system), int(rng.integers(60, 120)))
    try:
        return _simulated(system, clock, rng)
    except ValueError as refusal:
        return None if "uniform" in str(refusal) else str(refusal)


def simulate_embedded(rng: np.random.Generator) -> str | None:
    """Return where the simulation of a model that calls CasADi functions differs."""
    system = plant(rng, tuple(EMBEDDED))
    return _simulated(system, uniform(rng, step_of(system), 60), rng)


def fit(rng: np.random.Generator) -> str | None:
    """Return where a fit of a record at known times differs from the least squares of SciPy."""
    delayed = rng.random() < 0.25
    system = plant(rng, delayed=delayed)
    clock = CLOCKS["uniform" if delayed else str(rng.choice(EXACT))](
        rng, step_of(system), int(rng.integers(100, 160))
    )
    missing = rng.random() < 0.3
    case = experiment(rng, system, clock, missing=missing)
    question = Question([case], known_start=rng.random() < 0.5)
    return fitted(question, [1, None][rng.integers(2)])


def fit_criteria(rng: np.random.Generator) -> str | None:
    """Return where priors, ties, biases, or other noise models make a difference to SciPy."""
    system = plant(rng, outputs=2)
    case = experiment(rng, system, uniform(rng, step_of(system), 120))
    noise = str(rng.choice(["diagonal", "full", "given"]))
    priors, tied = {}, {}
    knowledge = rng.random()
    if knowledge < 0.4:
        mean = system.truth["a"] * (1 + 0.01 * rng.standard_normal())
        priors = {"a": (float(mean), 0.01 * system.truth["a"])}
    elif knowledge < 0.8:
        tied = {"a": ("k", system.truth["a"] / system.truth["k"])}
    bias = rng.random() < 0.3 and not priors
    known = rng.random() < 0.4
    return fitted(Question([case], noise, known, priors, tied, bias=bias))


def cost_of_record(rng: np.random.Generator) -> str | None:
    """Return where the cost of records at random values is not that of the likelihood's formula.

    The initial states are known, so that nothing is left to a solver.
    """
    system = plant(rng, order=int(rng.integers(2, 4)))
    noise = str(rng.choice(["diagonal", "full", "given"]))
    missing = noise != "full" and rng.random() < 0.4
    cases = [
        experiment(rng, system, uniform(rng, step_of(system), 50), missing=missing)
        for _ in range(rng.integers(1, 3))
    ]
    truth, knowledge = system.truth, rng.random()
    priors, tied = {}, {}
    if knowledge < 0.3:
        priors = {"a": (truth["a"] * float(rng.uniform(0.9, 1.1)), 0.05 * truth["a"])}
    elif knowledge < 0.8:
        # Factors off the truth, and different ones: a wrong tie then costs much.
        tied = {n: ("k", truth[n] / truth["k"] * float(rng.uniform(0.8, 1.25))) for n in ("a", "d")}
    question = Question(cases, noise, True, priors, tied, own=() if priors or tied else ("a",))
    reference, problem = Reference(question), question.problem()
    vector = reference.start * rng.uniform(0.85, 1.2, reference.start.size)
    want = reference.cost(vector)
    found = gb.cost(problem, dict(zip(reference.names, map(float, vector), strict=True)))
    if not abs(found - want) < 0.1 + 1e-3 * abs(want):
        return f"{question}: cost {found:.8g}, by its formula {want:.8g}"
    return None


def fit_methods(rng: np.random.Generator) -> str | None:
    """Return where another transcription or integrator makes a difference."""
    system = plant(rng, ("linear", "cubic", "tanh"))
    case = experiment(rng, system, uniform(rng, step_of(system), 100))
    methods = (
        gb.SingleShooting(),
        gb.Collocation(),
        gb.MultipleShooting(segment=7),
        gb.MultipleShooting(integrator=gb.Radau()),
        gb.MultipleShooting(ipopt=True),
    )
    return fitted(Question([case]), method=methods[rng.integers(len(methods))])


def fit_innovations(rng: np.random.Generator) -> str | None:
    """Return where a fit by prediction errors differs, with gains of the innovations."""
    system = plant(
        rng, ("linear", "cubic", "drag", "tanh"), outputs=1, order=int(rng.integers(1, 3))
    )
    clock = uniform(rng, step_of(system), 150)
    plain = experiment(np.random.default_rng(rng.integers(2**31)), system, clock)
    unit = np.std(plain.measured)
    gains = rng.uniform(0.1, 0.4, (len(system.states), 1)) / unit
    return fitted(Question([experiment(rng, system, clock, noise=0.05, gains=gains)], gains=True))


def fit_several(rng: np.random.Generator) -> str | None:
    """Return where a fit of two records with shared and own parameters differs."""
    system = plant(rng, ("linear", "cubic", "drag", "tanh"))
    cases = [experiment(rng, system, uniform(rng, step_of(system), 70)) for _ in range(2)]
    own = [(), ("a",), ("k",)][rng.integers(3)]
    noise = str(rng.choice(["diagonal", "given"]))
    known = rng.random() < 0.5
    return fitted(Question(cases, noise, known, own=own))


def fit_unstable(rng: np.random.Generator) -> str | None:
    """Return where the fit of an unstable plant in closed loop differs."""
    system = plant(rng, ("linear", "tanh", "switch", "drag"), unstable=True)
    clock = uniform(rng, step_of(system), 100)
    values, x = columns(system.truth), np.zeros((len(system.states), 1))
    inputs, block = np.zeros((len(system.inputs), clock.time.size)), int(rng.integers(4, 12))
    levels = rng.uniform(-1, 1, (len(system.inputs), clock.time.size // block + 1))
    for k in range(clock.time.size):
        inputs[:, k] = levels[:, k // block]
        rate = x[1, 0] if len(system.states) > 1 else 0.0
        inputs[0, k] = (levels[0, k // block] - 0.6 * x[0, 0] - 0.5 * rate) / (
            system.gain * system.truth["k"]
        )
        now = inputs[:, k, None]
        x = advance(system, values, x, now, now, np.array([step_of(system)]))
        if np.abs(x).max() > 10:
            return None
    moved = Motion(inputs, True)
    start = np.zeros(len(system.states))
    clean = trajectory(system, values, start[:, None], clock.time, moved)[0][:, :, 0]
    sizes = 0.01 * clean.std(axis=1)
    measured = clean + sizes[:, None] * rng.standard_normal(clean.shape)
    return fitted(Question([Experiment(system, clock, moved, start, measured, sizes)]))


def fit_steps(rng: np.random.Generator) -> str | None:
    """Return where a fit differs on clocks whose steps change, as those of a schedule."""
    system = plant(rng)
    clock = CLOCKS[str(rng.choice(["two rates", "schedule"]))](rng, step_of(system), 100)
    case = experiment(rng, system, clock)
    return fitted(Question([case], known_start=rng.random() < 0.5))


def fit_worse_clock(rng: np.random.Generator) -> str | None:
    """Return where a fit from rounded stamps or with lost rows is wrong and does not say so.

    The data do not say when things happened, so the estimate is held against the truth: within five
    standard errors and 3 %. And what the clock costs is in proportion: a standard error is below
    four times that of all rows, or of SciPy with the stamps for times; with a warning, below twenty
    times, because residuals that look alike widen it.
    """
    system = plant(rng, ("linear", "cubic", "drag", "tanh"))
    name = str(rng.choice(["rounded", "single precision", "lost rows"]))
    case = experiment(rng, system, CLOCKS[name](rng, step_of(system), 200), noise=0.02)
    minima = [Reference(Question([case])).minimum()]
    if name != "lost rows":
        minima.append(Reference(Question([_as_shown(case)])).minimum())
    if not all(minimum.clear for minimum in minima):
        return None
    answer = gb.fit(Question([case]).problem(), progress=False)
    if not answer.converged:
        return f"{case}: no start converged"
    for k, (parameter, truth) in enumerate(system.truth.items()):
        estimate, error = answer.estimate[parameter], answer.standard_error[parameter]
        if not answer.warnings and not abs(estimate - truth) < 5 * error + 0.03 * abs(truth):
            found = f"{parameter} = {estimate:.5g} ± {error:.2g}, truth {truth:.5g}"
            return f"{case}: no warning, but {found}"
        ratio = error / max(minimum.error[k] for minimum in minima)
        if not ratio < (20 if answer.warnings else 4):
            return f"{case}: the standard error of {parameter} is {ratio:.2g} times that of SciPy"
    return None


def _as_shown(case: Experiment) -> Experiment:
    """Return the experiment as if its stamps were the times."""
    rows = case.clock.rows
    stamps = case.clock.stamps[rows]
    return replace(
        case,
        clock=replace(case.clock, time=stamps, stamps=stamps, rows=np.arange(rows.size)),
        motion=replace(case.motion, values=case.motion.values[:, rows]),
        measured=case.measured[:, rows],
    )


def fit_embedded(rng: np.random.Generator) -> str | None:
    """Return where the fit of a model that calls CasADi functions differs."""
    system = plant(rng, tuple(EMBEDDED))
    return fitted(Question([experiment(rng, system, uniform(rng, step_of(system), 100))]))


def _above_its_start(problem: Any, begin: dict[str, float], method: Any = None) -> str | None:
    """Return where a fit from a start ends at a higher cost than the start has."""
    began = gb.cost(problem, begin, method)
    if not np.isfinite(began):
        return None
    answer = gb.fit(problem, [begin], method=method, progress=False)
    if answer.converged and answer.cost <= began + 1e-6 * (abs(began) + 1):
        return None
    return f"began at {began:.6g}, ended at {answer.cost:.6g}"


def _times(rng: np.random.Generator, factors: Sequence[float]) -> str | None:
    """Return where a fit from the truth ends above it, with the outputs of records times factors."""
    system = plant(rng, ("linear", "drag", "tanh"))
    parts = []
    for factor in factors:
        case = experiment(rng, system, uniform(rng, step_of(system), 100), noise=0.02)
        outputs = dict(zip(system.outputs, factor * case.measured, strict=True))
        parts.append(record(system, case.clock.time, case.motion, outputs))
    found = _above_its_start(gb.several(system.model, parts), system.truth)
    return found and f"{case}, records times {factors}: {found}"


def _light_mode_start(rng: np.random.Generator, method: Any) -> str | None:
    """Return where a fit of a light mode ends at a higher cost than its start has.

    The declared values have three times the frequency, from where a simulation over several periods
    leads to another minimum: a start that is lost is seen.
    """
    system = plant(rng, ("linear", "drag"), order=2, damping=(0.02, 0.1))
    case = experiment(rng, system, uniform(rng, 2 * step_of(system), 150), noise=0.02)
    declared = {"a": 9 * system.truth["a"], "d": 0.1 * system.truth["d"]}
    bounds = {name: (value / 50, value * 50) for name, value in system.truth.items()}
    problem = gb.Problem(system.model, case.record, start=declared, bounds=bounds)
    begin = {name: value * float(rng.uniform(0.95, 1.05)) for name, value in system.truth.items()}
    found = _above_its_start(problem, begin, method)
    return found and f"{case}: {found}"


def start(rng: np.random.Generator) -> str | None:
    """Return where a fit of a light mode ends at a higher cost than its start has."""
    return _light_mode_start(rng, gb.MultipleShooting())


def start_single_shooting(rng: np.random.Generator) -> str | None:
    """Return the same for single shooting, which IPOPT solves."""
    return _light_mode_start(rng, gb.SingleShooting())


def start_several(rng: np.random.Generator) -> str | None:
    """Return where a fit of records that agree ends at a higher cost than it began."""
    return _times(rng, (1.0,) * int(rng.integers(2, 4)))


def start_disagreeing(rng: np.random.Generator) -> str | None:
    """Return where a fit of records, one of which disagrees, ends at a higher cost than it began."""
    return _times(rng, (1.0, 1.0, float(rng.choice([0.2, 0.4, 2.0, 4.0]))))


FAMILIES = {
    "simulate": simulate,
    "simulate-steps": simulate_steps,
    "simulate-uneven-delays": simulate_uneven_delays,
    "simulate-embedded": simulate_embedded,
    "fit": fit,
    "cost-of-record": cost_of_record,
    "fit-criteria": fit_criteria,
    "fit-methods": fit_methods,
    "fit-innovations": fit_innovations,
    "fit-several": fit_several,
    "fit-unstable": fit_unstable,
    "fit-steps": fit_steps,
    "fit-worse-clock": fit_worse_clock,
    "fit-embedded": fit_embedded,
    "start": start,
    "start-single-shooting": start_single_shooting,
    "start-several": start_several,
    "start-disagreeing": start_disagreeing,
}
