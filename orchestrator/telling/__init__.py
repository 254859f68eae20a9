"""Telling people about a run: by webhooks and by e-mail, as the environment says. See docs/telling.md."""

from orchestrator.telling.message import Kind, Message, message_for
from orchestrator.telling.settings import tellers
from orchestrator.telling.teller import RETRIES, NotTold, Retries, Teller, TellingError
from orchestrator.telling.telling import tell

__all__ = [
    "RETRIES",
    "Kind",
    "Message",
    "NotTold",
    "Retries",
    "Teller",
    "TellingError",
    "message_for",
    "tell",
    "tellers",
]
