"""What people are told of a run, and that sending it never breaks anything."""

import dataclasses
import threading
import unicodedata

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.scheduler import TooManyErrors
from orchestrator.telling import Kind, Message, NotTold, TellingError, message_for, tell, tellers
from results.comparison import COLUMNS, Run, compare_runs
from results.run import RunStatus
from tests.orchestrator.test_scheduler_simulated import play, work
from tests.orchestrator.told_servers import QUICK, Hook, Inbox, closed_port, smtp
from tests.results.synthetic import cells, document, row
from tests.simulated_crew import Clock, SimulatedCrew

MESSAGE = Message(Kind.TEST, "a test", ("one", "two"), "demo")
TASKS = ("maniskill/A", "pybullet/B")


def compared(success, **changes):
    def run(name, succeeded, **changes):
        own = cells(("p",), TASKS)
        rows = [row(cell, seed, "success" if succeeded(seed) else "failure") for cell in own for seed in range(40)]
        frame = pd.DataFrame([{c: getattr(one, c) for c in COLUMNS} for one in rows], columns=list(COLUMNS))
        return Run(name, document(40, own, **changes), frame)

    return compare_runs(run("tuesday", success, **changes), run("monday", lambda seed: seed % 4 != 0))


def test_a_regression_is_told_with_its_reasons():
    told = message_for(document(), compared(lambda seed: seed % 2), "http://lab/tuesday")
    assert told.kind is Kind.REGRESSED
    assert told.title == "REGRESSED: tuesday against monday"
    assert any(line.startswith("p, maniskill/A: 75 % before, 50 % now of 40 episodes") for line in told.lines)
    assert (told.run, told.link) == ("tuesday", "http://lab/tuesday")


def test_a_regression_of_a_run_that_ended_early_says_both():
    ended = document(status=RunStatus.STOPPED, reason="the disk is full")
    told = message_for(ended, compared(lambda seed: seed % 2), None)
    assert told.kind is Kind.REGRESSED
    assert told.lines[-1] == "stopped early: the disk is full"


def test_a_run_that_could_not_be_judged_is_told_since_nobody_watches_any_more():
    ended = document(suite_name="another")
    found = compared(lambda seed: True, suite_name="another")
    told = message_for(ended, found, None)
    assert (told.kind, told.title) == (Kind.UNJUDGED, "NOT COMPARABLE: tuesday against monday")
    assert told.lines[0].startswith("suite differs: suite 'another', the baseline is of 'synthetic'")
    assert told.lines[-1].endswith("gauntlet accept tuesday")


@pytest.mark.parametrize("status", [RunStatus.COMPLETE, RunStatus.INTERRUPTED, RunStatus.RUNNING])
def test_of_a_run_that_ended_as_it_should_or_was_interrupted_nothing_is_told(status):
    assert message_for(document(status=status), None, None) is None
    assert message_for(document(status=status), compared(lambda seed: seed % 4 != 0), None) is None


def test_a_run_that_stopped_is_told_with_its_reason():
    told = message_for(document(status=RunStatus.STOPPED, reason="the disk is full"), None, None)
    assert told.kind is Kind.STOPPED
    assert told.title == "STOPPED: synthetic run-1"
    assert told.lines[0] == "stopped early: the disk is full"


def test_too_many_errors_are_known_by_the_reason_that_the_scheduler_gives():
    crew = SimulatedCrew(lambda episode: 1.0, Clock(), fate=lambda episode: "dies")
    with pytest.raises(TooManyErrors) as raised:
        play(work({("a/1", "p"): 5}), crew, {"a": 1}, allowed_errors=0)
    told = message_for(document(status=RunStatus.STOPPED, reason=str(raised.value)), None, None)
    assert told.kind is Kind.ERRORS
    assert told.title == "TOO MANY ERRORS: synthetic run-1"


@given(st.text(max_size=3000), st.lists(st.text(), max_size=3), st.text(), st.none() | st.text())
def test_every_text_of_a_message_is_one_printable_line(title, lines, run, link):
    made = Message(Kind.TEST, title, tuple(lines), run, link)
    for text in (made.title, *made.lines, made.run, made.link or "", *made.footer):
        assert len(text.splitlines()) <= 1
        assert not {unicodedata.category(sign) for sign in text} & {"Cc", "Cs", "Zl", "Zp"}
        text.encode()


def test_a_message_cannot_be_changed_after_it_was_made():
    with pytest.raises(dataclasses.FrozenInstanceError):
        MESSAGE.title = "a\nb"


def test_all_are_told_and_none_that_fails_keeps_another_from_it():
    inbox = Inbox()
    with Hook() as hook, smtp(inbox) as port:
        environment = {
            "GAUNTLET_WEBHOOK_URL": f"http://localhost:{closed_port()}/x {hook.url}",
            "GAUNTLET_SMTP_HOST": "localhost",
            "GAUNTLET_SMTP_PORT": str(port),
            "GAUNTLET_SMTP_TLS": "none",
            "GAUNTLET_MAIL_FROM": "gauntlet@example.org",
            "GAUNTLET_MAIL_TO": "lab@example.org",
        }
        troubles = tell(MESSAGE, tellers(environment, retries=QUICK))
    assert troubles == [
        "could not tell of demo: webhook 1 of 2 (http://localhost): connection refused, after 4 tries; "
        "check that the host is up, and GAUNTLET_WEBHOOK_URL"
    ]
    assert len(hook.came) == len(inbox.letters) == 1


def test_nobody_to_tell_is_no_trouble():
    assert tellers({}) == []
    assert tellers({"GAUNTLET_WEBHOOK_URL": "  ", "GAUNTLET_SMTP_HOST": "", "PATH": "x"}) == []
    assert tell(MESSAGE, []) == []


