"""Every metric by its name: what it is, its formula, and what to keep in mind of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import re

from vio_eval_ros.core.config import ALIGNMENTS
from vio_eval_ros.core.statistics import STATISTICS

#: what stands in the names of metrics for what varies
PLACEHOLDERS = {
    'STATISTIC': '|'.join(STATISTICS),
    'ALIGNMENT': '|'.join(ALIGNMENTS),
    'DELTA': r'[0-9.]+[fsmd]',
    'LENGTH': r'[0-9.]+',
    'PROCESS': r'\w+',
}


@dataclass(frozen=True)
class Term:
    """
    A metric.

    :param name: as in gates and JSON, with placeholders for what varies.
    :param words: what it is, as reports call it.
    :param formula: with g and G the true position and pose, e and P the estimated ones, and s, R,
        t the alignment.
    :param caveat: when it misleads or is null.
    """

    name: str
    words: str
    formula: str
    caveat: str = ''

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """What the names of the metric match."""
        pattern = self.name
        for placeholder, choices in PLACEHOLDERS.items():
            pattern = pattern.replace(placeholder, f'(?:{choices})')
        return re.compile(pattern)


GLOSSARY = (
    Term(
        'ate_trans_STATISTIC_m',
        'ATE of position [m]',
        '|s R e + t - g| of each pair',
        'depends on the alignment; one early error moves the whole run',
    ),
    Term(
        'ate_rot_STATISTIC_deg',
        'ATE of rotation [deg]',
        'angle of (R R_e)ᵀ R_g of each pair',
        'null without orientations, or where the motion does not determine R',
    ),
    Term(
        'ate_ALIGNMENT_trans_rmse_m',
        'ATE of position by alignment [m]',
        'the RMSE of |s R e + t - g| under that alignment',
        'always given, whatever alignment was chosen',
    ),
    Term(
        'sim3_scale',
        'scale of the estimate',
        's of the sim3 alignment; truth is s times the estimate',
        '1 is ideal; a monocular system cannot observe it',
    ),
    Term(
        'ate_extent_ratio',
        'ATE over the extent of the run',
        'ATE over the RMS distance of the truth from its mean',
        'at 1, standing still would be as good; above 0.5 a run counts as diverged',
    ),
    Term(
        'rpe_DELTA_trans_STATISTIC_m',
        'RPE of position over a delta [m]',
        '|E_t| of E = (G_i⁻¹ G_j)⁻¹ (P_i⁻¹ P_j)',
        'over frames it depends on the rate; compare equal rates only',
    ),
    Term(
        'rpe_DELTA_rot_STATISTIC_deg',
        'RPE of rotation over a delta [deg]',
        'angle of E_R',
        'null without orientations',
    ),
    Term(
        'rpe_DELTA_disp_STATISTIC_m',
        'RPE of displacement over a delta [m]',
        '|s R (e_j - e_i) - (g_j - g_i)|',
        'needs no orientations; depends on the rotation of the alignment',
    ),
    Term(
        'rpe_DELTA_dist_STATISTIC_m',
        'RPE of distance over a delta [m]',
        '| s |e_j - e_i| - |g_j - g_i| |',
        'needs no orientations; blind to direction',
    ),
    Term('rpe_DELTA_pairs', 'relative motions over a delta', 'how many there are'),
    Term(
        'segment_LENGTHm_trans_percent',
        'drift of position over a length [%]',
        'mean of |E_t| over segments of that length of path, divided by it',
        'only with segment_lengths_m; null where the path is shorter',
    ),
    Term(
        'segment_LENGTHm_rot_deg_per_m',
        'drift of rotation over a length [deg/m]',
        'mean of the angle of E_R, divided by the length',
        'only with segment_lengths_m; null where the path is shorter',
    ),
    Term('segment_LENGTHm_segments', 'segments of a length', 'how many there are'),
    Term(
        'kitti_trans_percent',
        'KITTI drift of position [%]',
        'the same over 100, 200, ... 800 m together',
        'null where the path is shorter than 100 m',
    ),
    Term(
        'kitti_rot_deg_per_m',
        'KITTI drift of rotation [deg/m]',
        'the same over 100, 200, ... 800 m together',
        'null where the path is shorter than 100 m',
    ),
    Term('kitti_segments', 'KITTI segments', 'how many there are'),
    Term(
        'path_length_m',
        'path of the ground truth [m]',
        'sum of |g_k+1 - g_k| over the pairs',
        'noise of a fast truth lengthens it, a sparse truth shortens it',
    ),
    Term(
        'drift_percent',
        'drift at the end [%]',
        '|E_t| from the first pair to the last, over path_length_m',
        'rests on two poses; zero by chance where errors happen to cancel',
    ),
    Term(
        'nees_position_mean',
        'NEES of position',
        'mean of dᵀ C⁻¹ d, with d the error and C its covariance as the estimate has it',
        '3 is consistent, more is overconfident; null without covariances',
    ),
    Term(
        'nees_orientation_mean',
        'NEES of orientation',
        'mean of dᵀ C⁻¹ d, with d the rotation vector of the error',
        '3 is consistent, more is overconfident; null without covariances',
    ),
    Term(
        'coverage_ratio',
        'coverage of the ground truth',
        'time tracked over the duration of the truth',
        'read it first: a system that fails early has a splendid ATE',
    ),
    Term(
        'tracked_ratio',
        'coverage since the first estimate',
        'time tracked over the duration of the truth from the first pair on',
        'does not count a late start; initialisation_s does',
    ),
    Term(
        'initialisation_s',
        'start of the estimate [s]',
        'from the first true pose to the first pair',
    ),
    Term(
        'matched_ratio',
        'share of estimates with a partner',
        'pairs over estimates',
        'low where clocks differ or the truth is sparse',
    ),
    Term(
        'ate_causal_trans_rmse_m',
        'ATE of position as first published [m]',
        'the ATE of each pose before later messages revised it',
        'null unless the estimate is a Path',
    ),
    Term(
        'ate_causal_rot_rmse_deg',
        'ATE of rotation as first published [deg]',
        'likewise',
        'null unless the estimate is a Path',
    ),
    Term(
        'loop_closure_gain',
        'loop-closure gain',
        'ATE as last revised over ATE as first published',
        '0.5 to 0.9 is usual; above 1.05 revisions did harm',
    ),
    Term(
        'latency_median_s',
        'latency, median [s]',
        'from the stamp of a pose to its arrival at the evaluator',
        'live only; null where stamps and node have different clocks',
    ),
    Term(
        'latency_p99_s',
        'latency, 99th percentile [s]',
        'likewise',
        'live only; null where stamps and node have different clocks',
    ),
    Term(
        'held_trans_rmse_m',
        'error of the last pose that had arrived [m]',
        '|s R e + t - g| at each true pose, of the newest e that had arrived by then',
        'live only; what a controller would have gone by',
    ),
    Term(
        'propagated_trans_rmse_m',
        'the same, propagated by its twist [m]',
        'likewise, of e moved at the twist of its message since its stamp',
        'live only; null where the messages have no twist',
    ),
    Term(
        'real_time_factor',
        'real-time factor',
        'seconds of stamps over seconds of the clock on the wall',
        'live only; below the rate of the recording, the stack does not keep up',
    ),
    Term(
        'cpu_PROCESS_mean_percent',
        'CPU of a process, mean [%]',
        'of one core; with the processes it started',
        'live only, with the option processes',
    ),
    Term(
        'cpu_PROCESS_p95_percent',
        'CPU of a process, 95th percentile [%]',
        'likewise, of samples over a second each',
        'live only, with the option processes',
    ),
    Term(
        'memory_PROCESS_max_mb',
        'memory of a process, most [MB]',
        'resident, with the processes it started',
        'live only, with the option processes; for gpu, what is used on it',
    ),
)


def term_of(metric: str) -> Term | None:
    """Return what the glossary has of a metric, by its whole name."""
    return next((term for term in GLOSSARY if term.pattern.fullmatch(metric)), None)


def listed() -> str:
    """Return the names of all metrics with their words, as help shows them."""
    width = max(len(term.name) for term in GLOSSARY)
    return '\n'.join(f'  {term.name:<{width}}  {term.words}' for term in GLOSSARY)


def in_words(metric: str) -> str:
    """Return what a metric is, with what varies in its name: its name where it is not known."""
    term = term_of(metric)
    if term is None:
        return metric
    delta = re.match(r'(?:rpe|segment)_([0-9.]+[fsmd])_', metric)
    alignment = re.match(rf'ate_({PLACEHOLDERS["ALIGNMENT"]})_', metric)
    words = term.words
    if delta:
        words = words.replace('a delta', delta[1]).replace('a length', delta[1])
    if alignment:
        under = 'without alignment' if alignment[1] == 'none' else f'under {alignment[1]}'
        words = words.replace('by alignment', under)
    return words
