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

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError, ReadError, VioEvalError

PASSED, FAILED, UNABLE = 0, 1, 2
MAX_YAML_BYTES = 1 << 20
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
    """An argument parser whose errors are one line, and to which -1e-5 is a number."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False, formatter_class=Help)
        self._negative_number_matcher = re.compile(r'-(\d|\.\d|inf)')

    def error(self, message: str) -> NoReturn:
        """Exit with status 2 and one line on stderr."""
        self.exit(UNABLE, f'{self.prog}: {message}; see {self.prog} --help\n')


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
        # whoever read our output has gone; let nothing try to write the rest at exit
        sys.stdout = None  # type: ignore[assignment]
        return UNABLE
    except OSError as error:
        problem = str(error)
    except KeyboardInterrupt:
        problem = 'interrupted'
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
            print(f'{verb}: {" ".join(problem.split())}', file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = None  # type: ignore[assignment]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add a flag for each option of the evaluation, and ``--config`` for a file of them."""
    group = parser.add_argument_group('evaluation')
    group.add_argument(
        '--config',
        type=Path,
        metavar='FILE',
        help='YAML file with any of the options below; flags override it',
    )
    for option in fields(EvaluationConfig):
        default = getattr(EvaluationConfig(), option.name)
        listed = isinstance(default, tuple)
        words = default if listed else (default,)
        shown = ' '.join(f'{w:g}' if isinstance(w, float) else w for w in words)
        choices = option.metadata['choices']
        unit = option.name.rsplit('_')[-1].upper()
        shape: dict[str, Any] = {'metavar': '|'.join(choices) or unit}
        if option.name.endswith('_to_body'):
            shape = {'nargs': 7, 'metavar': ('X', 'Y', 'Z', 'QX', 'QY', 'QZ', 'QW')}
        elif listed:
            shape['nargs'] = '*'
        group.add_argument(
            '--' + option.name.replace('_', '-'),
            dest=option.name,
            help=f'{option.metadata["description"]} (default: {shown or "none"})',
            **shape,
        )


def config_of(arguments: argparse.Namespace) -> EvaluationConfig:
    """Return the options of the command line over those of ``--config``."""
    values = {} if arguments.config is None else options_of(arguments.config)
    given = {option.name: getattr(arguments, option.name) for option in fields(EvaluationConfig)}
    values |= {name: value for name, value in given.items() if value is not None}
    return EvaluationConfig.from_mapping(values)


def options_of(path: Path) -> dict[str, Any]:
    """Return the options in a YAML file: a plain mapping, or a ROS parameter file."""
    values = load_yaml(path)
    nodes = [name for name in ('/**', 'vio_evaluator', '/vio_evaluator') if name in values]
    if not nodes:
        return values
    merged: dict[str, Any] = {}
    for name in nodes:
        node = values[name]
        parameters = node.get('ros__parameters') if isinstance(node, dict) else None
        if not isinstance(parameters, dict):
            raise ConfigError(f'{path}: {name} has no mapping ros__parameters')
        merged |= parameters
    return merged


def gates_of(path: Path) -> list[Gate]:
    """Return the gates in a YAML file; none at all is an error."""
    gates = Gate.from_mapping(load_yaml(path))
    if not gates:
        raise ConfigError(f'{path}: there are no gates')
    return gates


def load_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file; nothing but plain data is ever made of it."""
    import yaml

    try:
        with path.open(encoding='utf-8') as file:
            text = file.read(MAX_YAML_BYTES + 1)
        if len(text) > MAX_YAML_BYTES:
            raise ReadError(path, 'too large for a file of options')
        _refuse_repetition(path, yaml.compose(text, Loader=yaml.SafeLoader), set())
        values = yaml.safe_load(text)
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ReadError(path, f'not valid YAML: {" ".join(str(error).split())}') from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f'{path}: a mapping of names to values is expected')
    return values


def _refuse_repetition(path: Path, node: Any, seen: set[int]) -> None:
    """Raise where a key is given twice, or an alias repeats a part, perhaps a billion times."""
    children = [] if node is None or isinstance(node.value, str) else node.value
    keys: set[str] = set()
    for child in children:
        pair = child if isinstance(child, tuple) else (child,)
        line = pair[0].start_mark.line + 1
        if len(pair) == 2:
            if str(pair[0].value) in keys:
                raise ReadError(path, f"line {line}: '{pair[0].value}' is there already")
            keys.add(str(pair[0].value))
        for part in pair:
            if id(part) in seen:
                raise ReadError(path, f'line {line}: aliases are not allowed')
            seen.add(id(part))
            _refuse_repetition(path, part, seen)


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
