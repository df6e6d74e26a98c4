"""How this process was called, for the texts that show a command to type next."""

from pathlib import Path
import sys

#: the command that pip installs
COMMAND = 'vio_eval'


def called_as() -> str:
    """Return the words before the verb; '' where the verb is an executable, as in ROS 2."""
    name = Path(sys.argv[0]).name
    if name == '__main__.py':
        return 'python -m vio_eval_ros'
    return COMMAND if name.startswith(COMMAND) else ''
