"""What the page's server accepts: requests of this machine's own names, and messages of the controls and the camera."""

from __future__ import annotations

import asyncio
import contextlib
import http
import logging
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import msgspec
import websockets.asyncio.server

HOST = "127.0.0.1"
"""The page is served to this machine only, because it has no password."""
_LOCAL = {HOST, "localhost", "::1"}
_LARGEST = 2**16
"""Largest message of a browser; those of the page have some hundred [bytes]."""


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | float | str


class _Control(msgspec.Struct, forbid_unknown_fields=True, tag="GuiUpdateMessage"):
    uuid: str
    updates: _Value


class _Camera(msgspec.Struct, tag="ViewerCameraMessage"):
    pass


_MESSAGES = msgspec.msgpack.Decoder(_Control | _Camera)


def _is_local(headers: Any) -> bool:
    named = [*headers.get_all("Host"), *headers.get_all("Origin")]
    try:
        names = {urlsplit(text if "//" in text else f"//{text}").hostname for text in named}
    except ValueError:
        return False
    return bool(names) and names <= _LOCAL


def _is_of_the_page(message: bytes | str) -> bool:
    try:
        _MESSAGES.decode(message if isinstance(message, bytes) else b"")
    except (msgspec.MsgspecError, RecursionError):
        return False
    return True


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Make a viser server that is started in this context accept only what this machine's browsers send to the page.

    viser has no setting for this. Otherwise a page on the internet whose name resolves to this machine (DNS
    rebinding), or that opens a websocket to it, could watch the walk and use the controls; and a message could have
    viser publish the page on the internet (ShareUrlRequest), or change more of a control than its value. Errors within
    the server are logged in one line each, the first of its kind.
    """
    serve = websockets.asyncio.server.serve

    def guarded_serve(handler: Any, *args: Any, process_request: Any = None, **options: Any) -> Any:
        log = _Log()
        asyncio.get_running_loop().set_exception_handler(lambda _, context: log(**context))

        def check(connection: Any, request: Any) -> Any:
            if not _is_local(request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "this page is for this machine only\n")
            return process_request(connection, request) if process_request is not None else None

        async def checked(connection: Any) -> None:
            receive = connection.recv

            async def recv() -> Any:
                while not _is_of_the_page(message := await receive()):
                    pass
                return message

            connection.recv = recv
            try:
                await handler(connection)
            except Exception as error:  # viser's, of a message whose values it cannot use
                log("a connection has ended", error)

        return serve(checked, *args, process_request=check, **{**options, "max_size": _LARGEST})

    websockets.asyncio.server.serve = guarded_serve  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


class _Log:
    """Logs errors of a server."""

    def __init__(self) -> None:
        self._said = set[str]()

    def __call__(self, message: str, exception: BaseException | None = None, **_: Any) -> None:
        kind = f"{message}: {type(exception).__name__}"
        if kind not in self._said:
            self._said.add(kind)
            logging.getLogger(__name__).warning("the server of the page: %s: %r", message, exception)
