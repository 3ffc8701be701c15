"""Fine Steering Mirror, three actuators and three sensors: what linear models can reach.

python benchmarks/boards/fine_steering_mirror.py FOLDER [--output FILE] [--choose]

FOLDER has the `.npy` files of `data` of https://github.com/merijnfloren/fsm-benchmark-data
(CC BY 4.0, Floren et al. 2024). Each has 8192 samples at 6400 Hz, three signals, realizations of
orthogonal multisines, and two periods in steady state.

The error is that of the benchmark: the rms error over the standard deviation of each output, mean
over outputs, realizations and periods. No initial samples are left out, since all rows are in
steady state. `--excerpt FOLDER` only writes the responses of `problems/data`. `--choose` only
compares structures on the training data: fitted to three realizations, judged on the other three.

The row "response" is no parametric model: a matrix for each of the 3839 excited frequencies, from
the mean of the periods of the training data at that level. It shows what a linear model is able to
reach there, if its order is high enough. The test excites the same frequencies.

The row "flexible modes" is a grey box: 14 modes, each with a frequency, a damping, a shape at the
sensors and a shape at the actuators, behind one delay and beside a matrix of gains for the modes
above. The shapes are complex: points of the structure move out of phase where the damping is not
proportional. So the residues of a mode are complex and of rank one, and the order is 28, as that of
the published linear models. The fit is to every sixteenth line of that response. The frequencies
near which the modes are sought were read from the responses of the training data.
"""

import time
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np
from command import heading, parser, show

import greybox as gb

# Hz, near which the modes are sought; at 200 mV, half-way between
MODES_100 = (641, 814, 924, 960, 1003, 1324, 1445, 1692, 2132, 2277, 2319.5, 2552.5, 2784, 3090)
MODES_300 = (
    636,
    805.8,
    921.6,
    945,
    990,
    1315,
    1430,
    1683,
    2124.5,
    2272.6,
    2314.6,
    2544,
    2775,
    3055,
)
MODES = {
    level: tuple(
        np.interp(level, (100, 300), pair) for pair in zip(MODES_100, MODES_300, strict=True)
    )
    for level in (100, 200, 300)
}
COUNT = len(MODES_300)
FREQUENCY = 6400 / 8192 * np.arange(4097)  # Hz
THINNED = slice(1, 3840, 16)
LEVELS = (100, 200, 300)  # mV
BLOCK = 8  # lines
SOURCE = "https://github.com/merijnfloren/fsm-benchmark-data, CC BY 4.0, Floren et al. 2024"
EXCITED = slice(1, 3840)  # below 3000 Hz
PUBLISHED = {
    "published: linear, order 28, a model a level": (8.38, 7.95, 5.63),
    "published: linear, order 28, one model": (18.61, 6.61, 16.28),
    "published: nonlinear LFR, one model": (6.37, 4.84, 4.19),
}


