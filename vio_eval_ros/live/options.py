"""The options of the evaluator beside those of the evaluation."""

from __future__ import annotations

from dataclasses import dataclass

from vio_eval_ros.core.config import option, Options
from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.errors import ConfigError

#: may be set while the node runs: they do not change what a score means
SETTABLE = ('report_dir', 'window_s', 'stale_after_s', 'exit_code_from_gates')
LAST_PORT = 65_535


@dataclass(frozen=True)
class NodeConfig(Options):
    """The options of the evaluator beside those of the evaluation."""

    estimate: str = option(
        '', 'topic of the estimate, or /tf:PARENT.CHILD; empty: estimate, which can be remapped'
    )
    ground_truth: str = option(
        '', 'topic of the ground truth, or /tf:PARENT.CHILD; empty: ground_truth, likewise'
    )
    estimate_frames: tuple[str, ...] = option(
        (), 'the estimate as two frames of /tf: parent and child'
    )
    ground_truth_frames: tuple[str, ...] = option(
        (), 'the ground truth as two frames of /tf: parent and child'
    )
    estimates: tuple[str, ...] = option(
        (), 'several estimates: NAME:=TOPIC of each, or NAME:=/tf:PARENT.CHILD'
    )
    estimate_type: str = option('', 'message type of the estimate; empty: found out')
    ground_truth_type: str = option('', 'message type of the ground truth; empty: found out')
    ground_truth_file: str = option(
        '', 'ground truth instead of the topic: TUM or EuRoC file or folder, or RECORDING:/topic'
    )
    gates_file: str = option('', 'YAML file of gates: {metric: {max: number, min: number}}')
    profile: str = option(
        PROFILES[0], 'platform, where what the diagnosis calls healthy depends on it', PROFILES
    )
    limits_file: str = option('', 'YAML file of limits: {diagnose: {name: number}}')
    report_dir: str = option('', 'folder for the report of each run; empty: none is written')
    checkpoint_s: float = option(
        0.0,
        'how often the run is saved in report_dir, so that a node that was killed goes on with '
        'it; 0: never',
        minimum=0.0,
    )
    publish_metrics: tuple[str, ...] = option(
        ('ate_trans_rmse_m', 'ate_rot_rmse_deg', 'rpe_1s_trans_rmse_m', 'rpe_1s_rot_rmse_deg'),
        'metrics with topics of their own, ~/metrics/NAME and ~/window/NAME',
    )
    window_s: float = option(10.0, 'length of the window of ~/window/NAME', minimum=0.1)
    stale_after_s: float = option(2.0, 'a stream silent for longer is stale', minimum=0.0)
    processes: tuple[str, ...] = option(
        (), 'names of programs or nodes of the stack, of which CPU and memory are measured'
    )
    web_port: int = option(
        0, 'port of a page that shows path, errors and statuses; 0: none', minimum=0
    )
    web_host: str = option(
        '127.0.0.1', 'address of that page; by default only for browsers on this machine'
    )
    publish_tf: bool = option(
        False,
        'publish the alignment on /tf: the world of the estimate in that of the ground truth',
    )
    max_pairs: int = option(
        1_000_000,
        'how many pairs are kept; with more, rmse stay exact, other metrics are of a part',
        minimum=1000,
    )
    exit_code_from_gates: bool = option(False, 'exit with status 1 where a gate of any run failed')

    def __post_init__(self) -> None:
        """Check every option."""
        super().__post_init__()
        if self.web_port > LAST_PORT:
            raise ConfigError(f'web_port: {self.web_port} is no port: they end at {LAST_PORT}')
