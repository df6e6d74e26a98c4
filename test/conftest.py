"""What the tests share: real recordings, made-up ones, and the package as colcon installs it."""

from collections.abc import Callable, Iterator
import ctypes
from dataclasses import replace
from html.parser import HTMLParser
from importlib.util import find_spec
import io
import json
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
from typing import Any

import numpy as np
from PIL import Image
import pytest

from recorded_poses import poses, record, stamped, STORE
from ros_domain import private_domain
from vio_eval_ros.simulation import simulate

# What `nohup make test &` ignores would be ignored in every process that a test starts: a handler
# of Python's is not inherited.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

ROOT = Path(__file__).resolve().parents[1]
ON_A_ROS_GRAPH = ('ros', 'test_demo.py', 'test_launch.py', 'test_layouts.py')
REQUIRED = os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1'
#: the files of tests that were not collected, with the module that each lacks
LEFT_OUT = pytest.StashKey[dict[str, str]]()
EXECUTED = {'passed', 'failed', 'error', 'xfailed'}
SLOW_FIXTURES = {'browser', 'colcon'}
# What is in a clone and matters for building: no environments, no results of earlier builds.
NOT_COPIED = shutil.ignore_patterns('.*', 'build', 'install', 'log', '*.egg-info', '__pycache__')


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out a file of tests that imports what is not installed, and say so at the end."""
    if collection_path.suffix != '.py' or REQUIRED:
        return None
    imported = re.findall(r'^(?:import|from) (\w+)', collection_path.read_text(), re.MULTILINE)
    for module in dict.fromkeys(imported):
        if is_missing(module):
            config.stash.setdefault(LEFT_OUT, {})[collection_path.name] = module
            return True
    return None


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Say what was left out."""
    for name, module in config.stash.get(LEFT_OUT, {}).items():
        terminalreporter.write_line(f'left out: {name}, since {module} is not installed')


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `make test-fast` leaves out, as far as folder or fixtures decide it."""
    for item in items:
        for module in (mark.args[0] for mark in item.iter_markers('needs')):
            if is_missing(module):
                item.add_marker(pytest.mark.skip(reason=f'{module} is not installed'))
        if any(item.path.is_relative_to(ROOT / 'test' / name) for name in ON_A_ROS_GRAPH):
            item.add_marker(pytest.mark.ros)
        if SLOW_FIXTURES.intersection(getattr(item, 'fixturenames', ())):
            item.add_marker(pytest.mark.slow)


def is_missing(module: str) -> bool:
    """Return whether a module is not installed."""
    try:
        return find_spec(module) is None
    except ImportError:  # a part of what is not there
        return True


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Return the folder of real recordings; skip where it is absent, fail where it is required."""
    beside = Path(__file__).resolve().parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('VIO_EVAL_ROS_DATA', beside))
    if folder.is_dir():
        return folder
    if REQUIRED:
        pytest.fail(f'{folder} is required here and missing')
    pytest.skip(f'no real recordings at {folder}')


