"""
Everything that can go wrong for a reason the user can mend.

::

    VioEvalError
    ├── ReadError              a file, folder or topic that cannot be read
    │   └── UnsupportedMessage     a topic whose messages carry no pose
    ├── NoPairs                two trajectories that share no instant
    ├── WriteError             a report that cannot be written
    ├── InputError             an array or DataFrame of a wrong shape, type or value
    ├── ConfigError            an option, gate or parameter that makes no sense
    └── MissingPackage         a Python package that is not installed

A message is one line that names its subject and says what to do. Only the command lines and the
nodes print it; they exit with status 2.
"""

from __future__ import annotations

# exit statuses of every verb: a gate or expectation failed is 1, could not be done is 2
PASSED, FAILED, UNABLE = 0, 1, 2
#: what pip calls the packages whose modules have other names
NAMES_OF_PIP = {'google': 'protobuf', 'PIL': 'Pillow', 'ruamel': 'ruamel.yaml', 'yaml': 'PyYAML'}


class VioEvalError(Exception):
    """Base of all errors of this package; ``str(error)`` is one line fit for a user."""


class ReadError(VioEvalError):
    """
    A recording, file or topic cannot be read.

    :param source: what was asked for (a path, a topic or a source spec).
    :param problem: what is wrong with it and what to do.
    """

    def __init__(self, source: object, problem: str) -> None:
        super().__init__(f'{source}: {problem}')
        self.source = str(source)
        self.problem = problem

    def __reduce__(self) -> tuple[type[ReadError], tuple[str, str]]:
        """Return what pickle makes the error of again, in the process that waits for it."""
        return type(self), (self.source, self.problem)


class UnsupportedMessage(ReadError):
    """A topic exists but its message type carries no pose."""


class NoPairs(VioEvalError):
    """No estimate could be associated with ground truth; the message gives both time spans."""


class ConfigError(VioEvalError):
    """An option has a value that is not allowed; the message says which values are."""


class InputError(VioEvalError, ValueError):
    """An array or DataFrame is not what was expected; the message says what was, and what came."""


class WriteError(VioEvalError):
    """
    A result cannot be written; what was measured is still printed.

    :param path: where it should have gone.
    :param problem: what is wrong with that.
    """

    def __init__(self, path: object, problem: str) -> None:
        super().__init__(f'{path}: cannot write: {problem}')


class MissingPackage(VioEvalError):
    """
    A Python package that the installation should have brought cannot be imported.

    :param error: of the import.
    """

    def __init__(self, error: ImportError) -> None:
        module = (error.name or '').partition('.')[0]
        package = NAMES_OF_PIP.get(module, module)
        super().__init__(
            f'the Python package {package} is missing: pip install {package}; '
            'in a ROS workspace: rosdep install --from-paths src --ignore-src'
        )
