"""The cascaded attitude controller in discrete time, which stabilizes the vehicle."""

from collections.abc import Mapping

import greybox as gb
from greybox.data.files.optional_package import required
from greybox.modeling.parameter import is_finite_number
from greybox.workflows.experiment.controller import sensors_of
from greybox.workflows.experiment.sampled_loop import linear_controller


def _limited(value, limit):
    return gb.maximum(-limit, gb.minimum(value, limit))


class AttitudeController(gb.Controller):
    r"""Angle error to rate setpoint, rate error to control by a PID, once every $h$ seconds.

    $$q^*_k = \mathrm{sat}(K_\theta (\theta^*_k - \theta_k), q_{max}) + q^+_k, \qquad e_k = q^*_k -
    q_k$$

    $$d_k = d_{k-1} + \frac{\omega_D h}{1 + \omega_D h} \left( \frac{e_k - e_{k-1}}{h} - d_{k-1}
    \right), \qquad i_k = \mathrm{sat}(i_{k-1} + K_I h e_k, I_{max})$$

    $$u_k = \mathrm{sat}(K_P e_k + i_k + K_D d_k + u^+_k, u_{max})$$

    Anti-windup: after a saturated sample the integral may only shrink, which it does when $i_{k-1}$
    and $e_k$ have opposite signs. The setpoint of (3.14) is $\theta^*$ (`reference`); $q^+$
    (`rate`) and $u^+$ (`mixer`) are the other points at which ArduPilot's System Identification
    mode injects a test signal. The rate setpoint $q^*$ is logged as `q_reference`. The gains are
    ArduPilot's defaults: with the tilt dynamics identified in the paper the loop tolerates 6 times
    more or 4 times less control effectiveness, or 28 ms more delay. Not modeled: the input shaping
    and feed-forward of the setpoint, the filter of the rate setpoint, and the square-root control
    of large angle errors.

    Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, section 3;
    ArduPilot Copter, libraries/AC_AttitudeControl and AC_PID/AC_PID.cpp (update_all, update_i),
    parameters ATC_ANG_PIT and ATC_RAT_PIT.
    """

    states = ("error", "derivative", "integral", "limited")
    inputs = ("theta", "q")
    setpoints = ("reference", "rate", "mixer")
    outputs = ("u", "q_reference")
    units = {
        "reference": "rad",
        "theta": "rad",
        "q": "rad/s",
        "rate": "rad/s",
        "q_reference": "rad/s",
    }
    K_theta = gb.Parameter(
        4.5, bounds=(0, 20), unit="1/s", about="rate setpoint per angle error, ATC_ANG_PIT_P"
    )
    K_P = gb.Parameter(
        0.135, bounds=(0, 5), unit="s", about="control per rate error, ATC_RAT_PIT_P"
    )
    K_I = gb.Parameter(
        0.135, bounds=(0, 5), unit="1", about="control per rate error integral, ATC_RAT_PIT_I"
    )
    K_D = gb.Parameter(
        0.0036, bounds=(0, 1), unit="s²", about="control per rate error derivative, ATC_RAT_PIT_D"
    )
    I_max = gb.Parameter(
        0.5, bounds=(0, 1), unit="1", about="limit of the integral, ATC_RAT_PIT_IMAX"
    )
    omega_D = gb.Parameter(
        125.7, bounds=(1, 3000), unit="rad/s", about="derivative filter, ATC_RAT_PIT_FLTD 20 Hz"
    )
    q_max = gb.Parameter(3.5, bounds=(0.1, 20), unit="rad/s", about="limit of the rate setpoint")
    u_max = gb.Parameter(1.0, bounds=(0.01, 1), unit="1", about="limit of the control")

    def update(self, x, u, p):
        h = 1 / self.rate
        q_reference = _limited(p.K_theta * (u.reference - u.theta), p.q_max) + u.rate
        error = q_reference - u.q
        smoothing = p.omega_D * h / (1 + p.omega_D * h)
        derivative = x.derivative + smoothing * ((error - x.error) / h - x.derivative)
        integrates = gb.maximum(1 - x.limited, x.integral * error < 0)
        integral = gb.where(
            integrates, _limited(x.integral + p.K_I * h * error, p.I_max), x.integral
        )
        demand = p.K_P * error + integral + p.K_D * derivative + u.mixer
        limited = gb.where(abs(demand) >= p.u_max, 1, 0)
        return (error, derivative, integral, limited), (_limited(demand, p.u_max), q_reference)


