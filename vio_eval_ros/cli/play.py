"""Publishes a recording into ROS 2: its own bytes and stamps, at the pace it was recorded."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import repeat
import math
from pathlib import Path
import signal
import sys
import time
from typing import TYPE_CHECKING

from vio_eval_ros.cli.shell import Parser, run
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError, PASSED, ReadError, VioEvalError
from vio_eval_ros.live.audience import wait_for
from vio_eval_ros.ros import without_ros
from vio_eval_ros.settings import finite

if TYPE_CHECKING:
    from vio_eval_ros.recordings.container import Topic
    from vio_eval_ros.recordings.playback import Playback
    from vio_eval_ros.ros.player import Publication

#: how long a subscription that nobody insists on may take to be reached
UNASKED_S = 10.0
#: how many messages with static transforms late subscribers get at least
STATIC = 1000
EXAMPLES = """
examples:
  play V1_02_medium.bag                          a ROS 1 bag, as it is
  play V1_02_medium --rate 0.5                   a EuRoC folder (mav0), at half the speed
  play run.mcap --topics /vio/odometry /tf --remap /tf:=/recorded_tf
  play run --start 10 --duration 30 --loop --wait-for-subscribers

services of the node `player` (std_srvs/Trigger): ~/pause, ~/resume, ~/step

exit status: 0 played to the end or interrupted, 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    # set here, since a shell has what it starts in the background ignore Ctrl-C
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    arguments, ros_arguments = _split(sys.argv[1:] if argv is None else argv)
    options = _parser().parse_args(arguments)
    return run('play', lambda: _play(options, ros_arguments))


def _split(argv: list[str]) -> tuple[list[str], list[str]]:
    """Return our own arguments and those of ROS, which are between ``--ros-args`` and ``--``."""
    if '--ros-args' not in argv:
        return argv, []
    begin = argv.index('--ros-args')
    end = argv.index('--', begin) if '--' in argv[begin:] else len(argv)
    return argv[:begin] + argv[end + 1 :], argv[begin:end]


def _parser() -> Parser:
    parser = Parser(prog='play', description=__doc__, epilog=EXAMPLES)
    parser.add_argument(
        'recording',
        type=Path,
        metavar='RECORDING',
        help='ROS 1 .bag, rosbag2 folder, .db3, .mcap, or EuRoC folder (mav0)',
    )
    parser.add_argument('--topics', nargs='+', metavar='T', help='play these only (default: all)')
    parser.add_argument(
        '--rate',
        type=_rate,
        default=1.0,
        metavar='R',
        help='times real time; inf is as fast as it goes (default: 1)',
    )
    parser.add_argument(
        '--start', type=_not_negative, default=0.0, metavar='S', help='skip the first seconds'
    )
    parser.add_argument(
        '--duration', type=_positive, default=math.inf, metavar='S', help='play this many seconds'
    )
    parser.add_argument('--loop', action='store_true', help='start again at the end')
    parser.add_argument('--paused', action='store_true', help='wait for ~/resume or ~/step')
    parser.add_argument(
        '--remap',
        nargs='+',
        default=[],
        metavar='OLD:=NEW',
        help='publish under other names',
    )
    parser.add_argument(
        '--wait-for-subscribers',
        nargs='*',
        metavar='T',
        help='start when these have subscribers; without names, all that are played but '
        'transforms (default: those that anybody has subscribed to)',
    )
    parser.add_argument(
        '--wait-timeout',
        type=_not_negative,
        metavar='S',
        help='wait no longer; 0 starts at once (default: for ever for the topics of '
        f'--wait-for-subscribers, else {UNASKED_S:g} s)',
    )
    return parser


def _positive(text: str) -> float:
    number = finite(text)
    if not number > 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number above 0")
    return number


def _rate(text: str) -> float:
    return math.inf if text == 'inf' else _positive(text)


def _not_negative(text: str) -> float:
    number = finite(text)
    if not number >= 0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number >= 0")
    return number


def _play(options: argparse.Namespace, ros_arguments: list[str]) -> int:
    try:
        # imported here, so that Ctrl-C works meanwhile
        from vio_eval_ros.recordings.playback import Playback

        with Playback(options.recording) as playback:
            for note in playback.notes:
                _say(note)
            for warning in playback.warnings:
                _say(f'{warning}; left out')
            _publish(playback, options, ros_arguments)
    except KeyboardInterrupt:
        pass
    return PASSED


