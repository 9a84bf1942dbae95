"""A sound example that is spoilt."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Target:
    """A folder of files, which of them are spoilt, and commands that read them in a copy of the folder."""

    folder: Path
    files: Callable[[Path], list[Path]]
    commands: Callable[[Path], list[list[str]]]

    def copy(self, place: Path) -> Path:
        shutil.copytree(self.folder, place, symlinks=True)
        return place
