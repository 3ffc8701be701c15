"""Which equations of a model the measured signals make into regressions: how each state is known, what is left out."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from greybox.modeling.realization import Dynamics

Way = tuple[str, ca.SX, Literal["signal", "derivative"]]
"""A source, the row of the model that it equals, and whether it is a signal or the derivative of a state."""

TRIALS = 20  # random points at which a row must be affine


@dataclass(frozen=True, eq=False)
class KnownState:
    """How a state is known in time.

    ``value(x, s)`` gives it from `s`, the signal `source` of the record or the derivative of the state `source`, and
    the states known before it; None where it is the signal itself or simulated.
    """

    name: str
    how: Literal["signal", "derivative", "simulated"]
    source: str
    value: ca.Function | None

    def __str__(self) -> str:
        words = {"signal": f"from the signal {self.source}", "derivative": f"from the derivative of {self.source}"}
        return f"{self.name} {words.get(self.how, 'simulated from ' + self.source)}"


@dataclass(frozen=True)
class Equation:
    """One regression: the derivative of a state, or an output, against a row of the model."""

    target: str
    kind: Literal["derivative", "output"]
    parameters: tuple[str, ...]
    signals: tuple[str, ...]

    @property
    def left(self) -> str:
        """The left side as a person writes it."""
        return f"{self.target}'" if self.kind == "derivative" else self.target


@dataclass(frozen=True, eq=False)
class Equations:
    """The regressions that a model and a record allow.

    Attributes
    ----------
    states : tuple of KnownState
        In an order in which each needs only those before it; the simulated ones come last.
    equations : tuple of Equation
    linear, nonlinear : tuple of str
        Free parameters that enter the equations linearly (given the others), and those that do not.
    rows : casadi.Function
        (x, u, p) -> the right sides at zero `linear` (k,) and their slopes (k, linear).
    simulated : casadi.Function
        (x, u, p) -> the derivative of the simulated states at zero (s,) and their matrix (s, s).
    delay : casadi.Function
        (p) -> delay of every input, s. In all three `p` holds the free parameters.
    left_out : tuple of str
        What was left out, and why.
    """

    states: tuple[KnownState, ...]
    equations: tuple[Equation, ...]
    free: tuple[str, ...]
    linear: tuple[str, ...]
    nonlinear: tuple[str, ...]
    rows: ca.Function
    simulated: ca.Function
    delay: ca.Function
    delayed: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def simulated_names(self) -> tuple[str, ...]:
        """The states that follow from their equation alone."""
        return tuple(state.name for state in self.states if state.how == "simulated")


def regressions(model: Dynamics, signals: Iterable[str], fixed: Mapping[str, float], start: np.ndarray) -> Equations:
    """Find out which states are known and which equations then hold nothing but known signals and parameters.

    Parameters
    ----------
    model : Dynamics
    signals : names of the signals in the record
    fixed : mapping of name to value
        Of the parameters that are not estimated.
    start : (number of free parameters,) array
        Values at which simulated states must be stable, or they would not forget their unknown initial values.
    """
    return _Analysis(model, set(signals), fixed, start).result()


class _Analysis:
    """Symbols of one model with the fixed parameters put in."""

    def __init__(self, model: Dynamics, signals: set[str], fixed: Mapping[str, float], start: np.ndarray) -> None:
        self.model, self.signals, self.start = model, signals, start
        self.x, self.u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", len(model.inputs))
        self.free = tuple(name for name in model.parameters if name not in fixed)
        self.p = ca.SX.sym("p", len(self.free))
        p = ca.vertcat(*[fixed.get(name, self._symbol(name)) for name in model.parameters], ca.SX(0, 1))
        self.f = ca.SX(model.derivative(self.x, self.u, p))
        self.h = ca.SX(model.output(self.x, self.u, p))
        self.delays = ca.SX(model.delay(p))
        self.states: dict[str, KnownState] = {}
        self.left_out: list[str] = []

    def _symbol(self, name: str) -> ca.SX:
        return self.p[self.free.index(name)] if name in self.free else ca.SX(0)

    def result(self) -> Equations:
        self._measure()
        self._simulate()
        found = list(self._candidates())
        needed = self._needed(found)
        kept = [s for s in self.states.values() if s.how != "simulated" or s.name in needed]
        rows = [row for row, _ in found]
        linear = self._linear(rows)
        nonlinear = tuple(n for n in self.free if n not in linear and any(n in e.parameters for _, e in found))
        columns = ca.vertcat(*[self._symbol(n) for n in linear], ca.SX(0, 1))
        column = ca.vertcat(*rows, ca.SX(0, 1))
        slopes = ca.jacobian(column, columns)
        base = ca.substitute(column, columns, ca.SX.zeros(columns.numel())) if linear else column
        own = [self.model.states.index(s.name) for s in kept if s.how == "simulated"]
        pull = self.f[own] if own else ca.SX(0, 1)
        here = self.x[own] if own else ca.SX(0, 1)
        push = ca.substitute(pull, here, ca.SX.zeros(len(own))) if own else pull
        arguments = [self.x, self.u, self.p]
        return Equations(
            states=tuple(sorted(kept, key=lambda s: s.how == "simulated")),
            equations=tuple(e for _, e in found),
            free=self.free,
            linear=linear,
            nonlinear=nonlinear,
            rows=ca.Function("rows", arguments, [ca.densify(base), ca.densify(slopes)]),
            simulated=ca.Function("simulated", arguments, [ca.densify(push), ca.densify(ca.jacobian(pull, here))]),
            delay=ca.Function("delay", [self.p], [ca.densify(self.delays)]),
            delayed=tuple(n for k, n in enumerate(self.model.inputs) if not self.delays[k].is_zero()),
            left_out=tuple(self.left_out),
        )

    def _measure(self) -> None:
        """Take states from signals of their name, from outputs, and from derivatives of known states, until none is."""
        for name in self.model.states:
            if name in self.signals:
                self.states[name] = KnownState(name, "signal", name, None)
        while self._one_more():
            pass

    def _one_more(self) -> bool:
        outputs: list[Way] = [(n, self.h[k], "signal") for k, n in enumerate(self.model.outputs) if n in self.signals]
        known: list[Way] = [(n, self.f[self.model.states.index(n)], "derivative") for n in self.states]
        for source, row, how in (*outputs, *known):
            for k, name in enumerate(self.model.states):
                if self._unknown(row) != {name} or self._inputs(row) or self._own_parameters(row):
                    continue
                slope = ca.simplify(ca.jacobian(row, self.x[k]))
                if ca.symvar(slope) or slope.is_zero() or not self._affine(row, self.x[k]):
                    continue
                signal = ca.SX.sym("s")
                rest = ca.substitute(row, self.x[k], 0)
                value = ca.Function("value", [self.x, signal], [(signal - rest) / slope])
                self.states[name] = KnownState(name, how, source, value)
                return True
        return False

    def _simulate(self) -> None:
        """Take what follows from a stable linear equation with constant coefficients, driven by known signals."""
        own = [n for n in self.model.states if n not in self.states]
        while own:
            places = [self.model.states.index(n) for n in own]
            matrix = ca.jacobian(self.f[places], self.x[places])
            bad = [n for k, n in enumerate(own) if self._unfit(self.f[places[k]], matrix[k, :], own)]
            if not bad:
                values = np.asarray(ca.Function("A", [self.p], [ca.densify(matrix)])(self.start))
                bad = _unstable(values, own)
            if not bad:
                break
            own = [n for n in own if n not in bad]
        for name in own:
            row = self.f[self.model.states.index(name)]
            driven = [n for k, n in enumerate(self.model.states) if ca.depends_on(row, self.x[k]) and n != name]
            self.states[name] = KnownState(
                name, "simulated", " and ".join([*driven, *self._inputs(row)]) or "rest", None
            )

    def _unfit(self, row: ca.SX, slopes: ca.SX, own: list[str]) -> bool:
        """Tell whether the row of a state to be simulated needs others, or is not linear with constant coefficients."""
        varies = ca.depends_on(slopes, ca.vertcat(self.x, self.u))
        places = [self.model.states.index(n) for n in own]
        return varies or bool(self._unknown(row) - {*own}) or not self._affine(row, self.x[places])

    def _affine(self, row: ca.SX, symbols: ca.SX) -> bool:
        """Tell in numbers whether a row is affine in the symbols; the derivative of a sign is zero and hides it."""
        step = ca.SX.sym("step", symbols.numel())
        moved = ca.substitute(row, symbols, symbols + step)
        error = moved - row - ca.mtimes(ca.jacobian(row, symbols), step)
        test = ca.Function("test", [self.x, self.u, self.p, step], [ca.vertcat(error, row, moved)])
        random = np.random.default_rng(0)
        points = [[random.uniform(-3, 3, (test.size1_in(k), 1)) for k in range(4)] for _ in range(TRIALS)]
        values = np.array([np.asarray(test(*point)).ravel() for point in points])
        values = values[np.all(np.isfinite(values), axis=1)]
        return bool(np.all(np.abs(values[:, 0]) <= 1e-9 * (1 + np.abs(values[:, 1:]).sum(axis=1))))

    def _candidates(self) -> Iterable[tuple[ca.SX, Equation]]:
        """Yield the right side and the description of every equation that can be used."""
        for k, name in enumerate(self.model.states):
            if name not in self.states:
                self.left_out += [f"{name}' (the state {name} is not known)"] if self._parameters(self.f[k]) else []
            elif self.states[name].how != "simulated":
                yield from self._candidate(self.f[k], name, "derivative")
        for k, name in enumerate(self.model.outputs):
            if name in self.signals:
                yield from self._candidate(self.h[k], name, "output")

    def _candidate(
        self, row: ca.SX, name: str, kind: Literal["derivative", "output"]
    ) -> Iterable[tuple[ca.SX, Equation]]:
        parameters = self._parameters(row)
        if not parameters:
            return
        equation = Equation(name, kind, parameters, self._sources(row, name if kind == "derivative" else ""))
        unknown = self._unknown(row)
        if unknown:
            self.left_out.append(f"{equation.left} (it needs {' and '.join(sorted(unknown))}, not known)")
        else:
            yield row, equation

    def _unknown(self, row: ca.SX) -> set[str]:
        return self._used(row) - self.states.keys()

    def _used(self, row: ca.SX) -> set[str]:
        return {name for k, name in enumerate(self.model.states) if ca.depends_on(row, self.x[k])}

    def _inputs(self, row: ca.SX) -> list[str]:
        return [name for k, name in enumerate(self.model.inputs) if ca.depends_on(row, self.u[k])]

    def _needed(self, found: list[tuple[ca.SX, Equation]]) -> set[str]:
        return set().union(*(self._behind(row) for row, _ in found))

    def _behind(self, row: ca.SX) -> set[str]:
        """Return the states that a row needs, with those that its simulated and derived states need."""
        needed, new = set(), self._used(row)
        while new:
            needed |= new
            rows = [self.f[self.model.states.index(n)] for n in new if self._is_simulated(n)]
            new = set().union(*(self._used(row) for row in rows)) - needed
        return needed

    def _rows_behind(self, row: ca.SX) -> list[ca.SX]:
        """Return the row with the equations of the simulated states that it needs."""
        simulated = sorted(n for n in self._behind(row) if self._is_simulated(n))
        return [row, *(self.f[self.model.states.index(n)] for n in simulated)]

    def _is_simulated(self, name: str) -> bool:
        return name in self.states and self.states[name].how == "simulated"

    def _own_parameters(self, row: ca.SX) -> tuple[str, ...]:
        return tuple(n for n in self.free if ca.depends_on(row, self._symbol(n)))

    def _parameters(self, row: ca.SX) -> tuple[str, ...]:
        """Return the free parameters that a row depends on: its own, of simulated states, of delays."""
        column = ca.vertcat(*self._rows_behind(row))
        late = [self.delays[self.model.inputs.index(n)] for n in self._inputs(column)]
        return self._own_parameters(ca.vertcat(column, *late))

    def _sources(self, row: ca.SX, target: str) -> tuple[str, ...]:
        """Return the measured states behind a row and its target."""
        names, found = [*self._behind(row), *([target] if target else [])], set()
        for name in names:
            state = self.states.get(name)
            while state is not None and state.how == "derivative":
                state = self.states[state.source]
            if state is not None and state.how == "signal":
                found.add(state.source)
        return tuple(sorted(found))

    def _linear(self, rows: list[ca.SX]) -> tuple[str, ...]:
        """Return parameters in which all rows are jointly affine; of two that multiply, one is left out."""
        inside = ca.vertcat(*[r for row in rows for r in self._rows_behind(row)[1:]], self.delays, ca.SX(0, 1))
        own = [n for n in self.free if not ca.depends_on(inside, self._symbol(n))]
        own = [n for n in own if any(ca.depends_on(row, self._symbol(n)) for row in rows)]
        column = ca.vertcat(*rows, ca.SX(0, 1))
        partners = {n: self._partners(column, n, own) for n in own}
        own = [n for n in own if n not in partners[n] and all(self._affine(row, self._symbol(n)) for row in rows)]
        while any(partners[n] & {*own} for n in own):
            worst = max(own, key=lambda n: (len(partners[n] & {*own}), own.index(n)))
            own.remove(worst)
        return tuple(own)

    def _partners(self, column: ca.SX, name: str, others: list[str]) -> set[str]:
        slope = ca.simplify(ca.jacobian(column, self._symbol(name)))
        return {n for n in others if ca.depends_on(slope, self._symbol(n))}


def _unstable(matrix: np.ndarray, names: list[str]) -> list[str]:
    """Return the state that weighs most in a mode that does not die away."""
    if not np.all(np.isfinite(matrix)):
        return names
    values, vectors = np.linalg.eig(matrix)
    growing = np.flatnonzero(~(np.real(values) < 0))
    return [names[int(np.argmax(np.abs(vectors[:, growing[0]])))]] if growing.size else []
