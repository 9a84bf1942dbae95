"""The wheel works on its own: installed in an empty environment and called from another folder."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT]
    subprocess.run(command, check=True, timeout=300)
    return next(folder.glob("*.whl"))


@pytest.mark.slow
def test_contents(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    # All but compiled caches: a pattern of .gitignore once left out a package of the same name.
    folders = ("craternav_fg", "factors", "scenarios")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    wanted = [path.relative_to(ROOT).as_posix() for path in files if "__pycache__" not in path.parts]
    assert {"craternav_fg/py.typed", "factors/py.typed"} <= set(wanted)
    assert not [name for name in wanted if name not in names]
    assert not [name for name in names if name.startswith(("tests/", "docs/", "notebooks/"))]


@pytest.mark.slow
def test_it_runs_from_another_folder(wheel: Path, tmp_path: Path) -> None:
    """Its dependencies are those of this environment: what is tried is the wheel, not the network."""
    home = tmp_path / "environment"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    target = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True, text=True, check=True,
    ).stdout.strip()  # fmt: skip
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", wheel]
    subprocess.run(install, check=True, timeout=300)
    here = Path(sysconfig.get_path("purelib"))
    dependencies = tmp_path / "dependencies"
    dependencies.mkdir()
    for entry in here.iterdir():
        # Not this checkout, which an editable installation would put first.
        if "craternav" not in entry.name and entry.suffix != ".pth":
            (dependencies / entry.name).symlink_to(entry)
    (Path(target) / "dependencies.pth").write_text(str(dependencies))
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def craternav(*arguments: str) -> str:
        command = [home / "bin" / "craternav", *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    where = "import craternav_fg, sys; print(craternav_fg.__file__)"
    found = subprocess.run(
        [python, "-c", where], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert found.stdout.startswith(str(home))
    assert craternav("--version").strip()
    craternav("simulate", "measured_descent", "-o", "data")
    craternav("reconstruct", "data", "-o", "run", "-e", "smoother")
    craternav("report", "run")
    assert (tmp_path / "run/report.html").stat().st_size > 10_000
