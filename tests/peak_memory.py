"""The most memory that a command needs."""

import subprocess
import sys

# A process of its own starts the command: a child begins with the memory of its parent, here that
# of all tests, and what a parent is told is the largest of all its children.
_PARENT = """
import resource, subprocess, sys
code = subprocess.call([sys.executable, *sys.argv[1:]], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""


def run_measured(*arguments: object) -> tuple[subprocess.CompletedProcess[str], float]:
    """Run Python with some arguments; return the process and the most memory that it needed, MB."""
    done = subprocess.run(
        [sys.executable, "-c", _PARENT, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    return done, int(done.stdout.splitlines()[-1]) / 1024.0
