"""Notifications by webhook to real servers that fail first, refuse, hang up or are unreachable."""

import pytest

from robogauntlet.orchestrator.schedules.notifications import Message, send_all, targets
from tests.orchestrator.schedules.servers import Hook, certified, closed_port

MESSAGE = Message("REGRESSED: a against b", ("one & two", "<!channel>"), "a", "https://lab/a?x=1&y=2")


def notify(url):
    return send_all(MESSAGE, targets({"ROBOGAUNTLET_WEBHOOK_URL": url}))


def test_a_webhook_receives_json_as_slack_expects():
    with Hook() as hook:
        assert notify(hook.url) == []
    (received,) = hook.received
    assert received["text"].splitlines() == [
        "REGRESSED: a against b",
        "run: a",
        "report: https://lab/a?x=1&amp;y=2",
        "- one &amp; two",
        "- &lt;!channel&gt;",
    ]


@pytest.mark.parametrize("failure", [429, 500, 502, 503, 504, "hang up"])
def test_temporary_failures_are_retried(failure):
    with Hook([failure] * 3) as hook:
        assert notify(hook.url) == []
    assert len(hook.received) == 4
    assert all(one == hook.received[0] for one in hook.received)


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (429, "the server answered 429, after 4 tries; check ROBOGAUNTLET_WEBHOOK_URL"),
        (503, "the server answered 503, after 4 tries; check"),
        ("hang up", "failed with RemoteDisconnected, after 4 tries; check"),
        ("no http", "failed with BadStatusLine, after 4 tries; check"),
    ],
)
def test_four_failures_end_with_the_reason(status, words):
    with Hook([status] * 4) as hook:
        (line,) = notify(hook.url)
    assert line.startswith(f"the notification about a was not sent: webhook 1 (http://localhost): {words}")
    assert len(hook.received) == 4


@pytest.mark.parametrize(("status", "headers"), [(400, {}), (404, {}), (302, {"Location": "/elsewhere"})])
def test_permanent_failures_are_not_retried(status, headers):
    with Hook([status], headers) as hook:
        (line,) = notify(hook.url)
    reason = f"the server answered {status}; "
    assert line.startswith(f"the notification about a was not sent: webhook 1 (http://localhost): {reason}")
    assert "ROBOGAUNTLET_WEBHOOK_URL" in line
    assert len(hook.received) == 1


def test_a_refused_connection_differs_from_an_unknown_host():
    (refused,) = notify(f"http://localhost:{closed_port()}/x")
    assert "connection refused, after 4 tries" in refused
    (unknown,) = notify("http://robogauntlet.invalid/x")
    assert "failed with gaierror, after 4 tries" in unknown


def test_a_certificate_is_checked(authority, request):
    with Hook(tls=certified(authority)) as hook:
        (line,) = notify(hook.url)
        assert "the server's certificate was not accepted: " in line
        assert hook.received == []
        request.getfixturevalue("trusted")
        assert notify(hook.url) == []
    assert len(hook.received) == 1
