"""Which addresses others can reach."""

from robogauntlet.support.network import is_loopback


def test_loopback_addresses_are_this_machine_s_only():
    assert all(map(is_loopback, ("127.0.0.1", "127.9.9.9", "::1", "[::1]", "localhost", "LocalHost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.5", "example.org", "localhost.evil.example", "")))
