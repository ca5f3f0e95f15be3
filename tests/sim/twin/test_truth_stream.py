"""Truth reaches its listener whole, or the listener learns that it does not."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from sim.twin import truth_server
from sim.twin.truth_server import TruthServer
from smolbot.bench.hardware.remote_witness import RemoteWitness
from smolbot.errors import InputError, RigError


def block(count=2000):
    out = np.zeros((count, 8))
    out[:, 0] = 1e-3 * np.arange(count)
    out[:, 4] = 1.0
    return out


def test_a_listener_that_does_not_read_is_disconnected(monkeypatch):
    monkeypatch.setattr(truth_server, "MAX_WAITING_BLOCKS", 3)
    server = TruthServer("127.0.0.1", 0, {})
    with socket.create_connection(("127.0.0.1", server.port)) as deaf:
        assert deaf.recv(3) == b"{}\n"
        for _ in range(1000):  # 128 kB each: more than any buffer between two sockets
            server.publish(block())
        assert not server._listeners
        deaf.settimeout(5.0)
        taken = 0
        while data := deaf.recv(1 << 20):  # what was under way, and then the end
            taken += len(data)
    assert taken < 1000 * block().nbytes
    server.close()


def test_a_twin_that_ends_while_somebody_waits_is_an_error_at_once():
    server = TruthServer("127.0.0.1", 0, {"seed": 1})
    witness = RemoteWitness(f"127.0.0.1:{server.port}", 0.0)
    server.publish(block())
    assert witness.truth(1.5).time == 1.5
    with pytest.raises(InputError, match="not played 7"):
        witness.truth(7.0)
    server.close()
    with pytest.raises(RigError, match=f"127.0.0.1:{server.port} no longer serves"):
        witness.truth(7.0)
    assert witness.truth(1.5).time == 1.5  # what has arrived stays known
    witness.close()
