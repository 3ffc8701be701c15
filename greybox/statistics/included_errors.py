"""The included distributions of errors, by name."""

from greybox.statistics.error_distribution import ErrorDistribution, NormalErrors
from greybox.statistics.huber import HuberErrors

ERRORS: dict[str, ErrorDistribution] = {"normal": NormalErrors(), "huber": HuberErrors()}
"""The included distributions of errors by name."""
