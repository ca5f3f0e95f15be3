"""Authentication of the page: every request is checked before it reaches viser's server, which checks none.

By itself, viser answers anyone who reaches its port, takes the next port if one is busy, and would open a tunnel to
its makers' host if a page asked for it. Here every request is checked first, the port is the requested one or none,
and no page opens a tunnel.
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

MAX_MESSAGE_SIZE = 1_000_000
"""Largest message, in bytes, that a page may send; clicks and drawn paths have some hundreds."""


@dataclass(frozen=True)
class Refusal:
    """Answer to a request that is refused.

    Attributes
    ----------
    status : int
        HTTP status.
    text : str
        Text of the answer, or location of a redirection.
    cookie : str
        Cookie of a redirection: the request is to be repeated with it. Empty otherwise.
    """

    status: int
    text: str
    cookie: str = ""


@dataclass(frozen=True)
class PageAccess:
    """Address of the page, and authentication of its requests.

    Attributes
    ----------
    host : str
    port : int
    token : str
        Token that a browser must show; empty if whoever reaches the port may use the page.
    key : str
        Key in every page that was delivered: a request that moves or stops a robot must show it.
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
        """Address of the page, with its token."""
        name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname(), "::1": "[::1]"}.get(self.host, self.host)
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    @property
    def cookie(self) -> str:
        """Name of the cookie that holds the token."""
        return f"smolbot_console_{self.port}"

    def check_request(self, path: str, headers: Mapping[str, str]) -> Refusal | None:
        """Check a request.

        A page of another site in the operator's browser is refused by the names that the browser sends.

        Parameters
        ----------
        path : str
        headers : mapping

        Returns
        -------
        Refusal or None
            None if the request is allowed.
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

    def is_order_allowed(self, path: str) -> bool:
        """Return whether a request shows the key of a page that was delivered.

        Parameters
        ----------
        path : str

        Returns
        -------
        bool
        """
        return hmac.compare_digest(parse_qs(urlsplit(path).query).get("key", [""])[0].encode(), self.key.encode())

    def _is_token(self, shown: str) -> bool:
        return hmac.compare_digest(shown.encode(), self.token.encode())


def check_port_free(host: str, port: int) -> None:
    """Check that a port is free.

    Parameters
    ----------
    host : str
    port : int

    Raises
    ------
    InputError
        If nothing can listen there.
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
def _authenticate_requests(
    access: PageAccess, pages: Answer, sockets: Mapping[str, Handler], log: Callable[[str], None]
) -> Iterator[None]:
    """Put our checks in front of a server that is made with `websockets` while a ``with`` block runs."""
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
            refused = access.check_request(request.path, request.headers)
            if refused is not None and refused.cookie:
                return response(303, "text/plain", b"", {"Location": refused.text, "Set-Cookie": refused.cookie})
            if refused is not None:
                log(f"A request was refused ({refused.status}): {refused.text}")
                return response(refused.status, "text/plain; charset=utf-8", refused.text.encode() + b"\n")
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
                log(f"A page's connection was closed: {type(error).__name__}: {error}")

        return original(handle, *args, process_request=look, **{**options, "max_size": MAX_MESSAGE_SIZE})

    vars(module)["serve"] = serve
    try:
        yield
    finally:
        vars(module)["serve"] = original


def open_viser(
    access: PageAccess, pages: Answer, sockets: Mapping[str, Handler], log: Callable[[str], None]
) -> ViserServer:
    """Open a viser server whose requests are authenticated.

    Parameters
    ----------
    access : PageAccess
    pages : callable
        Answers plain requests by their path: status, content type and body, or None to leave it to viser.
    sockets : mapping
        Handlers of websockets by their path; viser handles the others.
    log : callable
        Called with one line for everything that was refused.

    Returns
    -------
    viser.ViserServer

    Raises
    ------
    InputError
        If the port is busy.
    """
    import os

    import viser

    check_port_free(access.host, access.port)
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    with _authenticate_requests(access, pages, sockets, log), contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(access.host, access.port, label="smolbot", verbose=False)
    if server.get_port() != access.port:
        server.stop()
        raise InputError(f"The console cannot listen on {access.host}:{access.port}: it was taken meanwhile.")

    def refuse(verbose: bool = True) -> None:
        log("A page asked for a public address; this console opens none.")

    server.request_share_url = refuse  # type: ignore[method-assign]
    server.get_event_loop().call_soon_threadsafe(
        server.get_event_loop().set_exception_handler,
        lambda _, context: log(f"A page sent what makes no sense: {context.get('exception', context['message'])}"),
    )
    return server
