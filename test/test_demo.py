"""The live demo does what the documentation shows, and says so where it cannot."""

import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
DEMO = (sys.executable, ROOT / 'demo' / 'live.py', ROOT / 'demo' / 'simulated_flight')
LIMIT_S = 90


def figures(text: str) -> str:
    """Return a text without the last digits of its numbers, which differ between processors."""
    return ' '.join(re.sub(r'(\.\d{6})\d+', r'\1', text).split())


@pytest.mark.needs('rclpy')
def test_the_figures_change_while_it_plays_and_equal_those_of_replay_in_the_end(tmp_path):
    done = subprocess.run(
        [*DEMO, tmp_path / 'report'],
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT_S,
        env=os.environ | {'PYTHONPATH': str(ROOT)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = re.findall(r'^ +(\d+)((?: +\d+\.\d+){4})$', done.stdout, re.MULTILINE)
    poses = [int(count) for count, _ in rows]
    assert len(rows) >= 5
    assert poses == sorted(set(poses))
    assert len({values for _, values in rows}) == len(rows)
    head, _, rest = done.stdout.partition('In the end')
    end = re.match('.*(?=^\\d+ of \\d+ figures)', rest, re.DOTALL | re.MULTILINE)[0]
    shown_there = (ROOT / 'docs' / 'live.md').read_text()
    assert figures(end) in figures(shown_there)
    assert head.splitlines()[2] in shown_there  # the names of the columns
    result = json.loads((tmp_path / 'report' / 'result.json').read_text())
    assert result['inputs']['estimate']['kind'] == 'topic'
    assert result['association']['pairs'] == 1200


@pytest.mark.needs('rclpy')
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_leaves_no_process(tmp_path, number):
    demo = subprocess.Popen(
        [*DEMO, tmp_path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {'PYTHONPATH': str(ROOT), 'PYTHONUNBUFFERED': '1'},
    )
    for line in demo.stdout:
        if 'poses' in line:
            break
    children = Path(f'/proc/{demo.pid}/task/{demo.pid}/children')
    started: set[str] = set()
    for _ in demo.stdout:  # a row of figures: both are running
        started |= set(children.read_text().split())
        break
    demo.send_signal(number)
    _, complaint = demo.communicate(timeout=LIMIT_S)
    assert demo.returncode == 1
    assert complaint.strip() == 'interrupted'
    assert len(started) == 2
    assert not any(Path(f'/proc/{number}').exists() for number in started)


def test_without_ros_it_is_one_line_that_names_the_other_demo(tmp_path):
    (tmp_path / 'diagnostic_msgs.py').write_text("raise ImportError('no ROS here')")
    done = subprocess.run(
        [*DEMO, tmp_path],
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT_S,
        env=os.environ | {'PYTHONPATH': str(tmp_path)},
    )
    assert done.returncode == 1
    assert done.stdout == ''
    assert done.stderr == (
        'The live demo needs ROS 2 (no ROS here); `make demo-offline` does without.\n'
    )
