"""Statuses as messages of ``/diagnostics``."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from vio_eval_ros.live.health import Status

SPOKEN = {'<=': ' at most ', '>=': ' at least ', '<': '(', '>': ')'}


def status_message(status: Status, source: str) -> DiagnosticStatus:
    """
    Return a status as a message.

    :param source: whose health it is.
    """
    return DiagnosticStatus(
        name=f'{source}: {status.name}',
        hardware_id=source,
        level=bytes([status.level]),
        message=_legible(status.message),
        values=[
            KeyValue(key=key, value=_legible(str(value))) for key, value in status.values.items()
        ],
    )


def _legible(text: str) -> str:
    """Return a text without angle brackets: viewers that render HTML would swallow the rest."""
    for sign, word in SPOKEN.items():
        text = text.replace(sign, word)
    return text
