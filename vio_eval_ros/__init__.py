"""
Accuracy of visual-inertial odometry and SLAM, while it runs and afterwards.

As a library::

    import vio_eval_ros as vio

    result = vio.evaluate('estimate.txt', 'V1_02_medium', alignment='sim3')
    result.metrics['ate_trans_rmse_m']
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, TYPE_CHECKING

from vio_eval_ros.version import __version__

if TYPE_CHECKING:
    from vio_eval_ros.api import compare, diagnose, evaluate, imu_noise, inspect, read
    from vio_eval_ros.core.config import EvaluationConfig
    from vio_eval_ros.core.gates import Gate
    from vio_eval_ros.errors import (
        ConfigError,
        InputError,
        NoPairs,
        ReadError,
        UnsupportedMessage,
        VioEvalError,
        WriteError,
    )
    from vio_eval_ros.recordings.arrays import trajectory
    from vio_eval_ros.recordings.sources import Source
    from vio_eval_ros.results import Comparison, Diagnosis, ImuNoise, Inspection, Result

#: the modules of the names below
HOMES = ('errors', 'api', 'results', 'recordings.arrays')
__all__ = [
    'Comparison',
    'ConfigError',
    'Diagnosis',
    'EvaluationConfig',
    'Gate',
    'ImuNoise',
    'InputError',
    'Inspection',
    'NoPairs',
    'ReadError',
    'Result',
    'Source',
    'UnsupportedMessage',
    'VioEvalError',
    'WriteError',
    '__version__',
    'compare',
    'diagnose',
    'evaluate',
    'imu_noise',
    'inspect',
    'read',
    'trajectory',
]


def __getattr__(name: str) -> Any:
    """Import a name of the face when it is first used: command lines start without it."""
    if name in __all__:
        for home in HOMES:
            module = import_module(f'vio_eval_ros.{home}')
            if hasattr(module, name):
                return getattr(module, name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return __all__
