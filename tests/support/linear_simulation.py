"""Responses of linear systems to long inputs."""

from scipy.signal import cont2discrete, lfilter


def lsim(system, u, time):
    """Return the output of a transfer function at rest, as `scipy.signal.lsim`, for u[0] = 0.

    scipy takes a step of Python for each sample, which is a third of a second for 24 000.
    """
    numerator, denominator, _ = cont2discrete(system, time[1] - time[0], method="foh")
    return lfilter(numerator[0], denominator, u)
