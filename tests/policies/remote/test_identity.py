"""What identifies a policy behind a server: its identity, what the server says of itself, or its address."""

import numpy as np
import pytest

from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.remote.msgpack_numpy import pack
from tests.policies.remote.test_client import CHUNK, QUICK, free_port, query, remote
from tests.remote_servers import answering, speaking


def test_with_an_identity_the_client_connects_at_the_first_query():
    options = {"address": f"ws://127.0.0.1:{free_port()}", "identity": "pi0_base@1"}
    assert catalog.spec("openpi", options).cameras == ("third_person", "wrist")
    other_address = {"address": "wss://robots.example", "identity": "pi0_base@1", "timeout_s": 5, "retries": 9}
    assert catalog.digest("openpi", options) == catalog.digest("openpi", other_address)
    for change in ({"identity": "pi0_base@2"}, {"image_size": 224}, {"execute": 5}, {"columns": [0, 1, 2, 3, 4, 5, 6]}):
        assert catalog.digest("openpi", {**options, **change}) != catalog.digest("openpi", options)


def test_without_an_identity_the_servers_metadata_are_hashed():
    digests = []
    for metadata in ({"model": "a"}, {"model": "b", "reset_pose": np.zeros(3)}, {"model": "a"}):
        with speaking(answering(CHUNK, metadata=metadata)) as address:
            digests.append(catalog.digest("openpi", {"address": address, **QUICK}))
    assert digests[0] == digests[2] != digests[1]


def test_a_server_without_metadata_is_known_by_its_address_and_its_numbers_say_so():
    with speaking(answering(CHUNK, metadata={})) as first, speaking(answering(CHUNK, metadata={})) as second:
        kind = catalog.find("openpi")
        digests = [catalog.digest("openpi", {"address": a}) for a in (first, first, second)]
        assert digests[0] == digests[1] != digests[2]
        assert (
            "checkpoints behind it cannot be told apart; give option identity"
            in kind.contact({"address": first}).warning
        )
        assert kind.contact({"address": first, "identity": "a"}).warning == ""
        assert len(remote(first).act([query()])) == 1


def test_metadata_that_change_under_one_identity_are_refused_at_reconnection_and_in_other_processes():
    named = iter(["a", "a", "b"])

    def once(connection):
        connection.send(pack({"checkpoint": next(named)}))
        connection.recv()
        connection.send(pack(CHUNK))
        connection.close()

    message = "its metadata have changed under identity 'mine'; give another checkpoint"
    with speaking(once) as address:
        contact = catalog.find("openpi").contact({"address": address, "identity": "mine", **QUICK})
        planned = catalog.load("openpi", contact.options)
        planned.act([query()])
        with pytest.raises(PolicyError, match=message):
            planned.act([query(8)])
    with speaking(answering(CHUNK, metadata={"checkpoint": "b"})) as address:
        with pytest.raises(PolicyError, match=message):
            catalog.load("openpi", {**contact.options, "address": address}).act([query()])
        assert catalog.digest("openpi", {"address": address, "identity": "mine"}) == planned.digest()


def test_a_restarted_server_with_another_policy_is_refused():
    names = iter(["a", "b"])

    def once(connection):
        connection.send(pack({"model": next(names)}))
        connection.recv()
        connection.send(pack(CHUNK))
        connection.close()

    with speaking(once) as address:
        policy = remote(address)
        policy.act([query()])
        with pytest.raises(PolicyError, match="expected the policy that the run was planned with, got another policy"):
            policy.act([query(8)])
