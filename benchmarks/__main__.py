"""Runs all benchmarks, one after the other: ``python benchmarks [--quick]``."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

SCRIPTS = ('compare.py', 'suite.py', 'live.py', 'play.py', 'confusion.py', 'imu_noise.py')


def main(options: list[str]) -> int:
    """Return 1 where a target is missed, after all have run."""
    done = [
        subprocess.run([sys.executable, Path(__file__).with_name(script), *options], check=False)
        for script in SCRIPTS
    ]
    return int(any(process.returncode for process in done))


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
