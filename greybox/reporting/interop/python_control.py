"""To and from python-control, ``pip install 'greybox-id[control]'``."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from greybox.data.files.argument_checks import as_names
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values
from greybox.data.files.optional_package import required
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.known_systems import KnownStateSpace, KnownTransferFunction
from greybox.modeling.model import pick_signals
from greybox.modeling.state_space import StateSpace
from greybox.reporting.interop.linear_systems import given_model
from greybox.workflows.experiment.loop_numbers import loop_frequencies
from greybox.workflows.experiment.margin_values import Margins


@public
def to_control(
    thing: Any,
    values: Values | None = None,
    *,
    kind: Literal["transfer-function", "state-space"] | None = None,
    pade: int | None = None,
    at: Values | None = None,
    input: str = "",
    output: str = "",
    part: int = 0,
) -> Any:
    """Return a response, or a model at its estimate, as a system of python-control.

    Parameters
    ----------
    thing : FrequencyResponse, tuple of them, Fit, Model or Margins
        A response, or a tuple with those of all pairs at the same frequencies, becomes a
        `control.FrequencyResponseData`, and so does the broken loop of `greybox.margins` at its
        estimate, of negative feedback.
    values : mapping of name to float, optional
        Values of a model's parameters, by default the declared starts.
    kind : "transfer-function" or "state-space"
        The `control.TransferFunction` of one input-output pair, or the `control.StateSpace` of the
        linearization; by default as the model is declared.
    pade : int, optional
        Order of the Padé approximation of delays, which none of these can hold; 0 leaves delays
        out.
    at : mapping of name to float, optional
        Operating point of the linearization; by default the one of the fit. If it has all states
        and inputs, a state-space system is linearized there, with a warning if it is no
        equilibrium.
    input, output : str
        The pair of a transfer function, where a model has several.
    part : int
        Part of a fit.

    Raises
    ------
    ModuleNotFoundError
        Without python-control.
    ValueError, TypeError
        For a delay without `pade`, or what cannot be converted.

    Examples
    --------
    >>> import greybox as gb
    >>> from greybox.models.tilt import Tilt
    >>> values = {"a1": -14.6, "a2": 3.0, "a3": 8.5, "a4": 295.0}
    >>> system = gb.interop.to_control(Tilt(), values, pade=2)
    """
    control = required("control", "control", "to_control()")
    if isinstance(thing, FrequencyResponse):
        thing = (thing,)
    if isinstance(thing, tuple):
        # python-control interpolates between frequencies, which must increase for that.
        pairs = {(r.output or "y", r.input or "u"): r.by_frequency for r in thing}
        outputs, inputs = map(unique, zip(*pairs, strict=True))
        omega = pairs[outputs[0], inputs[0]].omega
        is_matrix = len(pairs) == len(outputs) * len(inputs)
        if not is_matrix or any(not np.array_equal(r.omega, omega) for r in pairs.values()):
            raise ValueError(
                "the responses are not a matrix at common frequencies: convert them one by one, or "
                "estimate all pairs at the same omega=... of gb.spectral.spectral_response."
            )
        matrix = np.array([[pairs[y, u].response for u in inputs] for y in outputs])
        name = _named(thing[0].name if len(thing) == 1 else "")
        return control.FrequencyResponseData(matrix, omega, inputs=inputs, outputs=outputs, **name)

    if isinstance(thing, Margins):
        loop = thing.require_loop()
        omega = loop_frequencies(loop)
        response = loop.first.broken_at(thing.signal, omega)[0]
        loop = FrequencyResponse(omega, response, thing.signal, thing.signal, name=thing.plant)
        return to_control(loop)

    source = given_model(thing, values, at, part)
    name = _named(source.name or source.model.label)
    kinds = ("transfer-function", "state-space")
    # As declared: a conversion would lose the meaning of states, or the form of a ratio.
    kind = kind or kinds[isinstance(source.model, StateSpace)]
    if kind not in kinds:
        raise ValueError(f"kind is {kind!r:.40}: give 'transfer-function' or 'state-space'.")
    if kind == "transfer-function":
        u, y = pick_signals(source.model, input, output)
        ratio = source.polynomials(pade, u, y)
        return control.TransferFunction(*ratio, inputs=[u], outputs=[y], **name)

    system, matrices = source.matrices(pade)
    x, u, y = map(list, (system.states, system.inputs, system.outputs))
    return control.StateSpace(*matrices, states=x, inputs=u, outputs=y, **name)


@public
def from_control(
    system: Any,
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
) -> Any:
    """Return a system of python-control as a frequency response or as a model.

    The numbers of a model are parameters that are fixed, `KnownTransferFunction` or
    `KnownStateSpace`: use it as a known filter, ``from_control(filter) * Plant()``;
    ``Problem(..., free=["a1"])`` estimates one of them.

    Parameters
    ----------
    system : control.FrequencyResponseData, TransferFunction or StateSpace
        In continuous time; a transfer function has one input and one output. The responses of
        several pairs are a tuple, by output, then by input.
    inputs, outputs : sequence of str
        Names of the signals, by default those of the system.

    Raises
    ------
    ModuleNotFoundError
        Without python-control.
    ValueError, TypeError
        For a transfer function of several inputs or outputs, discrete time, or another object.
    """
    control = required("control", "control", "from_control()")
    kinds = control.FrequencyResponseData | control.TransferFunction | control.StateSpace
    if not isinstance(system, kinds):
        raise TypeError(
            f"system is {system!r:.60}: give a FrequencyResponseData, a TransferFunction or a "
            "StateSpace of python-control."
        )

    u = _signal_names(inputs, system.input_labels)
    y = _signal_names(outputs, system.output_labels)
    if isinstance(system, control.FrequencyResponseData):
        name = "" if "[" in (system.name or "[") else system.name  # sys[0] was generated
        first, *others = (
            FrequencyResponse(system.omega, system.frdata[k, i], input=u[i], output=y[k], name=name)
            for k in range(len(y))
            for i in range(len(u))
        )
        return (first, *others) if others else first

    if system.isdtime(strict=True):
        raise ValueError(
            f"the system has a sampling time of {system.dt} s, and models here are continuous in "
            "time."
        )
    if isinstance(system, control.TransferFunction):
        if (system.ninputs, system.noutputs) != (1, 1):
            raise ValueError(
                f"the system has {system.ninputs} inputs and {system.noutputs} outputs: give one "
                "of its pairs, system[0, 0]."
            )
        return KnownTransferFunction(system.num[0][0], system.den[0][0], u[0], y[0])

    x = _signal_names((), system.state_labels)
    return KnownStateSpace(system.A, system.B, system.C, system.D, states=x, inputs=u, outputs=y)


def _named(name: str) -> Mapping[str, str]:
    """Return the name of a system as python-control accepts it."""
    # It refuses dots, and brackets mark the names that it generates.
    plain = re.sub(r"\W+", "_", name).strip("_")
    return {"name": plain} if plain else {}


def _signal_names(given: Sequence[str], labels: Sequence[str]) -> tuple[str, ...]:
    """Return the given names, else the labels with ``u[0]`` as ``u`` or ``u1``."""
    # Names of signals become attributes in formulas, x.u1, which cannot contain brackets.
    if given:
        return as_names(given)

    def plain(label: str) -> str:
        numbered = re.fullmatch(r"([a-z])\[(\d+)\]", label)
        if numbered:
            alone = len(labels) == 1 and numbered[1] != "x"
            return numbered[1] if alone else f"{numbered[1]}{int(numbered[2]) + 1}"
        return re.sub(r"\W+", "_", label).strip("_")

    return tuple(plain(str(label)) for label in labels)
