"""Compilation of kernels, with a cache that knows the sources of all that a kernel calls.

numba's own cache is keyed by the kernel's file alone. It serves stale code when a kernel or a constant of
another file changes, and fails when a module that it refers to has moved. Processes that share it all compile
the same kernels, and mix up their files when they compile one kernel for different arguments; here one
compiles a kernel at a time, and the others wait for the result.
"""

import fcntl
import functools
import gc
import hashlib
import inspect
import pickle
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numba
from numba.core import types
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.extending import overload
from numba.np import arrayobj

# By NUMBA_DISABLE_JIT; numba defines its settings while it is imported.
_SWITCHED_OFF = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]
_ROOT = Path(__file__).resolve().parents[2]
# `from package.module import names`; what is imported for type checkers only is indented.
_IMPORT = re.compile(r"^from ((?:craternav_fg|factors)[\w.]*) import (?:\(([^)]*)\)|(.+))", re.MULTILINE)
# What a cache raises whose modules have moved, or whose file was cut short.
_UNREADABLE = (ImportError, AttributeError, EOFError, pickle.UnpicklingError)
# How long to wait for another process that compiles the same kernel: it may have been stopped.
_PATIENCE_S, _POLL_S = 120.0, 0.02


class _Cache(FunctionCache):
    """Compiled versions of one kernel on disk."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file._source_stamp = sources_digest(Path(inspect.getfile(function)))
        self._lock: IO[bytes] | None = None

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the compiled version for a signature; None where it is ours to compile."""
        found = self._load(signature, context)
        if found is None and self._lock is None:
            self._lock = _locked(Path(self._cache_file._index_path).with_suffix(".lock"))
            found = self._load(signature, context)
        return found

    def release(self) -> None:
        """Let other processes compile the kernel, or load what was compiled."""
        if self._lock is not None:
            # A process forked meanwhile has the same file open.
            fcntl.flock(self._lock, fcntl.LOCK_UN)
            self._lock.close()
            self._lock = None

    def _load(self, signature: Any, context: Any) -> Any:
        try:
            return super().load_overload(signature, context)
        except _UNREADABLE:
            self.flush()
            return None

    def filled(self) -> bool:
        """Whether there is a compiled version of the present sources."""
        try:
            return bool(self._cache_file._load_index())
        except _UNREADABLE:
            return False


def _locked(path: Path) -> IO[bytes] | None:
    """Lock a file against other processes; None where it cannot be locked, or not for a long time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("ab")
    except OSError:
        return None
    end_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end_s:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_POLL_S)
        except OSError:
            break
        else:
            return file
    file.close()
    return None


def _refuse_slice(source: Any, target: Any) -> None:
    """Stand for numba's error of a slice that is assigned an array of another size."""


@overload(_refuse_slice)
def _refuse_slice_compiled(source: Any, target: Any) -> Any:
    def refuse(source: Any, target: Any) -> None:
        raise ValueError("cannot assign slice from input of different size")

    return refuse


@contextmanager
def _short_refusal() -> Iterator[None]:
    """Compile without numba's message of a wrong slice: code that formats its sizes takes seconds."""
    original = arrayobj.raise_with_shape_context
    arrayobj.raise_with_shape_context = _refuse_slice
    try:
        yield
    finally:
        arrayobj.raise_with_shape_context = original


@contextmanager
def _no_garbage_search() -> Iterator[None]:
    """Compile without the search for garbage, which looks through millions of objects that all stay."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with numba when it is first called.

    With `NUMBA_DISABLE_JIT=1` functions stay Python, which a debugger steps through.

    Parameters
    ----------
    **options
        Options of `numba.njit`. With `cache=True` the compiled code is kept on disk until its sources change.

    Returns
    -------
    callable
        The decorator.
    """
    cached = options.pop("cache", False)
    # No kernel is called back from C: that entry takes a tenth of the compilation.
    options["no_cfunc_wrapper"] = True
    # What a kernel does not set numba takes from the one that happens to call it first, and caches that.
    options = {"fastmath": False, "error_model": "python", **options}
    # Of sums that may be reordered there must be one version: with a copy in each caller, optimised again,
    # that which runs depends on what the process has compiled, and so do the last digits.
    options["forceinline"] = bool(options["fastmath"])

    def compiled(function: Callable[..., Any]) -> Any:
        if _SWITCHED_OFF:
            return function
        dispatcher = numba.njit(**options)(function)
        cache = _Cache(function) if cached else None
        if cache is not None:
            dispatcher._cache = cache
        compile_for = dispatcher.compile

        def compile_alone(signature: Any) -> Any:
            # A kernel that is called with a constant is the one for any number: no version of its own.
            if isinstance(signature, tuple):
                signature = tuple(map(types.unliteral, signature))
            with global_compiler_lock, _short_refusal(), _no_garbage_search():
                try:
                    return compile_for(signature)
                finally:
                    if cache is not None:
                        cache.release()

        dispatcher.compile = compile_alone
        return dispatcher

    return compiled


def is_cached(kernel: Any) -> bool:
    """Whether a kernel need not be compiled: its code is on disk and fresh, or numba is switched off.

    Parameters
    ----------
    kernel : Dispatcher
        What `njit` with `cache=True` made.

    Returns
    -------
    bool
    """
    return bool(_SWITCHED_OFF or kernel._cache.filled())


@functools.cache
def sources_digest(file: Path) -> str:
    """Digest of the sources that compiled code of a file depends on.

    Parameters
    ----------
    file : Path

    Returns
    -------
    str
        Key of the file and of the files from which it imports kernels or constants, and so on.
    """
    digest = hashlib.sha256()
    for source in sorted(_closure(file.resolve())):
        digest.update(_text(source).encode())
    return digest.hexdigest()


def _closure(file: Path) -> set[Path]:
    found = {file}
    waiting = [file]
    while waiting:
        new = _imported(waiting.pop()) - found
        found |= new
        waiting += new
    return found


@functools.cache
def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


@functools.cache
def _imported(file: Path) -> frozenset[Path]:
    """Files from which a file imports what compiled code can use: kernels and constants."""
    found = set()
    for package, several, single in _IMPORT.findall(_text(file)):
        for line in (several or single).split(","):
            name = line.split("#")[0].split(" as ")[0].strip()
            source = _file(f"{package}.{name}") or _file(package)
            if source is not None and (name.isupper() or "njit" in _text(source)):
                found.add(source)
    return frozenset(found)


def _file(module: str) -> Path | None:
    path = _ROOT.joinpath(*module.split("."))
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)
