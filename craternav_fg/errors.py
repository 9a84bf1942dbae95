"""The exceptions of this package: every known error derives from `CraternavError`."""

from pathlib import Path
from typing import Any


class CraternavError(Exception):
    """Base of all errors that a user can act on; its text is one line."""


class InputError(CraternavError):
    """A file or value from outside is not what it must be.

    Parameters
    ----------
    path : Path or str
        The file at fault.
    problem : str
        What was expected and what was found.
    line : int, optional
        1-based line of the file.
    column : str, optional
        Name of the column or key.
    """

    def __init__(
        self, path: Path | str, problem: str, *, line: int | None = None, column: str | None = None
    ) -> None:
        where = str(path) if line is None else f"{path}:{line}"
        if column is not None:
            where += f": {column}"
        super().__init__(" ".join(f"{where}: {problem}".split()))
        self.path = Path(path)
        self.line = line
        self.column = column

    def __reduce__(self) -> tuple[Any, ...]:
        """Come back from another process as it was: made of its text, which has all that it was made of."""
        return self.__class__.__new__, (self.__class__, *self.args), self.__dict__


class EstimationError(CraternavError):
    """An estimator cannot go on from the data it was given; the text says why."""
