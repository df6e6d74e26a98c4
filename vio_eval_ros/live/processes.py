"""What the processes of the stack cost: CPU and memory, and the GPU where there is one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import os
import re
import shutil
import subprocess
import time
from typing import Any

import numpy as np

from vio_eval_ros.errors import ConfigError

#: how often to look for processes of these names: looking at all of them takes some time
SEARCH_S = 5.0
GPU = 'gpu'
GPU_QUERY = (
    'nvidia-smi',
    '--query-gpu=utilization.gpu,memory.used',
    '--format=csv,noheader,nounits',
    '--loop=1',
)
MEGABYTE = 1e6


class Usage:
    """Samples of CPU [% of a core] and memory [MB] of one thing, over a run."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._cpu: list[float] = []
        self._memory: list[float] = []

    @property
    def names(self) -> tuple[str, str, str]:
        """The names of its metrics."""
        return (
            f'cpu_{self._label}_mean_percent',
            f'cpu_{self._label}_p95_percent',
            f'memory_{self._label}_max_mb',
        )

    def add(self, cpu_percent: float, memory_mb: float) -> None:
        """Add a sample."""
        self._cpu.append(cpu_percent)
        self._memory.append(memory_mb)

    def begin(self) -> None:
        """Forget the samples so far."""
        self._cpu, self._memory = [], []

    def metrics(self) -> dict[str, float]:
        """Return mean and 95th percentile of the CPU, and the most memory; NaN of no sample."""
        values = (np.nan, np.nan, np.nan)
        if self._cpu:
            p95 = float(np.percentile(self._cpu, 95))
            values = (float(np.mean(self._cpu)), p95, max(self._memory))
        return dict(zip(self.names, values, strict=True))


class Processes:
    """
    Samples processes by their names.

    :param names: of executables, scripts or ROS nodes, or process ids.
    :raises ConfigError: psutil is not installed, or two names give the same metric.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._usages = {name: Usage(re.sub(r'\W', '_', name)) for name in names}
        if len(set(self.names)) < len(self.names):
            raise ConfigError(f'processes: two of {", ".join(names)} give metrics of one name')
        if not names:
            return
        try:
            import psutil
        except ImportError:
            raise ConfigError(
                'processes: psutil is not installed; pip install psutil, or install the package '
                'python3-psutil'
            ) from None
        self._psutil = psutil
        self._found: dict[str, dict[int, Any]] = {name: {} for name in names}
        self._busy_s: dict[Any, float] = {}  # CPU time of each process when last looked at
        self._searched_s = self._sampled_s = -np.inf
        self._gpu = _Gpu()
        if self._gpu.answers:
            self._usages[GPU] = self._gpu.usage

    @property
    def names(self) -> list[str]:
        """The names of all metrics."""
        return [name for usage in self._usages.values() for name in usage.names]

    def sample(self) -> None:
        """Look at all processes."""
        if not self._usages:
            return
        now_s = time.monotonic()
        if now_s - self._searched_s > SEARCH_S:
            self._searched_s = now_s
            self._search()
        for name, found in self._found.items():
            self._sample(self._usages[name], found, now_s - self._sampled_s)
        self._sampled_s = now_s
        self._gpu.read()

    def begin_run(self) -> None:
        """Forget what was sampled so far."""
        for usage in self._usages.values():
            usage.begin()

    def metrics(self) -> dict[str, float]:
        """Return the metrics of the run so far."""
        return {k: v for usage in self._usages.values() for k, v in usage.metrics().items()}

    def missing(self) -> list[str]:
        """Return the names of which there is no process."""
        return [name for name, found in self._found.items() if not found] if self._usages else []

    def close(self) -> None:
        """End what was started."""
        if self._usages:
            self._gpu.close()

    def _search(self) -> None:
        self._found = {name: {} for name in self._found}
        for process in self._psutil.process_iter(['name', 'cmdline']):
            words = process.info['cmdline'] or []
            for name, found in self._found.items():
                if process.pid != os.getpid() and _is_called(name, process, words):
                    family = self._family(process)
                    found |= {one.pid: one for one in family}

    def _family(self, process: Any) -> Iterator[Any]:
        """Yield a process and those that it started."""
        yield process
        try:
            yield from process.children(recursive=True)
        except self._psutil.Error:
            return

    def _sample(self, usage: Usage, found: Mapping[int, Any], seconds: float) -> None:
        busy_s = memory = 0.0
        seen = False
        for process in found.values():
            try:
                with process.oneshot():
                    times, size = process.cpu_times(), process.memory_info().rss
            except self._psutil.Error:  # it has ended
                continue
            total_s = times.user + times.system
            known = process in self._busy_s
            busy_s += total_s - self._busy_s.get(process, total_s)
            self._busy_s[process] = total_s
            memory += size / MEGABYTE
            seen |= known
        if seen:
            usage.add(100 * busy_s / seconds, memory)


class _Gpu:
    """What nvidia-smi tells once a second, where it is there."""

    def __init__(self) -> None:
        self.usage = Usage(GPU)
        self._process: subprocess.Popen[bytes] | None = None
        self._rest = b''
        if shutil.which(GPU_QUERY[0]):
            self._process = subprocess.Popen(
                GPU_QUERY,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            assert self._process.stdout is not None
            os.set_blocking(self._process.stdout.fileno(), False)

    @property
    def answers(self) -> bool:
        """Whether there is one."""
        return self._process is not None

    def read(self) -> None:
        """Take in what it has told since the last call."""
        if self._process is None:
            return
        assert self._process.stdout is not None
        *lines, self._rest = (self._rest + (self._process.stdout.read() or b'')).split(b'\n')
        for line in lines:
            numbers = re.fullmatch(rb'\s*([\d.]+)\s*,\s*([\d.]+)\s*', line)
            if numbers:
                self.usage.add(float(numbers[1]), float(numbers[2]) * 1.048576)

    def close(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def _is_called(name: str, process: Any, words: Sequence[str]) -> bool:
    """Return whether a process is what a name means."""
    if name.isdigit():
        return bool(process.pid == int(name))
    node = f'__node:={name.rpartition("/")[2]}'
    # an interpreter's script is its first argument
    programs = {os.path.basename(word) for word in words[:2]} | {process.info['name']}
    return name in programs or node in words
