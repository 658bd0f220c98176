"""The metadata service of an EC2 instance, as far as notices of interruptions go."""

import json
import secrets
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

TOKEN_PATH = "/latest/api/token"
ACTION_PATH = "/latest/meta-data/spot/instance-action"


class MetadataServer:
    """Answers IMDSv2 requests; without a notice there is no instance action. Close it when done."""

    def __init__(self) -> None:
        self.notice_s: float | None = None
        self._token = secrets.token_urlsafe(24)
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_PUT(self) -> None:
                known = self.path == TOKEN_PATH
                owner._answer(self, owner._token if known else None)

            def do_GET(self) -> None:
                if self.headers.get("X-aws-ec2-metadata-token") != owner._token:
                    self.send_error(401)
                    return
                owner._answer(self, owner._text(self.path))

            def log_message(self, format: str, *args: object) -> None:
                """Say nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """For AWS_EC2_METADATA_SERVICE_ENDPOINT."""
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def announce(self, in_s: float = 120.0) -> None:
        """Say that the instance ends so soon."""
        self.notice_s = time.time() + in_s

    def close(self) -> None:
        """End the service."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _text(self, path: str) -> str | None:
        if path != ACTION_PATH or self.notice_s is None:
            return None
        at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self.notice_s))
        return json.dumps({"action": "terminate", "time": at})

    def _answer(self, handler: BaseHTTPRequestHandler, text: str | None) -> None:
        if text is None:
            handler.send_error(404)
            return
        data = text.encode()
        handler.send_response(200)
        handler.send_header("Content-Length", str(len(data)))
        handler.end_headers()
        handler.wfile.write(data)
