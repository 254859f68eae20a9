"""Chromium without a screen, by the Chrome DevTools Protocol."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from studies.shared import Lacking
from tests.contrast import CHROMIUM

LIMIT_S = 60.0
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-port=0")


class Tab:
    """A tab of a window of a given size (px)."""

    def __init__(self, connection: ClientConnection, width: int, height: int, *, mobile: bool) -> None:
        self._connection, self._numbers = connection, count(1)
        self.call("Page.enable")
        self.call("Page.bringToFront")
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        number = next(self._numbers)
        self._connection.send(json.dumps({"id": number, "method": method, "params": parameters}))
        return self._receive("id", number)["result"]

    def open(self, address: str) -> None:
        """Open a page and wait for its load event."""
        self.call("Page.navigate", url=address)
        self._receive("method", "Page.loadEventFired")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression of JavaScript."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)["result"][
            "value"
        ]

    def _receive(self, key: str, value: object) -> dict[str, Any]:
        while True:
            message: dict[str, Any] = json.loads(self._connection.recv(timeout=LIMIT_S))
            if message.get(key) == value:
                return message


@contextmanager
def browser() -> Iterator[int]:
    """Start Chromium; yields the port of its protocol."""
    if CHROMIUM is None:
        raise Lacking("expected Chromium: sudo bash scripts/test_tools.sh")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            file, deadline = Path(profile) / "DevToolsActivePort", time.monotonic() + LIMIT_S
            while not (file.exists() and file.read_text().count("\n")):
                assert time.monotonic() < deadline, "Chromium does not answer"
                time.sleep(0.05)
            yield int(file.read_text().split()[0])
        finally:
            process.terminate()
            process.wait()


@contextmanager
def tab(port: int, width: int, height: int, *, mobile: bool = False) -> Iterator[Tab]:
    """Open a tab and close it afterwards."""
    request = urllib.request.Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")
    with urllib.request.urlopen(request) as answer:
        address = json.load(answer)["webSocketDebuggerUrl"]
    with connect(address, max_size=None, compression=None, proxy=None) as connection:
        opened = Tab(connection, width, height, mobile=mobile)
        yield opened
        opened.call("Page.close")
