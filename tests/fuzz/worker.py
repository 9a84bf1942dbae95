"""Runs cases in one process, with bounded memory: `python -m tests.fuzz.worker FOLDER FIRST LAST`.

Of each case it prints a line of JSON when it begins and one when it has ended: a parent process sees which
case has crashed or hung.
"""

import contextlib
import json
import random
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any
from unittest import mock

from markupsafe import Markup

from craternav_fg.reports import campaign_page
from tests.cli.calls import call
from tests.fuzz.mutate import spoil
from tests.fuzz.target import Target
from tests.fuzz.targets import make_targets

MEMORY = 2 << 30
SECONDS = 20.0
# Figures take most of the time of a reconstruction or a campaign's report that succeeds: they are drawn in
# one case of so many.
DRAWN_EVERY = 8


def say(what: dict[str, Any]) -> None:
    """Write a line for the parent process."""
    sys.__stdout__.write(f"{json.dumps(what)}\n")  # type: ignore[union-attr]
    sys.__stdout__.flush()  # type: ignore[union-attr]


def figures(*, drawn: bool) -> contextlib.AbstractContextManager[object]:
    """Draw the figures of a run, or not."""
    stack = contextlib.ExitStack()
    if not drawn:
        stack.enter_context(mock.patch("craternav_fg.runs.execute._figures", return_value={}))
        stack.enter_context(mock.patch.object(campaign_page, "inline_svg", return_value=Markup()))
    return stack


def reading(commands: list[list[str]], path: Path) -> list[list[str]]:
    """Commands that name a file or a folder above it; all of them where none does."""
    return [c for c in commands if any(Path(part) in (path, *path.parents) for part in c)] or commands


def run_case(targets: dict[str, Target], seed: int, place: Path) -> dict[str, Any]:
    """Spoil a file of a target, run one of its commands, and judge how it ended."""
    rng = random.Random(seed)
    name = rng.choice(sorted(targets))
    target = targets[name]
    here = target.copy(place / "case")
    path = rng.choice(target.files(here))
    how = spoil(path, rng)
    command = rng.choice(reading(target.commands(here), path))
    case = {"seed": seed, "command": command[:2], "file": path.name, "how": how, "fault": ""}
    say({"begins": case})
    began = time.process_time()
    try:
        with warnings.catch_warnings(), figures(drawn=seed % DRAWN_EVERY == 0):
            warnings.simplefilter("ignore")
            done = call(*command)
    except BaseException:
        case["fault"] = traceback.format_exc()[-1500:]
        return case
    case["cpu_s"] = round(time.process_time() - began, 2)
    lines = [line for line in done.err.splitlines() if "warning:" not in line and " is used" not in line]
    if done.code not in (0, 2):
        case["fault"] = f"exit code {done.code}: {done.err[-500:]}"
    elif done.code == 2 and (not lines or not lines[-1].startswith("craternav: ")):
        case["fault"] = f"no line: {done.err[-500:]!r}"
    elif case["cpu_s"] > SECONDS:
        case["fault"] = "takes too long"
    return case


def main(folder: Path, first: int, last: int) -> None:
    """Run cases first to last - 1."""
    with figures(drawn=False):
        targets = make_targets(folder / "sound")
        for target in targets.values():
            # What is compiled at its first call takes no time of a case.
            here = target.copy(folder / "warm")
            for command in target.commands(here):
                call(*command)
            shutil.rmtree(folder / "warm")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    say({"ready": True})
    for seed in range(first, last):
        with tempfile.TemporaryDirectory(dir=folder) as place:
            say(run_case(targets, seed, Path(place)))


if __name__ == "__main__":
    Path(sys.argv[1], "sound").mkdir(exist_ok=True)
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
