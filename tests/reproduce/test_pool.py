"""Tasks over processes: their order, and what ends them early."""

import os
import time
from pathlib import Path

import pytest

from craternav_fg.dataset.foreign_images import read_foreign_image
from craternav_fg.errors import CraternavError, InputError
from craternav_fg.reproduce.pool import run_all

NAP_S = 8.0


@pytest.mark.parametrize("workers", [1, 3])
def test_results_are_in_the_order_of_the_tasks(workers: int) -> None:
    seen = []
    tasks = [-3, 5, -1, 2]
    assert run_all(abs, tasks, workers, "sizes", lambda *step: seen.append(step)) == [3, 5, 1, 2]
    assert seen == [("sizes", done, 4) for done in (1, 2, 3, 4)]


def test_who_interrupts_does_not_wait_for_what_is_left() -> None:
    def interrupted(what: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_all(time.sleep, [0.0, NAP_S, NAP_S, NAP_S], 2, "naps", interrupted)
    assert time.monotonic() - began < NAP_S


def test_linear_algebra_of_each_process_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert run_all(os.getenv, ["OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"], 2, "threads", None) == ["1", "1"]


def test_an_error_of_a_file_comes_back_from_a_process_as_it_was() -> None:
    with pytest.raises(InputError, match=r"no\.png: file is missing") as caught:
        run_all(read_foreign_image, [Path("no.png"), Path("no.png")], 2, "images", None)
    assert (caught.value.path, caught.value.line) == (Path("no.png"), None)


def test_a_process_that_dies_is_an_error_of_one_line() -> None:
    with pytest.raises(CraternavError, match="exits: a worker process died"):
        run_all(os._exit, [1, 1], 2, "exits", None)
