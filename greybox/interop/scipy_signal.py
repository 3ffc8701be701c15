"""To and from the linear systems of scipy.signal, `scipy.signal.lti`."""

from collections.abc import Mapping
from typing import Any, Literal

from greybox.interop.linear_systems import given_model
from greybox.modeling.known_systems import KnownStateSpace, KnownTransferFunction


def to_scipy(
    thing: Any,
    values: Mapping[str, float] | None = None,
    *,
    kind: Literal["transfer-function", "state-space"] | None = None,
    pade: int | None = None,
    at: Mapping[str, float] | None = None,
    input: str = "",
    output: str = "",
    part: int = 0,
) -> Any:
    """Return a model at its estimate as a `scipy.signal` transfer function or state space.

    Parameters
    ----------
    thing : Fit or Model
    values, kind, pade, at, input, output, part
        As in `greybox.interop.to_control`.

    Raises
    ------
    ValueError, TypeError
        For a delay without `pade`, or what cannot be converted.
    """
    from scipy import signal  # noqa: PLC0415  (takes a third of a second to import)

    linear = given_model(thing, values, at, part).converted(kind, pade, input, output)
    if isinstance(linear, tuple):
        return signal.TransferFunction(*linear)
    return signal.StateSpace(linear.A, linear.B, linear.C, linear.D)


def from_scipy(
    system: Any, *, input: str = "u", output: str = "y", prefix: str = ""
) -> KnownTransferFunction | KnownStateSpace:
    """Return a `scipy.signal.lti` as a model whose numbers are parameters that are fixed.

    Parameters
    ----------
    system : scipy.signal.TransferFunction, ZerosPolesGain or StateSpace
        In continuous time.
    input, output : str
        Names of the signals; numbered, ``u1, u2 ...``, where a state space has several.
    prefix : str
        Begins the names of the parameters of a transfer function, so that two can be connected.

    Raises
    ------
    ValueError, TypeError
        For several outputs in one transfer function, discrete time, or another object.
    """
    from scipy import signal  # noqa: PLC0415  (takes a third of a second to import)

    # `dlti` is not a kind of `lti`, and deserves a message of its own.
    if isinstance(system, signal.dlti):
        raise ValueError(
            f"the system has a sampling time of {system.dt} s, and models here are continuous in "
            "time."
        )
    if not isinstance(system, signal.lti):
        raise TypeError(f"system is {system!r:.60}: give a scipy.signal.lti.")

    linear: Any = system  # scipy does not declare its attributes
    if isinstance(system, signal.StateSpace):
        outputs, inputs = linear.D.shape
        u, y = [
            [name] if count == 1 else [f"{name}{k + 1}" for k in range(count)]
            for name, count in ((input, inputs), (output, outputs))
        ]
        return KnownStateSpace(linear.A, linear.B, linear.C, linear.D, inputs=u, outputs=y)

    # ZerosPolesGain has zeros and poles instead of polynomials.
    rational = linear.to_tf()
    if rational.num.ndim > 1:
        raise ValueError(
            f"the system has {rational.num.shape[0]} outputs: give a system of one, or a "
            "StateSpace."
        )

    return KnownTransferFunction(
        rational.num.tolist(), rational.den.tolist(), input, output, prefix
    )
