"""Errors of the measurement equations."""


class FactorError(ValueError):
    """A measurement or a state that no factor can use; the text names the field."""
