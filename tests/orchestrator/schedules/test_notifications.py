"""The notifications about a run, and that sending them never raises."""

import threading

import pandas as pd
import pytest
from hypothesis import given, strategies as st

from robogauntlet.orchestrator.schedules.notifications import Message, Target, message_for, send_all, targets
from robogauntlet.results.analysis.comparison import COLUMNS, Run, compare_runs
from robogauntlet.results.run_document import RunStatus
from robogauntlet.support.errors import BadInput
from tests.orchestrator.schedules.servers import Hook, Inbox, closed_port, smtp
from tests.results.synthetic import cells, document, row

MESSAGE = Message("a test", ("one", "two"), "demo")
TASKS = ("maniskill/A", "pybullet/B")
MAIL = {
    "ROBOGAUNTLET_SMTP_HOST": "mail.example.org",
    "ROBOGAUNTLET_MAIL_FROM": "Gauntlet <robogauntlet@example.org>",
    "ROBOGAUNTLET_MAIL_TO": "a@example.org, Someone Else <b@example.org>",
}


def compared(success, **changes):
    def run(name, succeeded, /, **changes):
        own = cells(("p",), TASKS)
        rows = [row(cell, seed, "success" if succeeded(seed) else "failure") for cell in own for seed in range(40)]
        frame = pd.DataFrame([{c: getattr(one, c) for c in COLUMNS} for one in rows], columns=list(COLUMNS))
        return Run(name, document(40, own, **changes), frame)

    return compare_runs(run("tuesday", success, **changes), run("monday", lambda seed: seed % 4 != 0))


def test_a_regression_is_reported_with_its_reasons():
    message = message_for(document(), compared(lambda seed: seed % 2), "http://lab/tuesday")
    assert message.title == "REGRESSED: tuesday against monday"
    assert any(line.startswith("p, maniskill/A: 75 % before, 50 % now of 40 episodes") for line in message.lines)
    assert (message.run, message.link) == ("tuesday", "http://lab/tuesday")


def test_a_regression_of_a_stopped_run_mentions_both():
    ended = document(status=RunStatus.STOPPED, reason="the disk is full")
    message = message_for(ended, compared(lambda seed: seed % 2), None)
    assert message.title.startswith("REGRESSED")
    assert message.lines[-1] == "stopped early: the disk is full"


def test_a_run_that_is_not_comparable_is_reported():
    message = message_for(document(name="another"), compared(lambda seed: True, name="another"), None)
    assert message.title == "NOT COMPARABLE: tuesday against monday"
    assert message.lines[0].startswith("suite differs: suite 'another', the baseline has 'synthetic'")
    assert message.lines[-1].endswith("robogauntlet compare tuesday --accept")


@pytest.mark.parametrize("status", [RunStatus.COMPLETE, RunStatus.INTERRUPTED, RunStatus.RUNNING])
def test_complete_and_interrupted_runs_cause_no_notification(status):
    assert message_for(document(status=status), None, None) is None
    assert message_for(document(status=status), compared(lambda seed: seed % 4 != 0), None) is None


def test_a_stopped_run_is_reported_with_its_reason():
    message = message_for(document(status=RunStatus.STOPPED, reason="the disk is full"), None, None)
    assert message.title == "STOPPED: synthetic run-1"
    assert message.lines[0] == "stopped early: the disk is full"


@given(st.text(max_size=3000), st.lists(st.text(), max_size=3), st.text(), st.none() | st.text())
def test_a_message_has_a_printable_line_for_each_of_its_texts(title, lines, run, link):
    text = Message(title, tuple(lines), run, link).text
    assert len(text.splitlines()) <= 2 + len(lines) + (link is not None) + 1
    assert text.replace("\n", "").isprintable()
    text.encode()


def test_a_failing_target_does_not_affect_the_others():
    inbox = Inbox()
    with Hook() as hook, smtp(inbox) as port:
        webhooks = {"ROBOGAUNTLET_WEBHOOK_URL": f"http://localhost:{closed_port()}/x {hook.url}"}
        server = {"ROBOGAUNTLET_SMTP_HOST": "localhost", "ROBOGAUNTLET_SMTP_PORT": str(port)}
        environment = MAIL | server | webhooks | {"ROBOGAUNTLET_SMTP_TLS": "none"}
        troubles = send_all(MESSAGE, targets(environment))
    assert troubles == [
        "the notification about demo was not sent: webhook 1 (http://localhost): connection refused, "
        "after 4 tries; check ROBOGAUNTLET_WEBHOOK_URL"
    ]
    assert len(hook.received) == len(inbox.mails) == 1


