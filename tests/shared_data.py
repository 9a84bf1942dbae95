"""Real catalogues and images beside the project: not ours to ship, so tests on them skip without them."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data"


def shared(name: str) -> Path:
    """Path of a file there; the test skips when it is missing."""
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"needs shared/data/{name} beside the project")
    return path
