"""Exceptions of this package: every known error derives from `CraternavError`."""

from pathlib import Path
from typing import Any


class CraternavError(Exception):
    """Base of all errors that a user can act on; its text is one line."""


class InputError(CraternavError):
    """A file or value given by the user is not what it must be.

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
        self.problem = problem
        self.line = line
        self.column = column

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by its text and attributes: the text holds all arguments, so it cannot be composed again."""
        return self.__class__.__new__, (self.__class__, *self.args), self.__dict__


class EstimationError(CraternavError):
    """An estimator cannot use the data it was given; the text says why."""


def one_sentence(error: Exception) -> str:
    """Return the first sentence of an error's text: GTSAM's go on for a page.

    Parameters
    ----------
    error : Exception
    """
    return " ".join(str(error).split()).split(". ")[0].removesuffix(".")
