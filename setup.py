"""Installs the package with colcon (`ament_python`) and with plain pip alike."""

from glob import glob

from setuptools import find_packages, setup

from vio_eval_ros.__main__ import VERBS

NAME = 'vio_eval_ros'
IMAGES = ['Pillow']
IMU = ['allantools', 'matplotlib', 'plotly']
PANDAS = ['pandas']
REPORT = ['plotly']
# ROS 2 Jazzy where none is installed; rclpy does not start without the second
ROS = ['ros-jazzy-rclpy', 'ros-jazzy-rmw-fastrtps-cpp', 'ros-jazzy-common-interfaces']

setup(
    name=NAME,
    # a literal, since that is what catkin_prepare_release can raise
    version='0.1.0',
    description='Accuracy of visual-inertial odometry and SLAM, while it runs and afterwards',
    license='Apache-2.0',
    maintainer='vio_eval_ros maintainers',
    maintainer_email='maintainers@vio-eval-ros.example.org',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed'], f'{NAME}.rendering': ['page.css', 'page.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', sorted(glob('config/*.*'))),
        (f'share/{NAME}/config/gates', sorted(glob('config/gates/*.yaml'))),
        (f'share/{NAME}/config/suites', sorted(glob('config/suites/*.yaml'))),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    entry_points={
        'console_scripts': [f'{verb} = {module}:main' for verb, (module, _) in VERBS.items()],
    },
    zip_safe=True,
    python_requires='>=3.10',
    install_requires=[
        'mcap>=1.2',
        'numpy>=1.26',
        'PyYAML',
        # the first that lists topics without messages and lets go of a damaged bag
        'rosbags>=0.11.7',
        'tabulate',
        'tqdm',
    ],
    extras_require={
        'images': IMAGES,
        'imu': IMU,
        'pandas': PANDAS,
        'report': REPORT,
        'ros': ROS,
        'test': [
            *IMAGES,
            *IMU,
            *PANDAS,
            *REPORT,
            *ROS,
            'colcon-common-extensions',
            # the oracle; its newest releases need Python 3.11
            'evo==1.38.1; python_version >= "3.11"',
            'hypothesis',
            'ipykernel',
            'jsonschema',
            'markdown-it-py',
            'mypy',
            'nbclient',
            'nbformat',
            'playwright',
            'pytest',
            'pytest-xdist',
            'ruff',
            # the oracle of the permutation test
            'scipy>=1.15',
            'types-PyYAML',
            'types-tabulate',
            'types-tqdm',
            'xmlschema',
        ],
    },
)
