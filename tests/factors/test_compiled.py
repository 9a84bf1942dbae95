"""Compiled code on disk follows the sources of all that a kernel calls."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from factors.arrays import FloatArray
from factors.kernels import compiled
from factors.kernels.compiled import sources_digest

ROOT = Path(__file__).resolve().parents[2]
KERNELS = ROOT / "factors/kernels"

CALLED = """
from factors.kernels.compiled import njit

FACTOR = 2.0

@njit(cache=True)
def scaled(x):
    return FACTOR * x
"""
BETWEEN = """
from factors.kernels.called import scaled
from factors.kernels.compiled import njit

@njit(cache=True)
def both(x, y):
    return scaled(x) + scaled(y)
"""
CALLING = """
from factors.kernels.between import both
from factors.kernels.compiled import is_cached, njit

@njit(cache=True)
def added(x):
    return both(x, 1.0)

if __name__ == "__main__":
    import factors.kernels.calling as here
    kept = is_cached(here.added)
    print(kept, here.added(3.0))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with three kernels, each of which calls the next."""
    kernels = tmp_path / "factors/kernels"
    kernels.mkdir(parents=True)
    for name in ("__init__.py", "lazy.py", "numba_cache.py", "kernels/__init__.py", "kernels/compiled.py"):
        shutil.copy(ROOT / "factors" / name, tmp_path / "factors" / name)
    (kernels / "called.py").write_text(CALLED)
    (kernels / "between.py").write_text(BETWEEN)
    (kernels / "calling.py").write_text(CALLING)
    return tmp_path


def printed(package: Path) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-m", "factors.kernels.calling"],
        cwd=package, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_a_change_in_a_called_file_is_noticed(package: Path) -> None:
    assert printed(package) == ["False", "8.0"]
    assert printed(package) == ["True", "8.0"]
    called = package / "factors/kernels/called.py"
    called.write_text(CALLED.replace("FACTOR = 2.0", "FACTOR = 10.0"))
    assert printed(package) == ["False", "40.0"]


def test_a_module_that_moved_is_compiled_anew(package: Path) -> None:
    printed(package)
    kernels = package / "factors/kernels"
    (kernels / "called.py").rename(kernels / "moved.py")
    (kernels / "between.py").write_text(BETWEEN.replace("kernels.called", "kernels.moved"))
    assert printed(package) == ["False", "8.0"]


def test_the_digest_covers_called_files_and_no_others() -> None:
    """The kernel of a frame's rims calls those of the chart; nothing of it calls that of the sun's tilt."""
    files = {path.name for path in compiled._closure(KERNELS / "packed.py")}
    assert {"packed.py", "conic.py", "compiled.py"} <= files
    assert "sun.py" not in files
    assert sources_digest(KERNELS / "packed.py") != sources_digest(KERNELS / "sun.py")


def test_of_two_processes_one_compiles(package: Path) -> None:
    # Both begin at once, and compilation takes long: the other one waits for the kernel and reads it.
    code = """
import sys
from factors.kernels.compiled import njit
from factors.kernels.called import scaled
import factors.kernels.calling as here
kernels = here.added, here.both, scaled
print("ready", flush=True)
sys.stdin.readline()
here.added(3.0)
print(sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels))
"""
    command = [sys.executable, "-c", code]
    pair = [
        subprocess.Popen(command, cwd=package, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in pair:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in pair:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    misses = [int(process.communicate()[0]) for process in pair]
    assert sorted(misses) == [0, 3]


def test_a_slice_of_another_size_is_refused() -> None:
    @compiled.njit()
    def assign(source: FloatArray, target: FloatArray) -> None:
        target[:2] = source

    target = np.zeros(4)
    assign(np.array([1.0, 2.0]), target)
    assert target.tolist() == [1.0, 2.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="cannot assign slice from input of different size"):
        assign(np.zeros(3), target)


def test_kernels_stay_python_where_numba_is_switched_off() -> None:
    """So that a debugger steps through them: imports used to end in an AttributeError."""
    program = (
        "import numpy as np; import craternav_fg.pipeline.reconstruct\n"
        "from factors.kernels.conic import project_rims\n"
        "axes = np.array([[[900.0, 0.0, 0.0], [0.0, 700.0, 0.0]]])\n"
        "gTb = np.diag([1.0, -1.0, -1.0, 1.0]); gTb[2, 3] = 1e4\n"
        "charts, seen = project_rims(gTb, np.eye(4), np.zeros((1, 3)), axes)\n"
        "print(type(project_rims).__name__, *charts[0], seen[0])"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    kind, *chart, seen = done.stdout.split()
    assert (kind, seen) == ("function", "True")
    # The crater straight below, 0.09 by 0.07 of the distance.
    np.testing.assert_allclose(
        np.array(chart, dtype=float), [0.0, 0.0, np.log(0.09), 0.0, np.log(0.07)], atol=1e-12
    )


def test_sums_of_a_called_kernel_are_reordered_only_where_it_says_so() -> None:
    """Whoever calls it first; and in its callers it is inlined, so that no copy is another version."""

    @compiled.njit(cache=False)
    def in_order(x: FloatArray) -> float:
        total = 0.0
        for i in range(len(x)):
            total += x[i]
        return total

    @compiled.njit(cache=False, fastmath={"reassoc"})
    def reordered(x: FloatArray) -> float:
        total = in_order(x)
        for i in range(len(x)):
            total += x[i] * x[i]
        return total

    reordered(np.ones(3))
    (code,) = in_order.inspect_llvm().values()
    assert "fadd double" in code
    assert "reassoc" not in code
    (code,) = reordered.inspect_llvm().values()
    assert "fadd reassoc" in code
    assert "alwaysinline" in code
