"""How live pictures travel between a worker and a viewer: proof of the key, then messages.

Not `multiprocessing.connection`: its listener waits forever for a silent visitor, its sender for a
reader that does not read. Nothing is unpickled.
"""

import hashlib
import hmac
import secrets
import socket

from drcli.exchange.framing import WireError, exactly, framed
from drcli.exchange.live_record import PROTOCOL

HOST = "127.0.0.1"

MOST_MESSAGE_BYTES = 4 << 20
MOST_REQUEST_BYTES = 4096
_GREETING = b"drcli-live-%d\n" % PROTOCOL
_NONCE_BYTES = 32


def admit(peer: socket.socket, key: bytes) -> None:
    """Let a viewer in that knows the key, and prove to know it too.

    Raises:
        WireError: It does not know it.
        OSError: It left or timed out.
    """
    own = secrets.token_bytes(_NONCE_BYTES)
    peer.sendall(_GREETING + own)
    theirs = exactly(peer, _NONCE_BYTES)
    if not hmac.compare_digest(exactly(peer, _NONCE_BYTES), _proof(key, b"viewer", own, theirs)):
        raise WireError("the viewer does not know the key")
    peer.sendall(_proof(key, b"worker", own, theirs))


def enter(peer: socket.socket, key: bytes) -> None:
    """Check that a worker knows the key, and prove to know it too.

    Raises:
        WireError: It is another program, or refuses the key.
        OSError: It left or timed out.
    """
    if exactly(peer, len(_GREETING)) != _GREETING:
        raise WireError("another program listens there")
    theirs = exactly(peer, _NONCE_BYTES)
    own = secrets.token_bytes(_NONCE_BYTES)
    peer.sendall(own + _proof(key, b"viewer", theirs, own))
    if not hmac.compare_digest(exactly(peer, _NONCE_BYTES), _proof(key, b"worker", theirs, own)):
        raise WireError("the worker does not know the key")


def send(peer: socket.socket, data: bytes) -> None:
    """OSError if the other side left or does not read in time."""
    peer.sendall(framed(data))


def _proof(key: bytes, side: bytes, of_worker: bytes, of_viewer: bytes) -> bytes:
    """Depends on both random numbers, so it cannot be reused."""
    return hmac.digest(key, side + of_worker + of_viewer, hashlib.sha256)
