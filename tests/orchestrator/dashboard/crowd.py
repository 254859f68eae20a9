"""A dashboard in a process of its own, and twenty hostile clients that upload, compare, stall and guess its token."""

from __future__ import annotations

import http.client
import itertools
import multiprocessing
import os
import random
import secrets
import socket
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlsplit

import psutil

from robogauntlet.results.run_document import store_url
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_archive import export_run
from tests.bad_input.forged import exported_after
from tests.orchestrator.dashboard.filled import HOSTILE_POLICIES, nightly_run
from tests.processes import GAUNTLET, environment_of
from tests.results.store.test_exported_file import SCHEMAS

TOKEN = "correct-horse-battery-staple"
BEARER = {"authorization": f"Bearer {TOKEN}"}
TIMEOUT_S = 60.0
CLOSED = "closed by the server"
STALLED = "still open at the end"


class Server:
    """A served dashboard."""

    def __init__(self, root: Path, address: str, process: psutil.Process) -> None:
        self.root, self.address, self._process = root, address, process

    @property
    def memory(self) -> int:
        """Memory of the server and its child processes; pages that they share, as after a fork, count once (bytes)."""
        found = 0
        for process in (self._process, *self._process.children(recursive=True)):
            try:
                found += process.memory_full_info().pss
            except psutil.Error:  # it has ended
                continue
        return found


@contextmanager
def served_by_process(root: Path, *options: str) -> Iterator[Server]:
    """Serve a root as users do, with a token."""
    history = file_url(root / "history.sqlite")
    command = [*GAUNTLET, "serve", "--port", "0", "--history", history, *options]
    environment = environment_of(ROBOGAUNTLET_TOKEN=TOKEN)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    process = subprocess.Popen(command, env=environment, cwd=root, **pipes)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[1].rstrip("/")
        yield Server(root, address, psutil.Process(process.pid))
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


@dataclass(frozen=True)
class Crowd:
    """Hostile clients of a server."""

    address: str
    runs: tuple[str, ...]
    """Ids of recorded runs with rows, to compare; the first one is the largest."""
    run_id: str
    """The id of the exported run."""
    exported: bytes
    limit: int
    """Largest upload that the server takes (bytes)."""

    @contextmanager
    def attacking(self, seconds: float) -> Iterator[Callable[[], Counter[tuple[str, str]]]]:
        """Begin with all clients in another process; what is given waits for its end, and counts what they got.

        Keys of the counts: what a client did, and the status or what else became of it.
        """
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            yield pool.submit(self.attack, seconds).result

    def attack(self, seconds: float) -> Counter[tuple[str, str]]:
        """Attack with all clients in this process, at the priority of the server."""
        os.nice(19)
        rubbish, until = self._rubbish(), time.monotonic() + seconds
        clients = [_Client(self, rubbish, number, until) for number in range(sum(CLIENTS.values()))]
        counts: Counter[tuple[str, str]] = Counter()
        lock = threading.Lock()

        def play(client: _Client, act: Callable[[_Client], str]) -> None:
            while time.monotonic() < until:
                try:
                    got = act(client)
                except TimeoutError:
                    got = f"no answer within {TIMEOUT_S:.0f} s"
                except (OSError, http.client.HTTPException):
                    got = CLOSED
                with lock:
                    counts[act.__name__, got] += 1

        acts = [act for act, number in CLIENTS.items() for _ in range(number)]
        with ThreadPoolExecutor(len(acts)) as threads:
            list(threads.map(play, clients, acts))
        return counts

    def _rubbish(self) -> list[bytes]:
        """Bodies that are no exported run."""
        forged = [exported_after(";".join(SCHEMAS[name]), self.exported) for name in SCHEMAS]
        half = len(self.exported) // 2
        torn = [self.exported[:half], self.exported[:half] + random.Random(0).randbytes(half)]
        return [*forged, *torn, b"", b"SQLite format 3\0" + bytes(5000), random.Random(1).randbytes(1_000_000)]


