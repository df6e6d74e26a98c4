"""
Reads a suite from YAML.

::

    options: {alignment: se3, max_difference_s: 0.01}
    gates: {ate_trans_rmse_m: {max: 0.3, warn: 0.2}, success_rate: {min: 1.0}}
    sequences:
      - name: V1_02
        estimate: runs/V1_02/*.tum          # a glob: one run per match
        ground_truth: gt/V1_02.csv
        gates: {ate_trans_rmse_m: {max: 0.1}}

Paths are relative to the suite's file. The options, gates, rules and tags of a sequence override
those of the suite, name by name.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.criteria import band_for, gates_for, rules_for
from vio_eval_ros.scoring.entries import Entry
from vio_eval_ros.scoring.matching import matches, runs_of, split_spec
from vio_eval_ros.scoring.overrides import override
from vio_eval_ros.scoring.stack import check_stack
from vio_eval_ros.scoring.suite import RunSpec, Sequence, Suite
from vio_eval_ros.scoring.systems import named, with_systems
from vio_eval_ros.settings import load_yaml

SHARED_KEYS = ('options', 'gates', 'compare', 'bands', 'modality', 'tags', 'stack', 'calibration')
#: what is read; a suite may state it for all, with {sequence} and {system} in it
PATH_KEYS = ('estimate', 'causal', 'ground_truth', 'recording', 'times')
SEQUENCE_KEYS = ('name', *PATH_KEYS, *SHARED_KEYS)
SUITE_KEYS = ('sequences', 'systems', 'manifest', *PATH_KEYS, *SHARED_KEYS)
#: whatever is of the sequence is not of a system
SYSTEM_KEYS = tuple(
    key for key in SEQUENCE_KEYS if key not in ('ground_truth', 'times', 'bands', 'tags')
)


def load_suite(file: Path, overrides: Iterable[str] = (), tags: Iterable[str] = ()) -> Suite:
    """
    Read a suite.

    :param overrides: ``key.key=value`` each; ``sequences.NAME.key`` reaches into a sequence.
    :param tags: only sequences with one of these tags, or names, are read; all where none is
        given.
    :raises ConfigError: what is wrong in it, with its line; also a glob without a match.
    """
    top, overrides = load_yaml(file), tuple(overrides)
    for text in overrides:
        override(top, text)
    top.expect(*SUITE_KEYS)
    entries = [Entry((top, own), own) for own in named(top, 'sequences', SEQUENCE_KEYS).values()]
    chosen = with_systems(top, _tagged(entries, set(tags)) if tags else entries, SYSTEM_KEYS)
    manifest = top.text('manifest')
    return Suite(
        file,
        tuple(map(_sequence, chosen)),
        manifest=None if manifest is None else file.parent / manifest,
        overrides=overrides,
    )


def _tagged(entries: Iterable[Entry], wanted: set[str]) -> list[Entry]:
    """Return the sequences that have one of these tags; their name is one of them."""
    tagged = [(entry, {entry.name, *entry.texts('tags')}) for entry in entries]
    known = set().union(*(tags for _, tags in tagged))
    for tag in sorted(wanted - known):
        raise ConfigError(f"no sequence has the tag '{tag}'{nearest_name(tag, known)}")
    return [entry for entry, tags in tagged if wanted & tags]


def _sequence(entry: Entry) -> Sequence:
    base = entry.base
    config = _config(entry)
    runs = tuple(runs_of(entry))
    truth = _ground_truth(entry, runs)
    bands, times = entry.text('bands'), entry.path('times')
    return Sequence(
        name=entry.name,
        runs=runs,
        ground_truth=truth,
        config=config,
        gates=gates_for(entry, config),
        rules=rules_for(entry, config),
        band=band_for(entry),
        bands=None if bands is None else base / bands,
        modality=entry.text('modality'),
        tags=tuple(entry.texts('tags')),
        stack=_stack(entry),
        calibration=tuple(base / path for path in entry.texts('calibration')),
        times=None if times is None else base / times,
        system=entry.system,
    )


def _ground_truth(entry: Entry, runs: Iterable[RunSpec]) -> str:
    """Return the spec of the ground truth, which must exist; and that a recording is needed."""
    truth, *others = matches(entry, 'ground_truth')
    if others:
        raise entry.error('ground_truth', f'ground_truth: expected one, not {1 + len(others)}')
    path = Path(split_spec(truth.spec)[0])
    if not truth.is_topic and not path.exists():
        raise entry.error('ground_truth', f'ground_truth: there is no {path}')
    topics = [truth.is_topic, *(Spec.parse(run.estimate).path is None for run in runs)]
    if entry.text('recording') is not None and not any(topics):
        raise entry.error('recording', 'recording: not needed, since no topic is named')
    return truth.spec


def _config(entry: Entry) -> EvaluationConfig:
    merged: dict[str, Any] = {}
    for section in entry.sections('options'):
        section.check_each(EvaluationConfig.from_mapping)
        merged |= section
    try:
        return EvaluationConfig.from_mapping(merged)
    except ConfigError as error:  # each is valid, but not all of them together
        raise entry.error('options', error) from None


def _stack(entry: Entry) -> dict[str, Any]:
    """Return what is stated of the software under test; its files are read for manifests only."""
    merged: dict[str, Any] = {}
    for section in entry.sections('stack'):
        section.check_each(check_stack)
        merged |= section
    return merged
