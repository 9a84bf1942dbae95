"""Command that compiles the kernels."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from craternav_fg.cli.app import app, example
from craternav_fg.cli.options import JsonOption
from craternav_fg.cli.terminal import out, progress_bars, say
from craternav_fg.dataset import Dataset
from craternav_fg.runs.warm_up import warm_up


@app.command(epilog=example("warmup --json"))
def warmup(as_json: JsonOption = False) -> None:
    """Compile all kernels, so that the first run does not have to; compiled code stays on disk."""
    began_s = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="craternav-") as folder, progress_bars() as report:
        data = warm_up(Path(folder))
        commands = _of_single_images(data, Path(folder))
        for number, words in enumerate(commands):
            report("kernels", number + 1, len(commands) + 1)
            # What finds no answer on so small a problem is compiled all the same.
            subprocess.run([sys.executable, "-m", "craternav_fg", *words], capture_output=True, check=False)
        report("kernels", len(commands) + 1, len(commands) + 1)
    seconds = time.perf_counter() - began_s
    if as_json:
        out.print_json(json.dumps({"seconds": seconds}))
    else:
        say(f"all kernels are compiled: {seconds:.0f} s")


def _of_single_images(data: Dataset, folder: Path) -> list[list[str]]:
    """Commands for one image of a data set; they write into a folder."""
    rims, matched = str(folder / "rims.csv"), str(folder / "matched.csv")
    camera = data.path / "mav0" / "cam0" / "sensor.yaml"
    scene = ["--camera", str(camera), "--catalog", str(data.path / "craters.csv")]
    image = str(data.image_paths[len(data) // 2])
    return [
        ["detect", image, "-o", rims],
        ["identify", rims, *scene, "--index", str(folder / "index.npz"), "-o", matched],
        ["pose", matched, *scene],
        ["pose", matched, *scene, "--robust"],
    ]
