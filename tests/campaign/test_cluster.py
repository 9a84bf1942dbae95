"""Campaigns on a Dask cluster: a real scheduler, two worker processes."""

import socketserver
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from distributed import Client

from craternav_fg import workers
from craternav_fg.campaign import run
from craternav_fg.campaign.read import read_campaign
from craternav_fg.campaign.run import montecarlo
from craternav_fg.errors import CraternavError
from tests.campaign import inline
from tests.campaign.scene import contents, options, small_scenario, until_trials

TRIALS = 20


@dataclass
class Cluster:
    """A scheduler, its workers, and where they write."""

    address: str
    scheduler: subprocess.Popen[str]
    folder: Path

    def worker(self, name: str) -> subprocess.Popen[str]:
        """Start a worker."""
        return _start(self.folder / name, "worker", self.address, "--nthreads", 1, "--no-nanny")


def _start(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    folder.mkdir()
    command = [sys.executable, "-m", "dask", *map(str, arguments), "--no-dashboard", "--host", "127.0.0.1"]
    with (folder / "log").open("w") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, text=True, cwd=folder)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Return a scheduler without workers."""
    found = tmp_path / "scheduler.json"
    process = _start(tmp_path / "scheduler", "scheduler", "--port", 0, "--scheduler-file", found)
    try:
        until = time.monotonic() + 60.0
        while not found.exists():
            assert time.monotonic() < until
            time.sleep(0.05)
        with Client(scheduler_file=str(found), set_as_default=False) as client:
            address = client.scheduler.address
        yield Cluster(address, process, tmp_path)
    finally:
        process.kill()
        process.wait()


def after_trials(folder: Path, count: int, process: subprocess.Popen[str]) -> threading.Thread:
    """Kill -9 a process as soon as so many trials are there."""

    def watch() -> None:
        until_trials(folder, count)
        process.kill()

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_worker_killed_half_way_costs_nothing(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = (cluster.worker(name) for name in ("first", "second"))
    try:
        with Client(cluster.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60.0)
        thread = after_trials(tmp_path / "c", TRIALS // 2, first)
        summary = montecarlo(small_scenario(), tmp_path / "c", options(TRIALS, scheduler=cluster.address))
        thread.join()
        first.wait()
        assert second.poll() is None
    finally:
        for worker in (first, second):
            worker.kill()
            worker.wait()
    assert (summary["trials"], summary["failed"]) == (TRIALS, 0)
    monkeypatch.setattr(run, "processes", inline.processes)
    montecarlo(small_scenario(), tmp_path / "here", options(TRIALS))
    assert contents(tmp_path / "c") == contents(tmp_path / "here")


def test_a_lost_scheduler_ends_the_run_and_finished_trials_stay(cluster: Cluster, tmp_path: Path) -> None:
    worker = cluster.worker("only")
    try:
        with Client(cluster.address, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60.0)
        thread = after_trials(tmp_path / "c", 2, cluster.scheduler)
        with pytest.raises(CraternavError, match="the scheduler is lost; finished trials are kept"):
            montecarlo(small_scenario(), tmp_path / "c", options(1000, scheduler=cluster.address))
        thread.join()
    finally:
        worker.kill()
        worker.wait()
    assert len(read_campaign(tmp_path / "c").failures) >= 2


def test_a_scheduler_without_workers(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "CONNECT_TIMEOUT_S", 2.0)
    with pytest.raises(CraternavError, match=f"scheduler {cluster.address}: no worker within 2 s"):
        montecarlo(small_scenario(), tmp_path / "c", options(1, scheduler=cluster.address))
    assert not (tmp_path / "c").exists()


class _WebServer(socketserver.BaseRequestHandler):
    """Says what a web server says to what it does not understand."""

    def handle(self) -> None:
        self.request.recv(8)
        self.request.sendall(b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n")


def test_another_server_at_the_address(tmp_path: Path) -> None:
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), _WebServer) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        address = f"tcp://127.0.0.1:{server.server_address[1]}"
        try:
            with pytest.raises(CraternavError, match=f"scheduler {address}: what answers there is no Dask"):
                montecarlo(small_scenario(), tmp_path / "c", options(1, scheduler=address))
        finally:
            server.shutdown()
            thread.join()
    assert not (tmp_path / "c").exists()
