"""The version of greybox."""

__version__ = "0.3.0"
