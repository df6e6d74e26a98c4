"""The documentation of the evaluator's own options."""

from dataclasses import fields
from pathlib import Path
import re

from vio_eval_ros.live.options import NodeConfig, SETTABLE

DOCS = (Path(__file__).resolve().parents[2] / 'docs' / 'live.md').read_text()


def test_every_option_is_in_the_documentation():
    begin = DOCS.index('| parameter | default | meaning |')
    table = DOCS[begin : DOCS.index('\n\n', begin)]
    names = [name for row in table.splitlines() for name in re.findall(r'`(\w+)`', row)]
    known = [item.name for item in fields(NodeConfig)]
    assert [name for name in dict.fromkeys(names) if name in known] == known


def test_every_option_that_may_be_set_while_it_runs_is_in_the_documentation():
    sentence = DOCS[: DOCS.index('may be set while the node runs')].rpartition('\n\n')[2]
    assert set(re.findall(r'`(\w+)`', sentence)) >= set(SETTABLE)
