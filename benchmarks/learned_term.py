"""A learned term on ten plants that lack a term, and on ten that lack none.

python benchmarks/learned_term.py [--output FILE]

Each plant is a mass on a spring with a force of unknown form that depends on position or velocity,
or none. Three weights learn it, as docs/guide/learned_term.md does. The table says whether the
joint test asks for the term, which part of the true force is inside its 95 % band over the visited
range and how far off it is at most, how far the mass ends from the truth, without and with the
term, and what both fits say of themselves. Three straight pieces cannot follow every curve to the
noise: then the misfit says so.
"""

import argparse
import datetime as dt
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import greybox as gb
from greybox.assessment.verdict import verdict

TRUTH = {"m": 1.0, "k": 4.0, "c": 0.8}
STEP = 0.05

FORMS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "0.8 |v| v": ("v", lambda v: 0.8 * abs(v) * v),
    "0.3 v³": ("v", lambda v: 0.3 * v**3),
    "-0.5 tanh(2 v) + v": ("v", lambda v: v - 0.5 * gb.tanh(2 * v)),
    "stop of v at ±1": ("v", lambda v: 3 * (gb.maximum(v - 1, 0) - gb.maximum(-v - 1, 0))),
    "sinh(v) - v": ("v", lambda v: gb.exp(v) / 2 - gb.exp(-v) / 2 - v),
    "2 x³": ("x", lambda x: 2 * x**3),
    "4 (sin x - x)": ("x", lambda x: 4 * (gb.sin(x) - x)),
    "2 |x| x": ("x", lambda x: 2 * abs(x) * x),
    "stop of x at ±0.6": ("x", lambda x: 8 * (gb.maximum(x - 0.6, 0) - gb.maximum(-x - 0.6, 0))),
    "x⁵": ("x", lambda x: x**5),
}


class Mass(gb.StateSpace):
    """A mass on a spring."""

    states, inputs, outputs = ("x", "v"), ("F",), ("x", "v")
    m = gb.Parameter(1.0, bounds=(0.05, 20), unit="kg")
    k = gb.Parameter(4.0, bounds=(0.0, 100), unit="N/m")
    c = gb.Parameter(0.8, bounds=(0.0, 20), unit="N s/m")

    def force(self, x: Any, p: Any) -> Any:
        """Return the force beside the spring and the damper."""
        return 0.0

    def derivative(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivatives."""
        return [x.v, (u.F - p.k * x.x - p.c * x.v - self.force(x, p)) / p.m]

    def output(self, x: Any, u: Any, p: Any) -> Any:
        """Return the states."""
        return [x.x, x.v]


def plant(state: str, form: Callable[[Any], Any] | None) -> Mass:
    """Return the mass with a further force of a state."""

    class Plant(Mass):
        def force(self, x: Any, p: Any) -> Any:
            return 0.0 if form is None else form(x[state])

    return Plant()


def learned(state: str, knots: tuple[float, ...]) -> Mass:
    """Return the mass with a learned force: a change of slope at every knot, on both sides."""

    class Learned(Mass):
        w1 = gb.Parameter(0.0, bounds=(-50, 50), starts=(0, 0), prior=(0, 5))
        w2 = gb.Parameter(0.0, bounds=(-50, 50), starts=(0, 0), prior=(0, 5))
        w3 = gb.Parameter(0.0, bounds=(-50, 50), starts=(0, 0), prior=(0, 5))

        def force(self, x: Any, p: Any) -> Any:
            at = x[state]
            pieces = [gb.maximum(at - k, 0.0) - gb.maximum(-at - k, 0.0) for k in knots]
            return p.w1 * pieces[0] + p.w2 * pieces[1] + p.w3 * pieces[2]

    return Learned()


def tried(state: str, form: Callable[[Any], Any] | None, seed: int) -> list[str]:
    """Fit one plant without and with the learned term; return a row of the table."""
    random = np.random.default_rng(seed)
    F = np.repeat(random.normal(0, 4, 50), 16)
    forces = gb.Record(STEP * np.arange(F.size), {"F": F}, hold={"F": np.inf})
    clean = gb.simulate(plant(state, form), TRUTH, forces, initial={"x": 0.0, "v": 0.0})
    noise = {name: clean[name] + 0.02 * random.normal(size=F.size) for name in ("x", "v")}
    record = forces.with_signals(**noise)

    reach = float(np.quantile(np.abs(clean[state]), 0.98))
    knots = (0.2 * reach, 0.45 * reach, 0.7 * reach)
    model = learned(state, knots)
    plain = gb.fit(gb.Problem(Mass(), record), starts=4, progress=False)
    fit = gb.fit(gb.Problem(model, record), starts=4, progress=False)
    test = gb.validation.joint_test(fit, ["w1", "w2", "w3"])

    grid = np.linspace(-reach, reach, 81)
    slope = "c" if state == "v" else "k"

    def curve(p: Any) -> Any:
        # The slope at rest and the learned force together: only their sum has a meaning.
        names = type("Names", (dict,), {"__getattr__": dict.__getitem__})
        return p[slope] * grid + model.force({state: grid}, names(p))

    true = TRUTH[slope] * grid + (0 if form is None else np.asarray(form(grid)))
    draws = np.array([curve(p) for p in gb.draws(fit, 200)])
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    size = np.abs(true).max()
    off = np.abs(curve(fit.estimate) - true).max() / size

    def away(name: str, answer: gb.Fit) -> str:
        return f"{100 * (answer.estimate[name] / TRUTH[name] - 1):+.1f}"

    named = plain.misfit.causes[0].text if plain.misfit and not plain.misfit.explains else "-"
    return [
        f"{test.p_value:.1e}",
        f"{100 * np.mean((low <= true) & (true <= high)):.0f}",
        f"{100 * off:.1f}",
        away("m", plain),
        away("m", fit),
        verdict(plain).grade,
        verdict(fit).grade,
        named[:50],
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()

    lines = [f"greybox {gb.__version__}, {dt.date.today()}", ""]
    lines.append(
        f"{'lacks':<20} {'p of term':>9} {'in band %':>9} {'curve off %':>11} {'m off %':>8} "
        f"{'with it':>8} {'verdict':>9} {'with it':>9}  first cause named without it"
    )
    cases = [(name, state, form) for name, (state, form) in FORMS.items()]
    cases += [(f"nothing ({state})", state, None) for state in "vxvxvxvxvx"]
    for seed, (name, state, form) in enumerate(cases):
        cells = tried(state, form, seed)
        lines.append(
            f"{name:<20} {cells[0]:>9} {cells[1]:>9} {cells[2]:>11} {cells[3]:>8} {cells[4]:>8} "
            f"{cells[5]:>9} {cells[6]:>9}  {cells[7]}"
        )
        print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    if arguments.output:
        arguments.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
