"""Notifications by e-mail to real SMTP servers: encrypted, with a login, refused, unreachable."""

import email
import email.policy

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from robogauntlet.orchestrator.schedules.notifications import Message, send_all, targets
from tests.orchestrator.schedules.servers import Inbox, Users, certified, closed_port, greeter, smtp

MESSAGE = Message("REGRESSED: a against b", ("p: 85 % → 71 %",), "a", "runs/a/report.html")
few = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
PASSWORD = "correct-horse-battery"
LOGIN = {"ROBOGAUNTLET_SMTP_USER": "me", "ROBOGAUNTLET_SMTP_PASSWORD": PASSWORD}


def environment(port, tls, **more):
    return {
        "ROBOGAUNTLET_SMTP_HOST": "localhost",
        "ROBOGAUNTLET_SMTP_PORT": str(port),
        "ROBOGAUNTLET_SMTP_TLS": tls,
        "ROBOGAUNTLET_MAIL_FROM": "Gauntlet <robogauntlet@example.org>",
        "ROBOGAUNTLET_MAIL_TO": "a@example.org, Someone Else <b@example.org>",
        **more,
    }


def notify(port, tls="none", **more):
    return send_all(MESSAGE, targets(environment(port, tls, **more)))


def test_a_mail_arrives_with_its_subject_and_lines():
    inbox = Inbox()
    with smtp(inbox) as port:
        assert notify(port) == []
    (envelope,) = inbox.mails
    assert envelope.mail_from == "robogauntlet@example.org"
    assert envelope.rcpt_tos == ["a@example.org", "b@example.org"]
    mail = email.message_from_bytes(envelope.content, policy=email.policy.default)
    assert mail["Subject"] == "[robogauntlet] REGRESSED: a against b"
    assert mail["From"] == "Gauntlet <robogauntlet@example.org>"
    assert mail["To"] == "a@example.org, Someone Else <b@example.org>"
    assert mail.get_content().splitlines() == [
        *("REGRESSED: a against b", "run: a", "report: runs/a/report.html", "- p: 85 % → 71 %")
    ]


def test_starttls_encrypts_the_login_and_the_mail(authority, trusted):
    inbox = Inbox()
    options = {"tls_context": certified(authority), "require_starttls": True, "auth_required": True}
    with smtp(inbox, authenticator=Users("me", PASSWORD), **options) as port:
        assert notify(port, "starttls", **LOGIN) == []
    assert inbox.encrypted == [True]


@pytest.mark.filterwarnings("ignore:Requiring AUTH while not requiring TLS")  # aiosmtpd knows of STARTTLS only
def test_tls_encrypts_the_whole_connection(authority, trusted):
    inbox = Inbox()
    options = {"ssl_context": certified(authority), "auth_required": True, "auth_require_tls": False}
    with smtp(inbox, authenticator=Users("me", PASSWORD), **options) as port:
        assert notify(port, "tls", **LOGIN) == []
    assert len(inbox.mails) == 1


@pytest.mark.parametrize("tls", ["starttls", "tls"])
def test_a_certificate_of_an_unknown_authority_is_not_accepted(authority, tls):
    inbox = Inbox()
    options = {"tls_context": certified(authority)} if tls == "starttls" else {"ssl_context": certified(authority)}
    with smtp(inbox, **options) as port:
        (line,) = notify(port, tls, **LOGIN)
    assert "certificate was not accepted: unable to get local issuer certificate (SSL_CERT_FILE)" in line
    assert inbox.mails == []


def test_a_certificate_for_another_host_is_not_accepted(authority, trusted):
    inbox = Inbox()
    with smtp(inbox, tls_context=certified(authority, "elsewhere.example.org")) as port:
        (line,) = notify(port, "starttls")
    assert "Hostname mismatch" in line
    assert inbox.mails == []


def test_nothing_is_sent_to_a_server_without_starttls():
    inbox = Inbox()
    with smtp(inbox) as port:
        (line,) = notify(port, "starttls", **LOGIN)
    assert f"e-mail through localhost:{port} (starttls): failed with SMTPNotSupportedError; check" in line
    assert inbox.tries == 0


def test_a_wrong_password_is_not_retried(authority, trusted):
    inbox = Inbox()
    options = {"tls_context": certified(authority), "require_starttls": True, "auth_required": True}
    with smtp(inbox, authenticator=Users("me", "another"), **options) as port:
        (line,) = notify(port, "starttls", **LOGIN)
    assert line.endswith("the server answered 535; check ROBOGAUNTLET_SMTP_* and ROBOGAUNTLET_MAIL_*")
    assert PASSWORD not in line


def test_a_busy_server_is_retried():
    inbox = Inbox(["451 4.3.0 busy"] * 3)
    with smtp(inbox) as port:
        assert notify(port) == []
    assert inbox.tries == 4
    assert len(inbox.mails) == 1


@pytest.mark.parametrize(
    ("answer", "tries", "words"),
    [
        ("451 4.3.0 busy", 4, "answered 451, after 4 tries; check ROBOGAUNTLET_SMTP_* and ROBOGAUNTLET_MAIL_*"),
        ("550 5.7.1 not you", 1, "answered 550; "),
    ],
    ids=["busy", "refused for ever"],
)
def test_only_temporary_refusals_are_retried_and_at_most_three_times(answer, tries, words):
    inbox = Inbox([answer] * 9)
    with smtp(inbox) as port:
        (line,) = notify(port)
    assert f"the server {words}" in line
    assert inbox.tries == tries


def test_a_mail_that_some_recipients_do_not_get_is_a_problem_and_not_sent_again():
    inbox = Inbox(unknown={"b@example.org"})
    with smtp(inbox) as port:
        (line,) = notify(port)
    assert "failed with SMTPRecipientsRefused; check ROBOGAUNTLET_SMTP_*" in line
    assert [mail.rcpt_tos for mail in inbox.mails] == [["a@example.org"]]


def test_a_refused_connection_is_one_line():
    (line,) = notify(closed_port())
    assert "connection refused, after 4 tries; check ROBOGAUNTLET_SMTP_*" in line


def test_a_server_without_smtp_is_one_line():
    with greeter(b"hello there\r\n") as port:
        (line,) = notify(port)
    assert "failed with SMTPConnectError; check ROBOGAUNTLET_SMTP_*" in line


@few
@given(st.text(), st.text(), st.lists(st.text(), max_size=3))
def test_no_text_can_become_a_header(outbox, title, run, lines):
    inbox, port = outbox
    inserted = f"{title}\r\nBcc: everybody@example.org\n\nbody {run}"
    assert send_all(Message(inserted, (*lines, inserted), inserted), targets(environment(port, "none"))) == []
    back = email.message_from_bytes(inbox.mails.pop().content, policy=email.policy.default)
    headers = {"Subject", "From", "To", "Date", "Auto-Submitted", "Content-Type", "Content-Transfer-Encoding"}
    assert {*back.keys()} - {"X-Peer", "X-MailFrom", "X-RcptTo"} == headers | {"MIME-Version"}


@pytest.fixture(scope="module")
def outbox():
    inbox = Inbox()
    with smtp(inbox) as port:
        yield inbox, port