@pytest.fixture
def tf2_msgs(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Return where tf2_msgs is, as `make test` builds it; skip where that was not possible."""
    if find_spec('tf2_msgs') is not None:
        yield ''
        return
    prefix = Path(sys.prefix) / 'messages'
    (found,) = list(prefix.glob('lib/python3*/site-packages')) or [None]
    if found is None and REQUIRED:
        pytest.fail('tf2_msgs is required here and not built: test/messages/build.py')
    if found is None:
        pytest.skip('tf2_msgs is neither installed nor built: test/messages/build.py')
    monkeypatch.syspath_prepend(str(found))
    for name, path in (
        ('PYTHONPATH', found),
        ('LD_LIBRARY_PATH', prefix / 'lib'),
        ('AMENT_PREFIX_PATH', prefix),
    ):
        monkeypatch.setenv(name, str(path), prepend=os.pathsep)
    for library in sorted(prefix.glob('lib/*typesupport*.so')):
        ctypes.CDLL(str(library))  # this process looks for libraries where it did at its start
    yield str(found)
    for name in [name for name in sys.modules if name.partition('.')[0] == 'tf2_msgs']:
        del sys.modules[name]


@pytest.fixture(scope='session')
def colcon() -> str:
    beside_python = Path(sys.executable).parent
    found = shutil.which('colcon', path=f'{beside_python}{os.pathsep}{os.environ["PATH"]}')
    if found:
        return found
    if REQUIRED:
        pytest.fail('colcon is required here and missing')
    pytest.skip('colcon is not installed')


@pytest.fixture(scope='session')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a colcon workspace with a copy of the package in ``src``."""
    folder = tmp_path_factory.mktemp('workspace')
    shutil.copytree(ROOT, folder / 'src' / 'vio_eval_ros', ignore=NOT_COPIED)
    return folder


@pytest.fixture(scope='session')
def installed(colcon: str, workspace: Path) -> Path:
    """Return the folder into which colcon installed the package."""
    command = [colcon, '--log-base', 'log', 'build']
    done = subprocess.run(command, cwd=workspace, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / 'install' / 'vio_eval_ros'


@pytest.fixture
def ros_environment() -> Iterator[dict[str, str]]:
    """Return an environment with a ROS graph that no other test is on, in whatever process."""
    with private_domain() as variables:
        yield os.environ | {'PYTHONPATH': str(ROOT)} | variables


@pytest.fixture(scope='session')
def revising_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """
    Return a rosbag2 of a SLAM that publishes its whole Path twice a second.

    Each message on ``/slam/path`` takes back half of the drift of those before, as a loop closure
    does; ``/ground_truth/pose`` beside it has 200 poses a second.
    """
    flight = simulate(duration_s=15.0)
    messages = [('/ground_truth/pose', pose) for pose in poses(flight.ground_truth)]
    estimate, drift = flight.estimate, np.linspace(0, 1, len(flight.estimate)) ** 2
    for end in range(10, len(estimate) + 1, 10):
        positions = estimate.positions[:end].copy()
        positions[-10:, 2] += 2 * drift[end - 10 : end]
        positions[:-10, 2] += drift[: end - 10]
        path = poses(replace(estimate[:end], positions=positions))
        stamp_ns = int(estimate.stamps_ns[end - 1])
        messages.append(('/slam/path', stamped('nav_msgs/msg/Path', stamp_ns, path)))
    return record(tmp_path_factory.mktemp('slam') / 'recording', messages)


@pytest.fixture(scope='session')
def leica_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a rosbag2 with poses on ``/vio/pose`` and positions on ``/leica/position``."""
    flight, point = simulate(duration_s=15.0), STORE.types['geometry_msgs/msg/Point']
    messages = [('/vio/pose', pose) for pose in poses(flight.estimate)]
    truth = flight.ground_truth[::10]
    messages += [
        ('/leica/position', stamped('geometry_msgs/msg/PointStamped', stamp_ns, point(*p)))
        for stamp_ns, p in zip(truth.stamps_ns.tolist(), truth.positions, strict=True)
    ]
    return record(tmp_path_factory.mktemp('leica') / 'recording', messages)


class Parsed(HTMLParser):
    """
    What a browser takes an HTML report for.

    ``elements`` are name and attributes of each, in order, ``text`` is what is read, ``styles``
    and ``scripts`` are not.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.content: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self.content.append('')

    def handle_endtag(self, tag: str) -> None:
        self.elements.append((f'/{tag}', {}))
        self.content.append(' ')

    def handle_data(self, data: str) -> None:
        if self.content:
            self.content[-1] += data

    def of(self, name: str) -> list[tuple[dict[str, str | None], str]]:
        """Return attributes and the text up to the next tag of the elements of a name."""
        found = zip(self.elements, self.content, strict=True)
        return [(attributes, text) for (tag, attributes), text in found if tag == name]

    @property
    def text(self) -> str:
        found = zip(self.elements, self.content, strict=True)
        return ''.join(text for (tag, _), text in found if tag not in ('script', 'style'))

    @property
    def figures(self) -> list[dict[str, Any]]:
        """What is drawn, as plotly's dicts."""
        return [json.loads(text) for attributes, text in self.of('script') if attributes]


@pytest.fixture(scope='session')
def parsed() -> Callable[[str], Parsed]:
    """Return how to parse an HTML report."""
    return Parsed


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    """Return a headless Chromium; skip where there is none, fail where it is required."""
    names = ('chromium', 'chromium-browser', 'google-chrome')
    executable = next(filter(None, map(shutil.which, names)), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing = 'playwright is not installed'
    else:
        missing = None if executable else 'there is no chromium in PATH'
    if missing and os.environ.get('VIO_EVAL_ROS_REQUIRE_BROWSER') == '1':
        pytest.fail(f'a browser is required here, and {missing}')
    if missing:
        pytest.skip(missing)
    with sync_playwright() as playwright:
        # 3-D without a graphics card
        software = ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader']
        browser = playwright.chromium.launch(executable_path=executable, args=software)
        yield browser
        browser.close()


IN_SIGHT = "[...document.querySelectorAll('.plot')].filter(box => box.checkVisibility())"


class Window:
    """
    A browser's window, in which HTML reports are looked at.

    Whatever it shows: all plots in sight are drawn and have colours in them, nothing is complained
    of, nothing is fetched, and nothing reaches beyond the window at the right.
    """

    def __init__(self, browser: Any, file: Path) -> None:
        self.page = browser.new_page()
        self.page.set_default_timeout(120_000)
        self._file = file
        self._complaints: list[str] = []
        self.page.on('console', self._hear)
        self.page.on('pageerror', lambda error: self._complaints.append(str(error)))
        self.page.on('request', self._notice)

    def open(self, text: str, width: int) -> None:
        """Show a report in a width, and check what can be seen of it."""
        self._file.write_text(text, encoding='utf-8')
        self.page.set_viewport_size({'width': width, 'height': 900})
        self.page.goto(self._file.as_uri())
        self.check()

    def check(self) -> None:
        """Check what can be seen now."""
        self.wait(f"{IN_SIGHT}.every(box => box.querySelector('.main-svg'))")
        for box in self.page.query_selector_all('.plot'):
            if box.evaluate('box => box.checkVisibility()'):
                assert self._has_colours(box), box.get_attribute('aria-label')
        assert self.page.evaluate('document.documentElement.scrollWidth <= innerWidth')
        assert not self._complaints

    def wait(self, expression: str) -> None:
        """Wait until something is so; the page itself may not evaluate what it is given."""
        for _ in range(600):
            if self.page.evaluate(expression):
                return
            self.page.wait_for_timeout(100)
        raise AssertionError(f'after 60 s it is still not so: {expression}')

    def _has_colours(self, box: Any) -> bool:
        """Return whether something coloured is drawn, as soon as it is."""
        for _ in range(100):
            pixels = np.asarray(Image.open(io.BytesIO(box.screenshot())).convert('RGB'), int)
            if np.count_nonzero(np.ptp(pixels, axis=2) > 60) > 20:
                return True
            self.page.wait_for_timeout(100)
        return False

    def _hear(self, said: Any) -> None:
        if said.type == 'error':
            self._complaints.append(said.text)

    def _notice(self, request: Any) -> None:
        if request.url != self._file.as_uri() and not request.url.startswith(('data:', 'blob:')):
            self._complaints.append(f'asked for {request.url}')


@pytest.fixture
def window(browser: Any, tmp_path: Path) -> Iterator[Window]:
    """Return a window of a browser."""
    window = Window(browser, tmp_path / 'report.html')
    yield window
    window.page.close()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """
    Fail where no test was executed, be it that all were skipped.

    The status of pytest for that, 5, is success for colcon.
    """
    reporter = session.config.pluginmanager.get_plugin('terminalreporter')
    is_listing = session.config.option.collectonly
    if reporter is not None and not is_listing and not reporter.stats.keys() & EXECUTED:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line('no test was executed', red=True)