def test_no_target_is_no_error():
    assert targets({}) == []
    assert targets({"ROBOGAUNTLET_WEBHOOK_URL": "  ", "ROBOGAUNTLET_SMTP_HOST": "", "PATH": "x"}) == []
    assert send_all(MESSAGE, []) == []


def test_a_target_that_never_answers_times_out(monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.schedules.notifications.TOTAL_S", 1.0)
    release = threading.Event()
    silent = Target("one that never answers", "X", lambda message: release.wait())
    broken = Target("one that is broken", "Y", lambda message: {}["a secret"])
    try:
        troubles = send_all(MESSAGE, [silent, broken])
    finally:
        release.set()
    assert troubles == [
        "the notification about demo was not sent: one that never answers: not sent within 1 s; check X",
        "the notification about demo was not sent: one that is broken: failed with KeyError; check Y",
    ]


def test_mail_uses_starttls_on_its_usual_port_by_default():
    assert [target.name for target in targets(MAIL)] == ["e-mail through mail.example.org:587 (starttls)"]
    (mail,) = targets(MAIL | {"ROBOGAUNTLET_SMTP_TLS": "TLS"})
    assert mail.name == "e-mail through mail.example.org:465 (tls)"
    for host in ("localhost", "127.0.0.1", "::1"):
        (mail,) = targets(MAIL | {"ROBOGAUNTLET_SMTP_HOST": host, "ROBOGAUNTLET_SMTP_TLS": "none"})
        assert mail.name == f"e-mail through {host}:25 (none)"


WRONG = [
    ({"ROBOGAUNTLET_SMTP_TLS": "ssl"}, "ROBOGAUNTLET_SMTP_TLS: expected starttls, tls, or none for a server on this"),
    ({"ROBOGAUNTLET_SMTP_TLS": "none"}, "ROBOGAUNTLET_SMTP_TLS: expected starttls, tls, or none for a server on this"),
    ({"ROBOGAUNTLET_SMTP_PORT": "smtp"}, "ROBOGAUNTLET_SMTP_PORT: expected a number from 1 to 65535"),
    ({"ROBOGAUNTLET_SMTP_PORT": "65536"}, "ROBOGAUNTLET_SMTP_PORT: expected a number from 1 to 65535"),
    ({"ROBOGAUNTLET_SMTP_PORT": "²"}, "ROBOGAUNTLET_SMTP_PORT: expected a number from 1 to 65535"),
    ({"ROBOGAUNTLET_MAIL_TO": ""}, "ROBOGAUNTLET_MAIL_TO: expected e-mail addresses separated by commas, got nothing"),
    ({"ROBOGAUNTLET_MAIL_TO": "someone"}, "ROBOGAUNTLET_MAIL_TO: expected e-mail addresses separated by commas"),
    ({"ROBOGAUNTLET_MAIL_TO": "a@b.org\nBcc: c@d.org"}, "ROBOGAUNTLET_MAIL_TO: expected e-mail addresses"),
    ({"ROBOGAUNTLET_MAIL_FROM": "a@b.org, c@d.org"}, "ROBOGAUNTLET_MAIL_FROM: expected an e-mail address"),
    ({"ROBOGAUNTLET_SMTP_HOST": "user@host"}, "ROBOGAUNTLET_SMTP_HOST: expected the name of a host"),
    (
        {"ROBOGAUNTLET_SMTP_USER": "me"},
        "ROBOGAUNTLET_SMTP_PASSWORD: expected a value beside ROBOGAUNTLET_SMTP_USER, got n",
    ),
    (
        {"ROBOGAUNTLET_SMTP_PASSWORD": "pw"},
        "ROBOGAUNTLET_SMTP_USER: expected a value beside ROBOGAUNTLET_SMTP_PASSWORD, got n",
    ),
    ({"ROBOGAUNTLET_WEBHOOK_URL": "hooks.slack.com/services/x"}, "ROBOGAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
    (
        {"ROBOGAUNTLET_WEBHOOK_URL": "https://a.org/x ftp://b.org/y"},
        "ROBOGAUNTLET_WEBHOOK_URL: expected https://HOST/..., several",
    ),
    ({"ROBOGAUNTLET_WEBHOOK_URL": "https:///x"}, "ROBOGAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
    ({"ROBOGAUNTLET_WEBHOOK_URL": "https://[::1/x"}, "ROBOGAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
    ({"ROBOGAUNTLET_WEBHOOK_URL": "https://host:port/x"}, "ROBOGAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
]


@pytest.mark.parametrize(("changed", "expected"), WRONG, ids=[line[:60] for _, line in WRONG])
def test_a_missing_or_malformed_variable_is_named_in_one_line(changed, expected):
    with pytest.raises(BadInput) as raised:
        targets(MAIL | changed)
    (line,) = str(raised.value).splitlines()
    assert line.startswith(expected)
