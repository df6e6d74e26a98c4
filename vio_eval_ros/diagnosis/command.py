"""The one command that corrects all that flags can correct."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
import shlex
from typing import TYPE_CHECKING

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.recordings.spec import Spec, STATEMENTS, with_statement

if TYPE_CHECKING:  # whoever only evaluates takes FLAGS_OF from here, and no diagnosis
    from vio_eval_ros.diagnosis.report import Cause

FLAGS_OF = {'estimate': '--estimate', 'ground_truth': '--ground-truth'}


def correcting_command(
    causes: Sequence[Cause],
    specs: Mapping[str, str],
    config: EvaluationConfig,
    inputs: Sequence[str] = (),
) -> str:
    """
    Return the arguments of ``replay`` that undo the causes; empty where no flag undoes any.

    :param specs: of ``estimate`` and ``ground_truth``.
    :param config: the options that were given; they stay as they are where no cause changes them.
    :param inputs: what else names the inputs: a recording, ``--times FILE``.
    """
    stated = dict(specs)
    options = dict(_given(config))
    corrected = False
    for cause in causes:
        statements = [flag[1:] for flag in cause.flags if flag.startswith('?')]
        for statement in statements:
            if statement.partition('=')[0] in STATEMENTS[_kind(stated[cause.side])]:
                stated[cause.side] = with_statement(stated[cause.side], statement)
                corrected = True
        name, *values = [flag for flag in cause.flags if not flag.startswith('?')] or ['']
        if name:
            options[name] = values
            corrected = True
    if not corrected:
        return ''
    words = [word for side, spec in stated.items() for word in (FLAGS_OF[side], spec)]
    given = [word for name, values in options.items() for word in (name, *values)]
    return shlex.join(['replay', *inputs, *words, *given])


def _kind(spec: str) -> str:
    return 'topic' if Spec.parse(spec).topic else 'file'


def _given(config: EvaluationConfig) -> Iterator[tuple[str, list[str]]]:
    """Yield the flags of options that are not at their default."""
    usual = EvaluationConfig()
    for item in fields(config):
        value = getattr(config, item.name)
        if value != getattr(usual, item.name):
            values = value if isinstance(value, tuple) else (value,)
            yield '--' + item.name.replace('_', '-'), [_text(one) for one in values]


def _text(value: object) -> str:
    return f'{value:.17g}' if isinstance(value, float) else str(value)
