"""
What other tools do by default, as options of ours.

A preset gives the number that the tool would print for the same files; where a rule of it has no
option here, ``docs/coming-from-evo.md`` says which, and by how much the numbers differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

AS = 'begin with the defaults of that tool instead of ours; other options override them'
#: of evo 1.38.1 (``evo_ape`` and ``evo_rpe`` without flags), of rpg_trajectory_evaluation (class
#: ``Trajectory`` without ``eval_cfg.yaml``), of the KITTI odometry devkit, of ``error_singlerun
#: posyaw`` in OpenVINS, and of ``evaluate_ate.py`` of the TUM RGB-D benchmark
PRESETS: dict[str, Mapping[str, Any]] = {
    'evo': {
        'max_difference_s': 0.01,
        'alignment': 'none',
        'rpe_deltas': ('1f',),
        'rpe_pairs': 'sequential',
    },
    'rpg': {
        'max_difference_s': 0.02,
        'alignment': 'sim3',
        'rpe_deltas': ('10%', '20%', '30%', '40%', '50%'),
        'rpe_pairs': 'all',
        'rpe_tolerance': '20%',
    },
    'kitti': {
        'alignment': 'none',
        'rpe_deltas': ('1f',),
        'segment_lengths_m': tuple(float(length) for length in range(100, 900, 100)),
    },
    'ov_eval': {
        'max_difference_s': 0.02,
        'alignment': 'posyaw',
        'rpe_deltas': ('8m', '16m', '24m', '32m', '40m'),
        'rpe_pairs': 'all',
        'rpe_tolerance': '0.5',
    },
    'tum_rgbd': {
        'max_difference_s': 0.02,
        'alignment': 'se3',
        'rpe_deltas': ('1s',),
        'rpe_pairs': 'all',
    },
}
