"""The server of the page: who is answered, what is sent, and that nobody can hold it up."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
import http.client
import json
import socket
import sys
import time

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live import web
from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.live.page import View
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.simulation import simulate

pytestmark = pytest.mark.needs('aiohttp')
HOSTILE = '</script><script>hacked=1</script><img src=x onerror=hacked=1>'
LIMIT_S = 30


@pytest.fixture
def complaints() -> list[str]:
    return []


@pytest.fixture
def server(complaints) -> Iterator[web.PageServer]:
    with closing(web.PageServer('/vio_evaluator', '127.0.0.1', 0, complaints.append)) as server:
        yield server


@pytest.fixture(scope='module')
def views() -> list[View]:
    """Return two estimates, 20 s into their run; one has names that do no good."""
    flight, found = simulate(duration_s=20.0), []
    for label, topic in (('vins', '/vio/odometry'), ('openvins', HOSTILE)):
        run = LiveRun(RunSetup(EvaluationConfig(), (topic, '/ground_truth/pose')))
        run.add_estimate(flight.estimate)
        run.add_ground_truth(flight.ground_truth)
        for _ in run.advance():
            pass
        statuses = [
            Status('accuracy', Level.OK, 'running', {}),
            Status('streams', Level.WARN, f'nobody publishes {topic}', {}),
        ]
        found.append(View.of(label, run, statuses))
    return found


def wait_until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@contextmanager
def asked(
    server: web.PageServer, path: str, method: str = 'GET', **headers: str
) -> Iterator[http.client.HTTPResponse]:
    """Yield the answer to a request; its headers may replace those of the client."""
    connection = http.client.HTTPConnection('127.0.0.1', port_of(server), timeout=LIMIT_S)
    with closing(connection):
        connection.putrequest(method, path, skip_host='Host' in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        with connection.getresponse() as answer:
            yield answer


def heard(answer: http.client.HTTPResponse) -> dict:
    """Return the next state that is sent."""
    while not (line := answer.readline()).startswith(b'data: '):
        assert line
    return json.loads(line.removeprefix(b'data: '))


def port_of(server: web.PageServer) -> int:
    return int(server.address.rsplit(':', 1)[1].rstrip('/'))


def test_the_page_is_given_as_a_whole_and_never_from_a_store(server):
    with asked(server, '/') as answer:
        assert answer.status == 200
        assert answer.read().decode().endswith('</html>\n')
        assert answer.headers['Cache-Control'] == 'no-store'
        assert answer.headers['Content-Type'] == 'text/html; charset=utf-8'
        assert answer.headers['X-Frame-Options'] == 'DENY'


def test_who_listens_is_sent_each_state_once(server, views):
    assert not server.is_watched
    with asked(server, '/events') as answer:
        assert answer.headers['Content-Type'] == 'text/event-stream'
        wait_until(lambda: server.is_watched)
        assert answer.readline() == b'retry: 2000\n'
        for run in (1, 2):
            server.show(run, views)
            told = heard(answer)
            assert told['run'] == run
            assert [estimate['label'] for estimate in told['estimates']] == ['vins', 'openvins']
    wait_until(lambda: not server.is_watched)


@pytest.mark.parametrize(
    ('host', 'status'),
    [
        ('localhost:8080', 200),
        ('127.0.0.1', 200),
        ('[::1]:8080', 200),
        (socket.gethostname().upper(), 200),
        ('evil.example', 403),
        ('evil.example:8080', 403),
        ('localhost.evil.example', 403),
        ('127.0.0.1.evil.example', 403),
        ('[', 403),
        ('', 403),
    ],
)
def test_only_who_asks_for_this_machine_is_answered(server, host, status):
    for path in ('/', '/events'):
        with asked(server, path, Host=host) as answer:
            assert answer.status == status


def test_there_is_nothing_else_and_nothing_can_be_sent(server):
    with asked(server, '/../../etc/passwd') as answer:
        assert answer.status == 404
    with asked(server, '/', 'POST') as answer:
        assert answer.status == 405


def test_a_port_that_is_taken_is_an_error_at_once(server):
    with pytest.raises(OSError, match='address already in use'):
        web.PageServer('/vio_evaluator', '127.0.0.1', port_of(server), print)


def test_clients_beyond_the_most_are_turned_away_and_leave_room_again(server, monkeypatch):
    monkeypatch.setattr(web, 'MOST_CONNECTIONS', 3)
    address = ('127.0.0.1', port_of(server))
    taken = [socket.create_connection(address, timeout=LIMIT_S) for _ in range(3)]
    wait_until(lambda: len(server._runner.server.connections) == 3)
    with closing(socket.create_connection(address, timeout=LIMIT_S)) as beyond:
        with suppress(ConnectionError):
            assert beyond.recv(1) == b''
    for one in taken:
        one.close()
    wait_until(lambda: not server._runner.server.connections)
    with asked(server, '/') as answer:
        assert answer.status == 200


def test_a_client_that_takes_nothing_is_let_go_and_holds_up_nobody(server, views, monkeypatch):
    monkeypatch.setattr(web, 'STUCK_S', 0.5)
    stuck = socket.socket()
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with closing(stuck):
        stuck.connect(('127.0.0.1', port_of(server)))
        stuck.sendall(b'GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n')
        wait_until(lambda: server.is_watched)
        with asked(server, '/events') as answer:
            wait_until(lambda: server._watching == 2)
            run = 0

            def one_more_has_come() -> bool:
                nonlocal run
                run += 1
                server.show(run, views)
                assert heard(answer)['run'] == run
                return server._watching == 1

            wait_until(one_more_has_come)  # what is stuck was let go


def test_what_cannot_be_drawn_is_complained_of_once(server, views, complaints):
    for run in (1, 2):
        server.show(run, [None])
    wait_until(lambda: complaints)
    with asked(server, '/events') as answer:
        wait_until(lambda: server.is_watched)
        server.show(3, views)
        assert heard(answer)['run'] == 3
    (complaint,) = complaints
    assert complaint.startswith('the page failed: this is a bug, please report it: Attribute')


def test_a_server_ends_though_somebody_listens(server):
    with asked(server, '/events') as answer:
        wait_until(lambda: server.is_watched)
        server.close()
        server.close()
        assert answer.read() == b'retry: 2000\n\n'
    with pytest.raises(ConnectionRefusedError), asked(server, '/'):
        pass


def test_without_aiohttp_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, 'aiohttp', None)
    with pytest.raises(ConfigError, match=r"pip install 'vio_eval_ros\[web\]'"):
        web.PageServer('/vio_evaluator', '127.0.0.1', 0, print)


@pytest.mark.parametrize('width', [400, 1240])
def test_a_browser_shows_each_estimate_as_it_goes_on(server, views, browser, width):
    page = browser.new_page(viewport={'width': width, 'height': 900})
    with closing(page):
        complained: list[str] = []
        page.on('pageerror', lambda error: complained.append(str(error)))
        page.on('console', lambda said: complained.append(said.text))
        asked_for: list[str] = []
        page.on('request', lambda request: asked_for.append(request.url))
        page.goto(server.address)
        wait_until(lambda: server.is_watched)
        server.show(1, views)
        page.wait_for_selector('section + section .plot + .plot .main-svg', timeout=120_000)
        assert page.inner_text('header .badge') == 'live'
        assert page.inner_text('#run') == 'run 1'
        assert page.locator('h2').all_inner_texts() == ['vins', 'openvins']
        assert page.locator('.js-plotly-plot').count() == 4
        assert HOSTILE in page.inner_text('section + section p')
        assert HOSTILE in page.inner_text('section + section tr + tr')
        assert page.evaluate('typeof hacked') == 'undefined'
        assert page.evaluate('document.documentElement.scrollWidth <= innerWidth')
        page.emulate_media(color_scheme='dark')
        wait_until(
            lambda: page.evaluate(
                "[...document.querySelectorAll('.plot')].every("
                'box => box.layout.font.color === getComputedStyle(document.body).color)'
            )
        )
        # the next run has one estimate less, and nothing to draw yet
        empty = LiveRun(RunSetup(EvaluationConfig(), ('/vio/odometry', '/truth')))
        server.show(2, [View.of('', empty, [])])
        wait_until(lambda: page.locator('section').count() == 1)
        assert page.inner_text('.caption').startswith('Nothing can be drawn yet')
        assert not page.locator('.plots').is_visible()
        assert set(asked_for) == {server.address, f'{server.address}events'}
        assert not complained
        server.close()
        wait_until(lambda: page.inner_text('header .badge') == 'no connection')
