"""How often the intervals of measured margins contain the truth: no model, known flights.

python benchmarks/measured_margin_coverage.py [--repeats 20] [--only rate]

The flights are those of margin_coverage.py, with the sweep added to the control. The broken loop
comes from the response of the control to what was added to it. Printed: the share of intervals that
hold the truth in percent, and how many flights measured the quantity.
"""

import argparse

import numpy as np
from margin_coverage import PLANTS, Rate, RateLoop, flown

import greybox as gb
from greybox.workflows.experiment import broken_loop

NAMES = (
    "phase margin",
    "gain margin",
    "delay margin",
    "modulus margin",
    "crossover",
    "disturbance rejection bandwidth",
)


def main():
    """Print a row for each plant."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    for plant, (values, gains, rate, band) in PLANTS.items():
        if options.only not in plant:
            continue
        truth = gb.margins(Rate(), RateLoop(gains, rate=rate), values)
        held = {name: [] for name in NAMES}
        for seed in range(options.repeats):
            record = flown(values, gains, rate, band, "sweep at u", seed)
            response = gb.spectral.spectral_response(record, "u_excitation", "u", band=band)
            answer = gb.margins(broken_loop(response))
            for name in NAMES:
                margin = answer[name]
                if np.isfinite(margin.value):
                    held[name].append(margin.low <= truth[name].value <= margin.high)
        rows = [f"{n} {100 * np.mean(h):.0f} % of {len(h)}" for n, h in held.items() if h]
        print(f"{plant}: {'; '.join(rows)}", flush=True)


if __name__ == "__main__":
    main()
