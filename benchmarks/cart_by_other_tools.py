"""The cart of the guide by greybox and two other tools: coverage of 95 % intervals, and time.

python benchmarks/cart_by_other_tools.py [--tool greybox|aeroid|mujoco] [--color 0.95]

Each tool needs an environment of its own: `pip install aeroid` (https://pypi.org/project/aeroid/),
or `pip install "mujoco[sysid]"`. Ten flights of 20 s at 50 Hz: a cart is driven by a sum of sines,
linear between samples, and its position is measured with an error of 5 mm, white or an
autoregression of first order. The initial state is specified, since the other two tools do not
estimate it, and all tools begin at the same start. MuJoCo has the drag of the cart as the second
coefficient of its joint damping. It holds the control over a step and reads the sensor at the
beginning of the step, so that its simulation is late by about 1.5 steps: `--steps` in a sample.
"""

import argparse
import time

import numpy as np

TRUTH = {"m": 2.0, "b": 1.5, "c": 0.8}
START = {"m": 1.0, "b": 1.0, "c": 0.1}
BOUNDS = {"m": (0.1, 10.0), "b": (0.0, 20.0), "c": (0.0, 5.0)}
STEPS = 10  # Runge-Kutta steps of the truth in a sample
CART = """
<mujoco>
  <option integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="x" type="slide" axis="1 0 0"/>
    </body>
  </worldbody>
  <actuator><motor name="F" joint="x"/></actuator>
  <sensor><jointpos name="position" joint="x"/></sensor>
</mujoco>
"""


def acceleration(v, force, p):
    return (force - p["b"] * v - p["c"] * abs(v) * v) / p["m"]


def flight(seed, color):
    """Return time, force and measured position."""
    random = np.random.default_rng(seed)
    clock = np.arange(0, 20, 0.02)
    phases = random.uniform(0, 2 * np.pi, 5)
    force = sum(
        1.5 * np.sin(w * clock + phase)
        for w, phase in zip((0.5, 1.1, 2.3, 4.1, 7.3), phases, strict=True)
    )
    step, x, v, positions = 0.02 / STEPS, 0.0, 0.0, []
    for now, after in zip(force, [*force[1:], force[-1]], strict=True):
        positions.append(x)
        for k in range(STEPS):
            ends = (now + (after - now) * (k + share) / STEPS for share in (0, 0.5, 0.5, 1))
            slopes = [(0.0, 0.0)]
            for share, u in zip((0, 0.5, 0.5, 1), ends, strict=True):
                _, dv = slopes[-1]
                slopes.append(
                    (v + share * step * dv, acceleration(v + share * step * dv, u, TRUTH))
                )
            weights = np.array([1, 2, 2, 1]) * step / 6
            x, v = (x, v) + weights @ np.array(slopes[1:])
    white = random.standard_normal(clock.size)
    noise = [white[0]]
    for e in white[1:]:
        noise.append(color * noise[-1] + np.sqrt(1 - color**2) * e)
    return clock, force, np.array(positions) + 0.005 * np.array(noise)


def by_greybox(clock, force, position):
    import greybox as gb  # noqa: PLC0415  (each tool in its own environment)

    class Cart(gb.StateSpace):
        """A cart with friction and drag."""

        states, inputs, outputs = ("x", "v"), ("F",), ("x",)
        m, b, c = (gb.Parameter(START[name], bounds=BOUNDS[name]) for name in TRUTH)

        def derivative(self, x, u, p):
            return x.v, acceleration(x.v, u.F, {"m": p.m, "b": p.b, "c": p.c})

        def output(self, x, u, p):
            return (x.x,)

    record = gb.Record(clock, {"F": force, "x": position}, hold={"F": 0.0, "x": 0.0})
    criterion = gb.OutputError(initial={"x": 0.0, "v": 0.0})
    fit = gb.fit(gb.Problem(Cart(), record, criterion=criterion), starts=1, progress=False)
    return fit.estimate, fit.interval(0.95)


def by_aeroid(clock, force, position):
    import aeroid  # noqa: PLC0415

    def dynamics(_time, x, u, p):
        return np.array([x[1], acceleration(x[1], u[0], p)])

    model = aeroid.Model(
        states=["x", "v"],
        controls=["F"],
        parameters=START,
        dynamics=dynamics,
        outputs=["x"],
        measurement=lambda _time, x, _u, _p: np.array([x[0]]),
    )
    data = aeroid.FlightData(clock, {"F": force, "x": position})
    fit = aeroid.identify(model, data, list(TRUTH), x0=[0.0, 0.0], bounds=BOUNDS)
    return fit.parameters, {
        name: (fit.parameters[name] - 1.96 * error, fit.parameters[name] + 1.96 * error)
        for name, error in fit.stderr.items()
    }


def by_mujoco(clock, force, position, steps):
    import mujoco  # noqa: PLC0415
    from mujoco import sysid  # noqa: PLC0415

    spec = mujoco.MjSpec.from_string(CART)
    spec.option.timestep = (clock[1] - clock[0]) / steps
    model = spec.compile()

    def stated(name, modifier):
        return sysid.Parameter(name, START[name], *BOUNDS[name], modifier=modifier)

    def damping(place):
        def modify(spec, parameter):
            values = spec.joint("x").damping.copy()
            values[place] = parameter.value[0]
            spec.joint("x").damping = values

        return modify

    parameters = sysid.ParameterDict()
    parameters.add(stated("m", lambda s, p: setattr(s.body("cart"), "mass", p.value[0])))
    parameters.add(stated("b", damping(0)))
    parameters.add(stated("c", damping(1)))
    measured = sysid.TimeSeries.from_names(clock, position[:, None], model)
    control = sysid.TimeSeries(clock, force[:, None])
    initial = sysid.create_initial_state(model, np.zeros(1), np.zeros(1))
    flown = sysid.ModelSequences("cart", spec, "flight", initial, control, measured)
    residual = sysid.build_residual_fn(models_sequences=[flown])
    fit, result = sysid.optimize(parameters, residual, verbose=False)
    residuals, _, _ = residual(result.x, fit)
    _, half_widths = sysid.calculate_intervals(residuals, result.jac)
    estimate = dict(zip(TRUTH, result.x, strict=True))
    widths = dict(zip(TRUTH, half_widths, strict=True))
    return estimate, {n: (x - widths[n], x + widths[n]) for n, x in estimate.items()}


TOOLS = {"greybox": by_greybox, "aeroid": by_aeroid, "mujoco": by_mujoco}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tool", default="greybox", choices=TOOLS)
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--steps", type=int, default=10, help="of MuJoCo, in a sample")
    parser.add_argument("--color", type=float, default=0.0)
    options = parser.parse_args()
    fitted = TOOLS[options.tool]
    more = {"steps": options.steps} if options.tool == "mujoco" else {}
    inside, seconds, far = 0, [], 0
    for seed in range(options.flights):
        measured = flight(seed, options.color)
        begin = time.process_time()
        estimate, intervals = fitted(*measured, **more)
        seconds.append(time.process_time() - begin)
        inside += sum(low <= TRUTH[name] <= high for name, (low, high) in intervals.items())
        far += any(abs(estimate[name] / true - 1) > 0.1 for name, true in TRUTH.items())
    tool = f"mujoco, {options.steps} steps in a sample" if more else options.tool
    print(
        f"{tool}, errors with correlation {options.color:g} from sample to sample: "
        f"{inside} of {3 * options.flights} intervals contain the truth; "
        f"{far} of {options.flights} estimates are more than 10 % off; "
        f"median processor time {np.median(seconds):.2f} s"
    )


if __name__ == "__main__":
    main()
