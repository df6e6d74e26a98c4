"""
Manifests: what a result was made of and what came out, so that anyone can make it again.

Every input is named by its path and sha256, the configuration of the stack is carried along.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
import os
from pathlib import Path
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.evaluation.recorded import sha256
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.version import __version__

if TYPE_CHECKING:
    from vio_eval_ros.scoring.scoring import SequenceResult, SuiteResult
    from vio_eval_ros.scoring.suite import Suite

SCHEMA = 'vio_eval_ros.manifest/1'
MAX_BYTES = 1 << 26
MAX_TEXT_BYTES = 1 << 20
STACK_KEYS = ('name', 'version', 'commit', 'config')


@dataclass(frozen=True)
class Document:
    """
    A file that explains a run.

    :param text: all of it; None where it is no text, or a long one.
    """

    path: Path
    sha256: str
    text: str | None

    @classmethod
    def read(cls, path: Path) -> Document:
        """Return the document in a file; ``ReadError`` where there is none."""
        import hashlib

        try:
            if not path.is_file():
                raise ReadError(path, 'is no file' if path.exists() else 'there is no such file')
            if path.stat().st_size > MAX_TEXT_BYTES:
                return cls(path, str(sha256([path])), None)
            data = path.read_bytes()
        except OSError as error:
            raise ReadError(path, error.strerror or str(error)) from None
        digest = hashlib.sha256(data).hexdigest()
        try:
            return cls(path, digest, data.decode())
        except UnicodeDecodeError:
            return cls(path, digest, None)


@dataclass(frozen=True)
class Stack:
    """The software that made an estimate, with its configuration and calibration files."""

    name: str | None = None
    version: str | None = None
    commit: str | None = None
    config: tuple[Document, ...] = ()
    calibration: tuple[Document, ...] = ()

    @classmethod
    def of(
        cls, stated: Mapping[str, Any], calibration: Iterable[Path] = (), base: Path = Path()
    ) -> Stack:
        """
        Return the stack of ``{name: text, version: text, commit: text, config: [paths]}``.

        :param base: what the paths of its configuration are relative to.
        """
        check_stack(stated)
        return cls(
            stated.get('name'),
            stated.get('version'),
            stated.get('commit'),
            tuple(Document.read(path) for path in config_paths(stated, base)),
            tuple(Document.read(path) for path in calibration),
        )


def check_stack(stated: Mapping[str, Any]) -> None:
    """Raise ``ConfigError`` where what is stated of a stack makes no sense; no file is read."""
    for key, value in stated.items():
        if key not in STACK_KEYS:
            near = nearest_name(key, STACK_KEYS) or f'; there are {", ".join(STACK_KEYS)}'
            raise ConfigError(f"stack: there is no '{key}' here{near}")
        if key != 'config' and not isinstance(value, (str, type(None))):
            raise ConfigError(f"stack: {key}: '{value}' is no text; put it into quotes")
    listed = stated.get('config') or []
    paths = [listed] if isinstance(listed, (str, Path)) else listed
    if not isinstance(paths, list) or not all(isinstance(path, (str, Path)) for path in paths):
        raise ConfigError('stack: config: a list of files is expected')


def config_paths(stated: Mapping[str, Any], base: Path) -> list[Path]:
    """Return the files of configuration that are stated of a stack, whose check it passed."""
    listed = stated.get('config') or []
    return [base / path for path in ([listed] if isinstance(listed, (str, Path)) else listed)]


class ScoredRun(NamedTuple):
    """
    A run, by the specs that it was read from, and what came out.

    :param result: None where it could not be scored.
    :param error: why not.
    """

    estimate: str
    ground_truth: str
    result: Result | None
    error: str = ''
    recording: Path | None = None
    causal: str | None = None
    times: Path | None = None


class Manifest:
    """
    A manifest in the making.

    Paths in it are relative to its folder where they were given relative to another, so that all
    may be moved together, and absolute where they were given so.

    :param file: where it will be written.
    :param root: the folder that relative paths have been joined to already.
    """

    def __init__(self, file: Path, root: Path = Path()) -> None:
        # what .. means in a linked folder: the parent of the folder that it links to
        self._folder = os.path.realpath(file.parent)
        self._root = root
        self._texts: dict[str, str] = {}
        self._facts: dict[str, Any] = {}
        self._sequences: list[dict[str, Any]] = []
        self._sha256 = cache(lambda path: sha256([path]))

    def add_document(self, name: str, document: Document) -> None:
        """Add a document about the whole."""
        self._facts[name] = self._document(document)

    def add_fact(self, name: str, value: Any) -> None:
        """Add what is to be said of the whole."""
        self._facts[name] = value

    def add_sequence(
        self,
        name: str,
        config: EvaluationConfig,
        stack: Stack,
        runs: Iterable[ScoredRun],
        judged: Mapping[str, Any] | None = None,
    ) -> None:
        """
        Add the runs of a sequence, which share their options and the stack.

        :param judged: what all of them together were found to be, where they were judged.
        """
        self._sequences.append(
            {
                'name': name,
                'stack': {
                    **{key: getattr(stack, key) for key in STACK_KEYS[:-1]},
                    'config': [self._document(document) for document in stack.config],
                },
                'calibration': [self._document(document) for document in stack.calibration],
                'options': config.to_dict(),
                'runs': [self._run(run) for run in runs],
                **(judged or {}),
            }
        )

    def to_json(self) -> str:
        """Return the manifest in schema ``vio_eval_ros.manifest/1``."""
        import json

        content = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'machine': machine(),
            **self._facts,
            'sequences': self._sequences,
            'texts': self._texts,
        }
        text = json.dumps(content, indent=2, allow_nan=False) + '\n'
        if len(text) > MAX_BYTES:
            raise ConfigError(f'the manifest would be larger than {MAX_BYTES >> 20} MiB; split it')
        return text

    def _run(self, run: ScoredRun) -> dict[str, Any]:
        result = run.result
        estimate, truth = (result.estimate, result.ground_truth) if result else (None, None)
        return {
            'estimate': self._input(run, run.estimate, estimate),
            'causal': self._input(run, run.causal, None) if run.causal else None,
            'ground_truth': self._input(run, run.ground_truth, truth),
            'times': self._path(run.times) if run.times else None,
            'result': result.to_dict() if result else None,
            'error': run.error or None,
        }

    def _input(self, run: ScoredRun, text: str, read: Input | None) -> dict[str, Any]:
        """Return a spec that holds from the folder of the manifest, and its files."""
        spec = Spec.parse(text)
        path, topic = spec.path or run.recording, f':{spec.topic}' if spec.topic else ''
        if path is None:  # an absolute path without a file is taken for a topic
            path, topic = Path(str(spec.topic)), ''
        files = read.paths if read else [path] if path.is_file() else []
        stated = '&'.join(f'{name}={value}' for name, value in spec.statements.items())
        return {
            'spec': self._path(path) + topic + ('?' + stated if stated else ''),
            'files': [{'path': self._path(file), 'sha256': self._sha256(file)} for file in files],
        }

    def _document(self, document: Document) -> dict[str, str]:
        if document.text is not None:
            self._texts[document.sha256] = document.text
        return {'path': self._path(document.path), 'sha256': document.sha256}

    def _path(self, path: Path) -> str:
        if path.is_absolute() and not path.is_relative_to(self._root):
            return str(path)
        return os.path.relpath(path, self._folder)


def manifest_of_suite(
    file: Path, suite: Suite, baseline: Path | None = None
) -> Callable[[SuiteResult], str]:
    """
    Return what makes the manifest of a suite when it is scored; its documents are read now.

    :param file: where the manifest will be written.
    :param baseline: what it is compared with.
    :raises ReadError: a document that is not there.
    """
    base = suite.file.parent
    manifest = Manifest(file, base)
    for name, path in (('suite', suite.file), ('baseline', baseline)):
        if path is not None:
            manifest.add_document(name, Document.read(path))
    stacks = {one.name: Stack.of(one.stack, one.calibration, base) for one in suite.sequences}

    def finished(result: SuiteResult) -> str:
        for one in result.sequences:
            sequence = one.sequence
            scored = [
                ScoredRun(
                    of.run.estimate,
                    sequence.ground_truth,
                    of.result,
                    of.error,
                    of.run.recording,
                    of.run.causal,
                    sequence.times,
                )
                for of in one.runs
            ]
            stack = stacks[sequence.name]
            manifest.add_sequence(sequence.name, sequence.config, stack, scored, judged(one))
        manifest.add_fact('set', list(suite.overrides))
        manifest.add_fact('verdict', result.verdict)
        return manifest.to_json()

    return finished


def judged(one: SequenceResult) -> dict[str, Any]:
    """Return the gates over the runs of a sequence, what it was compared with, and the verdict."""
    comparisons = one.comparisons
    return without_nan(
        {
            'gates': one.gates_to_dicts(),
            'comparisons': None
            if comparisons is None
            else [
                {
                    'rule': each.rule._asdict(),
                    'baseline_values': list(each.baseline.values),
                    'found': each.to_dict(),
                }
                for each in comparisons
            ],
            'verdict': one.verdict,
        }
    )


def machine() -> dict[str, str]:
    """Return what the last bits of a result depend on."""
    import platform

    return {
        'platform': platform.platform(),
        'cpu': _cpu_model() or platform.machine(),
        'python': platform.python_version(),
        'numpy': np.__version__,
    }


def _cpu_model() -> str:
    """Return the name of the processor; nothing where the system does not tell."""
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return ''
    models = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return models[0] if models else ''
