"""What every verb shares: options from the one table, errors as one line, progress."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
import io
import os
from pathlib import Path
import re
import sys
import time
from typing import Any, NoReturn

from vio_eval_ros.cli.command import called_as
from vio_eval_ros.cli.completion import complete, words
from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.presets import AS, PRESETS
from vio_eval_ros.errors import ConfigError, MissingPackage, UNABLE, VioEvalError
from vio_eval_ros.rendering.text import printable
from vio_eval_ros.settings import options_of

BAR_AFTER_S = 0.5


class Help(argparse.RawDescriptionHelpFormatter):
    """As wide as the terminal; argparse itself loads much more to find out, at every start."""

    def __init__(self, prog: str) -> None:
        try:
            width = os.get_terminal_size().columns - 2
        except OSError:
            width = 98
        super().__init__(prog, width=width)


class Parser(argparse.ArgumentParser):
    """
    The arguments of a verb; errors are one line, and -1e-5 is a number.

    :param prog: the verb. Usage and examples show it as it was called.
    """

    def __init__(self, prog: str, description: str | None, epilog: str) -> None:
        self.verb = prog
        command = f'{called_as()} {prog}'.lstrip()
        super().__init__(
            prog=command,
            description=description,
            epilog=epilog.replace(f'\n  {prog} ', f'\n  {command} '),
            allow_abbrev=False,
            formatter_class=Help,
        )
        self._negative_number_matcher = re.compile(r'-(\d|\.\d|inf)')

        #: what to say of one argument too many, given it and all others
        self.advise: Callable[[str, argparse.Namespace], str] = lambda word, _: ''

    def parse_args(self, *args: Any, **options: Any) -> Any:
        """Parse the arguments, or complete them where the shell asks for that."""
        if '_ARGCOMPLETE' in os.environ:
            import argcomplete

            argcomplete.autocomplete(self, always_complete_options=False)
        arguments, unknown = self.parse_known_args(*args, **options)
        if unknown:
            self._refuse(unknown, arguments)
        return arguments

    def _refuse(self, unknown: list[str], arguments: argparse.Namespace) -> NoReturn:
        """Name the first unknown option and the nearest one, or the argument that is too much."""
        for word in unknown:
            option = word.partition('=')[0]
            if option.startswith('-') and option != '-':
                near = nearest_name(option, self._option_string_actions)
                self.error(f"there is no option '{option}'{near}")
        advice = self.advise(unknown[0], arguments)
        self.error(f"'{unknown[0]}' is one argument too many{advice}")

    def error(self, message: str) -> NoReturn:
        """Exit with status 2 and one line on stderr."""
        wrong = re.match(r".*invalid choice: '(.*)' \(choose from (.*)\)", message)
        if wrong:
            message += nearest_name(wrong[1], re.findall(r'[\w-]+', wrong[2]))
        end = ' ' if message.endswith('?') else '; '
        self.exit(UNABLE, f'{self.verb}: {message}{end}see {self.prog} --help\n')


def run(verb: str, main: Callable[[], int]) -> int:
    """
    Return the exit status of a verb; whatever it could not do becomes one line on stderr.

    In Python's development mode (``python -X dev``) an unexpected error is raised instead.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')  # names need not fit the terminal
    try:
        return main()
    except VioEvalError as error:
        problem = str(error)
    except BrokenPipeError:
        # the reader of our output is gone; nothing may try to write the rest at exit
        sys.stdout = None
        return UNABLE
    except OSError as error:
        problem = str(error)
    except KeyboardInterrupt:
        problem = 'interrupted'
    except ModuleNotFoundError as error:
        problem = str(MissingPackage(error))
    except MemoryError:
        problem = 'there is not enough memory'
    except Exception as error:
        if sys.flags.dev_mode:
            raise
        problem = (
            f'this is a bug, please report it: {type(error).__name__}: {error} '
            '(python -X dev shows where)'
        )
    complain(verb, problem)
    return UNABLE


def complain(verb: str, problem: str) -> None:
    """Print one line on stderr, if anybody listens."""
    try:
        if sys.stderr is not None:
            print(f'{verb}: {printable(" ".join(problem.split()))}', file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = None


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add a flag for each option of the evaluation, and ``--config`` for a file of them."""
    group = parser.add_argument_group('evaluation')
    group.add_argument(
        '--config',
        type=Path,
        metavar='FILE',
        help='YAML file with any of the options below; flags override it',
    )
    action = group.add_argument(
        '--as',
        dest='as',
        metavar='|'.join(PRESETS),
        help=AS,
    )
    complete(action, words(PRESETS))
    for option in fields(EvaluationConfig):
        default = getattr(EvaluationConfig(), option.name)
        listed = isinstance(default, tuple)
        values = default if listed else (default,)
        shown = ' '.join(f'{v:g}' if isinstance(v, float) else v for v in values)
        choices = option.metadata['choices']
        unit = option.name.rsplit('_')[-1].upper()
        shape: dict[str, Any] = {'metavar': '|'.join(choices) or unit}
        if option.name.endswith('_to_body'):
            shape = {'nargs': 7, 'metavar': ('X', 'Y', 'Z', 'QX', 'QY', 'QZ', 'QW')}
        elif listed:
            shape['nargs'] = '*'
        text = f'{option.metadata["description"]} (default: {shown or "none"})'
        action = group.add_argument(
            '--' + option.name.replace('_', '-'),
            dest=option.name,
            help=text.replace('%', '%%'),
            **shape,
        )
        if choices:
            complete(action, words(choices))


def config_of(arguments: argparse.Namespace) -> EvaluationConfig:
    """Return the options of the command line over those of ``--config``."""
    values = {} if arguments.config is None else options_of(arguments.config)
    try:
        EvaluationConfig.from_mapping(values)
    except ConfigError as error:
        raise ConfigError(f'{arguments.config}: {error}') from None
    names = ['as', *(option.name for option in fields(EvaluationConfig))]
    given = {name: getattr(arguments, name) for name in names}
    values |= {name: value for name, value in given.items() if value is not None}
    return EvaluationConfig.from_mapping(values)


def progress(items: Iterable[Any], total: int) -> Iterator[Any]:
    """Yield the items; a read that takes long shows a bar, if stderr is a terminal."""
    items, begin, done = iter(items), time.monotonic(), 0
    if sys.stderr is not None and sys.stderr.isatty():
        for item in items:
            yield item
            done += 1
            if time.monotonic() - begin > BAR_AFTER_S:
                from tqdm import tqdm

                items = tqdm(items, 'reading', total, initial=done, unit='', leave=False)
                break
    yield from items
