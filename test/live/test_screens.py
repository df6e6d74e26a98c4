"""Where people see how a running evaluation is, and what becomes of it where they do not."""

import io
import sys

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live import notices
from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.live.screens import Log, Screens, Shown

RUN = LiveRun(RunSetup(EvaluationConfig(), ('/odom', '/truth')))
WRONG = Status('streams', Level.WARN, 'nobody publishes /odom', {})
ADVICE = ["nobody publishes /odom; did you mean '/vio/odom'?"]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def logged() -> dict[str, list[str]]:
    return {'info': [], 'warning': [], 'error': []}


@pytest.fixture
def log(logged, monkeypatch) -> Log:
    monkeypatch.setattr(notices, 'STANDS_S', 0.0)
    return Log(*(lines.append for lines in logged.values()))


def test_where_there_is_no_terminal_only_advice_is_logged_once(log, logged):
    stream = io.StringIO()
    screens = Screens('/vio_evaluator', NodeConfig(), log, stream)
    for _ in range(2):
        screens.show(1, [Shown('vins', RUN, [WRONG])], ADVICE)
    screens.close()
    assert logged == {'info': [], 'warning': ADVICE, 'error': []}
    assert stream.getvalue() == ''


def test_on_a_terminal_every_warning_is_logged_once_and_lines_are_drawn(log, logged, monkeypatch):
    monkeypatch.setattr('vio_eval_ros.live.screens.width_of', lambda stream: 80)
    monkeypatch.setattr('vio_eval_ros.live.status_line.width_of', lambda stream: 80)
    monkeypatch.setenv('NO_COLOR', '1')
    stream = Terminal()
    screens = Screens('/vio_evaluator', NodeConfig(), log, stream)
    for _ in range(2):
        screens.show(1, [Shown('vins', RUN, [WRONG]), Shown('', RUN, [WRONG])], ADVICE)
    screens.close()
    screens.show(1, [Shown('vins', RUN, [WRONG])], [])  # on the way to its end
    screens.close()
    said = 'streams: nobody publishes /odom'
    assert logged['warning'] == [f'vins: {said}', said]
    drawn = 'vins  0 pairs  WARN streams: nobody publishes /odom\x1b[K\n'
    assert stream.getvalue().count(drawn) == 2
    assert stream.getvalue().endswith('\x1b[J')


def test_a_page_that_lacks_a_library_is_refused_by_the_name_of_the_parameter(log, monkeypatch):
    monkeypatch.setitem(sys.modules, 'aiohttp', None)
    with pytest.raises(ConfigError, match=r'^web_port: aiohttp is not installed; pip install'):
        Screens('/vio_evaluator', NodeConfig(web_port=8080), log, io.StringIO())


def test_what_is_no_port_is_refused():
    with pytest.raises(ConfigError, match='web_port: 70000 is no port'):
        NodeConfig(web_port=70_000)
    with pytest.raises(ConfigError, match='web_port: -1 is below 0'):
        NodeConfig(web_port=-1)


@pytest.mark.needs('aiohttp')
def test_an_address_that_is_not_of_this_machine_is_told(log, logged):
    screens = Screens('/e', NodeConfig(web_port=8080, web_host='192.0.2.1'), log, io.StringIO())
    screens.show(1, [Shown('', RUN, [WRONG])], [])
    screens.close()
    (line,) = logged['error']
    assert line.startswith('web_port: no page at 192.0.2.1:8080: ')
    assert '\n' not in line
