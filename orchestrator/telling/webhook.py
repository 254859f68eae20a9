"""Tells by a webhook that takes Slack's JSON: Slack, Mattermost, Rocket.Chat and what imitates them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import requests
from requests.adapters import HTTPAdapter

from orchestrator.telling.message import Message
from orchestrator.telling.quiet import quiet
from orchestrator.telling.teller import RETRIES, NotTold, Retries, what_came

VARIABLE = "GAUNTLET_WEBHOOK_URL"
LONGEST_TEXT, LONGEST_HEADER, LONGEST_SECTION = 4_000, 150, 3_000
"""Slack's limits for a message's text, a header and a section; characters of the escaped text."""
MOST_SECTIONS = 10
"""Slack takes 50 blocks; nobody reads them."""
_ESCAPES = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_SLACK_WORDS = (
    *("invalid_payload", "invalid_blocks", "no_text", "no_team", "no_service", "no_active_hooks", "invalid_token"),
    *("channel_not_found", "channel_is_archived", "user_not_found", "action_prohibited", "rate_limited"),
    *("posting_to_general_channel_denied", "too_many_attachments", "team_disabled", "token_revoked"),
)
"""What Slack answers to say why not. Other answers are not repeated: a server may repeat the address in them."""


@dataclass(frozen=True)
class Webhook:
    """An address that takes messages. Who knows it can write there, so it is shown nowhere but for its host."""

    name: str
    url: str = field(repr=False)
    retries: Retries = RETRIES

    def send(self, message: Message) -> None:
        """Post the message.

        A message whose answer was lost is sent again, so it may come twice.

        Raises:
            NotTold: See `Teller.send`.
        """
        trouble = self._post(payload(message))
        if trouble is not None:  # raised out here, where no exception with the address in its text is at work
            raise NotTold(trouble)

    def _post(self, content: dict[str, Any]) -> str | None:
        tried = f"after {self.retries.tries} tries"
        with quiet(), requests.Session() as session:
            for scheme in ("http://", "https://"):
                session.mount(scheme, HTTPAdapter(max_retries=self.retries.retry()))
            try:
                with session.post(
                    self.url, json=content, timeout=self.retries.timeout_s, allow_redirects=False, stream=True
                ) as response:
                    if 200 <= response.status_code < 300:
                        return None
                    return _refused(response.status_code, _slack_word(response), tried)
            except Exception as error:  # requests lets some of urllib3's through, and any may hold the address
                return f"{what_came(error)}, {tried}; check that the host is up, and {VARIABLE}"


def _slack_word(response: requests.Response) -> str:
    """Why Slack says no, if it is Slack and says so: ` (invalid_payload)`."""
    with contextlib.suppress(Exception):
        start = response.raw.read(80, decode_content=True).decode("ascii", "replace")
        return next((f" ({word})" for word in _SLACK_WORDS if start.strip() == word), "")
    return ""


def _refused(status: int, word: str, tried: str) -> str:
    """What a status other than success means, and what to do."""
    came = f"answered {status}{word}"
    if status == 429:
        return f"{came}, too many messages, {tried}; tell less often, or wait"
    if status >= 500:
        return f"{came}, it is out of order, {tried}; wait, or see whether the service is down"
    if 300 <= status < 400:
        return f"{came}, a redirection, which is not followed; put the address that it leads to into {VARIABLE}"
    if status in (401, 403, 404, 410):
        return f"{came}: messages are not (or no longer) taken at this address; make a new webhook and set {VARIABLE}"
    return f"{came}: it does not take Slack's JSON as it was sent; check that {VARIABLE} is a Slack-compatible webhook"


def payload(message: Message) -> dict[str, Any]:
    """The JSON of a message: `text` for notifications and for what knows no blocks, `blocks` for Slack.

    All texts are escaped as Slack demands, and cut to its limits.
    """
    lines = [f"• {line}" for line in message.lines]
    text = "\n".join(
        [
            f"*{escaped(message.title, LONGEST_HEADER)}*",
            *pack(lines, LONGEST_TEXT - 1_600, 1),
            *(escaped(line, 700) for line in message.footer),
        ]
    )
    return {
        "text": text,
        "blocks": [
            {"type": "header", "text": {"type": "plain_text", "text": escaped(message.title or "?", LONGEST_HEADER)}},
            *({"type": "section", "text": _words(chunk)} for chunk in pack(lines, LONGEST_SECTION, MOST_SECTIONS)),
            {"type": "context", "elements": [_words(line) for line in _footer(message)]},
        ],
    }


def _footer(message: Message) -> list[str]:
    """The run, and the report to click at if it is on the web."""
    link = message.link or ""
    target = f"<{link.replace('&', '&amp;')}|report>"
    is_web = link.startswith(("http://", "https://")) and not any(sign in link for sign in " |<>")
    if not is_web or len(target) > LONGEST_SECTION:
        return [escaped(line, LONGEST_SECTION) for line in message.footer]
    return [escaped(message.footer[0], LONGEST_SECTION), target]


def _words(text: str) -> dict[str, Any]:
    return {"type": "mrkdwn", "text": text, "verbatim": True}


def escaped(text: str, limit: int) -> str:
    """The text as Slack wants it (`&`, `<` and `>` as entities), at most `limit` characters, no entity cut in two."""
    signs = [_ESCAPES.get(sign, sign) for sign in text]
    if sum(map(len, signs)) <= limit:
        return "".join(signs)
    kept, room = [], limit - 1
    for sign in signs:
        room -= len(sign)
        if room < 0:
            break
        kept.append(sign)
    return "".join(kept) + "…"


def pack(lines: Iterable[str], limit: int, at_most: int) -> list[str]:
    """The lines, escaped, in at most so many chunks of at most `limit` characters. What is left out is counted."""
    left = [escaped(line, limit // 2) for line in lines]
    chunks: list[str] = []
    while left and len(chunks) < at_most:
        last = len(chunks) == at_most - 1
        room = limit if not last or sum(len(line) + 1 for line in left) <= limit else limit - 40
        chunk = []
        while left and len(left[0]) < room:
            room -= len(left[0]) + 1
            chunk.append(left.pop(0))
        if last and left:
            chunk.append(f"… and {len(left):,} lines more")
        chunks.append("\n".join(chunk))
    return chunks
