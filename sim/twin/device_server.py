"""The twin's device server, which can be killed and restarted like a process."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import grpc
from nidaqmx._stubs.nidaqmx_pb2_grpc import add_NiDAQmxServicer_to_server

from sim.twin.card_model import CardModel
from sim.twin.service import TwinServicer
from smolbot.bench.hardware.deadline import MESSAGE_LIMIT
from smolbot.errors import RigError

MAX_THREADS = 32
"""Threads of the server: every waiting read holds one."""


class DeviceServer:
    """Serves a card from construction on.

    Parameters
    ----------
    card : CardModel
    address : str
        As ``host:port``; port 0 takes a free one.

    Attributes
    ----------
    address : str
        Where it listens.

    Raises
    ------
    RigError
        If the port is taken.
    """

    def __init__(self, card: CardModel, address: str) -> None:
        self._card = card
        self._lock = threading.Lock()
        self._closed = False
        self._server, port = self._listen(address)
        self.address = f"{address.rpartition(':')[0]}:{port}"

    def _listen(self, address: str) -> tuple[grpc.Server, int]:
        options = [
            ("grpc.max_receive_message_length", MESSAGE_LIMIT),
            ("grpc.max_send_message_length", MESSAGE_LIMIT),
            ("grpc.so_reuseport", 0),
        ]
        server = grpc.server(ThreadPoolExecutor(MAX_THREADS, thread_name_prefix="device server"), options=options)
        add_NiDAQmxServicer_to_server(TwinServicer(self._card), server)
        try:
            port = server.add_insecure_port(address)
        except RuntimeError:
            port = 0
        if not port:
            raise RigError(
                f"The twin's device server cannot listen on {address}, which is taken: does another twin run? "
                "End it, or give bench.server another port."
            )
        server.start()
        return server, port

    def kill(self) -> None:
        """Stop at once; every connection breaks. The card is not affected."""
        with self._lock:
            self._server.stop(None).wait()

    def restart(self) -> None:
        """Start again, without the former tasks."""
        with self._lock:
            if not self._closed:
                self._server, _ = self._listen(self.address)

    def close(self) -> None:
        """Stop for good; harmless when repeated."""
        with self._lock:
            self._closed = True
            self._server.stop(None).wait()
