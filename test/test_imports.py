"""Imports point inward: the layers of the design, read from the source of every module."""

import ast
from collections.abc import Iterator
from pathlib import Path
import subprocess
import sys

from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'vio_eval_ros'
MODULES = {
    '.'.join(file.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): file
    for file in sorted((ROOT / PACKAGE).rglob('*.py'))
}
TREES = {module: ast.parse(file.read_text()) for module, file in MODULES.items()}
# What the arithmetic must not know of, though it is in the standard library.
OUTSIDE_WORLD = {
    'asyncio', 'datetime', 'glob', 'io', 'logging', 'multiprocessing', 'os', 'pathlib', 'shutil',
    'socket', 'subprocess', 'sys', 'tempfile', 'threading', 'time',
}  # fmt: skip
# What each layer may import beside itself, from the ground up; all may know errors and version.
LAYERS = {
    'errors': set(),
    'version': set(),
    'core': set(),
    'settings': {'core'},
    'rendering': {'core'},
    'recordings': {'core'},
    'diagnosis': {'core', 'recordings', 'rendering'},
    # a recording is inspected, or its IMU analysed, by name: as a library and on the command line
    'imu': {'core', 'recordings', 'rendering'},
    'inspection': {'core', 'recordings', 'rendering', 'settings'},
    'conversion': {'core', 'recordings', 'rendering'},
    'simulation': {'core', 'conversion', 'imu', 'rendering'},
    'evaluation': {'core', 'diagnosis', 'recordings'},
    'comparison': {'core', 'evaluation', 'recordings', 'rendering'},
    'reports': {'core', 'comparison', 'evaluation', 'rendering'},
    'figures': {'core', 'evaluation', 'rendering', 'reports'},
    'scoring': {
        'core',
        'comparison',
        'evaluation',
        'recordings',
        'rendering',
        'reports',
        'settings',
    },
    'live': {
        'core',
        'comparison',
        'diagnosis',
        'evaluation',
        'recordings',
        'rendering',
        'reports',
    },
}
LAYERS['results'] = LAYERS['live'] | {'figures', 'imu', 'inspection'}
LAYERS['api'] = LAYERS['results'] | {'results'}
SHELLS = {'ros', 'cli', '__main__', PACKAGE}
ONLY_IN = {
    'rclpy': ('ros.',),
    'rosbags': ('recordings.', 'reports.mcap', 'conversion'),
    'mcap': ('recordings.', 'reports.mcap', 'conversion'),
}


def imported(module: str) -> Iterator[tuple[str, int]]:
    """Yield what a module imports, by full name and line, inside functions as well."""
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f'{module}:{node.lineno}: imports are absolute'
            for alias in node.names:
                name = f'{node.module}.{alias.name}'
                yield (name if name in MODULES else str(node.module)), node.lineno


def layer(module: str) -> str:
    """Return the folder or file below the package; the package itself for its top."""
    return module.removeprefix(f'{PACKAGE}.').partition('.')[0]


IMPORTS = [(module, name, line) for module in MODULES for name, line in imported(module)]
OWN = [(module, name, line) for module, name, line in IMPORTS if name.startswith(PACKAGE)]


def test_every_module_belongs_to_a_layer():
    assert {layer(module) for module in MODULES} == {*LAYERS, *SHELLS}
    assert ('vio_eval_ros.core.metrics', 'numpy') in {(m, name) for m, name, _ in IMPORTS}


def test_the_core_imports_numpy_itself_and_arithmetic_of_the_standard_library():
    known = {PACKAGE, 'numpy', *sys.stdlib_module_names} - OUTSIDE_WORLD
    assert not [
        f'{module}:{line} imports {name}'
        for module, name, line in IMPORTS
        if layer(module) in ('core', 'errors') and name.partition('.')[0] not in known
    ]


def test_layers_import_only_what_lies_below_them():
    order = list(LAYERS)
    assert all(order.index(below) < order.index(one) for one in LAYERS for below in LAYERS[one])
    assert not [
        f'{module}:{line} imports {name}'
        for module, name, line in OWN
        if layer(module) in LAYERS
        and layer(name) not in {layer(module), 'errors', 'version', *LAYERS[layer(module)]}
    ]


def test_no_modules_import_each_other_in_a_circle():
    below = {module: {name for m, name, _ in OWN if m == module} for module in MODULES}
    while ground := [module for module, names in below.items() if not names & below.keys()]:
        for module in ground:
            del below[module]
    assert not below, 'these are in a circle or import one that is'


def test_only_the_command_lines_print_and_the_core_opens_no_files():
    found = []
    for module, tree in TREES.items():
        names = {'core': ('print', 'open', 'input'), 'errors': ('print', 'open', 'input')}
        forbidden = names.get(layer(module), () if layer(module) in SHELLS else ('print',))
        found += [
            f'{module}:{node.lineno} uses {node.id}'
            for node in ast.walk(tree)
            if isinstance(node, ast.Name) and node.id in forbidden
        ]
    assert not found


def test_what_knows_of_ros_and_bags_stays_where_it_belongs():
    assert not [
        f'{module}:{line} imports {name}'
        for module, name, line in IMPORTS
        if (places := ONLY_IN.get(name.partition('.')[0]))
        and not f'{module.removeprefix(f"{PACKAGE}.")}.'.startswith(places)
    ]


def test_whoever_only_evaluates_does_not_wait_for_a_diagnosis(tmp_path):
    flight = simulate(duration_s=10.0)
    for name, side in (('est', flight.estimate), ('gt', flight.ground_truth)):
        (tmp_path / name).write_text(tum(side))
    code = (
        'import sys; from vio_eval_ros.__main__ import main\n'
        "try: main(['replay', '--estimate', 'est', '--ground-truth', 'gt'])\n"
        'finally: print(*sys.modules, file=sys.stderr)'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    loaded = done.stderr.split()
    assert 'vio_eval_ros.diagnosis.hint' in loaded
    assert not {'vio_eval_ros.diagnosis.report', 'numpy.ma', 'rosbags'}.intersection(loaded)
