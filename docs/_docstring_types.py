"""Types in docstrings as text: an extension of griffe.

Griffe reads a type that is a Python expression as one, so that "los+shape" becomes a sum of two names and
`ndarray, shape (n, 3)` a call. Text that is no expression stays as it is.
"""

import re
from typing import Any

import griffe


class DocstringTypes(griffe.Extension):
    """Rewrites the types of numpydoc's sections such that they are no Python expressions."""

    def on_instance(self, *, obj: griffe.Object | griffe.Alias, **_: Any) -> None:
        """Rewrite the types in the docstring of an object."""
        if not obj.is_alias and obj.docstring is not None:
            obj.docstring.value = as_text(obj.docstring.value)


def as_text(docstring: str) -> str:
    """Rewrite the types of a docstring."""
    docstring = re.sub(r"\bndarray, shape \(", "ndarray of shape (", docstring)
    return re.sub(r"^(\w[\w, ]* : )\{(.*)\}", r"\1one of \2", docstring, flags=re.MULTILINE)
