"""Who may open the page: a guard in front of viser's server, which has none of its own.

viser answers whoever reaches its port, takes the next port where one is busy, and would open a tunnel to its makers'
host when a page asks for it. Here every request is looked at first, the port is the one that was asked for or none,
and no page opens anything.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import io
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from smolbot.errors import InputError

if TYPE_CHECKING:
    from viser import ViserServer

LOOPBACK = ("127.0.0.1", "localhost", "::1")

LARGEST = 1_000_000
"""Bytes of the largest message that a page may send; clicks and drawn paths are some hundreds."""


@dataclass(frozen=True)
class Refusal:
    """What somebody is told who may not come in; `cookie` is set where the way in is to ask again with it."""

    status: int
    words: str
    cookie: str = ""


@dataclass(frozen=True)
class Door:
    """Where the page is, and who may open it.

    Attributes
    ----------
    host : str
    port : int
    token : str
        That a page must show; empty where whoever reaches the port may come in.
    key : str
        Written into every page that was let in: what moves or stops a robot by a plain request must show it.
    """

    host: str
    port: int
    token: str = ""
    key: str = field(default_factory=lambda: secrets.token_urlsafe(16))

    def __post_init__(self) -> None:
        if self.host not in LOOPBACK and not self.token:
            raise InputError(f"--host {self.host}: a page that others can reach needs a token; none is set.")

    @property
    def address(self) -> str:
        """Of the page, token and all."""
        name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname(), "::1": "[::1]"}.get(self.host, self.host)
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    @property
    def cookie(self) -> str:
        return f"smolbot_console_{self.port}"

    def refusal(self, path: str, headers: Mapping[str, str]) -> Refusal | None:
        """Why a request is not answered; None if it is.

        A page of another site that runs in the operator's browser is stopped by the names that the browser sends.
        """
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if self.host in LOOPBACK and urlsplit(f"//{host}").hostname not in LOOPBACK:
            return Refusal(403, f"This console answers to {self.host} only; the request asks for '{host}'.")
        if origin is not None and urlsplit(origin).netloc != host:
            return Refusal(403, f"A page of {origin} may not use this console.")
        if not self.token:
            return None
        shown = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if shown and self._is_token(shown):
            return Refusal(303, "/", f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict")
        with contextlib.suppress(CookieError):
            kept = SimpleCookie(headers.get("Cookie", "")).get(self.cookie)
            if kept is not None and self._is_token(kept.value):
                return None
        return Refusal(401, "This console asks for its token: open the address that it printed when it was started.")

    def may_order(self, path: str) -> bool:
        """Whether a request shows the key of a page that was let in."""
        return hmac.compare_digest(parse_qs(urlsplit(path).query).get("key", [""])[0].encode(), self.key.encode())

    def _is_token(self, shown: str) -> bool:
        return hmac.compare_digest(shown.encode(), self.token.encode())


def must_be_free(host: str, port: int) -> None:
    """Raise a clear error where nothing can listen.

    Raises
    ------
    InputError
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.create_server((host, port), family=family):
            pass
    except OSError as error:
        raise InputError(
            f"The console cannot listen on {host}:{port}: {error.strerror or error}. Name another port with --port."
        ) from error


Answer = Callable[[str], tuple[int, str, bytes] | None]
Handler = Callable[[Any], Awaitable[None]]


@contextlib.contextmanager
def _guarded(door: Door, pages: Answer, sockets: Mapping[str, Handler], tell: Callable[[str], None]) -> Iterator[None]:
    """While the block runs, a server that is made with `websockets` gets our guard in front."""
    import websockets.asyncio.server as module
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    original = module.serve

    def response(status: int, kind: str, body: bytes, more: Mapping[str, str] | None = None) -> Response:
        reason = http.HTTPStatus(status)
        headers = Headers({"Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store"})
        headers.update(more or {})
        return Response(reason.value, reason.phrase, headers, body)

    def serve(handler: Handler, *args: Any, process_request: Any, **options: Any) -> Any:
        def look(connection: Any, request: Any) -> Any:
            refused = door.refusal(request.path, request.headers)
            if refused is not None and refused.cookie:
                return response(303, "text/plain", b"", {"Location": refused.words, "Set-Cookie": refused.cookie})
            if refused is not None:
                tell(f"A request was refused ({refused.status}): {refused.words}")
                return response(refused.status, "text/plain; charset=utf-8", refused.words.encode() + b"\n")
            if request.headers.get("Upgrade", "").lower() != "websocket":
                answer = pages(request.path)
                if answer is not None:
                    return response(*answer)
            return process_request(connection, request)

        async def handle(connection: Any) -> None:
            inner = sockets.get(urlsplit(connection.request.path).path, handler)
            try:
                await inner(connection)
            except Exception as error:  # whatever one page sends must not end the others
                tell(f"A page's connection was closed: {type(error).__name__}: {error}")

        return original(handle, *args, process_request=look, **{**options, "max_size": LARGEST})

    vars(module)["serve"] = serve
    try:
        yield
    finally:
        vars(module)["serve"] = original


def open_viser(door: Door, pages: Answer, sockets: Mapping[str, Handler], tell: Callable[[str], None]) -> ViserServer:
    """A viser server behind the door.

    Parameters
    ----------
    pages : callable
        Answers plain requests by their path: status, content type and body, or None to leave it to viser.
    sockets : mapping
        Handlers of websockets by their path; viser has the others.
    tell : callable
        Told in one line of everything that was refused.

    Raises
    ------
    InputError
        If the port is busy.
    """
    import os

    import viser

    must_be_free(door.host, door.port)
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    with _guarded(door, pages, sockets, tell), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(door.host, door.port, label="smolbot", verbose=False)
    if server.get_port() != door.port:
        server.stop()
        raise InputError(f"The console cannot listen on {door.host}:{door.port}: it was taken meanwhile.")

    def refuse(verbose: bool = True) -> None:
        tell("A page asked for a public address; this console opens none.")

    server.request_share_url = refuse  # type: ignore[method-assign]
    server.get_event_loop().call_soon_threadsafe(
        server.get_event_loop().set_exception_handler,
        lambda _, context: tell(f"A page sent what makes no sense: {context.get('exception', context['message'])}"),
    )
    return server
