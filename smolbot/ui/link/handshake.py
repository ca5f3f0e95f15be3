"""Mutual authentication of both ends of a link by a shared secret, which is not sent."""

from __future__ import annotations

import hashlib
import hmac
import os
import socket

from smolbot.ui.link.frames import LinkError, receive_exactly

GREETING = b"smolbot link 1\n"
_NONCE = 32

STEP_TIMEOUT = 2.0
"""Time limit of each step, in s."""


def _compute_proof(secret: bytes, role: bytes, ours: bytes, theirs: bytes) -> bytes:
    return hmac.digest(secret, GREETING + role + ours + theirs, hashlib.sha256)


def authenticate_caller(sock: socket.socket, secret: bytes) -> None:
    """Authenticate as the accepting end; nothing else that the peer sends is read before.

    Parameters
    ----------
    sock : socket.socket
    secret : bytes

    Raises
    ------
    LinkError
        If the peer does not know the secret.
    """
    nonce = os.urandom(_NONCE)
    sock.sendall(GREETING + nonce)
    theirs = receive_exactly(sock, _NONCE)
    if not hmac.compare_digest(receive_exactly(sock, 32), _compute_proof(secret, b"caller", nonce, theirs)):
        raise LinkError("it does not know the secret")
    sock.sendall(_compute_proof(secret, b"console", nonce, theirs))


def authenticate_to_console(sock: socket.socket, secret: bytes) -> None:
    """Authenticate as the connecting end.

    Parameters
    ----------
    sock : socket.socket
    secret : bytes

    Raises
    ------
    LinkError
        If the peer is no console, or not ours.
    """
    try:
        greeting = receive_exactly(sock, len(GREETING))
        if greeting != GREETING:
            raise LinkError(f"no console answers there, but something that says {greeting!r}")
        theirs, nonce = receive_exactly(sock, _NONCE), os.urandom(_NONCE)
        sock.sendall(nonce + _compute_proof(secret, b"caller", theirs, nonce))
        answer = receive_exactly(sock, 32)
    except TimeoutError as error:
        raise LinkError("no console answers there") from error
    if not hmac.compare_digest(answer, _compute_proof(secret, b"console", theirs, nonce)):
        raise LinkError("what answers there does not know the secret of our console")
