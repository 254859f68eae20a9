"""Servers on loopback: RoboGauntlet's own, and one that sends the answers of a test."""

import asyncio
import threading
from contextlib import contextmanager

from websockets.sync.server import serve

from robogauntlet.orchestrator.inference.server_thread import ServerThread
from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy
from robogauntlet.orchestrator.inference.websocket_server import ServerOptions
from robogauntlet.policies import catalog
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack


class Running(ServerThread):
    """RoboGauntlet's server in a thread of this process."""

    @property
    def policy(self):
        return self.server.served.policy

    @property
    def batches(self):
        return dict(self.server.policy.batcher.batches)

    def drop(self):
        """Cut every connection, as a network does."""

        async def cut():
            for connection in list(self.listening.connections):
                connection.transport.abort()
            await asyncio.sleep(0.05)

        self.call(cut())


@contextmanager
def serving(kind, options=None, *, policy=None, task="unknown/unknown", digest=None, execute=None, **place):
    options = options or {}
    policy = policy or catalog.load(kind, options)
    digest = digest or catalog.digest(kind, options)
    served = IdentifiedPolicy(policy, kind, digest, task, execute)
    with Running(served, ServerOptions(port=place.pop("port", 0), **place)) as running:
        yield running


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
