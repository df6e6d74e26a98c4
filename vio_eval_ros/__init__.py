"""
Accuracy of visual-inertial odometry and SLAM, while it runs and afterwards.

As a library::

    import vio_eval_ros as vio

    result = vio.evaluate('estimate.txt', 'V1_02_medium', alignment='sim3')
    result.metrics['ate_trans_rmse_m']
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from vio_eval_ros.version import __version__

if TYPE_CHECKING:
    from vio_eval_ros.api import evaluate, read, Result, trajectory
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
    from vio_eval_ros.recordings.sources import Source

__all__ = [
    'ConfigError',
    'EvaluationConfig',
    'Gate',
    'InputError',
    'NoPairs',
    'ReadError',
    'Result',
    'Source',
    'UnsupportedMessage',
    'VioEvalError',
    'WriteError',
    '__version__',
    'evaluate',
    'read',
    'trajectory',
]


def __getattr__(name: str) -> Any:
    """Import the face when it is first used, so that command lines start without it."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from vio_eval_ros import api, errors

    value = getattr(errors if hasattr(errors, name) else api, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
