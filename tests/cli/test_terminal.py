"""Sentences are wrapped between words in a terminal, and stay one line in a file or a pipe."""

import io

import pytest
from rich.console import Console

from craternav_fg.cli import terminal

TEXT = "rims: contradict what ekf predicts from the other sensors; check /data/a-very-long/" + 60 * "x"


@pytest.mark.parametrize("is_terminal", [True, False])
def test_sentences_are_wrapped_in_a_terminal_alone(
    is_terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = io.StringIO()
    console = Console(file=shown, width=80, force_terminal=is_terminal, no_color=True, markup=False)
    monkeypatch.setattr(terminal, "err", console)
    monkeypatch.setattr(terminal, "out", console)
    terminal.warn(TEXT)
    terminal.tell(TEXT)
    lines = shown.getvalue().splitlines()
    whole = [f"craternav: warning: {TEXT}", TEXT]
    if not is_terminal:
        assert lines == whole
        return
    assert max(map(len, lines)) <= 87
    # A path is never broken, and nothing is lost.
    assert sum(line.endswith("/data/a-very-long/" + 60 * "x") for line in lines) == 2
    assert [line[0] == " " for line in lines] == [False, True, True, False, True]
    assert " ".join(line.strip() for line in lines) == " ".join(whole)
