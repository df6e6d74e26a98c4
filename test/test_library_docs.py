"""The examples of the library's documentation run, and print what is shown below them."""

from contextlib import redirect_stdout
import io
from pathlib import Path
import re

from nbclient import NotebookClient
import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / 'docs/notebooks').glob('*.ipynb'))


def without_last_digits(text: str) -> str:
    """Return a text without the last digits of its numbers, which differ between processors."""
    return re.sub(r'(\.\d{9})\d+', r'\1', text.strip())


def examples(document: str) -> list[tuple[str, str]]:
    """Return the Python blocks of a document, each with the output that is shown below it."""
    text = (ROOT / document).read_text()
    if document == 'README.md':
        text = text.split('## As a library')[1].split('\n## ')[0]
    pattern = r'```python\n(.*?)```(?:\n+```\n(.*?)```)?'
    return re.findall(pattern, text, re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize('document', ['README.md', 'docs/library.md'])
def test_the_examples_print_what_is_shown(document, monkeypatch):
    monkeypatch.chdir(ROOT)
    names: dict = {}
    found = examples(document)
    for code, shown in found:
        with redirect_stdout(io.StringIO()) as printed:
            exec(compile(code, document, 'exec'), names)
        assert without_last_digits(printed.getvalue()) == without_last_digits(shown)
    assert any(shown for _, shown in found)


@pytest.mark.slow
@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.name)
def test_every_cell_of_a_notebook_runs(path, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', str(ROOT))
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    NotebookClient(
        notebook,
        timeout=120,
        kernel_name='python3',
        resources={'metadata': {'path': ROOT / 'docs/notebooks'}},
    ).execute()
    kinds = {
        kind
        for cell in notebook.cells
        if cell.cell_type == 'code'
        for output in cell.outputs
        if 'data' in output
        for kind in output.data
    }
    assert {'text/html', 'application/vnd.plotly.v1+json'} <= kinds


def test_there_is_a_notebook():
    assert NOTEBOOKS
