"""A ROS domain of one's own, in whatever process the test runs."""

from collections.abc import Iterator
from contextlib import contextmanager
import fcntl
from pathlib import Path
import random
import tempfile

DOMAINS = range(61, 102)


@contextmanager
def private_domain() -> Iterator[dict[str, str]]:
    """Yield the variables of an environment with a ROS graph that no other test is on."""
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        with (Path(tempfile.gettempdir()) / f'ros_domain_{domain}.lock').open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
            return
    raise RuntimeError('all domains are taken')
