"""The version of rtin."""

__version__ = "0.1.0"
