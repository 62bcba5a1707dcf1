"""Log of docs/guide/many_machines.md: a local Ray cluster of two nodes; one is killed, some collisions are poisoned.

    python benchmarks/cluster.py --out runs/cluster

The nodes are processes of this machine with a Raylet each; they share nothing but the folder, so they stand in for two
machines. The log is runs/cluster/cluster.md. The collisions of the log are those of the rigid-body world and the
fracture simulator; `--cheap` puts arithmetic in their place, which keeps one processor as busy.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from cluster_work import POISONED, Busy, Poisoned
from harness import ROOT, start, table, write_text

from deepfracture.dataset import (
    Dataset,
    DatasetSettings,
    Local,
    RayCluster,
    SimulateOptions,
    Simulator,
    open_dataset,
    recorded,
    simulate_collisions,
)
from deepfracture.dataset.generate import physical_simulator
from deepfracture.fracture import material
from deepfracture.geometry import builtin

HOST = "127.0.0.1"
RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
"""A cluster on the loopback tells nobody and asks for no token."""
SEED = 7
BUCKET = "data"
Digests = dict[str, str]
"""Of files or objects, by their keys."""
LIMIT, MEMORY = 60.0, 3.0
"""Seconds and gigabytes that a collision may take in the run with poison."""


@dataclass
class Log:
    """What happened, and when."""

    lines: list[str]
    begun: float

    def __call__(self, words: str) -> None:
        self.lines.append(f"{time.monotonic() - self.begun:7.1f} s  {words}")
        sys.stderr.write(self.lines[-1] + "\n")


def cluster(
    collisions: int = 60, resolution: int = 64, shape: str = "pot", cheap: float | None = None, wait: bool = False,
    port: int = 6399, bucket: bool = False, out: Path = ROOT / "runs" / "cluster",
) -> None:  # fmt: skip
    """Fill the same data set in five ways, or six, and compare their bytes.

    Args:
        collisions: of each data set.
        resolution: voxels along each axis.
        shape: a built-in shape.
        cheap: seconds of arithmetic that stand in for a collision; by default it is simulated.
        wait: spend these seconds waiting, as the two nodes would if each had a processor to itself.
        port: of the cluster's head on the loopback.
        bucket: also into a bucket of an S3 server on the loopback.
        out: folder for the data sets, which are made anew, and cluster.md.
    """
    os.environ |= RAY
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    log = Log([], time.monotonic())
    healthy = physical_simulator if cheap is None else Busy(cheap, wait)
    what = f"{shape} at r = {resolution}" if cheap is None else f"{cheap:g} s of {'waiting' if wait else 'arithmetic'}"
    log(f"{collisions} collisions, {what}; {os.cpu_count()} processors; ray {_version()}")
    log("local, 2 processes")
    run = _Runs(shape, collisions, resolution, healthy, out, log, f"{HOST}:{port}")
    rates = {"local, 2 processes": run("local", Local(2))}
    wanted = digests(out / "local")
    stored = []
    with bucket_server() if bucket else nullcontext(), head(port, log):
        with node(port, "A", 1, log):
            rates["ray, 1 worker"] = run("one", RayCluster(run.address, None))
            with node(port, "B", 1, log) as second:
                rates["ray, 2 workers"] = run("two", RayCluster(run.address, None))
                log("again, and node B is killed when a third is done")
                killer = threading.Thread(target=kill, args=(second, out / "killed", collisions // 3, log))
                killer.start()
                rates["ray, node B killed"] = run("killed", RayCluster(run.address, None))
                killer.join()
        with node(port, "C", 2, log):
            log(f"poisoned: {POISONED}, limit {LIMIT:g} s, memory {MEMORY:g} GB")
            run("poisoned", RayCluster(run.address, None), make_simulator=Poisoned(healthy), limit=LIMIT, memory=MEMORY)
            if bucket:
                stored.append(run.into_bucket(wanted))
            for record in open_dataset(out / "poisoned").records:
                if record.kind == "failed":
                    log(f"entry {record.name} failed: {record.reason}")
    report(out, log, [*compared(out, wanted), *stored], rates)


def compared(out: Path, wanted: Digests) -> list[tuple]:
    """A row for each data set on disk: are its bytes those that are wanted?"""
    rows = []
    for name in ("local", "one", "two", "killed"):
        data, found = open_dataset(out / name), digests(out / name)
        same = "equal" if found == wanted else "DIFFERENT"
        rows.append((name, data.tried, len({r.number for r in data.records}), data.failed, len(found), same))
    found = digests(out / "poisoned")
    agree = {key for key in found if _entry(key) not in POISONED}
    same = all(found[key] == wanted[key] for key in agree) and agree == {k for k in wanted if _entry(k) not in POISONED}
    data = open_dataset(out / "poisoned")
    rows.append(("poisoned", data.tried, len({r.number for r in data.records}), data.failed, len(found),
                 "equal but for the poisoned" if same else "DIFFERENT"))  # fmt: skip
    return rows


@dataclass(frozen=True)
class _Runs:
    """The same data set, by whoever does it."""

    shape: str
    collisions: int
    resolution: int
    healthy: Callable[[DatasetSettings], Simulator]
    out: Path
    log: Log
    address: str

    def __call__(
        self, name: str, executor: Local | RayCluster, *,
        make_simulator: Callable[[DatasetSettings], Simulator] | None = None, limit: float = 600.0,
        memory: float | None = None,
    ) -> float:  # fmt: skip
        """Entries a second, once a quarter is stored: starting the workers is paid once and not counted."""
        begun = time.monotonic()
        data: Dataset = simulate_collisions(
            builtin(self.shape), material("plaster"), self.out / name,
            SimulateOptions(self.collisions, self.resolution, limit=limit, memory=memory, seed=SEED),
            executor=executor, make_simulator=make_simulator or self.healthy,
        )  # fmt: skip
        seconds = time.monotonic() - begun
        times = sorted(path.stat().st_mtime for path in (self.out / name / "entries").iterdir())
        times = times[len(times) // 4 :]
        rate = (len(times) - 1) / (times[-1] - times[0])
        self.log(
            f"{name}: {data.tried} entries, {len(data)} broken, {data.failed} failed, in {seconds:.1f} s; "
            f"{rate:.2f} a second after the first quarter"
        )
        return rate

    def into_bucket(self, wanted: Digests) -> tuple:
        """By Ray into a bucket; its row of the table."""
        import obstore
        from obstore.store import S3Store

        begun = time.monotonic()
        data = simulate_collisions(
            builtin(self.shape), material("plaster"), f"s3://{BUCKET}/set",
            SimulateOptions(self.collisions, self.resolution, seed=SEED), executor=RayCluster(self.address, None),
            make_simulator=self.healthy,
        )  # fmt: skip
        self.log(f"bucket: {data.tried} entries, {data.failed} failed, in {time.monotonic() - begun:.1f} s")
        there = S3Store(BUCKET, prefix="set", client_options={"allow_http": True})
        keys = [found["path"] for page in obstore.list(there) for found in page]
        found = {key: hashlib.sha256(obstore.get(there, key).bytes()).hexdigest() for key in keys}
        same = "equal" if found == wanted else "DIFFERENT"
        return ("bucket", data.tried, len({r.number for r in data.records}), data.failed, len(found), same)


@contextmanager
def bucket_server() -> Iterator[None]:
    """A server on the loopback that speaks S3, with an empty bucket, where the environment says."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(HOST, 0, verbose=False)
    server.start()
    logging.getLogger("werkzeug").setLevel(logging.WARNING)  # it tells of every request
    endpoint = "http://{}:{}".format(*server.get_host_and_port())
    os.environ |= {"AWS_ENDPOINT_URL": endpoint, "AWS_REGION": "us-east-1",
                   "AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing"}  # fmt: skip
    urllib.request.urlopen(urllib.request.Request(f"{endpoint}/{BUCKET}", method="PUT"))
    try:
        yield
    finally:
        server.stop()