def signals(folder: Path, level: int, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and outputs (samples, signals, realizations, periods) of a level."""
    return np.load(folder / f"u_{level}mV_{part}.npy"), np.load(folder / f"y_{level}mV_{part}.npy")


def response(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the matrix of each line (lines, outputs, inputs) by least squares on realizations."""
    U, Y = (np.fft.rfft(signal.mean(axis=3), axis=0) for signal in (u, y))
    matrices = np.zeros((len(U), Y.shape[1], U.shape[1]), dtype=complex)
    matrices[EXCITED] = Y[EXCITED] @ np.linalg.pinv(U[EXCITED])
    return matrices


def steady_state(matrices: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the outputs for periodic inputs."""
    spectrum = np.einsum("fij,fjrp->firp", matrices, np.fft.rfft(u, axis=0))
    return np.fft.irfft(spectrum, n=len(u), axis=0)


def start_of(matrices: np.ndarray, level: int, phase: bool) -> dict[str, float]:
    """Return parameters of the modes: linear least squares, and its part of rank one."""
    T, z, s = 1.34e-4, 0.012, 1j * FREQUENCY[EXCITED]
    sought = MODES[level]
    modes = [f**2 / (s**2 + 2 * z * f * s + f**2) for f in sought]
    moving = [mode * s / f for mode, f in zip(modes, sought, strict=True)] if phase else []
    columns = np.stack([np.ones_like(s), *modes, *moving], axis=1)
    columns *= np.exp(-2 * np.pi * s * T)[:, None]
    values = matrices[EXCITED].reshape(-1, 9)
    real = np.r_[columns.real, columns.imag], np.r_[values.real, values.imag]
    static, *gains = np.linalg.lstsq(*real, rcond=None)[0].reshape(-1, 3, 3)
    start = {"T": T} | {f"d_{i}{j}": static[i, j] for i in range(3) for j in range(3)}
    for k, f in enumerate(sought):
        left, size, right = np.linalg.svd(gains[k] + (1j * gains[k + COUNT] if phase else 0))
        j = int(np.argmax(abs(right[0])))
        shapes = {f"a_{i}{k}": left[i, 0] * size[0] * right[0, j] for i in range(3)}
        shapes |= {f"b_{i}{k}": right[0, i] / right[0, j] for i in range(3)}
        start |= {f"f_{k}": f, f"z_{k}": z, f"most_{k}": j}
        start |= {name: float(shape.real) for name, shape in shapes.items()}
        start |= {f"i{name}": float(shape.imag) for name, shape in shapes.items()}
    return start


def pair(i: int, j: int, start: dict[str, float], phase: bool) -> gb.TransferFunction:
    """Return the transfer function from an actuator j to a sensor i."""
    declared = {
        "T": gb.Parameter(start["T"], bounds=(0, 1e-3), unit="s", about="delay"),
        f"d_{i}{j}": gb.Parameter(start[f"d_{i}{j}"], bounds=(-10, 10), about="higher modes"),
    }
    for k in range(COUNT):
        f, fixed = start[f"f_{k}"], bool(j == start[f"most_{k}"])
        declared |= {
            f"f_{k}": gb.Parameter(f, bounds=(0.985 * f, 1.015 * f), unit="Hz", about="frequency"),
            f"z_{k}": gb.Parameter(start[f"z_{k}"], bounds=(1e-4, 0.2), about="damping"),
        }
        shapes = {"a": (f"{i}{k}", 1, False, "sensor"), "b": (f"{j}{k}", 2, fixed, "actuator")}
        for name, (index, size, settled, place) in shapes.items():
            for part in ("", "i") if phase else ("",):
                declared[f"{part}{name}_{index}"] = gb.Parameter(
                    start[f"{part}{name}_{index}"],
                    bounds=(-size, size),
                    about=f"{'out of phase' if part else 'shape'} at the {place}",
                    fixed=settled,
                )

    def value(self, s, p):
        x = s / (2 * np.pi)
        total = p[f"d_{i}{j}"]
        for k in range(COUNT):
            f, z, a, b = p[f"f_{k}"], p[f"z_{k}"], p[f"a_{i}{k}"], p[f"b_{j}{k}"]
            gain = a * b
            if phase:
                a_out, b_out = p[f"ia_{i}{k}"], p[f"ib_{j}{k}"]
                gain += -a_out * b_out + (a * b_out + a_out * b) * x / f
            total += gain * f**2 / (x**2 + 2 * z * f * x + f**2)
        return total * gb.exp(-s * p.T)

    body = {"input": f"u{j}", "output": f"y{i}", "response": value, **declared}
    return type(f"Modes{i}{j}", (gb.TransferFunction,), body)()


def modes(matrices: np.ndarray, level: int, phase: bool = True) -> tuple[np.ndarray, gb.Fit]:
    """Fit flexible modes to the response at a level, and return theirs."""
    size = np.sqrt(np.mean(np.abs(matrices[EXCITED]) ** 2, axis=(0, 2)))[:, None]  # of each output
    scaled = matrices / size / 3
    start = start_of(scaled, level, phase)
    pairs = {(i, j): pair(i, j, start, phase) for i in range(3) for j in range(3)}
    omega = 2 * np.pi * FREQUENCY
    problems = []
    for (i, j), model in pairs.items():
        values = scaled[THINNED, i, j]
        data = gb.FrequencyResponse(
            omega[THINNED],
            values,
            variance=np.full(len(values), 1e-4),
            input=f"u{j}",
            output=f"y{i}",
        )
        problems.append(gb.Problem(model, data, criterion=gb.MaximumLikelihood()))
    fit = gb.fit(
        reduce(add, problems),
        starts=1,
        solver_options={"tol": 1e-6},
        progress=False,
        profiles=False,
    )

    fitted = np.zeros_like(matrices)
    for (i, j), model in pairs.items():
        values = {name: fit.estimate[name] for name in model.parameters}
        response = gb.frequency_response(model, values, omega[EXCITED]).response
        fitted[EXCITED, i, j] = 3 * size[i] * response
    return fitted, fit


def write_excerpt(folder: Path, level: int, path: Path) -> None:
    """Write every eighth line of the response with its variance, in µm/V, for `read_responses`.

    The variance of a line has (realizations - inputs) degrees of freedom, 3, and neighbors differ
    little: eight lines are averaged.
    """
    u, y = signals(folder, level, "train")
    U, Y = (np.fft.rfft(s.mean(axis=3), axis=0)[EXCITED] for s in (u, 1e6 * y))
    matrices = Y @ np.linalg.pinv(U)
    spare = U.shape[2] - U.shape[1]
    power = np.sum(np.abs(Y - matrices @ U) ** 2, axis=2) / spare
    gain = np.linalg.inv(U @ U.conj().transpose(0, 2, 1)).real.diagonal(axis1=1, axis2=2)
    blocks = (len(U) // BLOCK, BLOCK, *matrices.shape[1:])
    variance = (power[:, :, None] * gain[:, None, :])[: blocks[0] * BLOCK].reshape(blocks)
    middle = BLOCK // 2 + BLOCK * np.arange(blocks[0])
    responses = []
    for i, j in np.ndindex(*blocks[2:]):
        values = rounded(matrices[middle, i, j].real, 6) + 1j * rounded(
            matrices[middle, i, j].imag, 6
        )
        responses.append(
            gb.FrequencyResponse(
                2 * np.pi * FREQUENCY[EXCITED][middle],
                values,
                variance=rounded(variance[:, :, i, j].mean(axis=1), 3),
                dof=np.full(len(values), float(BLOCK * spare)),
                input=f"u{j + 1}",
                output=f"y{i + 1}",
                units={f"u{j + 1}": "V", f"y{i + 1}": "µm"},
            )
        )
    gb.data.write_responses(responses, path)
    path.write_text(f"# source: {SOURCE}\n{path.read_text(encoding='utf-8')}", encoding="utf-8")


def rounded(values: np.ndarray, digits: int) -> np.ndarray:
    """Return values with a number of significant digits."""
    return np.array([float(f"{value:.{digits}g}") for value in values])


def static(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the matrix of gains (outputs, inputs) by least squares on samples."""
    inputs, outputs = (np.moveaxis(signal, 1, 0).reshape(signal.shape[1], -1) for signal in (u, y))
    return outputs @ np.linalg.pinv(inputs)


def error(y: np.ndarray, predicted: np.ndarray) -> float:
    """Return the error of the benchmark in percent."""
    return 100 * float(np.mean(np.sqrt(np.mean((y - predicted) ** 2, axis=0)) / y.std(axis=0)))


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    fitted = {level: signals(folder, level, "train") for level in LEVELS}
    tested = {level: signals(folder, level, "test") for level in LEVELS}
    gains = {level: static(*fitted[level]) for level in LEVELS}
    responses = {level: response(*fitted[level]) for level in LEVELS}

    begin = time.process_time()
    fits = {level: modes(matrices, level) for level, matrices in responses.items()}
    seconds = (time.process_time() - begin) / len(LEVELS)

    rows = {
        "naive: zero": [error(y, np.zeros_like(y)) for _, y in tested.values()],
        "naive: static gains": [
            error(y, np.einsum("ij,njrp->nirp", gains[level], u))
            for level, (u, y) in tested.items()
        ],
        **PUBLISHED,
        "flexible modes, 14, a model a level": [
            error(y, steady_state(fits[level][0], u)) for level, (u, y) in tested.items()
        ],
        "response, a matrix a frequency, a level": [
            error(y, steady_state(responses[level], u)) for level, (u, y) in tested.items()
        ],
    }
    mean = sum(responses.values()) / len(LEVELS)
    rows["response, mean of the levels"] = [
        error(y, steady_state(mean, u)) for u, y in tested.values()
    ]
    rows["noise: difference of two periods, over √2"] = [
        error(y, y[..., ::-1]) / np.sqrt(2) for _, y in tested.values()
    ]

    lines = [
        heading(),
        "",
        f"{'error on the test data, %':46}" + "".join(f"{level:>5} mV" for level in LEVELS),
    ]
    lines += [f"{label:46}" + "".join(f"{e:8.2f}" for e in row) for label, row in rows.items()]
    lines += ["", "error of the response fitted at a level (row), on each level, %"]
    lines += [
        f"{level:>5} mV{'':38}"
        + "".join(f"{error(y, steady_state(matrices, u)):8.2f}" for u, y in tested.values())
        for level, matrices in responses.items()
    ]
    lines += ["", f"frequency, Hz, and damping of the modes, {seconds:.0f} s a fit"]
    for k in range(COUNT):
        found = (
            f"{fit.estimate[f'f_{k}']:9.1f} ± {fit.standard_error[f'f_{k}']:<6.2g}"
            f"{fit.estimate[f'z_{k}']:7.4f} ± {fit.standard_error[f'z_{k}']:<8.1g}"
            for _, fit in fits.values()
        )
        lines.append("".join(found).rstrip())
    return lines


def choice(folder: Path) -> list[str]:
    """Return the errors of structures on realizations that were not fitted, at 300 mV."""
    u, y = signals(folder, LEVELS[-1], "train")
    matrices = response(u[:, :, :3], y[:, :, :3])
    rows = {"response, a matrix a frequency": matrices}
    rows |= {
        f"flexible modes, 14, {'complex' if phase else 'real'} shapes": modes(
            matrices, LEVELS[-1], phase
        )[0]
        for phase in (False, True)
    }
    lines = [heading(), "", "error at 300 mV on three realizations of the training data, %"]
    return lines + [
        f"{label:46}{error(y[:, :, 3:], steady_state(fitted, u[:, :, 3:])):8.2f}"
        for label, fitted in rows.items()
    ]


def main() -> None:
    """Print the table, or write the responses."""
    arguments = parser(__doc__)
    arguments.add_argument("--choose", action="store_true")
    arguments.add_argument("--excerpt", type=Path)
    options = arguments.parse_args()
    if options.excerpt:
        for level in LEVELS:
            path = options.excerpt / f"fine_steering_mirror_{level}mV.csv"
            write_excerpt(options.folder, level, path)
        return
    show(choice if options.choose else board, options)


if __name__ == "__main__":
    main()
