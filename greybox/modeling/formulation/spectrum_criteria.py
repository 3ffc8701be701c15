"""Criteria for the Fourier integrals of a manoeuvre: `EquationError` and `OutputError`."""

from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.data.record import Record
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.disturbance import gust_time
from greybox.modeling.formulation.modeled_outputs import modeled_outputs
from greybox.modeling.formulation.output_error import OutputError
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameter
from greybox.modeling.realization import dynamics


@public
@frozen
class EquationError(TimeCriterion):
    """Maximum likelihood with all errors in the differential equation, such as turbulence.

    The data are a `TransientSpectrum`.

    The errors are those of det(jωI - A) Y for one output, and those of jωX - A X - B U for as many
    outputs as states. The likelihood is that of the outputs, whose variance depends on the
    parameters: plain least squares of these errors would be biased where the band leaves out a part
    of them. Noise in the outputs biases the estimate; use `OutputError` for it.

    Parameters
    ----------
    gusts : bool
        Whether gusts last longer than a sample: white noise through a first-order lag, whose time
        constant is the parameter ``T_gust`` (Dryden's spectrum along the flight path). Their values
        at both ends are estimated like those of the states.

    Source: Klein and Morelli, Aircraft System Identification, 2nd ed., chapter 7; the likelihood:
    Pintelon and Schoukens, System Identification, 2nd ed., section 9.11, with one denominator for
    plant and noise.

    Examples
    --------
    >>> class Cart(gb.StateSpace):
    ...     'A cart that rolls.'
    ...
    ...     states = outputs = ("v",)
    ...     inputs = ("F",)
    ...     b = gb.Parameter(1.0, bounds=(0, 10), unit="1/kg", about="acceleration per force")
    ...     c = gb.Parameter(0.5, bounds=(0, 5), unit="1/s", about="rolling")
    ...
    ...     def derivative(self, x, u, p):
    ...         return (p.b * u.F - p.c * x.v,)
    ...
    ...     def output(self, x, u, p):
    ...         return (x.v,)
    >>> time = np.arange(400) / 20
    >>> record = gb.Record(time, {"F": np.sin(0.1 * time**2)})
    >>> v = gb.simulate(Cart(), record=record)["v"]
    >>> record = gb.Record(time, {"F": record["F"], "v": v})
    >>> spectrum = gb.spectral.transient_spectrum(record, "F", "v", (0.5, 4.0))
    >>> fit = gb.fit(gb.Problem(Cart(), spectrum, criterion=gb.EquationError()), starts=1)
    >>> round(fit.estimate["c"], 1)
    0.5
    """

    gusts: bool = False
    rule = "equation error"
    condition = (
        "errors of the differential equation whose size changes slowly over the band, as in light "
        "turbulence, and known inputs"
    )

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if not isinstance(self.noise, str):
            raise ValueError(
                "EquationError estimates the size of the errors of the equation: leave out noise."
            )

    def spectrum_parameters(self, spectrum: TransientSpectrum) -> dict[str, Parameter]:
        """Return the time constant of gusts, between a sample and the manoeuvre."""
        ends = spectrum.step, spectrum.duration
        return {"T_gust": gust_time(ends, "equation")} if self.gusts else {}

    def compared(self, model: Model, record: Record) -> tuple[str, ...]:
        """Refuse a record."""
        raise ValueError(
            "EquationError is for the Fourier integrals of a manoeuvre and the data are a record: "
            "give gb.spectral.transient_spectrum(record, ...), or use gb.regression.equation_error."
        )


def outputs_in_spectrum(
    criterion: TimeCriterion, model: Model, spectrum: TransientSpectrum
) -> tuple[str, ...]:
    """Return the outputs of the model that are in the spectrum.

    Raises
    ------
    ValueError
        If the criterion, the model and the spectrum do not fit together.
    """
    label, kind = model.label, type(criterion).__name__
    if not isinstance(criterion, OutputError | EquationError):
        raise ValueError(
            f"{kind} is for records and the data are a TransientSpectrum: use OutputError()."
        )

    for option in ("inputs", "biases", "initial", "errors"):
        value = getattr(criterion, option, None)
        if value and value not in ("record", "normal"):
            raise ValueError(
                f"{option} of {kind} is for records and the data are a TransientSpectrum, which "
                "knows how its inputs ran and has no samples: leave it out."
            )

    outputs = modeled_outputs(model, spectrum.inputs, spectrum.outputs, "spectrum")
    criterion.check_noise(model, outputs)
    # With fewer equations than states, the others are eliminated to one of higher order; in
    # between there is no likelihood.
    states = len(dynamics(model).states)
    if isinstance(criterion, EquationError) and len(outputs) not in (1, states):
        raise ValueError(
            f"EquationError compares one output, or as many as {label} has states ({states}), and "
            f"the spectrum has {', '.join(outputs)}: use OutputError(), or leave outputs out of "
            "the spectrum."
        )

    return outputs
