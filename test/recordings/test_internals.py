"""What is used of rosbags and mcap beyond their documentation is there, by name."""

import importlib
import inspect

import pytest

from vio_eval_ros.recordings import mcap_internals, rosbags_internals

# module, name, and the parameters with which it is called
PARTS = {
    mcap_internals: [
        ('mcap.data_stream', 'ReadDataStream', ['stream']),
        ('mcap.records', 'Chunk.read', ['stream']),
        ('mcap.stream_reader', 'breakup_chunk', ['chunk', 'validate_crc']),
    ],
    rosbags_internals: [
        (
            'rosbags.convert.converter',
            'is_same_wireformat',
            ['src_typestore', 'dst_typestore', 'src_msgtype', 'dst_msgtype'],
        ),
        ('rosbags.convert.converter', 'migrate_bytes', ['cache', 'data', 'src_is2', 'dst_is2']),
        ('rosbags.rosbag2.metadata', 'parse_qos', ['dcts']),
        ('rosbags.typesys.store', 'Typestore', []),
    ],
}


@pytest.mark.parametrize(
    ('module', 'name', 'parameters'), [part for parts in PARTS.values() for part in parts]
)
def test_what_is_used_beyond_the_documentation_is_there(module, name, parameters):
    part = importlib.import_module(module)
    for attribute in name.split('.'):
        part = getattr(part, attribute, None)
        assert part is not None, f'this release has no {module}.{name}'
    there = list(inspect.signature(part).parameters)
    assert set(parameters) <= set(there), f'{module}.{name} takes {there}'


@pytest.mark.parametrize('module', PARTS, ids=lambda module: module.__name__)
def test_every_part_that_is_imported_is_listed(module):
    listed = {name.partition('.')[0] for _, name, _ in PARTS[module]}
    documented = {'ChunkIndex', 'Message', 'Qos'}
    imported = {
        name
        for name, value in vars(module).items()
        if getattr(value, '__module__', '').startswith(('mcap', 'rosbags'))
    }
    assert imported - documented == listed