class Silent:
    name = "one that never answers"

    def __init__(self, release):
        self.release = release

    def send(self, message):
        self.release.wait()


class Broken:
    name = "one that is broken"

    def send(self, message):
        raise ValueError("with a secret in its text")


class Refusing:
    name = "one that refuses"

    def send(self, message):
        raise NotTold("not today")


def test_one_that_never_ends_is_given_up_and_the_others_are_heard():
    release = threading.Event()
    try:
        troubles = tell(MESSAGE, [Silent(release), Refusing()], total_s=1.0)
    finally:
        release.set()
    assert troubles == [
        "could not tell of demo: one that never answers: not sent within 1 s; see whether it is reached from here",
        "could not tell of demo: one that refuses: not today",
    ]


def test_an_unexpected_error_is_told_by_its_type_alone():
    (line,) = tell(MESSAGE, [Broken()])
    assert line == "could not tell of demo: one that is broken: unexpected ValueError; please report it"


MAIL = {
    "GAUNTLET_SMTP_HOST": "mail.example.org",
    "GAUNTLET_MAIL_FROM": "Gauntlet <gauntlet@example.org>",
    "GAUNTLET_MAIL_TO": "a@example.org, Someone Else <b@example.org>",
}


def test_mail_is_encrypted_by_starttls_on_its_usual_port_unless_told_otherwise():
    (mail,) = tellers(MAIL)
    assert mail.name == "e-mail through mail.example.org:587 (starttls)"
    (mail,) = tellers(MAIL | {"GAUNTLET_SMTP_TLS": "TLS"})
    assert mail.name == "e-mail through mail.example.org:465 (tls)"
    assert [one.addr_spec for one in mail.recipients] == ["a@example.org", "b@example.org"]


WRONG = [
    ({"GAUNTLET_SMTP_TLS": "ssl"}, "GAUNTLET_SMTP_TLS: expected starttls, tls, none, got another word"),
    ({"GAUNTLET_SMTP_TLS": "none"}, "GAUNTLET_SMTP_TLS: none is for a server on this machine"),
    ({"GAUNTLET_SMTP_PORT": "smtp"}, "GAUNTLET_SMTP_PORT: expected a number from 1 to 65535"),
    ({"GAUNTLET_SMTP_PORT": "65536"}, "GAUNTLET_SMTP_PORT: expected a number from 1 to 65535"),
    ({"GAUNTLET_SMTP_PORT": "²"}, "GAUNTLET_SMTP_PORT: expected a number from 1 to 65535"),
    ({"GAUNTLET_MAIL_TO": ""}, "GAUNTLET_MAIL_TO: not set, and an e-mail needs it"),
    ({"GAUNTLET_MAIL_TO": "nobody"}, "GAUNTLET_MAIL_TO: expected e-mail addresses separated by commas"),
    ({"GAUNTLET_MAIL_TO": "a@b.org\nBcc: c@d.org"}, "GAUNTLET_MAIL_TO: expected e-mail addresses"),
    ({"GAUNTLET_MAIL_FROM": "a@b.org, c@d.org"}, "GAUNTLET_MAIL_FROM: expected one address, got 2"),
    ({"GAUNTLET_SMTP_HOST": "user@host"}, "GAUNTLET_SMTP_HOST: expected the name of a host"),
    ({"GAUNTLET_SMTP_USER": "me"}, "GAUNTLET_SMTP_PASSWORD: not set, and GAUNTLET_SMTP_USER is"),
    ({"GAUNTLET_SMTP_PASSWORD": "pw"}, "GAUNTLET_SMTP_USER: not set, and GAUNTLET_SMTP_PASSWORD is"),
    ({"GAUNTLET_WEBHOOK_URL": "hooks.slack.com/services/x"}, "GAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
    ({"GAUNTLET_WEBHOOK_URL": "https://a.org/x ftp://b.org/y"}, "GAUNTLET_WEBHOOK_URL, address 2 of 2: expected"),
    ({"GAUNTLET_WEBHOOK_URL": "https:///x"}, "GAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
    ({"GAUNTLET_WEBHOOK_URL": "https://[::1/x"}, "GAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
    ({"GAUNTLET_WEBHOOK_URL": "https://host:port/x"}, "GAUNTLET_WEBHOOK_URL: expected https://HOST/..."),
]


@pytest.mark.parametrize(("changed", "expected"), WRONG, ids=[line[:60] for _, line in WRONG])
def test_what_is_missing_or_malformed_is_one_line_that_names_the_variable(changed, expected):
    with pytest.raises(TellingError) as raised:
        tellers(MAIL | changed)
    (line,) = str(raised.value).splitlines()
    assert line.startswith(expected)


def test_all_that_is_wrong_is_told_at_once():
    with pytest.raises(TellingError) as raised:
        tellers({"GAUNTLET_SMTP_PORT": "x", "GAUNTLET_WEBHOOK_URL": "x"})
    assert [line.partition(":")[0] for line in str(raised.value).splitlines()] == [
        "GAUNTLET_WEBHOOK_URL",
        "GAUNTLET_SMTP_HOST",
        "GAUNTLET_MAIL_FROM",
        "GAUNTLET_MAIL_TO",
        "GAUNTLET_SMTP_PORT",
    ]


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "::1"])
def test_mail_in_the_clear_is_for_this_machine_only(host):
    (mail,) = tellers(MAIL | {"GAUNTLET_SMTP_HOST": host, "GAUNTLET_SMTP_TLS": "none"})
    assert mail.port == 25
