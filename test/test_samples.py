"""
What is right for each of a folder of sample inputs is what the program gives.

The folder is beside the checkout, or ``VIO_EVAL_CASES`` names it; it has a `cases.yaml` and the
`run_cases.py` that decides whether a check of it holds.
"""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
import sys
from typing import Any

import pytest
import yaml

from ros_domain import private_domain

ROOT = Path(__file__).resolve().parents[1]
FOLDER = Path(os.environ.get('VIO_EVAL_CASES', ROOT.parent / 'shared' / 'cases'))
LISTED = FOLDER / 'cases.yaml'
SAMPLES = yaml.safe_load(LISTED.read_text(encoding='utf-8')) if LISTED.is_file() else []


def module_of(path: Path) -> Any:
    """Return a script as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.skipif(not SAMPLES, reason=f'no sample inputs at {FOLDER}')
@pytest.mark.parametrize('sample', SAMPLES, ids=[sample['name'] for sample in SAMPLES])
def test_what_is_right_for_a_sample_is_what_comes(sample, monkeypatch):
    run = module_of(FOLDER / 'run_cases.py').run
    monkeypatch.setenv('PYTHONPATH', str(ROOT))
    with private_domain() as variables:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        found = [run(sys.executable, FOLDER / sample['name'], one) for one in sample['checks']]
    assert not any(found), '\n'.join(filter(None, found))
