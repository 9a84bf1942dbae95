"""Command line of the training."""

from importlib.util import find_spec

import pytest

from craternav_fg.training import __main__ as command


def test_without_pytorch_the_crater_network_is_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    assert command.main(["craters", str(tmp_path / "new")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "craternav_fg[train]" in error
    assert not (tmp_path / "new").exists()


@pytest.mark.skipif(find_spec("torch") is None, reason="needs the extra train")
def test_a_checkpoint_that_is_none_is_one_line(tmp_path, capsys):
    (tmp_path / "checkpoint.pt").write_bytes(b"no checkpoint")
    assert command.main(["craters", str(tmp_path), "--steps", "1"]) == 2
    assert "checkpoint.pt: cannot be read as a checkpoint" in capsys.readouterr().err
