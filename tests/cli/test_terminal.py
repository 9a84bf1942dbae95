"""Sentences are wrapped between words in a terminal, and stay one line in a file or a pipe."""

import io

import pytest
from rich.console import Console

from craternav_fg.cli import terminal

PATH = "/data/a-very-long/" + 90 * "x"
TEXT = f"rims: contradict what ekf predicts from the other sensors; check {PATH}"


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
    terminal.note(TEXT)
    lines = shown.getvalue().splitlines()
    whole = [f"craternav: warning: {TEXT}", TEXT, f"craternav: {TEXT}"]
    if not is_terminal:
        assert lines == whole
        return
    # A path is never broken, and nothing is lost.
    assert sorted(map(len, lines))[-4] <= 80
    assert lines.count(f"  {PATH}") == 3
    assert " ".join(line.strip() for line in lines) == " ".join(whole)
