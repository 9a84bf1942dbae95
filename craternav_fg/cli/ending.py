"""How a command ends: a known error is one line and exit code 2, Ctrl-C is one line and exit code 130."""

import atexit
import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

# Exit code of a known error, that of typer for wrong usage.
KNOWN_ERROR_CODE = 2
# Added to the number of a signal: the exit code that a shell expects.
_SIGNAL_CODE = 128
_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
# After this time a signal whose exception was lost is raised again.
_AGAIN_S = 0.01


@contextmanager
def one_line_endings() -> Iterator[None]:
    """End the process in one line, however the commands within end.

    A signal need not arrive as `KeyboardInterrupt`: numba and GTSAM turn it into errors of their own. That
    one has come is therefore remembered. It need not arrive at all: in a function that C calls, as where
    numba compiles, Python prints an exception and goes on. The signal is then raised again.
    """
    received: list[int] = []
    lost: list[threading.Timer] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        if received and not lost:
            # The second time at once, whatever is left behind.
            os._exit(_SIGNAL_CODE + number)
        lost.clear()
        received[:] = [number]
        raise KeyboardInterrupt

    # A command in the background of a script is to ignore Ctrl-C.
    before = {number: signal.getsignal(number) for number in _WORDS}
    report = sys.unraisablehook
    _escape_what_cannot_be_printed()
    try:
        # From here on a signal may come.
        sys.unraisablehook = _raising_again(received, lost, report)
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, stop)
        yield
        sys.stdout.flush()
    except SystemExit as end:
        if received:
            _end_by(received[0], end)
        _flush()
        raise
    except BaseException as error:
        if received or isinstance(error, KeyboardInterrupt):
            _end_by(received[0] if received else signal.SIGINT, error)
        line = _known(error)
        if line is None:
            raise
        _end(line, KNOWN_ERROR_CODE)
    finally:
        for timer in lost:
            timer.cancel()
        sys.unraisablehook = report
        for number, handler in before.items():
            signal.signal(number, handler)
        atexit.unregister(_ignore_signals)
        atexit.register(_ignore_signals)
    if received:
        _end_by(received[0], None)


def ended_by_a_signal(end: SystemExit) -> bool:
    """Tell whether a command was ended by a signal."""
    return end.code in [_SIGNAL_CODE + number for number in _WORDS]


def leave(end: SystemExit) -> NoReturn:
    """End the process after what is to be done at its end, but without taking modules down.

    What a signal interrupts in a module's C code may be without the interpreter's lock, and abort then.
    """
    atexit._run_exitfuncs()
    assert isinstance(end.code, int)
    os._exit(end.code)


def _raising_again(
    received: list[int], lost: list[threading.Timer], report: Callable[[Any], object]
) -> Callable[[Any], object]:
    """Make a hook for exceptions that Python cannot raise: that of a signal comes again, unprinted."""

    def hook(unraisable: Any) -> None:
        if not (received and issubclass(unraisable.exc_type, KeyboardInterrupt)):
            report(unraisable)
            return
        timer = threading.Timer(_AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, received[0]))
        timer.daemon = True
        lost.append(timer)
        timer.start()

    return hook


def _ignore_signals() -> None:
    """Ignore signals while Python ends: its exit code would be lost."""
    for number in _WORDS:
        signal.signal(number, signal.SIG_IGN)


def _known(error: BaseException) -> str | None:
    """Say a known error in one line; None for a defect."""
    from craternav_fg.errors import CraternavError

    if isinstance(error, CraternavError):
        return str(error)
    if isinstance(error, MemoryError):
        return "not enough memory"
    if isinstance(error, OSError) and error.errno is not None:
        what = "the output" if error.filename is None else os.fsdecode(error.filename)
        return " ".join(f"{what}: {os.strerror(error.errno)}".split())
    return None


def _end_by(number: int, error: BaseException | None) -> NoReturn:
    """End by a signal. What a command has to say is the text of the `KeyboardInterrupt` that it raises."""
    # Code that C began may have been interrupted, too: unless other code is run, Python ends by SIGINT then.
    ctypes.pythonapi.PyRun_SimpleString(b"")
    line = _WORDS[signal.Signals(number)]
    while error is not None:
        if isinstance(error, KeyboardInterrupt) and error.args:
            line += f"; {error}"
            break
        error = error.__cause__ or error.__context__
    _end(line, _SIGNAL_CODE + number)


def _end(line: str, code: int) -> NoReturn:
    # Without rich, whose import may be what was interrupted.
    red, plain = ("\x1b[31m", "\x1b[0m") if sys.stderr.isatty() and "NO_COLOR" not in os.environ else ("", "")
    with suppress(OSError):
        sys.stderr.write(f"{red}craternav: {line}{plain}\n")
        sys.stderr.flush()
    _flush()
    sys.exit(code)


def _flush() -> None:
    """Write what was printed; where that fails, Python must not try it again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _escape_what_cannot_be_printed() -> None:
    """Let a terminal without Unicode show names that it cannot print."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")