def report(out: Path, log: Log, rows: list[tuple], rates: dict[str, float]) -> None:
    """The log, the table and the ratio as cluster.md."""
    log(f"one worker to two: {rates['ray, 2 workers'] / rates['ray, 1 worker']:.2f} times the throughput")
    times = [(name, f"{rate:.2f}") for name, rate in rates.items()]
    head_ = ("data set", "entries", "different numbers", "failed", "objects", "bytes, against local")
    text = [
        table(head_, rows), table(("run", "collisions a second"), times),
        "```text\n" + "\n".join(log.lines) + "\n```\n",
    ]  # fmt: skip
    write_text(out / "cluster.md", "\n".join(text))


@contextmanager
def head(port: int, log: Log) -> Iterator[None]:
    """The head of a cluster, on which nothing is simulated, and a connection to it."""
    import ray

    # In a folder of its own: else Ray remembers the address of this cluster when it is no more.
    with tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True) as folder:
        options = ["--head", f"--port={port}", "--include-dashboard=false", "--num-cpus=0", f"--temp-dir={folder}"]
        with _raylet(options) as process:
            _wait(lambda: _listens(port), process)
            ray.init(f"{HOST}:{port}", logging_level=logging.WARNING, log_to_driver=False)
            log(f"head started (process {process.pid})")
            yield
            ray.shutdown()


