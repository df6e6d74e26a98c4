"""CPU and memory of processes by their names, and of a GPU."""

import subprocess
import sys
import time

import pytest

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live import processes
from vio_eval_ros.live.processes import Processes

BUSY = """
import time
x = bytearray(60_000_000)
while True:
    end = time.monotonic() + 0.05
    while time.monotonic() < end:
        pass
    time.sleep(0.05)
"""


@pytest.fixture
def busy(tmp_path):
    """Return a process that needs about half of a core and 60 MB, as a script of this name."""
    script = tmp_path / 'vins_node'
    script.write_text(BUSY)
    process = subprocess.Popen([sys.executable, script, '--ros-args', '-r', '__node:=vins'])
    yield process
    process.kill()
    process.wait()


@pytest.mark.slow
@pytest.mark.parametrize('by', ['script', 'node', 'pid'])
def test_what_a_process_costs_comes_back(busy, by):
    name = {'script': 'vins_node', 'node': '/ns/vins', 'pid': str(busy.pid)}[by]
    label = {'script': 'vins_node', 'node': '_ns_vins', 'pid': str(busy.pid)}[by]
    found = Processes([name])
    end_s = time.monotonic() + 20
    while True:
        found._searched_s = -1e9  # it may have begun a moment ago
        found.sample()
        memory = found.metrics()[f'memory_{label}_max_mb']
        if memory > 60 or time.monotonic() > end_s:
            break
        time.sleep(0.1)
    found.begin_run()
    before_s = sum(found._busy_s.values())
    begin_s = time.monotonic()
    found.sample()
    for _ in range(5):
        time.sleep(0.2)
        found.sample()
    used_s = sum(found._busy_s.values()) - before_s
    metrics = found.metrics()
    found.close()
    # whatever the machine gave to it
    share = 100 * used_s / (time.monotonic() - begin_s)
    assert metrics[f'cpu_{label}_mean_percent'] == pytest.approx(share, rel=0.25)
    assert metrics[f'cpu_{label}_p95_percent'] >= metrics[f'cpu_{label}_mean_percent'] > 5
    assert 60 < metrics[f'memory_{label}_max_mb'] < 150
    assert found.missing() == []


def test_nobody_of_that_name_is_unknown_and_told():
    found = Processes(['no such program'])
    found.sample()
    assert found.missing() == ['no such program']
    assert all(value != value for value in found.metrics().values())
    assert list(found.metrics()) == found.names


def test_no_names_cost_nothing():
    found = Processes([])
    found.sample()
    found.close()
    assert (found.names, found.metrics(), found.missing()) == ([], {}, [])


def test_names_that_cannot_be_told_apart_are_refused():
    with pytest.raises(ConfigError, match='two of a-b, a_b give metrics of one name'):
        Processes(['a-b', 'a_b'])


def test_psutil_is_asked_for_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, 'psutil', None)
    with pytest.raises(ConfigError, match='psutil is not installed; pip install psutil'):
        Processes(['vins'])


def test_a_gpu_is_listened_to_where_there_is_one(tmp_path, monkeypatch):
    program = tmp_path / 'nvidia-smi'
    lines = ('#!/bin/sh', 'echo "37, 1000"', 'echo "[N/A], 5"', 'echo "39, 2000"', 'exec sleep 60')
    program.write_text('\n'.join(lines))
    program.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=':')
    found = Processes(['no such program'])
    end_s = time.monotonic() + 20
    while found.metrics()['memory_gpu_max_mb'] != pytest.approx(2097.152):
        assert time.monotonic() < end_s
        found.sample()
        time.sleep(0.02)
    assert found.metrics()['cpu_gpu_mean_percent'] == 38.0
    child = found._gpu._process
    found.close()
    assert child.returncode is not None


def test_without_a_gpu_there_are_no_metrics_of_one(monkeypatch):
    monkeypatch.setattr(processes.shutil, 'which', lambda name: None)
    assert not any('gpu' in name for name in Processes(['x']).names)
