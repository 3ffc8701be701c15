"""Flexible modes of a structure between several actuators and several sensors."""

from typing import NamedTuple

import greybox as gb


class Mode(NamedTuple):
    """Guess of a mode: natural frequency in rad/s, and shapes at all sensors and all actuators."""

    omega: float
    sensors: tuple[float, ...]
    actuators: tuple[float, ...]


TWO_MODES = (Mode(60.0, (2.0, -1.0), (1.0, 0.5)), Mode(150.0, (1.0, 3.0), (-0.5, 1.0)))


class FlexibleModes(gb.StateSpace):
    r"""Displacements at sensors from the commands of actuators: a sum of modes, and gains.

    $$\frac{y_i}{u_j} = e^{-s T_{delay}} \left( d_{ij} + \sum_k c_{ik} b_{kj}
    \frac{\omega_k^2}{s^2 + 2 \zeta_k \omega_k s + \omega_k^2} \right)$$

    A mode has one shape $c_k$ at the sensors and one shape $b_k$ at the actuators. Only their
    product has an effect, so the shape at the actuator that drives the mode most stays as in the
    guess. The gains $d$ are those of the modes above the band of the data. The states are the
    displacement of a mode and its velocity over $\omega_k$.

    Source: modal superposition, for example Preumont, Vibration Control of Active Structures, 2011,
    chapter 2.

    Parameters
    ----------
    modes : sequence of Mode
        Guesses. Frequencies are sought within 3 %.
    gains : sequence of sequences of float
        Guesses of the gains, one row for each output.
    inputs, outputs : sequence of str
        Names in the data.
    delay : float
        The largest delay, s.

    Raises
    ------
    ValueError
        Unless all shapes and gains are as long as inputs and outputs.
    """

    def __init__(
        self,
        modes=TWO_MODES,
        gains=((1.0, 0.5), (0.5, 1.0)),
        inputs=("u1", "u2"),
        outputs=("y1", "y2"),
        delay=0.01,
    ):
        size = (len(outputs), len(inputs))
        sizes = {(len(mode.sensors), len(mode.actuators)) for mode in modes}
        sizes |= {(len(gains), len(row)) for row in gains}
        if sizes != {size}:
            raise ValueError(
                f"modes and gains must have the size of {size[0]} outputs and {size[1]} inputs: "
                f"got {sorted(sizes)}."
            )
        self.count = len(modes)
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        self.states = tuple(f"{name}_{k}" for k in self._numbers for name in ("x", "v"))
        self.delays = dict.fromkeys(self.inputs, "T_delay")
        self.parameters = {
            "T_delay": gb.Parameter(delay / 5, bounds=(0, delay), unit="s", about="delay")
        }
        for k, mode in zip(self._numbers, modes, strict=True):
            self.parameters |= _mode_parameters(k, mode, self.inputs, self.outputs)
        largest = max(abs(gain) for row in gains for gain in row)
        for i, (output, row) in enumerate(zip(self.outputs, gains, strict=True), start=1):
            for j, (name, gain) in enumerate(zip(self.inputs, row, strict=True), start=1):
                about = f"{output} per {name} of the modes above"
                self.parameters[f"d_{i}_{j}"] = _shape(gain, largest, about)

    @property
    def _numbers(self):
        return range(1, self.count + 1)

    def derivative(self, x, u, p):
        rates = []
        for k in self._numbers:
            omega, velocity = p[f"omega_{k}"], x[f"v_{k}"]
            force = sum(p[f"b_{k}_{j}"] * u[name] for j, name in enumerate(self.inputs, start=1))
            spring = force - x[f"x_{k}"] - 2 * p[f"zeta_{k}"] * velocity
            rates += [omega * velocity, omega * spring]
        return tuple(rates)

    def output(self, x, u, p):
        return tuple(
            sum(p[f"c_{i}_{k}"] * x[f"x_{k}"] for k in self._numbers)
            + sum(p[f"d_{i}_{j}"] * u[name] for j, name in enumerate(self.inputs, start=1))
            for i in range(1, len(self.outputs) + 1)
        )


def _mode_parameters(k, mode, inputs, outputs):
    """Return the parameters of mode k by name."""
    omega = gb.Parameter(
        mode.omega,
        bounds=(0.97 * mode.omega, 1.03 * mode.omega),
        starts=(0.995 * mode.omega, 1.005 * mode.omega),
        unit="rad/s",
        about="natural frequency",
    )
    zeta = gb.Parameter(
        0.01, bounds=(1e-4, 0.3), starts=(5e-3, 0.02), unit="1", about="damping ratio"
    )
    parameters = {f"omega_{k}": omega, f"zeta_{k}": zeta}
    largest = max(abs(shape) for shape in mode.sensors)
    for i, (output, shape) in enumerate(zip(outputs, mode.sensors, strict=True), start=1):
        parameters[f"c_{i}_{k}"] = _shape(shape, largest, f"shape at {output}")
    largest = max(abs(shape) for shape in mode.actuators)
    for j, (name, shape) in enumerate(zip(inputs, mode.actuators, strict=True), start=1):
        fixed = abs(shape) == largest
        parameters[f"b_{k}_{j}"] = _shape(shape, largest, f"shape at {name}", fixed)
    return parameters


def _shape(guess, largest, about, fixed=False):
    """Return a parameter near its guess; `largest` sets the scale of both boxes."""
    return gb.Parameter(
        guess,
        bounds=(guess - 5 * largest, guess + 5 * largest),
        starts=(guess - 0.2 * largest, guess + 0.2 * largest),
        unit="1",
        about=about,
        fixed=fixed,
    )
