"""Notifications about runs by webhook and e-mail, configured by environment variables. See docs/operating.md."""

from robogauntlet.orchestrator.notifications.message import Message, message_for
from robogauntlet.orchestrator.notifications.sending import Notifier, Retries, send_all
from robogauntlet.orchestrator.notifications.settings import NotificationError, notifiers

__all__ = ["Message", "NotificationError", "Notifier", "Retries", "message_for", "notifiers", "send_all"]
