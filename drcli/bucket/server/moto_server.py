"""An S3 server in memory, for tests, lost at its end.

Run as `python -m drcli.bucket.server.moto_server PORT`.
"""

import sys
import threading

from moto.server import ThreadedMotoServer

from drcli.base.processes import handle


def main(port: int) -> None:
    stop = threading.Event()
    handle(lambda *_: stop.set())
    server = ThreadedMotoServer("127.0.0.1", port, verbose=False)
    server.start()
    stop.wait()
    server.stop()


if __name__ == "__main__":
    main(int(sys.argv[1]))