def _publish(playback: Playback, options: argparse.Namespace, ros_arguments: list[str]) -> None:
    """Play a recording as the options say."""
    topics = _chosen(playback, options.topics)
    new_names = _new_names(topics, options.remap)
    length_s = (playback.last_ns - playback.first_ns) / 1e9
    if options.start > length_s:
        raise ConfigError(f'--start {options.start:g}: the recording is {length_s:g} s long')
    length_s = min(options.duration, length_s - options.start)
    start_ns = playback.first_ns + round(options.start * 1e9)
    end_ns = start_ns + round(length_s * 1e9)

    try:
        from vio_eval_ros.recordings.storage import OfferedQos
        from vio_eval_ros.recordings.transforms import static_topics, TF_TYPES
        from vio_eval_ros.ros.player import message_class, Publication, running
    except ImportError as error:
        raise without_ros(error) from None
    publications = []
    for topic in topics:
        known = message_class(topic.msgtype)
        if known is None:
            _say(f'{topic.name}: {topic.msgtype} is not installed; left out')
            continue
        offer = playback.offers.get(topic.name, OfferedQos())
        if static_topics(topic.name, [topic.name]) and topic.msgtype in TF_TYPES:
            offer = replace(
                offer, reliable=True, latched=True, depth=max(offer.depth, topic.count)
            )
        publications.append(Publication(topic.name, new_names[topic.name], known, offer))
    if not publications:
        raise VioEvalError('nothing to play: none of the topics can be published')
    names = {publication.topic for publication in publications}
    latched = {publication.topic for publication in publications if publication.offer.latched}
    awaited = _awaited(options.wait_for_subscribers, publications)

    with running(publications, options.rate, options.paused, ros_arguments, _say) as player:
        wait_for(player.audiences, player.names_of(awaited), _timeout_s(options), _say)
        if math.isinf(options.rate):
            _say('as fast as it goes: a subscriber that does not keep up loses messages')
        began_s = time.monotonic()
        try:
            if latched and options.start:
                before = playback.messages(latched, playback.first_ns, start_ns - 1)
                if count := player.publish_latched(before):
                    _say(f'published {count:,} messages that were latched before --start')
            for _ in repeat(None) if options.loop else (None,):
                messages = playback.messages(names, start_ns, end_ns)
                with _progress(length_s) as progress:
                    player.play(messages, start_ns, progress)
                if not player.published:
                    raise ReadError(options.recording, 'it has no messages in that part')
        finally:
            _say(
                f'published {player.published:,} messages of {len(names)} topics in '
                f'{time.monotonic() - began_s:.1f} s; '
                f'largest delay {player.largest_delay_s * 1e3:.1f} ms'
            )
            if unheard := player.without_subscribers():
                _say(f'no subscribers of {", ".join(unheard)}')
        player.flush()


def _chosen(playback: Playback, wanted: Sequence[str] | None) -> list[Topic]:
    """Return the topics to play; ``/clock`` is not one of them, play publishes its own."""
    there = {topic.name: topic for topic in playback.topics if topic.count}
    if there.pop('/clock', None):
        _say('ignoring the recorded /clock; play publishes its own')
    names = [f'/{name.lstrip("/")}' for name in wanted or there]
    for name in names:
        if name not in there:
            raise ConfigError(f'{name}: there is no such topic; {_listed(there.values())}')
    return [there[name] for name in dict.fromkeys(names)]


def _listed(topics: Iterable[Topic]) -> str:
    return 'topics: ' + ', '.join(
        f'{topic.name} ({topic.msgtype}, {topic.count})' for topic in topics
    )


def _new_names(topics: Sequence[Topic], remap: Sequence[str]) -> dict[str, str]:
    """Return the name under which to publish each topic."""
    names = {topic.name: topic.name for topic in topics}
    for rule in remap:
        old, assigned, new = rule.partition(':=')
        old = f'/{old.lstrip("/")}'
        if not assigned or not new:
            raise ConfigError(f"--remap '{rule}': write OLD:=NEW")
        if old not in names:
            raise ConfigError(f"--remap '{rule}': {old} is not played; {_listed(topics)}")
        names[old] = new
    for name in names.values():
        if name.lstrip('/') == 'clock':
            raise ConfigError('--remap: /clock is where play publishes the time')
        both = [old for old, new in names.items() if new.lstrip('/') == name.lstrip('/')]
        if len(both) > 1:
            raise ConfigError(f'--remap: {" and ".join(both)} would both become {name}')
    return names


def _awaited(wanted: Sequence[str] | None, publications: Sequence[Publication]) -> list[str]:
    """Return the topics that must be heard."""
    if wanted is None:
        return []
    if not wanted:
        # nobody may want the transforms of a recording, which are in nearly all
        return [p.topic for p in publications if p.message_type.__name__ != 'TFMessage']
    names = {name for p in publications for name in (p.topic, p.name)}
    for name in wanted:
        if name not in names:
            near = nearest_name(name, names)
            raise ConfigError(f'--wait-for-subscribers: {name} is not played{near}')
    return [p.topic for p in publications if {p.topic, p.name} & set(wanted)]


def _timeout_s(options: argparse.Namespace) -> float:
    if options.wait_timeout is not None:
        return float(options.wait_timeout)
    return UNASKED_S if options.wait_for_subscribers is None else math.inf


@contextmanager
def _progress(length_s: float) -> Iterator[Callable[[float], object]]:
    """Return what takes the seconds played so far; a terminal shows them as a bar."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda seconds: None
        return
    from tqdm import tqdm

    with tqdm(
        total=round(length_s, 1),
        desc='playing',
        bar_format='{desc} {bar} {n:.1f}/{total:.1f} s',
        leave=False,
    ) as bar:
        yield lambda seconds: bar.update(seconds - bar.n)


def _say(line: str) -> None:
    """Print a line on stderr; playing goes on where nobody reads it."""
    if sys.stderr is None:
        return
    from vio_eval_ros.rendering.text import printable

    try:
        if sys.stderr.isatty():
            from tqdm import tqdm

            tqdm.write(f'play: {printable(line)}', file=sys.stderr)
        else:
            print(f'play: {printable(line)}', file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = None