class _Client:
    """A hostile client. Each method does harm once and returns what came back."""

    def __init__(self, crowd: Crowd, rubbish: list[bytes], number: int, until: float) -> None:
        self._crowd, self._rubbish, self._until = crowd, itertools.cycle(rubbish), until
        self._random, self._turn = random.Random(number), itertools.count(number)
        self._place = urlsplit(crowd.address)

    def upload_a_run(self) -> str:
        run_id = secrets.token_hex(16)
        return self._post(self._crowd.exported.replace(self._crowd.run_id.encode(), run_id.encode()))

    def upload_rubbish(self) -> str:
        match next(self._turn) % 4:
            case 0:
                return self._post(self._too_much())
            case 1:
                return self._post(b"x", {"content-length": str(self._crowd.limit + 1)})
            case 2:
                return self._post(b"x" * 5000, {"content-length": "10"})
            case _:
                return self._post(next(self._rubbish))

    def compare(self) -> str:
        largest, *others = self._crowd.runs
        margin, other = f"&margin={self._random.uniform(0.001, 0.9)}", self._random.choice(others)
        hostile = quote(HOSTILE_POLICIES[0], safe="")
        paths = (
            f"/compare?policies={largest}{margin}",
            f"/compare?run={largest}&baseline={other}{margin}",
            f"/compare?first={largest}:experts&second={other}:merged{margin}",
            f"/compare?policies={other}{margin}",
            "/compare?policies=wide",
            "/leaderboard?suite=nightly",
            "/runs/wide",
            "/runs/many",
            f"/failures?page={self._random.randint(1, 100)}",
            f"/history?policy={hostile}",
        )
        return self._request("GET", paths[next(self._turn) % len(paths)])

    def stall(self) -> str:
        head = f"Host: localhost\r\nAuthorization: Bearer {TOKEN}\r\n"
        post = f"POST /runs HTTP/1.1\r\n{head}Content-Length: 500000\r\n\r\n"
        page = f"GET /static/report.css HTTP/1.1\r\n{head}\r\n"
        with socket.create_connection((self._place.hostname, self._place.port), timeout=TIMEOUT_S) as connection:
            match next(self._turn) % 5:
                case 0:
                    return self._trickle(connection, b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Long: ")
                case 1:
                    return self._trickle(connection, post.encode() + b"SQLite format 3\0")
                case 2:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                    return self._trickle(connection, 100 * page.encode(), reads=True)
                case 3:
                    return self._trickle(connection, b"")
                case _:
                    connection.sendall(b"GET / HTTP/1.1\r\n")
                    connection.shutdown(socket.SHUT_WR)
                    return self._trickle(connection, b"")

    def guess_the_token(self) -> str:
        if next(self._turn) % 2:
            return self._request("GET", "/runs", headers={"authorization": f"Bearer {secrets.token_hex(16)}"})
        return self._request("POST", "/login", f"token={secrets.token_hex(16)}".encode())

    def _too_much(self) -> Iterator[bytes]:
        chunk = bytes(1_000_000)
        for _ in range(self._crowd.limit // len(chunk) + 2):
            if time.monotonic() > self._until:
                return
            yield chunk

    def _post(self, body: bytes | Iterator[bytes], headers: dict[str, str] | None = None) -> str:
        return self._request("POST", "/runs", body, BEARER | (headers or {}))

    def _request(self, method: str, path: str, body=None, headers: dict[str, str] = BEARER) -> str:
        with closing(http.client.HTTPConnection(self._place.netloc, timeout=TIMEOUT_S)) as connection:
            connection.request(method, path, body, headers, encode_chunked=isinstance(body, Iterator))
            answer = connection.getresponse()
            answer.read()
            return str(answer.status)

    def _trickle(self, connection: socket.socket, sent: bytes, *, reads: bool = False) -> str:
        """Send this and then a byte every half second, or read as slowly, until the server answers or closes."""
        connection.sendall(sent)
        connection.settimeout(0.5)
        got = b""
        while time.monotonic() < self._until:
            try:
                part = connection.recv(1000)
            except TimeoutError:
                if sent:
                    connection.sendall(b"x")
                continue
            if not part:
                return got[9:12].decode() or CLOSED
            got = got or part
            if reads:
                time.sleep(0.5)
        return STALLED


CLIENTS: dict[Callable[[_Client], str], int] = {
    _Client.upload_a_run: 4,
    _Client.upload_rubbish: 4,
    _Client.compare: 6,
    _Client.stall: 4,
    _Client.guess_the_token: 2,
}
"""What clients do, and how many do it."""


def exported_run(folder: Path, *, seeds: int) -> tuple[str, bytes]:
    """The id of a run that was exported, and the file. Its id occurs only as a whole."""
    where, run, _ = nightly_run(folder, 7_000, 1_790_000_000.0, seeds=seeds)
    with closing(Store.open(store_url(where, run), run.run_id)) as rows:
        export_run(run, rows, folder / "run.robogauntlet")
    return run.run_id, (folder / "run.robogauntlet").read_bytes()
