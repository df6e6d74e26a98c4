"""Statuses as messages of ``/diagnostics``."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from vio_eval_ros.live.health import Status


def status_message(status: Status, source: str) -> DiagnosticStatus:
    """
    Return a status as a message.

    :param source: whose health it is.
    """
    return DiagnosticStatus(
        name=f'{source}: {status.name}',
        hardware_id=source,
        level=bytes([status.level]),
        message=status.message,
        values=[KeyValue(key=key, value=str(value)) for key, value in status.values.items()],
    )
