"""Processes on a ROS graph of their own: what they have used so far, and their end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import random
import re
import signal
import subprocess
from typing import Any

PROJECT = Path(__file__).resolve().parents[1]


def private_graph() -> dict[str, str]:
    """Return what makes processes meet each other on the ROS graph, and nobody else."""
    return {
        'PYTHONPATH': os.pathsep.join([str(PROJECT), os.environ.get('PYTHONPATH', '')]),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(random.randint(30, 60)),
    }


@contextmanager
def started(command: Sequence[Any], **options: Any) -> Iterator[subprocess.Popen]:
    """Start a process; kill it behind the with statement if it is still there."""
    with subprocess.Popen([str(word) for word in command], **options) as process:
        try:
            yield process
        finally:
            process.kill()


def interrupted(process: subprocess.Popen, patience_s: float) -> bool:
    """Return whether a process ends within some seconds after Ctrl-C."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        return False
    return True


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used, all its threads, user and system."""
    return _cpu_s(Path(f'/proc/{pid}/stat'))


def thread_cpu_s(pid: int) -> dict[str, float]:
    """Return the CPU time that threads of a process have used, by their names."""
    used_s: dict[str, float] = {}
    for task in Path(f'/proc/{pid}/task').iterdir():
        name = (task / 'comm').read_text().strip()
        used_s[name] = used_s.get(name, 0.0) + _cpu_s(task / 'stat')
    return used_s


def resident_bytes(pid: int) -> int:
    """Return what a process has in memory that is its own, not mapped files."""
    status = Path(f'/proc/{pid}/status').read_text()
    (anonymous,) = re.findall(r'RssAnon:\s+(\d+) kB', status)
    return int(anonymous) * 1024


def _cpu_s(stat: Path) -> float:
    fields = stat.read_text().rpartition(')')[2].split()  # behind a name, which may have spaces
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
