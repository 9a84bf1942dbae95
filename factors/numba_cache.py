"""Where numba keeps compiled code when neither the package nor the home folder can be written.

numba then refuses to define a cached function, so that nothing could even be imported.
"""

import os
import stat
import tempfile
from pathlib import Path

_VARIABLE = "NUMBA_CACHE_DIR"


def provide() -> Path | None:
    """Let numba use a temporary folder, if it has no other; to be called before numba is imported.

    Returns
    -------
    Path or None
        The folder; None when numba has a place of its own, or one was chosen by `NUMBA_CACHE_DIR`.
    """
    here = Path(__file__).resolve().parent
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    if os.environ.get(_VARIABLE) or _writable(here / "__pycache__") or _writable(home / "numba"):
        return None
    folder = Path(tempfile.gettempdir()) / f"craternav-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
        # Code of others must not be run: the folder is ours, and only ours.
        own = stat.S_ISDIR(about.st_mode) and about.st_uid == os.getuid() and not about.st_mode & 0o077
        if not own:
            folder = Path(tempfile.mkdtemp(prefix="craternav-"))
    except OSError:
        return None
    os.environ[_VARIABLE] = str(folder)
    # matplotlib would warn in three lines.
    os.environ.setdefault("MPLCONFIGDIR", str(folder))
    return folder


def _writable(folder: Path) -> bool:
    """Whether a folder can be written, or made where it is missing."""
    while not folder.exists():
        folder = folder.parent
    return os.access(folder, os.W_OK | os.X_OK)


FOLDER = provide()
"""The temporary folder, if numba has no other place for compiled code."""
