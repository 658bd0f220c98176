"""A metadata service on this machine that says what a test tells it."""

import json
import threading
from collections.abc import Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Self


class MetadataServer:
    """Answers as the services of EC2, Google and Azure do.

    Attributes:
        answers: Texts by path; all others are not found.
        asked: Paths with methods, in order.
        tokens: Tokens of EC2 that are valid.
        refused: Status for requests of tokens, if not 200.
    """

    def __init__(self) -> None:
        self.answers: dict[str, str] = {}
        self.asked: list[str] = []
        self.tokens: set[str] = set()
        self.headers: list[Mapping[str, str]] = []
        self.refused = 0
        self._given = 0
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer._answer(self, "GET")

            def do_PUT(self) -> None:
                outer._answer(self, "PUT")

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.02,), daemon=True
        )

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def describe(self, facts: Mapping[str, str]) -> None:
        """Answer with these texts, by path below latest/meta-data/ of EC2."""
        self.answers |= {f"/latest/meta-data/{name}": text for name, text in facts.items()}

    def interrupt(self, action: str = "terminate", time: str = "") -> None:
        notice = {"action": action, **({"time": time} if time else {})}
        self.describe({"spot/instance-action": json.dumps(notice)})

    def _answer(self, request: BaseHTTPRequestHandler, method: str) -> None:
        self.asked.append(f"{method} {request.path}")
        self.headers.append(dict(request.headers))
        if request.path == "/latest/api/token":
            self._give_token(request, method)
            return
        sent = request.headers.get("X-aws-ec2-metadata-token", "")
        if request.path.startswith("/latest/") and sent not in self.tokens and not self.refused:
            self._send(request, 401, "")
            return
        text = self.answers.get(request.path)
        self._send(request, 404 if text is None else 200, text or "")

    def _give_token(self, request: BaseHTTPRequestHandler, method: str) -> None:
        seconds = request.headers.get("X-aws-ec2-metadata-token-ttl-seconds", "")
        if self.refused:
            self._send(request, self.refused, "")
        elif method != "PUT" or not 1 <= int(seconds or 0) <= 21_600:
            self._send(request, 400, "")
        else:
            self._given += 1
            self.tokens.add(f"token-{self._given}")
            self._send(request, 200, f"token-{self._given}")

    def _send(self, request: BaseHTTPRequestHandler, status: int, text: str) -> None:
        data = text.encode()
        request.send_response(status)
        request.send_header("Content-Length", str(len(data)))
        if request.path.startswith("/computeMetadata/"):
            request.send_header("Metadata-Flavor", "Google")
        with suppress(ConnectionError):  # on a busy machine, the other side may have given up
            request.end_headers()
            request.wfile.write(data)
