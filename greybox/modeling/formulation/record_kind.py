"""Records as the data of a problem."""

from greybox.data.record import Record
from greybox.modeling.formulation.data_kind import DataKind
from greybox.modeling.formulation.included_criteria import TIME_CRITERIA
from greybox.modeling.formulation.signal_units import check_units
from greybox.modeling.formulation.time_criterion import TimeCriterion
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameters


class RecordKind(DataKind):
    """Records: signals in time, or rows without a time."""

    data_class = Record
    criterion_class = TimeCriterion
    criteria = TIME_CRITERIA
    noun = "a record"
    plural = "records"
    has_operating_point = False  # a record runs through many

    def added_parameters(self, model: Model, data: Record, criterion: TimeCriterion) -> Parameters:
        """Return the biases, gains and sizes of noise that the criterion estimates."""
        added = criterion.parameters(model, data)
        check_units(model, data)
        return added

    def compared_model(self, model: Model, data: Record, criterion: TimeCriterion) -> Model:
        """Return the model with the states of the disturbances that the criterion assumes."""
        return criterion.disturbed(model, data)
