"""Frequency responses as the data of a problem."""

from greybox.data.frequency_response import FrequencyResponse, Stretch
from greybox.modeling.formulation.data_kind import DataKind
from greybox.modeling.formulation.frequency_criteria import (
    Criterion,
    MaximumLikelihood,
    RelativeError,
)
from greybox.modeling.formulation.included_criteria import CRITERIA
from greybox.modeling.formulation.signal_units import check_response_units
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameters


class ResponseKind(DataKind):
    """Frequency responses."""

    data_class = FrequencyResponse
    criterion_class = Criterion
    criteria = CRITERIA
    noun = "a frequency response"
    plural = "frequency responses"

    def usual_criterion(self, data: FrequencyResponse) -> Criterion:
        """Return maximum likelihood where the data have variances, otherwise (4.26)."""
        # Errors of one relative size, as (4.26) takes them, would contradict most variances: its
        # estimates vary more, and with few points its intervals are several times as wide.
        return RelativeError() if data.variance is None else MaximumLikelihood()

    def added_parameters(
        self, model: Model, data: FrequencyResponse, criterion: Criterion
    ) -> Parameters:
        """Check model, data and criterion: no criterion for responses adds parameters."""
        criterion.check(data)
        check_response_units(model, data)
        return {}

    def compared_data(self, data: FrequencyResponse) -> FrequencyResponse:
        """Return the response without its hold, which is not a part of a model."""
        return data.without_hold()

    def label(self, model: Model, data: FrequencyResponse) -> str:
        """Return the name of the response, its pair if the model has several, or the model."""
        has_several_pairs = len(model.input_names) * len(model.output_names) > 1
        return data.name or (data.pair if has_several_pairs else "") or model.label

    def source_stretches(self, data: FrequencyResponse) -> tuple[Stretch, ...]:
        """Return the stretches of records from which the response was estimated."""
        return tuple(stretch for stretch in data.stretches if stretch)
