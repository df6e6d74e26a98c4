"""
The one table of options.

Parameter descriptions, command-line flags, ``config/evaluator.yaml`` and the table in the docs
derive from :class:`EvaluationConfig`, so every shell names, describes and rejects the same things
in the same words.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
import math
import re
from typing import Any, NamedTuple, TypeVar

from vio_eval_ros.core.presets import PRESETS
from vio_eval_ros.errors import ConfigError

ASSOCIATIONS = ('nearest', 'interpolate')
ALIGNMENTS = ('none', 'origin', 'scale', 'posyaw', 'se3', 'sim3')
RPE_PAIRS = ('all', 'sequential')
Kind = TypeVar('Kind', bound='Options')

MAX_LEVER_M = 1e6
MAX_SECONDS = 4e9  # added to today's time, it still fits into int64 nanoseconds
DELTA_UNITS = {
    'f': 'frames',
    's': 'seconds',
    'm': 'metres',
    'd': 'degrees',
    '%': 'percent of the path of the ground truth',
}


class Delta(NamedTuple):
    """The distance between the two poses of a relative error: a value and its unit letter."""

    value: float
    unit: str

    @classmethod
    def parse(cls, text: str) -> Delta:
        """Return the delta that ``10f``, ``1s``, ``0.5m``, ``15d`` or ``20%`` means."""
        match = re.fullmatch(r'(\d+(?:\.\d*)?|\.\d+)([a-z%])', text)
        if not match or match[2] not in DELTA_UNITS or not 1e-9 <= float(match[1]) <= 1e9:
            meant = re.fullmatch(r'([\d.]+) ?(frame|sec|met|deg)[a-z]*', text)
            raise ConfigError(
                f"'{text}' is not a valid delta; write a number without exponent and its unit: "
                'f (frames), s (seconds), m (metres), d (degrees) or % (of the path), such as 1f, '
                '0.5s or 10m' + (f"; did you mean '{meant[1]}{meant[2][0]}'?" if meant else '')
            )
        # as many decimals as its name has
        delta = cls(round(float(match[1]), 9), match[2])
        if delta.unit == 'f' and not delta.value.is_integer():
            raise ConfigError(f"'{text}': frames are counted in whole numbers, such as 10f")
        if delta.unit == '%' and delta.value > 100:
            raise ConfigError(f"'{text}': no part of the path is longer than 100%")
        return delta

    def of_path(self, path_m: float) -> Delta:
        """Return the delta, in whole centimetres where it is a share of a path of that length."""
        if self.unit != '%':
            return self
        length = self.value / 100 * path_m
        return Delta(math.floor(100 * length) / 100 or round(length, 9), 'm')

    def tolerance(self, text: str) -> float:
        """Return the tolerance that ``10%`` of it, or ``0.5`` of its unit, means for a delta."""
        if self.unit == 'f':
            return 0.0
        share = text.removesuffix('%')
        return float(share) if share == text else float(share) / 100 * self.value

    def __str__(self) -> str:
        """Return the delta as it is written in options and metric names."""
        return plain(self.value) + self.unit


def option(
    default: Any, description: str, choices: tuple[str, ...] = (), minimum: float | None = None
) -> Any:
    """Return the field of an option, with its description and limits."""
    metadata = {'description': description, 'choices': choices, 'minimum': minimum}
    if isinstance(default, tuple):
        return field(default_factory=lambda: default, metadata=metadata)
    return field(default=default, metadata=metadata)


class Options:
    """A frozen dataclass of options, which converts values to their types and rejects bad ones."""

    def __post_init__(self) -> None:
        """Convert every value to its type, and reject what is out of range."""
        for item in fields(self):  # type: ignore[arg-type]
            value = _typed(item.name, getattr(self, item.name), item.type)
            object.__setattr__(self, item.name, value)
            choices, minimum = item.metadata['choices'], item.metadata['minimum']
            if choices and value not in choices:
                raise ConfigError(
                    f"{item.name}: '{value}' is not one of {', '.join(choices)}"
                    + nearest_name(value, choices)
                )
            if minimum is not None and not value >= minimum:
                raise ConfigError(f'{item.name}: {value:g} is below {minimum:g}')

    @classmethod
    def from_mapping(cls: type[Kind], values: Mapping[str, Any]) -> Kind:
        """Return the options named in ``values``; an unknown name is an error."""
        names = [item.name for item in fields(cls)]  # type: ignore[arg-type]
        for name in values:
            if name not in names:
                raise ConfigError(f"unknown option '{name}'{nearest_name(str(name), names)}")
        return cls(**values)


@dataclass(frozen=True)
class EvaluationConfig(Options):
    """How an estimate is compared with ground truth; ``ConfigError`` for values without sense."""

    association: str = option(
        'nearest',
        'how stamps are matched: mutually nearest poses, or the denser side interpolated at '
        'every pose of the other',
        ASSOCIATIONS,
    )
    max_difference_s: float = option(
        0.02, 'largest difference between the stamps of a pair (nearest)', minimum=0.0
    )
    max_gap_s: float = option(
        0.5,
        'longest interval that counts as tracking, and over which poses are interpolated',
        minimum=0.0,
    )
    time_offset_s: float = option(0.0, 'added to the stamps of the estimate')
    alignment: str = option(
        'se3',
        'which difference between the two worlds is removed before the absolute error',
        ALIGNMENTS,
    )
    align_first_s: float = option(
        0.0, 'align on the pairs of the first seconds only; 0 aligns on all', minimum=0.0
    )
    rpe_deltas: tuple[str, ...] = option(
        ('1f', '1s', '10m'),
        'distances between the poses of a relative error: f frames, '
        's seconds, m metres, d degrees, % of the path (offline)',
    )
    rpe_tolerance: str = option(
        '10%',
        'by how much the poses of a relative error may be nearer or farther apart: a share of '
        'the delta, such as 10%, or a number in its unit, such as 0.5',
    )
    rpe_pairs: str = option(
        'all',
        'relative errors start at every pose, or each where the previous one ended',
        RPE_PAIRS,
    )
    segment_lengths_m: tuple[float, ...] = option(
        (), 'lengths of ground-truth path over which drift is given in percent'
    )
    start_s: float = option(
        0.0, 'ignore what comes earlier, relative to the first ground truth', minimum=0.0
    )
    end_s: float = option(
        math.inf, 'ignore what comes later, relative to the first ground truth', minimum=0.0
    )
    estimate_to_body: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        'pose x y z qx qy qz qw of the body in the frame that the estimate tracks',
    )
    ground_truth_to_body: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        'pose x y z qx qy qz qw of the body in the frame that the ground truth tracks',
    )

    def __post_init__(self) -> None:
        """Check every option by itself, and against the others."""
        super().__post_init__()
        try:
            deltas = tuple(str(Delta.parse(delta)) for delta in self.rpe_deltas)
        except ConfigError as error:
            raise ConfigError(f'rpe_deltas: {error}') from None
        object.__setattr__(self, 'rpe_deltas', tuple(dict.fromkeys(deltas)))
        if not re.fullmatch(r'(\d+(\.\d*)?|\.\d+)%?', self.rpe_tolerance):
            raise ConfigError(
                f"rpe_tolerance: '{self.rpe_tolerance}' is neither a share of the delta, such as "
                '10%, nor a number in its unit, such as 0.5'
            )
        if self.start_s >= self.end_s:
            raise ConfigError(f'start_s: {self.start_s:g} is not before end_s: {self.end_s:g}')
        lengths = tuple(dict.fromkeys(round(length, 9) for length in self.segment_lengths_m))
        if not all(length > 0 for length in lengths):
            raise ConfigError('segment_lengths_m: every length is a positive number of metres')
        object.__setattr__(self, 'segment_lengths_m', lengths)
        for name in ('estimate_to_body', 'ground_truth_to_body'):
            pose = getattr(self, name)
            if (
                len(pose) != 7
                or abs(math.hypot(*pose[3:]) - 1) > 1e-2
                or max(map(abs, pose)) > MAX_LEVER_M
            ):
                raise ConfigError(
                    f'{name}: give x y z qx qy qz qw with a unit quaternion, '
                    f"not '{' '.join(f'{v:g}' for v in pose)}'"
                )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> EvaluationConfig:
        """Return the options named in ``values``, over those of the tool that ``as`` names."""
        values = dict(values)
        tool = values.pop('as', None)
        if tool is not None and tool not in PRESETS:
            raise ConfigError(
                f"as: '{tool}' is not one of {', '.join(PRESETS)}{nearest_name(tool, PRESETS)}"
            )
        return super().from_mapping({**PRESETS.get(tool, {}), **values})

    def of_path(self, path_m: float) -> EvaluationConfig:
        """Return the options for a ground truth of that length: deltas in % become metres."""
        deltas = (str(Delta.parse(delta).of_path(path_m)) for delta in self.rpe_deltas)
        return replace(self, rpe_deltas=tuple(deltas))

    @property
    def needs_path(self) -> bool:
        """Whether deltas are a share of the path, which is known only at the end of a run."""
        return any(delta.endswith('%') for delta in self.rpe_deltas)

    def to_dict(self) -> dict[str, Any]:
        """Return every option as plain numbers, strings and lists; no end is None."""
        values: dict[str, Any] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, tuple):
                value = list(value)
            values[item.name] = None if value == math.inf else value
        return values


def plain(value: float) -> str:
    """Return a number without an exponent, with at most nine decimals."""
    return f'{value:.9f}'.rstrip('0').rstrip('.')


def nearest_name(name: object, known: Any) -> str:
    """Return '; did you mean ...?' where a known name is close, else nothing."""
    import difflib

    written, names = str(name).lower(), list(map(str, known))
    begun = [one for one in names if len(written) > 3 and one.lower().startswith(written)]
    same = [one for one in names if one.lower() == written]
    close = same or begun or difflib.get_close_matches(str(name), names, n=1)
    return f"; did you mean '{close[0]}'?" if close else ''


def _shown(value: Any) -> str:
    """Return a value as an error shows it, truncated where it is long."""
    if value is None:
        return 'nothing'
    if isinstance(value, (list, tuple)):
        return 'a list'
    if not isinstance(value, (str, int, float)):
        return 'a mapping' if isinstance(value, Mapping) else f'a {type(value).__name__}'
    text = f"'{value}'"
    return text if len(text) <= 60 else text[:60] + "...'"


def _typed(name: str, value: Any, kind: Any) -> Any:
    """Return the value as the type that the annotation ``kind`` of the option names."""
    if hasattr(value, 'tolist'):  # numbers and arrays of NumPy
        value = value.tolist()
    if kind == 'str':
        if isinstance(value, str):
            return value
        raise ConfigError(f'{name}: {_shown(value)} is not a word')
    if kind == 'bool':
        if isinstance(value, bool):
            return value
        raise ConfigError(f'{name}: {_shown(value)} is neither true nor false')
    if kind == 'int':
        number = _number(name, value)
        if number.is_integer():
            return int(number)
        raise ConfigError(f'{name}: {_shown(value)} is not a whole number')
    if kind == 'float':
        return _number(name, math.inf if name == 'end_s' and value is None else value)
    items = [value] if isinstance(value, (str, int, float)) else value
    if not isinstance(items, (list, tuple)):
        raise ConfigError(f'{name}: {_shown(value)} is not a list')
    if kind == 'tuple[str, ...]':
        return tuple(_typed(name, item, 'str') for item in items)
    return tuple(_number(name, item) for item in items)


def _number(name: str, value: Any) -> float:
    """Return a number that an option can take: never NaN, infinite only for ``end_s``."""
    try:
        number = float('nan' if isinstance(value, bool) else value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if math.isnan(number) or (math.isinf(number) and (name != 'end_s' or number < 0)):
        raise ConfigError(f'{name}: {_shown(value)} is not a finite number')
    if name.endswith('_s') and math.isfinite(number) and abs(number) > MAX_SECONDS:
        raise ConfigError(f'{name}: {number:g} s is more than clocks can differ')
    return number
