"""Which equations of a model become regressions, and which parameters are linear in them."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Literal

import casadi as ca

from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import Values
from greybox.modeling.formula_structure import has_switches
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.realization import Dynamics
from greybox.modeling.symbolic_reading import as_column, entries_by_name

Kind = Literal["derivative", "output"]
Source = tuple[str, ca.SX, Literal["signal", "derivative"]]
"""A name, the row of the model that it equals, and whether it is a signal or a derivative."""


@frozen
class KnownState:
    """How the time history of a state is obtained.

    ``value(x, s)`` gives it from the states known before it and from `s`: the signal `source` of
    the record, or the derivative of the state `source`. Behind it is the measured `signal`.
    """

    name: str
    how: Literal["signal", "derivative"]
    source: str
    signal: str
    value: ca.Function

    def __str__(self) -> str:
        kind = "signal" if self.how == "signal" else "derivative of"
        return f"{self.name} from the {kind} {self.source}"


@frozen
class Equation:
    """One regression: the derivative of a state, or an output, against a row of the model."""

    target: str
    kind: Kind
    parameters: tuple[str, ...]
    signals: tuple[str, ...]

    @property
    def left(self) -> str:
        """The left side as text."""
        return f"{self.target}'" if self.kind == "derivative" else self.target


@frozen
class Equations:
    """The regressions that a model and a record allow.

    Attributes
    ----------
    states : tuple of KnownState
        Each needs only those before it.
    equations : tuple of Equation
    state_names, input_names : tuple of str
        Names of the model, in the order of x and u.
    linear, nonlinear : tuple of str
        Free parameters that enter the equations linearly (given the others), and the other ones,
        which are held at their starts.
    rows : casadi.Function
        (x, u, p) -> the right sides at zero `linear` (k,) and their slopes (k, linear).
    delay : casadi.Function
        (p) -> delay of every input, s. In both functions, `p` are the free parameters.
    left_out : tuple of str
        What was left out, and why.
    """

    states: tuple[KnownState, ...]
    equations: tuple[Equation, ...]
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    linear: tuple[str, ...]
    nonlinear: tuple[str, ...]
    rows: ca.Function
    delay: ca.Function
    left_out: tuple[str, ...]


def regressions(
    model: Dynamics,
    signals: Iterable[str],
    fixed: Values,
) -> Equations:
    """Return the equations of a model that contain only known signals and parameters.

    Parameters
    ----------
    model : Dynamics
    signals : names of the signals in the record
    fixed : mapping of name to value
        Values of the parameters that are not estimated.
    """
    return _Analysis(model, set(signals), fixed).result()


class _Analysis:
    """A model in symbols, with numbers for the fixed parameters."""

    def __init__(
        self,
        model: Dynamics,
        signals: set[str],
        fixed: Values,
    ) -> None:
        self.model = model
        self.signals = signals
        self.x = ca.SX.sym("x", len(model.states))
        self.u = ca.SX.sym("u", len(model.inputs))
        self.free = tuple(name for name in model.parameters if name not in fixed)
        self.p = ca.SX.sym("p", len(self.free))
        # The symbols by name, to see what a row needs.
        self.state = entries_by_name(model.states, self.x)
        self.input = entries_by_name(model.inputs, self.u)
        self.parameter = entries_by_name(self.free, self.p)
        p = as_column([{**fixed, **self.parameter}[name] for name in model.parameters])
        self.f = entries_by_name(model.states, ca.SX(model.derivative(self.x, self.u, p)))
        self.h = entries_by_name(model.outputs, ca.SX(model.output(self.x, self.u, p)))
        self.delays = ca.SX(model.delay(p))
        self.states: dict[str, KnownState] = {}
        self.left_out: list[str] = []

    @one_thread_at_a_time
    def result(self) -> Equations:
        """Go through the states, then the equations, then the parameters."""
        # Each step needs the previous one: only known states make equations, and only the equations
        # show which parameters are linear.
        # Each state may make another one known: x from a position, then v from x.
        while self._one_more_state():
            pass
        candidates = list(self._candidates())
        equations = tuple(equation for _, equation in candidates)
        rows = as_column([row for row, _ in candidates])
        linear = self._linear(rows)
        unknowns = as_column([self.parameter[n] for n in linear])
        # The rows where the unknowns are zero, and their slopes.
        affine = [ca.substitute(rows, unknowns, 0 * unknowns), ca.jacobian(rows, unknowns)]
        nonlinear = tuple(
            n for n in self.free if n not in linear and any(n in e.parameters for e in equations)
        )

        return Equations(
            states=tuple(self.states.values()),
            equations=equations,
            state_names=self.model.states,
            input_names=self.model.inputs,
            linear=linear,
            nonlinear=nonlinear,
            rows=ca.Function("affine", [self.x, self.u, self.p], [*map(ca.densify, affine)]),
            delay=ca.Function("delay", [self.p], [ca.densify(self.delays)]),
            left_out=tuple(self.left_out),
        )

    def _one_more_state(self) -> bool:
        """Find one more state that is a signal or a derivative, up to constants."""
        rows = (*self.state.items(), *self.h.items())
        signals: list[Source] = [(n, row, "signal") for n, row in rows if n in self.signals]
        rates: list[Source] = [(n, self.f[n], "derivative") for n in self.states]
        for source, row, how in (*signals, *rates):
            for name, x in self.state.items():
                others = {**self.input, **self.parameter}
                if self._unknown(row) != {name} or _needed(row, others):
                    continue
                slope = ca.simplify(ca.jacobian(row, x))
                if ca.symvar(slope) or slope.is_zero() or not self._affine(row, x):
                    continue
                signal = ca.SX.sym("s")
                offset = ca.substitute(row, x, 0)
                value = ca.Function("value", [self.x, signal], [(signal - offset) / slope])
                measured = source if how == "signal" else self.states[source].signal
                self.states[name] = KnownState(name, how, source, measured, value)
                return True
        return False

    def _affine(self, rows: ca.SX, symbols: ca.SX) -> bool:
        """Return whether rows are affine in the symbols."""
        others = [s for s in ca.symvar(rows) if not ca.depends_on(symbols, s)]
        alone = ca.substitute(rows, as_column(others), ca.DM.ones(len(others)))
        # CasADi takes a sign for linear: its derivative is zero.
        return ca.is_linear(rows, symbols) and not has_switches(alone)

    def _candidates(self) -> Iterator[tuple[ca.SX, Equation]]:
        """Yield the right side and the description of every equation that can be used."""
        rows: list[tuple[str, Kind, ca.SX]] = []
        for name, row in self.f.items():
            if name in self.states:
                rows.append((name, "derivative", row))
            elif self._parameters(row):
                self.left_out.append(f"{name}' (the state {name} is not known)")
        for name, row in self.h.items():
            if name in self.signals:
                rows.append((name, "output", row))
        for name, kind, row in rows:
            parameters = self._parameters(row)
            if not parameters:
                continue
            # The measured states behind the row and its target.
            names = {*_needed(row, self.state), name if kind == "derivative" else ""}
            sources = sorted({self.states[n].signal for n in names & self.states.keys()})
            equation = Equation(name, kind, parameters, tuple(sources))
            unknown = " and ".join(sorted(self._unknown(row)))
            if unknown:
                self.left_out.append(f"{equation.left} (it needs {unknown}, not known)")
            else:
                yield row, equation

    def _unknown(self, row: ca.SX) -> set[str]:
        return {*_needed(row, self.state)} - self.states.keys()

    def _parameters(self, row: ca.SX) -> tuple[str, ...]:
        """Return the free parameters of a row and of its delays."""
        late = [self.delays[self.model.inputs.index(n)] for n in _needed(row, self.input)]
        return tuple(_needed(ca.vertcat(row, *late), self.parameter))

    def _linear(self, rows: ca.SX) -> tuple[str, ...]:
        """Return the parameters in which all rows are jointly affine."""
        # A parameter of a delay changes the regressors themselves.
        excluded = _needed(self.delays, self.parameter)
        names = [n for n in _needed(rows, self.parameter) if n not in excluded]
        linear: list[str] = []

        def partners(name: str) -> int:
            """Return how many parameters this one multiplies, itself where it is a power."""
            slope = ca.simplify(ca.jacobian(rows, self.parameter[name]))
            return sum(n in names for n in _needed(slope, self.parameter))

        # If parameters multiply one another, the one with the most partners is held: the others are
        # then linear.
        for name in sorted(names, key=partners):
            if self._affine(rows, as_column([self.parameter[n] for n in (*linear, name)])):
                linear.append(name)
        return tuple(name for name in names if name in linear)


def _needed(rows: ca.SX, symbols: Mapping[str, ca.SX]) -> list[str]:
    """Return the names of the symbols on which rows depend."""
    return [name for name, symbol in symbols.items() if ca.depends_on(rows, symbol)]
