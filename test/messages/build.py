"""
Builds tf2_msgs, which is not on PyPI, for the tests of transforms.

It goes into the folder ``messages`` of the virtual environment that runs this, with the generators
of ROS 2 from PyPI. Where that is not possible, one line says why, and those tests are skipped.
"""

from __future__ import annotations

from importlib.util import find_spec
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile

HERE = Path(__file__).resolve().parent
PREFIX = Path(sys.prefix) / 'messages'
TOOLS = [
    'empy==3.3.4',
    'lark',
    *(
        f'ros-jazzy-{name}'
        for name in (
            'ament-cmake',
            'ament-cmake-gmock',
            'ament-cmake-gtest',
            'ament-cmake-include-directories',
            'ament-cmake-pytest',
            'ament-cmake-ros',
            'ament-package',
            'fastrtps-cmake-module',
            'geometry-msgs',
            'python-cmake-module',
            'rosidl-core-generators',
            'rosidl-default-generators',
            'rosidl-default-runtime',
        )
    ),
]
#: where the machine that made the wheels had Python, and where it is here
FOREIGN = {
    r'/opt/python/cp\d+-cp\d+/include/python[\d.]+': sysconfig.get_path('include'),
    r'/opt/python/cp\d+-cp\d+/lib/python[\d.]+/site-packages': sysconfig.get_path('purelib'),
}


def build() -> None:
    """Build and install the package."""
    run(sys.executable, '-m', 'pip', 'install', '-qq', '--disable-pip-version-check', *TOOLS)
    for file in (Path(sys.prefix) / 'share').rglob('*.cmake'):
        text = ours = file.read_text()
        for foreign, path in FOREIGN.items():
            ours = re.sub(foreign, path, ours)
        if ours != text:
            file.write_text(ours)
    libraries = f'{PREFIX}/lib;{sys.prefix}/lib'
    with tempfile.TemporaryDirectory() as folder:
        run(
            'cmake',
            *('-S', HERE / 'tf2_msgs', '-B', folder),
            f'-DCMAKE_PREFIX_PATH={sys.prefix}',
            f'-DCMAKE_INSTALL_PREFIX={PREFIX}',
            f'-DCMAKE_INSTALL_RPATH={libraries}',
            f'-DPython3_EXECUTABLE={sys.executable}',
            '-DBUILD_TESTING=OFF',
        )
        run('cmake', '--build', folder, '--parallel', '2')
        run('cmake', '--install', folder)


def run(*command: str | Path) -> None:
    """Run a program as the generators want it to be run; raise what it says if it fails."""
    paths = {
        'PATH': f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}',
        'AMENT_PREFIX_PATH': sys.prefix,
        'PYTHONPATH': sysconfig.get_path('purelib'),
    }
    done = subprocess.run(
        command, env=os.environ | paths, capture_output=True, text=True, check=False
    )
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines() or ['no reason given']
        raise RuntimeError(f'{Path(command[0]).name}: {said[-1]}')


if __name__ == '__main__':
    try:
        # in a ROS installation it is there; its sources beside this file are no package of Python
        if not getattr(find_spec('tf2_msgs'), 'origin', None):
            build()
    except (OSError, RuntimeError) as error:
        shutil.rmtree(PREFIX, ignore_errors=True)
        print(f'tf2_msgs cannot be built here ({error}): the tests of transforms are skipped')
