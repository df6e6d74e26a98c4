"""How people see a running evaluation: on the terminal, in the browser, in the log."""

from contextlib import closing
import fcntl
import os
import socket
import struct
import subprocess
import sys
import termios
from threading import Thread
from urllib.request import urlopen

import pytest


def free_port() -> int:
    with closing(socket.socket()) as one:
        one.bind(('127.0.0.1', 0))
        return one.getsockname()[1]


@pytest.mark.needs('aiohttp')
def test_the_page_is_told_what_the_diagnostics_say_and_ends_with_the_node(
    graph, ros, flight, evaluator
):
    port = free_port()
    node = evaluator(f'web_port:={port}')
    estimate, truth = graph.both()
    heard: list[bytes] = []

    def listen() -> None:
        with urlopen(f'http://127.0.0.1:{port}/events', timeout=60) as answer:
            heard.extend(answer)

    listener = Thread(target=listen)
    listener.start()
    try:
        graph.wait_until(lambda: b'no pairs yet: ' in b''.join(heard), 'a state')
        ros.send(estimate, flight.estimate)
        ros.send(truth, flight.ground_truth)
        graph.wait_for_arrival()
        graph.wait_until(lambda: b'381 pairs' in b''.join(heard), 'the last state')
    finally:
        node.stop()
        listener.join()
    assert f'the page is at http://127.0.0.1:{port}/' in node.told


@pytest.mark.needs('aiohttp')
def test_a_port_that_is_taken_does_not_end_the_evaluation(graph, evaluator):
    with closing(socket.create_server(('127.0.0.1', 0))) as taken:
        port = taken.getsockname()[1]
        node = evaluator(f'web_port:={port}')
        graph.wait_for('accuracy', 'WARN', 'no pairs yet')
        complaint = node.stop()
    assert f'no page at 127.0.0.1:{port}: address already in use; ' in complaint
    assert complaint.rstrip().endswith('the evaluation goes on without it')
    assert complaint.count('\n') == 1


def test_a_misspelt_topic_is_told_once_with_the_one_that_is_meant(graph, ros, evaluator):
    node = evaluator(reliable=False, arguments=['-r', 'ground_truth:=/ground_truht'])
    graph.publisher('/estimate', ros.ESTIMATE)
    graph.publisher('/ground_truth', ros.GROUND_TRUTH, matched=False)
    meant = "nobody publishes /ground_truht; did you mean '/ground_truth'?"
    for name in ('association', 'streams'):
        graph.wait_for(name, 'WARN', meant)
    # in the log when it has stood for a while
    graph.wait_until(lambda: node._node._screens._notices._told, 'a line in the log')
    graph.wait_for_statuses()
    assert node.stop().count(meant) == 1


def test_a_terminal_shows_a_line_below_the_log(graph, ros, environment, flight):
    reader, writer = os.openpty()
    fcntl.ioctl(writer, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 100, 0, 0))
    process = subprocess.Popen(
        [sys.executable, '-m', 'vio_eval_ros', 'evaluator'],
        env=environment | {'TERM': 'xterm'},
        stderr=writer,
    )
    os.close(writer)
    shown = bytearray()

    def read() -> None:
        while True:
            try:
                shown.extend(os.read(reader, 10_000))
            except OSError:  # the other side is closed
                return

    listener = Thread(target=read)
    listener.start()
    graph.processes.append(process)
    try:
        estimate, truth = graph.both()
        ros.send(estimate, flight.estimate)
        ros.send(truth, flight.ground_truth)
        graph.wait_until(lambda: b'381 pairs  ATE 0.' in shown, 'a line')
    finally:
        graph.processes.remove(process)
        process.terminate()
        process.wait(timeout=60)
        listener.join()
        os.close(reader)
    text = shown.decode()
    assert '\x1b[J[INFO]' in text.replace('\x1b[0m', '')
    assert text.endswith('\x1b[J')
    assert '\x1b[K\r' in text
