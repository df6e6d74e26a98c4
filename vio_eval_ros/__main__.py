"""
Run any verb without ROS: ``python -m vio_eval_ros VERB``.

With ROS the same verbs are ``ros2 run vio_eval_ros VERB``.
"""

from __future__ import annotations

import difflib
import importlib
import sys

#: Every verb: the module whose ``main`` runs it, and what it does. ``setup.py`` reads it too.
VERBS: dict[str, tuple[str, str]] = {
    'evaluator': ('vio_eval_ros.cli.evaluator', 'score a running estimator, live in ROS 2'),
    'replay': ('vio_eval_ros.cli.replay', 'score one recording or a pair of trajectory files'),
    'score': ('vio_eval_ros.cli.score', 'score a suite of runs against gates and a baseline'),
    'imu_noise': ('vio_eval_ros.cli.imu_noise', 'measure the noise of an IMU at rest'),
    'diagnose': ('vio_eval_ros.cli.diagnose', 'say why an estimate is bad'),
    'simulate': ('vio_eval_ros.cli.simulate', 'write a run with known truth and chosen faults'),
    'inspect': ('vio_eval_ros.cli.inspect', 'look for faults in the streams of a recording'),
    'play': ('vio_eval_ros.cli.play', 'publish a recording into ROS 2'),
}


def _usage() -> str:
    verbs = '\n'.join(f'  {verb:<12}{purpose}' for verb, (_, purpose) in VERBS.items())
    return f'usage: python -m vio_eval_ros VERB ...\n\n{verbs}\n\nVERB --help lists its options.'


def main(argv: list[str] | None = None) -> int:
    """
    Run the verb that the first argument names, and import no other.

    :param argv: verb and its arguments; those of the process where None.
    :return: the verb's exit status; 2 where there is no such verb.
    """
    argv = sys.argv[1:] if argv is None else argv
    if not argv:
        print(_usage(), file=sys.stderr)
        return 2
    verb, *arguments = argv
    if verb in ('-h', '--help'):
        print(_usage())
        return 0
    if verb not in VERBS:
        near = difflib.get_close_matches(verb, VERBS, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'?" if near else f'choose from {", ".join(VERBS)}'
        print(f"vio_eval_ros: there is no verb '{verb}'; {hint}", file=sys.stderr)
        return 2
    module, _ = VERBS[verb]
    try:
        status: int = importlib.import_module(module).main(arguments)
    except KeyboardInterrupt:  # it is not that far yet
        print(f'{verb}: interrupted', file=sys.stderr)
        return 2
    return status


if __name__ == '__main__':
    sys.exit(main())
