"""An S3 server in memory, which loses its objects when it stops.

Started as `python -m drcli.store.server.moto_server PORT`.
"""

import signal
import sys
import threading

from moto.server import ThreadedMotoServer


def main(port: int) -> None:
    """Serve until SIGTERM or SIGINT."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    server = ThreadedMotoServer("127.0.0.1", port, verbose=False)
    server.start()
    stop.wait()
    server.stop()


if __name__ == "__main__":
    main(int(sys.argv[1]))
