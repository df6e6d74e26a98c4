"""Imports point inward: the layers of the design, read from the source of every module."""

import ast
from collections.abc import Iterator
from pathlib import Path
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'vio_eval_ros'
MODULES = {
    '.'.join(file.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): file
    for file in sorted((ROOT / PACKAGE).rglob('*.py'))
}
# What the arithmetic must not know of, though it is in the standard library.
OUTSIDE_WORLD = {
    'asyncio', 'datetime', 'glob', 'io', 'logging', 'multiprocessing', 'os', 'pathlib', 'shutil',
    'socket', 'subprocess', 'sys', 'tempfile', 'threading', 'time',
}  # fmt: skip
INNER = {'core', 'errors'}
SHELLS = {'cli', 'nodes'}
# Layers between the core and the shells: none knows of another, but for what is named here.
MAY_ALSO_IMPORT = {
    'imu': {PACKAGE, 'reports'},  # the version; how a page is made
    'inspection': {PACKAGE, 'reports', 'settings'},  # the version; how pages and YAML are made
    'reports': {PACKAGE},
    'simulation': {'imu', 'reports'},  # what noise is; how a TUM file is written
    'scoring': {PACKAGE, 'recordings', 'reports', 'settings'},  # it holds the ends together
}
ONLY_IN = {
    'rclpy': ('nodes.',),
    'rosbags': ('recordings.', 'reports.mcap', 'simulation'),
    'mcap': ('recordings.', 'reports.mcap', 'simulation'),
}


def imported(module: str) -> Iterator[tuple[str, int]]:
    """Yield what a module imports, by full name and line, inside functions as well."""
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
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


def in_layer(*names: str) -> list[str]:
    return [module for module in MODULES if layer(module) in names]


def test_there_is_something_to_check():
    assert {'core', 'recordings', 'reports', 'cli', 'errors'} <= set(map(layer, MODULES))
    assert ('numpy', 'vio_eval_ros.core.metrics') in {
        (name, module) for module in in_layer('core') for name, _ in imported(module)
    }


@pytest.mark.parametrize('module', in_layer('core', 'errors'))
def test_the_core_imports_numpy_itself_and_arithmetic_of_the_standard_library(module):
    for name, line in imported(module):
        top = name.partition('.')[0]
        allowed = (
            layer(name) in INNER
            if top == PACKAGE
            else top == 'numpy' or top in sys.stdlib_module_names - OUTSIDE_WORLD
        )
        assert allowed, f'{module}:{line} imports {name}'


@pytest.mark.parametrize('module', in_layer('core', 'errors'))
def test_the_core_neither_prints_nor_opens_files(module):
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        called = (
            node.func.id
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            else None
        )
        assert called not in ('print', 'open', 'input'), f'{module}:{node.lineno}'


@pytest.mark.parametrize('module', [m for m in MODULES if layer(m) not in SHELLS])
def test_only_the_command_lines_and_nodes_print(module):
    if module == f'{PACKAGE}.__main__':
        return
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.Name):
            assert node.id != 'print', f'{module}:{node.lineno}'


@pytest.mark.parametrize(
    'module', [m for m in MODULES if layer(m) not in {*SHELLS, *INNER, '__main__', PACKAGE}]
)
def test_layers_around_the_core_import_the_core_and_themselves(module):
    own = {*INNER, layer(module), *MAY_ALSO_IMPORT.get(layer(module), ())}
    for name, line in imported(module):
        if name.partition('.')[0] == PACKAGE:
            assert layer(name) in own, f'{module}:{line} imports {name}'


@pytest.mark.parametrize('module', MODULES)
def test_what_knows_of_ros_and_bags_stays_where_it_belongs(module):
    for name, line in imported(module):
        places = ONLY_IN.get(name.partition('.')[0])
        inside = module.removeprefix(f'{PACKAGE}.') + '.'
        assert places is None or inside.startswith(places), f'{module}:{line} imports {name}'


@pytest.mark.parametrize('module', MODULES)
def test_nothing_imports_a_shell_but_its_own(module):
    for name, line in imported(module):
        if name.partition('.')[0] == PACKAGE and layer(name) in SHELLS:
            allowed = {layer(name), 'nodes'} if layer(name) == 'cli' else {layer(name)}
            assert layer(module) in allowed, f'{module}:{line} imports {name}'
