"""The tables of findings, causes and limits in the docs are those of the code."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / 'docs'


@pytest.mark.parametrize(
    ('document', 'row', 'wrong'),
    [
        ('inspect.md', '| `gap_s` | 0.1 s |', '| `gap_s` | 0.2 s |'),
        ('diagnose.md', '| `scale_percent` | 3 % |', '| `scale_percent` | 4 % |'),
        ('metrics.md', '| `sim3_scale` | scale of', '| `sim3_scale` | size of'),
        ('imu_noise.md', '| `missing_ratio` | 0.01 |', '| `missing_ratio` | 0.02 |'),
    ],
)
def test_the_tables_are_those_of_the_code(document, row, wrong):
    spec = spec_from_file_location('make_tables', DOCS / 'make_tables.py')
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    text = (DOCS / document).read_text()
    assert made.with_tables(document, text) == text, 'run make tables'
    assert row in text
    assert made.with_tables(document, text.replace(row, wrong)) == text
