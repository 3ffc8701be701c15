"""What a problem asks of its data: the interface of every kind of data."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from greybox.data.frequency_response import Stretch
from greybox.modeling.formulation.criterion import AnyCriterion
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameters


class DataKind(ABC):
    """One kind of data: which criteria measure it, and how a model is held against it.

    Attributes
    ----------
    data_class : type
        The class of the data.
    criterion_class : type
        The class of all criteria for them.
    criteria : tuple of AnyCriterion
        The included criteria; the first is the usual one, unless the data say more.
    noun, plural : str
        What the data are in a sentence, with the article, and several of them.
    has_operating_point : bool
        Whether an ODE is linearized for them, at one operating point.
    """

    data_class: ClassVar[type]
    criterion_class: ClassVar[type[AnyCriterion]]
    criteria: ClassVar[tuple[AnyCriterion, ...]]
    noun: ClassVar[str]
    plural: ClassVar[str]
    has_operating_point: ClassVar[bool] = True

    def usual_criterion(self, data: Any) -> AnyCriterion:
        """Return the criterion of a problem that states none."""
        return self.criteria[0]

    @abstractmethod
    def added_parameters(self, model: Model, data: Any, criterion: Any) -> Parameters:
        """Return the parameters that the criterion adds to those of the model.

        Raises
        ------
        ValueError
            If model, data and criterion do not fit together.
        """

    def compared_model(self, model: Model, data: Any, criterion: Any) -> Model:
        """Return the model that is held against the data, with what the criterion adds to it."""
        return model

    def compared_data(self, data: Any) -> Any:
        """Return the data as the model is held against them."""
        return data

    def label(self, model: Model, data: Any) -> str:
        """Return the name of the data; by default that of the model."""
        return data.name or model.label

    def source_stretches(self, data: Any) -> tuple[Stretch, ...]:
        """Return the stretches of records from which the data were estimated."""
        return ()