@contextmanager
def node(port: int, name: str, processors: int, log: Log) -> Iterator[subprocess.Popen]:
    """A node that joins the cluster."""
    import ray

    def there() -> set[str]:
        return {found["NodeID"] for found in ray.nodes() if found["Alive"]}

    before = there()
    with _raylet([f"--address={HOST}:{port}", f"--num-cpus={processors}"]) as process:
        _wait(lambda: bool(there() - before), process)
        log(f"node {name} joined with {processors} processors (process {process.pid})")
        yield process
    _wait(lambda: there() <= before, None)


@contextmanager
def _raylet(options: list[str]) -> Iterator[subprocess.Popen]:
    ray = Path(sys.executable).with_name("ray")
    told = [f"--node-ip-address={HOST}", "--object-store-memory=200000000"]
    paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths}
    process = subprocess.Popen(
        [str(ray), "start", "--block", *told, *options], env=environment, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield process
    finally:
        kill_family(process)


def _wait(until: Callable[[], bool], process: subprocess.Popen | None) -> None:
    for _ in range(1200):
        if until():
            return
        if process is not None and process.poll() is not None:
            raise RuntimeError(f"ray start ended with status {process.returncode}")
        time.sleep(0.1)
    raise RuntimeError("the cluster does not come up")


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0


def kill(process: subprocess.Popen, folder: Path, when: int, log: Log) -> None:
    """kill -9 to a node and all that runs on it, as soon as the data set in `folder` has `when` entries."""
    while not folder.exists() or len(recorded(folder)) < when:
        time.sleep(0.1)
    many = kill_family(process)
    log(f"node B killed with kill -9, {many} processes, after {len(recorded(folder))} entries")


def kill_family(process: subprocess.Popen) -> int:
    """kill -9 to a process and all its descendants; how many they were."""
    family = [process.pid]
    for pid in family:  # grows while it is walked through
        for task in Path(f"/proc/{pid}/task").glob("*/children"):
            family += [int(child) for child in task.read_text().split()]
    for pid in family:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()
    return len(family)


def digests(folder: Path) -> Digests:
    """Hash of every file of a data set."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _entry(key: str) -> int | None:
    """The entry that a file belongs to."""
    parts = key.split("/")
    if parts[0] == "entries":
        return int(parts[1].removesuffix(".json"))
    return int(parts[2]) if parts[0] in ("labels", "distance") and len(parts) > 2 else None


def _version() -> str:
    import ray

    return ray.__version__


if __name__ == "__main__":
    start(cluster)
