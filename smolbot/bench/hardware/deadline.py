"""A gRPC channel to a device server with a deadline for every call."""

from __future__ import annotations

from typing import Any

MESSAGE_LIMIT = 64 * 2**20  # bytes; by default a long recording fails after it was taken from the card
CONNECT_TIMEOUT = 3.0  # s, to find the server


def open_channel(address: str, timeout: float) -> tuple[Any, Any]:
    """Open a gRPC channel to a device server on which every call has a deadline.

    Parameters
    ----------
    address : str
        As host:port.
    timeout : float, in s
        Deadline of a call, in addition to the timeout of the request itself.

    Returns
    -------
    channel : grpc.Channel
        With deadlines.
    bare : grpc.Channel
        The channel beneath, which is to be closed.

    Raises
    ------
    ConnectionError
        If nothing answers there.
    ModuleNotFoundError
        If gRPC is not installed.
    """
    import grpc

    options = [
        ("grpc.max_receive_message_length", MESSAGE_LIMIT),
        ("grpc.max_send_message_length", MESSAGE_LIMIT),
        ("grpc.enable_http_proxy", 0),
        ("grpc.use_local_subchannel_pool", 1),  # a connection of its own
    ]
    bare = grpc.insecure_channel(address, options)
    try:
        grpc.channel_ready_future(bare).result(CONNECT_TIMEOUT)
    except grpc.FutureTimeoutError as error:
        bare.close()
        raise ConnectionError(f"no device server answers at {address}") from error

    class Details(grpc.ClientCallDetails):  # type: ignore[misc,unused-ignore]
        def __init__(self, details: Any, timeout: float) -> None:
            self.method, self.metadata, self.credentials = details.method, details.metadata, details.credentials
            self.wait_for_ready, self.compression = None, None
            self.timeout = timeout

    class Deadline(grpc.UnaryUnaryClientInterceptor):  # type: ignore[misc,unused-ignore]
        def intercept_unary_unary(self, continuation: Any, details: Any, request: Any) -> Any:
            """Give a call its deadline.

            Parameters
            ----------
            continuation : callable
            details : grpc.ClientCallDetails
            request : object

            Returns
            -------
            grpc.Call
            """
            own = getattr(request, "timeout", 0.0)
            allowed = timeout + (own if isinstance(own, float | int) and own > 0.0 else 0.0)
            return continuation(Details(details, allowed), request)

    return grpc.intercept_channel(bare, Deadline()), bare
