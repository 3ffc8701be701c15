"""A matrix of responses: a Bode diagram for every output, below one another, and every input, side by side."""

from collections.abc import Sequence

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.files.text_table import in_greek
from greybox.plotting.bode import bode
from greybox.plotting.matplotlib_figure import (
    TITLE_SIZE,
    AxesArray,
    label_horizontal,
    new_figure,
    plain,
)


def response_matrix(responses: Sequence[FrequencyResponse]) -> AxesArray:
    """Draw the responses of all outputs to all inputs as a matrix, each as magnitude and phase.

    Parameters
    ----------
    responses : sequence of FrequencyResponse
        As `greybox.spectral.response_matrix` returns them; pairs that are missing are left blank.

    Returns
    -------
    numpy.ndarray of Axes, shape (2 * outputs * inputs,)
        Row by row, magnitudes before phases. The last line of a notebook cell is
        ``gb.plotting.response_matrix(responses)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For what is no response, or if there is none.
    """
    for response in responses:
        if not isinstance(response, FrequencyResponse):
            raise TypeError(f"cannot draw {response!r:.80}: give FrequencyResponses.")
    if not len(responses):
        raise ValueError("there is no response to draw: give at least one.")
    outputs = list(dict.fromkeys(response.output for response in responses))
    inputs = list(dict.fromkeys(response.input for response in responses))
    figure = new_figure(1.0 + 3.6 * len(inputs), 0.8 + 4.2 * len(outputs))
    axes = figure.subplots(2 * len(outputs), len(inputs), sharex=True, squeeze=False)
    ranges = []
    for i, output in enumerate(outputs):
        for j, name in enumerate(inputs):
            pair = axes[2 * i : 2 * i + 2, j]
            found = [r for r in responses if (r.output, r.input) == (output, name)]
            if not found:
                for ax in pair:
                    ax.set_axis_off()
                continue
            bode(*found, axes=pair, legend=False)
            ranges.append(pair[0].get_xlim())
            pair[0].set_title(plain(f"{in_greek(name)} to {in_greek(output)}"), fontsize=TITLE_SIZE)
            for ax, label in zip(pair, ("|.|, dB", "∠, °"), strict=True):
                ax.set_ylabel(label if j == 0 else "")
                ax.set_xlabel("")
    # The axes share one range, which each diagram has set to that of its own.
    low, high = zip(*ranges, strict=True)
    axes[0, 0].set_xlim(min(low), max(high))
    label_horizontal(axes[-1], "ω, rad/s")
    return np.asarray(axes.ravel())
