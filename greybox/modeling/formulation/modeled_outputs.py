"""The outputs of a model that are in data."""

from collections.abc import Iterable

from greybox.modeling.model import Model


def modeled_outputs(
    model: Model, inputs: Iterable[str], outputs: Iterable[str], noun: str
) -> tuple[str, ...]:
    """Return the outputs of the model that are among those of the data.

    Raises
    ------
    ValueError
        If an input is missing, or all outputs are.
    """
    for name in model.input_names:
        if name not in inputs:
            raise ValueError(
                f"{model.label} needs the input {name!r}, which the {noun} does not have: rename "
                f"one of its signals, {', '.join(inputs) or 'none'}."
            )

    compared = tuple(name for name in model.output_names if name in outputs)
    if not compared:
        raise ValueError(
            f"the {noun} has none of the outputs of {model.label} "
            f"({', '.join(model.output_names)}); it has {', '.join(outputs) or 'none'}."
        )

    return compared