class ControlUnit(gb.Controller):
    """The control in the unit of the logged signal that is the input of the plant."""

    inputs, setpoints, outputs = (), ("control",), ("u",)
    unit = gb.Parameter(1.0, bounds=(1e-6, 1e6), unit="1", about="what is logged of a control of 1")

    def update(self, x, u, p):
        return (), (p.unit * u.control,)


class LinearLaw(gb.Controller):
    r"""A linear system from the error to the control, as a controller of a loop.

    $$u(z) = C(z) \, (r(z) - y(z))$$

    A system in continuous time is made discrete at the rate of the loop by Tustin's rule. The
    signals are `reference`, `y` and `u`; name them as the plant does, by `signals`.

    Source: Franklin, Powell, Workman (1998), Digital Control of Dynamic Systems, section 6.1.

    Parameters
    ----------
    system : python-control system or Model
        Of one input and one output: a `control.TransferFunction` or `control.StateSpace`, whose
        sampling time is that of the loop, if it has one; or a model without a delay, such as a
        `TransferFunction` of your own, at its declared values.
    rate : float, Hz
    signals : mapping of str to str, optional

    Raises
    ------
    TypeError
        For gains in place of a system.
    ValueError
        For another sampling time, or several inputs or outputs.
    """

    inputs, outputs = ("y",), ("u",)

    def __init__(self, system, *, rate, signals=None):
        control = required("control", "control", "LinearLaw")
        # The command line and `loop_of_log` construct a controller from its gains.
        if isinstance(system, Mapping):
            raise TypeError(
                "LinearLaw needs a linear system, not gains: on the command line name a class of "
                "your own, derived from it, whose constructor passes on control.tf(...)."
            )

        # The rate makes the system discrete before the base class checks it.
        if not (is_finite_number(rate) and rate > 0):
            raise ValueError(f"LinearLaw cannot run {rate!r} times per second: give a rate in Hz.")
        if isinstance(system, control.FrequencyResponseData):
            raise TypeError(
                "LinearLaw needs a transfer function or a state space, not measured points: fit a "
                "model to them."
            )
        # A model is converted, which refuses delays.
        if not hasattr(system, "isdtime"):
            system = gb.interop.to_control(system, kind="state-space")
        if isinstance(system.dt, float) and system.dt > 0 and abs(system.dt * rate - 1) > 1e-6:
            raise ValueError(
                f"the system has a sampling time of {system.dt:g} s, and the loop one of "
                f"{1 / rate:g} s: give rate={1 / system.dt:g}."
            )
        if (system.ninputs, system.noutputs) != (1, 1):
            raise ValueError(
                f"the system has {system.ninputs} inputs and {system.noutputs} outputs: give one "
                "of its pairs, system[0, 0]."
            )
        if isinstance(system, control.TransferFunction) and (
            len(system.num[0][0]) > len(system.den[0][0])
        ):
            raise ValueError(
                "the system has more zeros than poles: add the lag of its derivative, such as "
                "s / (0.01 * s + 1) in place of s."
            )
        if not system.isdtime(strict=True):
            system = control.sample_system(system, 1 / rate, method="bilinear")
        system = control.ss(system)
        self.blocks = (system.A, system.B, system.C, system.D)
        self.states = tuple(f"x{k}" for k in range(len(system.A)))
        super().__init__(rate=rate, signals=signals)

    def update(self, x, u, p):
        A, B, C, D = self.blocks
        error = u.reference - u.y
        states = [getattr(x, name) for name in self.states]

        def row(state, direct):
            return sum((a * value for a, value in zip(state, states, strict=True)), direct * error)

        following = tuple(row(A[k], B[k, 0]) for k in range(len(states)))
        return following, (row(C[0], D[0, 0]),)


def control_system(controllers):
    """Return a controller, or several in series, as a `control.StateSpace` at the rate of the loop.

    Its inputs are what the controllers measure and their setpoints, its outputs their outputs. They
    are linearized about their initial states; the signs are those of the controllers, so that the
    feedback of the loop is positive.
    """
    control = required("control", "control", "control_system()")

    chain = [controllers] if isinstance(controllers, gb.Controller) else controllers
    sensors = sensors_of(chain)
    linear = linear_controller(chain, sensors, ())
    driven = [law.outside(name) for law in chain for name in law.outputs]
    inputs = [*sensors, *(name for name in linear.commands if name not in driven)]
    columns = [(*sensors, *linear.commands).index(name) for name in inputs]
    rows = [linear.commands.index(name) for name in driven]
    return control.ss(
        linear.F,
        linear.G[:, columns],
        linear.H[rows],
        linear.J[rows][:, columns],
        1 / chain[0].rate,
        inputs=inputs,
        outputs=driven,
    )
