"""Whether the model explains the data, and what it may lack."""

from collections.abc import Iterator

from greybox.estimate.misfit import Misfit


def unexplained(misfit: Misfit | None) -> Iterator[str]:
    """Say that estimates and errors are those of a wrong model, and name what it may lack."""
    if misfit is None or misfit.explains:
        return
    causes = " or ".join(cause.text for cause in misfit.likely)
    lacks = f" It may lack {causes}." if causes else ""
    yield (
        "the model does not explain the data, so its estimates may be biased, and the standard "
        f"errors are valid only if it did.{lacks}"
    )
