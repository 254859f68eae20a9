"""One thread that computes for an event loop, and that the end of the process does not wait for."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any


class DaemonThread(Executor):
    """Calls functions one after the other.

    The standard library's executors keep a process from ending while a function hangs; this one does not.
    """

    def __init__(self) -> None:
        """Start nothing; the first call starts the thread."""
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="policy", daemon=True)
        self._is_closed = False

    def submit(self, function: Callable[..., Any], /, *positional: Any, **named: Any) -> Future[Any]:
        """Call a function when those before it have returned. Raises RuntimeError after `shutdown`."""
        if self._is_closed:
            raise RuntimeError("expected no call after shutdown")
        if not self._thread.is_alive():
            self._thread.start()
        future: Future[Any] = Future()
        self._calls.put((future, lambda: function(*positional, **named)))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no further calls and end the thread after those that it has, without those that it has not begun."""
        self._is_closed = True
        while cancel_futures and not self._calls.empty():
            if (call := self._calls.get()) is not None:
                call[0].cancel()
        self._calls.put(None)
        if wait and self._thread.is_alive():
            self._thread.join()

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            future, compute = call
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = compute()
            except BaseException as error:  # given to the caller, as the standard library's executors do
                future.set_exception(error)
            else:
                future.set_result(result)
            del future, compute, call
