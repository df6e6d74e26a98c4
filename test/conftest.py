"""What the tests share: where the real recordings are."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Return the folder of real recordings; skip where it is absent, fail where it is required."""
    beside = Path(__file__).resolve().parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('VIO_EVAL_ROS_DATA', beside))
    if folder.is_dir():
        return folder
    if os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1':
        pytest.fail(f'{folder} is required here and missing')
    pytest.skip(f'no real recordings at {folder}')


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where everything was skipped, though the real recordings are required."""
    reporter = session.config.pluginmanager.get_plugin('terminalreporter')
    required = os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1'
    if required and reporter is not None and not reporter.stats.get('passed'):
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED
