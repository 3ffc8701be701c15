"""Fine Steering Mirror, three actuators and three sensors: what linear models can reach.

python benchmarks/boards/fine_steering_mirror.py FOLDER [--output FILE]

FOLDER has the `.npy` files of `data` of https://github.com/merijnfloren/fsm-benchmark-data
(CC BY 4.0, Floren et al. 2024). Each has 8192 samples at 6400 Hz, three signals, realizations of
orthogonal multisines, and two periods in steady state.

The error is that of the benchmark: the rms error over the standard deviation of each output, mean
over outputs, realizations and periods. No initial samples are left out, since all rows are in
steady state. Nothing is chosen, so the test data are used once.

The row "response" is no parametric model: a matrix for each of the 3839 excited frequencies, from
the mean of the periods of the training data at that level. It shows what a linear model is able to
reach there, if its order is high enough. The test excites the same frequencies.
"""

from pathlib import Path

import numpy as np
from command import heading, parser, show

LEVELS = (100, 200, 300)  # mV
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

    rows = {
        "naive: zero": [error(y, np.zeros_like(y)) for _, y in tested.values()],
        "naive: static gains": [
            error(y, np.einsum("ij,njrp->nirp", gains[level], u))
            for level, (u, y) in tested.items()
        ],
        **PUBLISHED,
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
    return lines


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
