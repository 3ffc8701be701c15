"""Spectra of manoeuvres as the data of a problem."""

from greybox.data.frequency_response import Stretch
from greybox.data.transient_spectrum import TransientSpectrum
from greybox.modeling.formulation.data_kind import DataKind
from greybox.modeling.formulation.included_criteria import SPECTRUM_CRITERIA
from greybox.modeling.formulation.signal_units import check_units
from greybox.modeling.formulation.spectrum_criteria import outputs_in_spectrum
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameters


class SpectrumKind(DataKind):
    """Fourier integrals of manoeuvres."""

    data_class = TransientSpectrum
    criterion_class = TimeCriterion
    criteria = SPECTRUM_CRITERIA
    noun = "a TransientSpectrum"
    plural = "manoeuvres"

    def added_parameters(
        self, model: Model, data: TransientSpectrum, criterion: TimeCriterion
    ) -> Parameters:
        """Return the sizes and time constants of the noise that the criterion estimates."""
        outputs_in_spectrum(criterion, model, data)
        check_units(model, data)
        return criterion.spectrum_parameters(data)

    def source_stretches(self, data: TransientSpectrum) -> tuple[Stretch, ...]:
        """Return the stretch of the record from which the spectrum was computed."""
        return (data.stretch,) if data.stretch else ()
