"""A mail server and a webhook on this machine, which keep what they get."""

import json
import socketserver
import ssl
import threading
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


@dataclass
class Hook:
    """A webhook: bodies of requests, and the statuses of the next answers (then 200)."""

    url: str = ""
    bodies: list[dict[str, Any]] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)


@contextmanager
def hook() -> Iterator[Hook]:
    """A webhook on this machine."""
    state = Hook()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            data = self.rfile.read(int(self.headers["Content-Length"]))
            status = state.statuses.pop(0) if state.statuses else 200
            if status == 200:
                state.bodies.append(json.loads(data))
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    state.url = f"http://127.0.0.1:{server.server_port}/services/T0/B0/hook-secret"
    try:
        yield state
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@dataclass
class Post:
    """A mail server: what it got, and what it wants.

    Attributes:
        mails: Texts of the mails.
        logins: User and password of each login.
        encrypted: Whether the last mail came over an encrypted connection.
        refuses: Answer to a recipient, if it refuses all.
        password: The right one.
    """

    port: int = 0
    mails: list[str] = field(default_factory=list)
    logins: list[tuple[str, str]] = field(default_factory=list)
    encrypted: bool = False
    refuses: str = ""
    password: str = "p@ss"


@contextmanager
def post_office(certificate: tuple[Path, Path] | None, *, at_once: bool = False) -> Iterator[Post]:
    """A mail server on this machine.

    Args:
        certificate: It offers encryption with it; None for none.
        at_once: Whether the connection is encrypted from its beginning.
    """
    state = Post()
    context = None
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate)

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            encrypted = at_once and context is not None
            self.connection = self.request
            try:
                if encrypted and context is not None:
                    self.connection = context.wrap_socket(self.connection, server_side=True)
                self.talk(encrypted)
            except (OSError, ValueError):
                return
            finally:
                self.connection.close()

        def talk(self, encrypted: bool) -> None:
            stream = self.connection.makefile("rb")

            def say(line: str) -> None:
                self.connection.sendall(f"{line}\r\n".encode())

            say("220 ready")
            while line := stream.readline():
                words = line.decode().split()
                verb = words[0].upper() if words else ""
                if verb == "EHLO":
                    offers = [] if encrypted or context is None else ["250-STARTTLS"]
                    for offer in ["250-post", *offers, "250 AUTH PLAIN"]:
                        say(offer)
                elif verb == "STARTTLS" and context is not None:
                    say("220 go ahead")
                    self.connection = context.wrap_socket(self.connection, server_side=True)
                    stream.close()
                    stream, encrypted = self.connection.makefile("rb"), True
                elif verb == "AUTH":
                    _, user, password = b64decode(words[2]).decode().split("\0")
                    state.logins.append((user, password))
                    say("235 welcome" if password == state.password else "535 no")
                elif verb == "RCPT" and state.refuses:
                    say(state.refuses)
                elif verb == "DATA":
                    say("354 go on")
                    lines = []
                    while (text := stream.readline()) != b".\r\n":
                        lines.append(text.decode())
                    state.mails.append("".join(lines))
                    state.encrypted = encrypted
                    say("250 taken")
                elif verb == "QUIT":
                    say("221 bye")
                    return
                else:
                    say("250 fine")

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True
        allow_reuse_address = True

    server = Server(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    state.port = server.server_address[1]
    try:
        yield state
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
