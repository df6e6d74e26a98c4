"""
Serves the page of a running evaluation, in a thread of its own.

Each client has the newest state or waits for it: none has a queue, so that slow ones cost nothing
and hold up nobody. The page and what it shows go to programs on this machine only, unless the user
names another address, and to pages of other sites never.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Sequence
import ipaddress
import logging
import socket
from threading import Thread
from typing import Any, TYPE_CHECKING
from urllib.parse import urlsplit

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.page import document, state, View

if TYPE_CHECKING:
    from aiohttp import web

    Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

#: clients at a time
MOST_CONNECTIONS = 32
#: how long a client may take nothing before it is let go
STUCK_S = 10.0
CHUNK = 65_536
HEADERS = {
    'Cache-Control': 'no-store',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
}
#: how soon a page tries again when the evaluator has gone [ms]
RETRY = b'retry: 2000\n\n'


class PageServer:
    """
    The page of an evaluation, as long as it is not closed.

    :param name: of the node.
    :param host: the address to listen on.
    :param port: likewise; 0 for one that is free.
    :param complain: logs what the user should know; called in the thread of the server.
    :raises ConfigError: a library that is missing.
    :raises OSError: where it cannot listen there.
    """

    def __init__(self, name: str, host: str, port: int, complain: Callable[[str], object]) -> None:
        self._web = _library()
        self._page = document(name).encode()
        self._names = {'localhost', host, socket.gethostname(), f'{socket.gethostname()}.local'}
        self._complain = complain
        self._newest: tuple[int, Sequence[View]] = (0, ())
        self._drawn: tuple[int, Sequence[View]] = self._newest
        self._event = b''  # what was drawn last, as it is sent
        self._changed = asyncio.Event()  # of this event
        self._is_ending = False
        self._problem = ''
        self._watching = 0
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name='page', daemon=True)
        self._thread.start()
        try:
            self._do(self._start(host, port))
        except BaseException:
            self._end()
            raise

    @property
    def is_watched(self) -> bool:
        """Whether anybody looks: else nothing need be shown."""
        return self._watching > 0

    def show(self, run: int, views: Sequence[View]) -> None:
        """Show a state in place of the one before; drawing it is left to the other thread."""
        self._newest = (run, views)
        self._loop.call_soon_threadsafe(self._draw)

    def close(self) -> None:
        """Serve no more."""
        if not self._loop.is_closed():
            self._do(self._stop())
            self._end()

    def _do(self, what: Coroutine[Any, Any, None]) -> None:
        """Do something in the thread of the server, and wait until it is done."""
        asyncio.run_coroutine_threadsafe(what, self._loop).result()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _start(self, host: str, port: int) -> None:
        app = self._web.Application()
        for path, give in (('/', self._give_page), ('/events', self._give_events)):
            app.router.add_get(path, self._to_own_names(give), allow_head=False)
        app.on_response_prepare.append(_add_headers)
        # what is wrong with a request concerns its sender
        logger = logging.Logger('page')
        logger.addHandler(logging.NullHandler())
        self._runner = self._web.AppRunner(
            app,
            access_log=None,
            logger=logger,
            handler_cancellation=True,
            shutdown_timeout=1.0,
        )
        await self._runner.setup()
        self._server = await self._loop.create_server(self._protocol, host, port)
        address, port = self._server.sockets[0].getsockname()[:2]
        #: where the page is
        self.address = f'http://{f"[{address}]" if ":" in address else address}:{port}/'

    async def _stop(self) -> None:
        self._is_ending = True
        self._changed.set()
        self._server.close()
        await self._runner.cleanup()

    def _protocol(self) -> asyncio.Protocol:
        """Return what serves a new client."""
        server = self._runner.server
        assert server is not None  # the runner was set up
        return server() if len(server.connections) < MOST_CONNECTIONS else _Refusal()

    def _draw(self) -> None:
        """Draw the newest state, once, and have it sent to all who wait."""
        if self._newest is self._drawn:
            return
        self._drawn = self._newest
        try:
            self._event = f'data: {state(*self._drawn)}\n\n'.encode()
        except Exception as error:  # the evaluation goes on, and may have more luck next time
            problem = f'{type(error).__name__}: {error}'
            if problem != self._problem:
                self._problem = problem
                self._complain(f'the page failed: this is a bug, please report it: {problem}')
            return
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _to_own_names(self, give: Handler) -> Handler:
        """
        Return a handler for those who asked for this machine by its name or an address.

        A page of another site may have a name of its own resolved to this machine, and could then
        read what the browser takes for that site's.
        """

        async def answer(request: web.Request) -> web.StreamResponse:
            if self._is_own(request.headers.get('Host', '')):
                return await give(request)
            return self._web.Response(status=403, text='This is not the name of this machine.\n')

        return answer

    def _is_own(self, host: str) -> bool:
        try:
            name = urlsplit(f'//{host}').hostname or ''
            if name in self._names:
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    async def _give_page(self, request: web.Request) -> web.StreamResponse:
        response = self._web.StreamResponse(headers={'Content-Type': 'text/html; charset=utf-8'})
        response.content_length = len(self._page)
        await response.prepare(request)
        for begin in range(0, len(self._page), CHUNK):
            if not await _sent(request, response, self._page[begin : begin + CHUNK]):
                break
        return response

    async def _give_events(self, request: web.Request) -> web.StreamResponse:
        response = self._web.StreamResponse(headers={'Content-Type': 'text/event-stream'})
        await response.prepare(request)
        self._watching += 1
        try:
            seen, goes_on = self._drawn, await _sent(request, response, RETRY)
            while goes_on and not self._is_ending:
                if seen is self._drawn:
                    await self._changed.wait()
                    continue
                seen = self._drawn
                goes_on = await _sent(request, response, self._event)
        finally:
            self._watching -= 1
        return response


class _Refusal(asyncio.Protocol):
    """Serves nothing: there are clients enough."""

    def connection_made(self, transport: Any) -> None:
        """Close the connection."""
        transport.abort()


async def _sent(request: web.Request, response: web.StreamResponse, data: bytes) -> bool:
    """Return whether a client has taken what was sent; one that is stuck is let go."""
    try:
        await asyncio.wait_for(response.write(data), STUCK_S)
    except asyncio.TimeoutError:
        if request.transport is not None:
            request.transport.abort()
        return False
    except ConnectionError:
        return False
    return True


async def _add_headers(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)


def _library() -> Any:
    try:
        from aiohttp import web
    except ImportError:
        raise ConfigError(
            "aiohttp is not installed; pip install 'vio_eval_ros[web]', or install the package "
            'python3-aiohttp'
        ) from None
    return web
