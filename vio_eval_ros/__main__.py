# PYTHON_ARGCOMPLETE_OK
"""
The command ``vio_eval VERB``, which is ``python -m vio_eval_ros VERB`` as well.

In a ROS 2 workspace every verb is an executable: ``ros2 run vio_eval_ros VERB``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import difflib
from functools import partial
import importlib
import os
import sys

from vio_eval_ros.cli.command import called_as, COMMAND
from vio_eval_ros.errors import MissingPackage, UNABLE
from vio_eval_ros.version import __version__

#: Every verb: the module whose ``main`` runs it, and what it does. ``setup.py`` reads it too.
VERBS: dict[str, tuple[str, str]] = {
    'evaluator': ('vio_eval_ros.cli.evaluator', 'score a running estimator, live in ROS 2'),
    'replay': ('vio_eval_ros.cli.replay', 'score one recording or a pair of trajectory files'),
    'score': ('vio_eval_ros.cli.score', 'score a suite of runs against gates and a baseline'),
    'plot': ('vio_eval_ros.cli.plot', 'draw figures of runs, ready for a paper'),
    'imu_noise': ('vio_eval_ros.cli.imu_noise', 'measure the noise of an IMU at rest'),
    'diagnose': ('vio_eval_ros.cli.diagnose', 'say why an estimate is bad'),
    'simulate': ('vio_eval_ros.cli.simulate', 'write a run with known truth and chosen faults'),
    'inspect': ('vio_eval_ros.cli.inspect', 'look for faults in the streams of a recording'),
    'convert': ('vio_eval_ros.cli.convert', 'write a trajectory in another format'),
    'info': ('vio_eval_ros.cli.info', 'say what is in trajectories: span, rate, length, gaps'),
    'play': ('vio_eval_ros.cli.play', 'publish a recording into ROS 2'),
}


def _usage() -> str:
    verbs = '\n'.join(f'  {verb:<12}{purpose}' for verb, (_, purpose) in VERBS.items())
    command = called_as() or COMMAND
    return f"usage: {command} VERB ...\n\n{verbs}\n\n'{command} VERB --help' lists its options."


def main(argv: list[str] | None = None) -> int:
    """
    Run the verb that the first argument names, and import no other.

    :param argv: verb and its arguments; those of the process where None.
    :return: the verb's exit status; 2 where there is no such verb.
    """
    argv = sys.argv[1:] if argv is None else argv
    if '_ARGCOMPLETE' in os.environ:
        argv = _verb_to_complete()
    if not argv:
        print(_usage(), file=sys.stderr)
        return 2
    verb, *arguments = argv
    if verb in ('-h', '--help', 'help'):
        try:
            print(_usage(), flush=True)
        except BrokenPipeError:  # whoever reads it, such as head, has seen enough
            sys.stdout = None
        return 0
    if verb == '--version':
        print(f'{COMMAND} {__version__}')
        return 0
    if verb not in VERBS:
        near = difflib.get_close_matches(verb, VERBS, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'?" if near else f'choose from {", ".join(VERBS)}'
        print(f"{COMMAND}: there is no verb '{verb}'; {hint}", file=sys.stderr)
        return 2
    return _call(verb, arguments)


def __getattr__(name: str) -> Callable[[], int]:
    """Return the ``main`` of a verb, by the name of the verb: the executables of ROS call it."""
    if name in VERBS:
        return partial(_call, name)
    raise AttributeError(name)


def _call(verb: str, arguments: list[str] | None = None) -> int:
    """Return the exit status of a verb; handle what can happen before the verb handles it."""
    try:
        status: int = importlib.import_module(VERBS[verb][0]).main(arguments)
    except KeyboardInterrupt:
        problem = 'interrupted'
    except ModuleNotFoundError as error:
        problem = str(MissingPackage(error))
    else:
        return status
    print(f'{verb}: {problem}', file=sys.stderr)
    return UNABLE


def _verb_to_complete() -> list[str]:
    """
    Complete the verb itself and exit, or return the verb whose parser is to complete the rest.

    See https://kislyuk.github.io/argcomplete/ for the variables by which the shell asks.
    """
    import argcomplete
    from argcomplete.lexers import split_line

    line, point = os.environ['COMP_LINE'], int(os.environ['COMP_POINT'])
    *_, words, _ = split_line(line, point)
    first = int(os.environ['_ARGCOMPLETE'])  # 1 + the number of words before ours: an interpreter
    if len(words) > first and words[first] in VERBS:
        os.environ['_ARGCOMPLETE'] = str(first + 1)
        return [words[first]]
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument('verb', choices=VERBS)
    argcomplete.autocomplete(parser)
    return []


if __name__ == '__main__':
    sys.exit(main())
