"""Servers on loopback: RoboGauntlet's own, and one that sends the answers of a test."""

import asyncio
import threading
from contextlib import contextmanager

from websockets.sync.server import serve

from robogauntlet.orchestrator.inference.websocket_server import IdentifiedPolicy, PolicyServer, ServerOptions
from robogauntlet.policies import catalog
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack


class Running:
    """RoboGauntlet's server in a thread of this process."""

    def __init__(self, served, place):
        self._server, self.policy = PolicyServer(served, place), served.policy
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()
        self.listening = self._call(self._server.start())
        self.port = self.listening.sockets[0].getsockname()[1]
        self.address = f"ws://127.0.0.1:{self.port}"

    @property
    def batches(self):
        return dict(self._server.batcher.batches)

    def stop(self):
        async def close():
            self.listening.close()
            await self.listening.wait_closed()

        self._call(close())

    def drop(self):
        """Cut every connection, as a network does."""

        async def cut():
            for connection in list(self.listening.connections):
                connection.transport.abort()
            await asyncio.sleep(0.05)

        self._call(cut())

    def end(self):
        self.stop()
        self._server.close()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(5)
        self.loop.close()

    def _call(self, what):
        return asyncio.run_coroutine_threadsafe(what, self.loop).result(10)


@contextmanager
def serving(kind, options=None, *, policy=None, task="unknown/unknown", digest=None, **place):
    options = options or {}
    policy = policy or catalog.load(kind, options)
    digest = digest or catalog.digest(kind, options)
    running = Running(IdentifiedPolicy(policy, kind, digest, task), ServerOptions(port=place.pop("port", 0), **place))
    try:
        yield running
    finally:
        running.end()


@contextmanager
def speaking(handler, **options):
    """A server whose connections are handed to `handler`; yields its address."""

    def quietly(connection):
        try:
            handler(connection)
        except Exception:
            connection.close()

    with serve(quietly, "127.0.0.1", options.pop("port", 0), compression=None, max_size=None, **options) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join(5)


def answering(*answers, metadata=None, seen=None):
    """A handler in openpi's manner: metadata, then these answers by turns; the last for ever."""

    def handle(connection):
        connection.send(pack({"model": "test"} if metadata is None else metadata))
        left = list(answers)
        for frame in connection:
            if seen is not None:
                seen.append(unpack(frame))
            answer = left.pop(0) if len(left) > 1 else left[0]
            if callable(answer):
                answer = answer(connection, frame)
            if answer is not None:
                connection.send(pack(answer) if isinstance(answer, dict) else answer)

    return handle
