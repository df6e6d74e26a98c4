"""
Manifests: what a result was made of and what came out, so that anyone can reproduce it.

Every input is named by its path and sha256; the configuration of the stack is included.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
import os
from pathlib import Path
from typing import Any

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.recorded import sha256
from vio_eval_ros.evaluation.result import Input
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.results import RunResult, SequenceResult, SuiteResult
from vio_eval_ros.scoring.stack import Document, Stack, STACK_KEYS
from vio_eval_ros.scoring.suite import Suite
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.manifest/1'
MAX_BYTES = 1 << 26


class Manifest:
    """
    A manifest that is being assembled.

    Paths that were given relative are kept relative to the folder of the manifest, so that all
    may be moved together; absolute ones stay absolute.

    :param file: where it will be written.
    :param root: the folder that relative paths have been joined to already.
    """

    def __init__(self, file: Path, root: Path = Path()) -> None:
        # in a linked folder, .. is the parent of the folder that it links to
        self._folder = os.path.realpath(file.parent)
        self._root = root
        self._texts: dict[str, str] = {}
        self._facts: dict[str, Any] = {}
        self._sequences: list[dict[str, Any]] = []
        self._sha256 = cache(lambda path: sha256([path]))

    def add_document(self, name: str, document: Document) -> None:
        """Add a document about the manifest as a whole."""
        self._facts[name] = self._document(document)

    def add_fact(self, name: str, value: Any) -> None:
        """Add a fact about the manifest as a whole."""
        self._facts[name] = value

    def add_sequence(
        self,
        name: str,
        runs: Iterable[RunResult],
        *,
        ground_truth: str,
        config: EvaluationConfig,
        stack: Stack,
        times: Path | None = None,
        judgement: Mapping[str, Any] | None = None,
    ) -> None:
        """
        Add the runs of a sequence, which share all of what follows them.

        :param ground_truth: its spec.
        :param times: the stamps of KITTI poses.
        :param judgement: the gates and the verdict on all runs together, where there are some.
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
                'runs': [self._run(run, ground_truth, times) for run in runs],
                **(judgement or {}),
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

    def _run(self, run: RunResult, ground_truth: str, times: Path | None) -> dict[str, Any]:
        result, spec, recording = run.result, run.run, run.run.recording
        estimate, truth = (result.estimate, result.ground_truth) if result else (None, None)
        return {
            'estimate': self._input(spec.estimate, recording, estimate),
            'causal': self._input(spec.causal, recording) if spec.causal else None,
            'ground_truth': self._input(ground_truth, recording, truth),
            'times': self._path(times) if times else None,
            'result': result.to_dict() if result else None,
            'error': run.error or None,
        }

    def _input(
        self, text: str, recording: Path | None, read: Input | None = None
    ) -> dict[str, Any]:
        """Return a spec that holds from the folder of the manifest, and its files."""
        spec = Spec.parse(text)
        path, topic = spec.path or recording, f':{spec.topic}' if spec.topic else ''
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
    Return a function that makes the manifest of a suite from its result; documents are read now.

    :param file: where the manifest will be written.
    :param baseline: the file that it is compared with.
    :raises ReadError: a document cannot be read.
    """
    base = suite.file.parent
    manifest = Manifest(file, base)
    for name, path in (('suite', suite.file), ('baseline', baseline)):
        if path is not None:
            manifest.add_document(name, Document.read(path))
    stacks = {one.title: Stack.of(one.stack, one.calibration, base) for one in suite.sequences}

    def finished(result: SuiteResult) -> str:
        for one in result.sequences:
            sequence = one.sequence
            manifest.add_sequence(
                sequence.title,
                one.runs,
                ground_truth=sequence.ground_truth,
                config=sequence.config,
                stack=stacks[sequence.title],
                times=sequence.times,
                judgement=judgement(one),
            )
        manifest.add_fact('set', list(suite.overrides))
        manifest.add_fact('verdict', result.verdict)
        return manifest.to_json()

    return finished


def judgement(one: SequenceResult) -> dict[str, Any]:
    """Return the gates over the runs of a sequence, the comparisons, and the verdict."""
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
    """Return the name of the processor, empty where the system does not give it."""
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return ''
    models = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return models[0] if models else ''
