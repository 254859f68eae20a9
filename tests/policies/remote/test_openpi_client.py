"""Compatibility with openpi's own client and server (`openpi-client`, `openpi-server`, Apache 2.0)."""

import asyncio
import contextlib
import queue
import threading

import numpy as np
import pytest
import websockets.asyncio.server

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, Query
from robogauntlet.policies.remote.conversion import resize_image
from robogauntlet.policies.remote.msgpack_numpy import pack
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.remote_servers import serving, speaking

client = pytest.importorskip("openpi_client.websocket_client_policy")
packing = pytest.importorskip("openpi_client.msgpack_numpy")
images = pytest.importorskip("openpi_client.image_tools")
servers = pytest.importorskip("openpi_server.websocket_policy_server")

EPISODE = Episode("p", "d", "null/Reach", 0, Protocol(60, 8, View()))


@pytest.fixture
def query():
    generator = np.random.default_rng(0)
    seen = {name: generator.integers(0, 256, (96, 96, 3), dtype=np.uint8) for name in ("third_person", "wrist")}
    return Query(EPISODE, 0, Observation(seen, generator.normal(size=8), "reach the goal"))


def shown(seen):
    return {
        "observation/image": seen.images["third_person"],
        "observation/wrist_image": seen.images["wrist"],
        "observation/state": seen.proprioception,
        "prompt": seen.instruction,
    }


def test_openpis_client_gets_the_policys_actions_from_our_server(query):
    (decision,) = catalog.load("untrained", {}).act([query])
    with serving("untrained", token="sesame") as server:
        theirs = client.WebsocketClientPolicy("127.0.0.1", server.port, api_key="sesame")
        assert theirs.get_server_metadata()["policy"] == "untrained"
        for _ in range(2):
            np.testing.assert_array_equal(theirs.infer(shown(query.observation))["actions"], decision.actions)
            with pytest.raises(RuntimeError, match="expected an image as observation/image"):
                theirs.infer({"prompt": "reach the goal"})


@contextlib.contextmanager
def their_server(policy, monkeypatch):
    """openpi's server of a policy, as its `serve_policy.py` starts it, on a free port; yields the address."""
    ports, serve_really = queue.Queue(), websockets.asyncio.server.serve

    @contextlib.asynccontextmanager
    async def serve_and_tell(*arguments, **options):
        async with serve_really(*arguments, **options) as server:
            ports.put(server.sockets[0].getsockname()[1])
            yield server

    monkeypatch.setattr(websockets.asyncio.server, "serve", serve_and_tell)
    loop = asyncio.new_event_loop()
    serving = loop.create_task(servers.WebsocketPolicyServer(policy, "127.0.0.1", 0).run())

    def serve():
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(serving)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{ports.get(timeout=60)}"
    finally:
        loop.call_soon_threadsafe(serving.cancel)
        thread.join(60)
    loop.close()


def test_our_client_is_answered_by_openpis_server_and_its_errors_are_one_line(query, monkeypatch):
    class Policy:
        def infer(self, observation):
            seen.append(observation)
            if len(seen) == 2:
                raise KeyError("joints")
            return {"actions": np.arange(70, dtype=np.float32).reshape(10, 7)}

    seen = []
    with their_server(Policy(), monkeypatch) as address:
        ours = catalog.load("openpi", {"address": address, "image_size": 224, "execute": 5, "identity": "theirs"})
        (decision,) = ours.act([query])
        np.testing.assert_array_equal(decision.actions, np.arange(35.0).reshape(5, 7))
        with pytest.raises(PolicyError, match=r"got an error: KeyError: 'joints'$"):
            ours.act([query])
    assert seen[0]["prompt"] == query.observation.instruction
    picture = images.resize_with_pad(query.observation.images["third_person"], 224, 224)
    np.testing.assert_array_equal(seen[0]["observation/image"], picture)


def test_our_client_reads_messages_of_openpis_packer(query):
    seen = []

    def handle(connection):
        connection.send(packing.packb({"name": "theirs", "rate": np.float32(20.0), "reset_pose": np.zeros(3)}))
        for frame in connection:
            seen.append(packing.unpackb(frame))
            if len(seen) == 2:
                connection.send("Traceback (most recent call last):\n  File serve.py\nKeyError: 'joints'\n")
                connection.close(1011)
                return
            connection.send(packing.packb({"actions": np.arange(70, dtype=np.float32).reshape(10, 7)}))

    with speaking(handle) as address:
        ours = catalog.load("openpi", {"address": address, "image_size": 224, "execute": 5})
        (decision,) = ours.act([query])
        np.testing.assert_array_equal(decision.actions, np.arange(35.0).reshape(5, 7))
        with pytest.raises(PolicyError, match=r"got an error: KeyError: 'joints'$"):
            ours.act([query])
        assert len(ours.act([query])) == 1
    picture = images.resize_with_pad(query.observation.images["wrist"], 224, 224)
    np.testing.assert_array_equal(seen[0]["observation/wrist_image"], picture)


def test_frames_and_images_are_byte_identical_to_openpis(query):
    message = {**shown(query.observation), "one": np.float32(2), "plain": [1, 2.5, None, True]}
    assert pack(message) == packing.packb(message)
    for size in ((20, 40), (41, 20), (224, 300), (33, 97)):
        image, options = query.observation.images["wrist"], read_options({"address": "a:1", "image_size": list(size)})
        np.testing.assert_array_equal(resize_image(options, image), images.resize_with_pad(image, *size))
