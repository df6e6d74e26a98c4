"""Installs the package with colcon (`ament_python`) and with plain pip alike."""

from glob import glob
from pathlib import Path
import sys

from setuptools import find_packages, setup

from vio_eval_ros.__main__ import VERBS

NAME = 'vio_eval_ros'
URL = 'https://github.com/vio-eval-ros/vio_eval_ros'
# resolved, since `colcon build --symlink-install` runs a link to this file
README = Path(__file__).resolve().with_name('README.md')

# Pip gives one command, `vio_eval VERB`: names such as `play` would hide other programs. ROS gets
# an executable for each verb in lib/vio_eval_ros, where `ros2 run` looks. setup.cfg sends the
# scripts of exactly these two commands there, which colcon and bloom run, and pip does not.
FOR_ROS = not {'develop', 'install'}.isdisjoint(sys.argv)
COMMANDS = [f'{verb} = {NAME}.__main__:{verb}' for verb in VERBS]

GEO = ['pymap3d']
IMAGES = ['Pillow']
IMU = ['allantools', 'matplotlib', 'plotly']
PANDAS = ['pandas']
# its fields have said whether they are repeated since then
# constrained layout with legends outside of the axes, and columns of legends
PLOT = ['matplotlib>=3.7']
PROTOBUF = ['protobuf>=6.31']
PX4 = ['pyulog']
# the cost of a running stack
PROCESSES = ['psutil']
# release 6 is another library under the same name
TERMINAL = ['plotext>=5.3,<6']
REPORT = ['plotly']
# the page of the running evaluator; it ends slow requests since then
WEB = ['aiohttp>=3.9', 'plotly']
# ROS 2 Jazzy where none is installed; rclpy does not start without the second
ROS = ['ros-jazzy-rclpy', 'ros-jazzy-rmw-fastrtps-cpp', 'ros-jazzy-common-interfaces']

setup(
    name=NAME,
    # a literal, since that is what catkin_prepare_release can raise
    version='0.1.0',
    description='Scores visual-inertial odometry and SLAM against ground truth, live and offline',
    long_description=README.read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    keywords='ros ros2 vio slam odometry evaluation benchmark trajectory ate rpe imu',
    license='Apache-2.0',
    maintainer='vio_eval_ros maintainers',
    maintainer_email='maintainers@vio-eval-ros.example.org',
    url=URL,
    project_urls={
        'Documentation': f'{URL}/tree/main/docs',
        'Source': URL,
        'Issues': f'{URL}/issues',
        'Changelog': f'{URL}/blob/main/CHANGELOG.rst',
    },
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Intended Audience :: Developers',
        'Intended Audience :: Science/Research',
        'Operating System :: MacOS',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.10',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Topic :: Scientific/Engineering',
        'Topic :: Software Development :: Quality Assurance',
        'Typing :: Typed',
    ],
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={
        NAME: ['py.typed'],
        f'{NAME}.figures': ['paper.mplstyle'],
        f'{NAME}.rendering': ['page.css', '*.js'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', sorted(glob('config/*.*'))),
        (f'share/{NAME}/config/gates', sorted(glob('config/gates/*.yaml'))),
        (f'share/{NAME}/config/suites', sorted(glob('config/suites/*.yaml'))),
        # where the files above look for them, so that editors complete them
        (f'share/{NAME}/docs/schema', sorted(glob('docs/schema/*.json'))),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    entry_points={
        'console_scripts': COMMANDS if FOR_ROS else [f'vio_eval = {NAME}.__main__:main'],
    },
    zip_safe=True,
    python_requires='>=3.10',
    install_requires=[
        'argcomplete',
        # part of Python since 3.14
        'backports.zstd; python_version < "3.14"',
        'lz4',
        'mcap>=1.2',
        'numpy>=1.26',
        # the first that lists topics without messages and lets go of a damaged bag
        'rosbags>=0.11.7',
        'ruamel.yaml',
        'tabulate',
        'tqdm',
    ],
    extras_require={
        'geo': GEO,
        'images': IMAGES,
        'imu': IMU,
        'pandas': PANDAS,
        'plot': PLOT,
        'processes': PROCESSES,
        'protobuf': PROTOBUF,
        'px4': PX4,
        'report': REPORT,
        # of several hundred megabytes, hence not for the tests
        'rerun': ['rerun-sdk>=0.24'],
        'ros': ROS,
        'terminal': TERMINAL,
        'web': WEB,
        'test': [
            *GEO,
            *IMAGES,
            *IMU,
            *PANDAS,
            *PLOT,
            *PROCESSES,
            *PROTOBUF,
            *PX4,
            *REPORT,
            *ROS,
            *TERMINAL,
            *WEB,
            'build',
            'check-jsonschema',
            'colcon-common-extensions',
            # make docs
            'furo',
            # the oracle; its newest releases need Python 3.11
            'evo==1.38.1; python_version >= "3.11"',
            'hypothesis',
            'ipykernel',
            'jsonschema',
            'markdown-it-py',
            'mypy',
            'nbclient',
            'nbformat',
            'myst-parser',
            'playwright',
            'pytest',
            'pytest-xdist',
            # the tests read what is written with another library
            'PyYAML',
            'ruff',
            # the oracle of the permutation test
            'scipy>=1.15',
            'twine',
            'sphinx',
            'sphinx-copybutton',
            'types-PyYAML',
            'types-protobuf',
            'types-psutil',
            'types-tabulate',
            'types-tqdm',
            'wheel',
            'xmlschema',
            'zizmor',
        ],
    },
)
