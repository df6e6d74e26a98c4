"""Where people see how it goes: lines on the terminal, a page in the browser, the log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import sys
from typing import NamedTuple, TextIO

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.health import Status
from vio_eval_ros.live.notices import Notices, warnings
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.page import View
from vio_eval_ros.live.run import LiveRun
from vio_eval_ros.live.status_line import StatusLines, width_of
from vio_eval_ros.live.web import PageServer


class Shown(NamedTuple):
    """
    How an estimate is.

    :param label: what it is called beside others; empty where there is only one.
    """

    label: str
    run: LiveRun
    statuses: Sequence[Status]


class Log(NamedTuple):
    """How something is logged."""

    info: Callable[[str], object]
    warning: Callable[[str], object]
    error: Callable[[str], object]


class Screens:
    """
    Shows how the evaluation is.

    :param name: of the node.
    :param stream: where the log goes; lines are drawn where it is a terminal.
    :raises ConfigError: a page that was asked for and needs a library that is missing.
    """

    def __init__(
        self, name: str, settings: NodeConfig, log: Log, stream: TextIO | None = None
    ) -> None:
        stream = stream or sys.stderr
        self._log = log
        self._notices = Notices()
        self._lines = StatusLines(stream) if width_of(stream) else None
        self._page: PageServer | None = None
        if settings.web_port:
            self._page = self._served(name, settings.web_host, settings.web_port)

    def show(self, number: int, estimates: Sequence[Shown], advice: Sequence[str]) -> None:
        """
        Show how the estimates are in a run of a number.

        :param advice: what is worth a line of the log where no terminal shows the statuses.
        """
        if self._page and self._page.is_watched:
            self._page.show(number, [View.of(*shown) for shown in estimates])
        if not self._lines:
            self._tell(advice)
            return
        self._tell(
            f'{one.label}: {sentence}' if one.label else sentence
            for one in estimates
            for sentence in warnings(one.statuses)
        )
        self._lines.draw([(one.label, one.run.values, one.statuses) for one in estimates])

    def close(self) -> None:
        """Show no more."""
        if self._page:
            self._page.close()
        if self._lines:
            self._lines.clear()
            self._lines = None

    def _tell(self, sentences: Iterable[str]) -> None:
        for sentence in self._notices.new(sentences):
            self._log.warning(sentence)

    def _served(self, name: str, host: str, port: int) -> PageServer | None:
        """Return the page; None where it cannot be served, with a line that says why."""
        try:
            page = PageServer(name, host, port, self._log.error)
        except ConfigError as error:
            raise ConfigError(f'web_port: {error}') from None
        except OSError as error:
            why = (error.strerror or str(error)).rpartition(': ')[2]
            self._log.error(
                f'web_port: no page at {host}:{port}: {why}; the evaluation goes on without it'
            )
            return None
        self._log.info(f'the page is at {page.address}')
        return page
