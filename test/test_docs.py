"""What the documentation shows is what the program does."""

import ast
from dataclasses import fields
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

from test_imports import LAYERS
from verbs import call, transcript
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.glossary import GLOSSARY
from vio_eval_ros.recordings.spec import STATEMENTS
from vio_eval_ros.reports import REPORTS

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'vio_eval_ros'
REPLAY = (ROOT / 'docs' / 'replay.md').read_text()
CONTRIBUTING = (ROOT / 'CONTRIBUTING.md').read_text()
DOCUMENTS = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]


def options_table() -> str:
    """Return the table of options as the documentation has it."""
    lines = ['| option | default | meaning |', '|---|---|---|']
    for option in fields(EvaluationConfig):
        default = getattr(EvaluationConfig(), option.name)
        words = default if isinstance(default, tuple) else (default,)
        shown = ' '.join(f'{word:g}' if isinstance(word, float) else word for word in words)
        choices = option.metadata['choices']
        meaning = option.metadata['description'] + (
            f': {", ".join(f"`{choice}`" for choice in choices)}' if choices else ''
        )
        lines.append(f'| `{option.name}` | `{shown}` | {meaning} |'.replace('``', 'none'))
    return '\n'.join(lines)


def test_the_table_of_options_is_that_of_the_code():
    assert options_table() in REPLAY


def test_the_output_shown_is_the_output_printed():
    done = call('replay', 'demo/simulated_flight', cwd=ROOT)
    assert done.returncode == 0, transcript(done)
    # the last digit may differ between processors
    shown = re.sub(r'(\d)(?=\s|$|,|\))', '#', done.stdout.strip())
    blocks = [re.sub(r'(\d)(?=\s|$|,|\))', '#', block.strip()) for block in REPLAY.split('```')]
    assert shown in blocks


def test_every_report_and_statement_is_documented():
    for name in REPORTS:
        assert f'`{name}`' in REPLAY
    for name in STATEMENTS['file'] | STATEMENTS['topic']:
        assert f'?{name}=' in REPLAY


def names_of(file: Path) -> set[str]:
    """Return the names that a module defines, and the methods of its classes."""
    found = set()
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {target.id for target in targets if isinstance(target, ast.Name)}
        if isinstance(node, ast.ClassDef):
            methods = (item for item in node.body if isinstance(item, ast.FunctionDef))
            found |= {f'{node.name}.{item.name}' for item in methods}
    return found


def test_every_place_that_contributing_names_exists():
    places = re.findall(r'([\w/]+\.py):([\w.]+)', CONTRIBUTING)
    assert len(places) > 30
    for file, name in places:
        assert name in names_of(PACKAGE / file), f'{file}:{name}'
    for file in re.findall(r'`((?:\w+/)*(?:\w+\.(?:py|yml|cff|rst|xml)|\w+/))`', CONTRIBUTING):
        assert any((folder / file).exists() for folder in (PACKAGE, ROOT)), file


def test_contributing_lists_every_package_in_the_order_of_the_layers():
    section = CONTRIBUTING.split('## Where things are')[1].split('This is the order')[0]
    listed = re.findall(r'^    (\w+)(?:/|\.py) ', section, re.MULTILINE)
    small = {'errors', 'version'}
    assert listed == [name for name in LAYERS if name not in small] + ['cli', 'ros']
    for name, start in re.findall(
        r'^    (\w+)/ .* start(?: reading)? at (\w+\.py)$', section, re.M
    ):
        assert (PACKAGE / name / start).is_file(), start


def test_every_target_that_the_documents_make_exists():
    targets = re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    for document in DOCUMENTS:
        for target in re.findall(r'(?:^    |`)make ([a-z-]+)', document.read_text(), re.MULTILINE):
            assert target in targets, (document.name, target)


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    targets = re.findall(r'\]\(([^)#]+)', document.read_text())
    for target in targets:
        assert target.startswith('https://') or (document.parent / target).exists(), target


def test_every_metric_named_in_the_documents_exists():
    config = EvaluationConfig(
        rpe_deltas=('1f', '1s', '10m', '10f', '1m', '100m'), segment_lengths_m=(100,)
    )
    terms = {term.name for term in GLOSSARY}
    names = {
        *metric_names(config),
        *terms,
        *config.to_dict(),
        'ate_trans_m',
        'ate_rot_deg',
    }  # of a pair
    for document in DOCUMENTS:
        for name in re.findall(
            r'\b(?:ate|rpe|segment|kitti|nees)_\w*(?:_m|_deg|_percent|_mean)\b',
            document.read_text(),
        ):
            assert name in names, (document.name, name)


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    pages = shutil.copytree(ROOT / 'docs', tmp_path / 'docs')
    # links of the pages lead to these
    shutil.copytree(ROOT / 'config', tmp_path / 'config')
    done = subprocess.run(
        [sys.executable, '-m', 'sphinx', '--quiet', '--fail-on-warning', pages, tmp_path / 'site'],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    first = (tmp_path / 'site' / 'index.html').read_text()
    assert 'From vio.csv to a table in your paper' in first
    assert 'https://fonts' not in first
    found = (tmp_path / 'site' / 'searchindex.js').read_text()
    assert 'loop_closure_gain' in found or 'loop_closure' in found
