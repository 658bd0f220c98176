"""The process that checks reward functions: `python -m drcli.web.reward_process`.

It reads and writes JSON lines, and ends with its input, so never outlives the console. It keeps the
simulation out of the console.
"""

import json
import os
import queue
import sys
import threading
from pathlib import Path
from typing import Any

from drcli.base.installation import lazy_imports
from drcli.base.json_record import plain
from drcli.config.loading import load_settings
from drcli.web.answers import error_of, placed

with lazy_imports():
    from drcli.rewards import live_check


class _Requests(threading.Thread):
    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.waiting: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.given_up = threading.Event()
        self._cancelled = 0

    def run(self) -> None:
        for line in sys.stdin.buffer:
            request = json.loads(line)
            if "cancel" in request:
                self._cancelled = request["cancel"]
                self.given_up.set()
            else:
                self.waiting.put(request)
        os._exit(0)  # the console has ended

    def begin(self, number: int) -> threading.Event:
        if self._cancelled < number:
            self.given_up.clear()
        return self.given_up


def main() -> None:
    # What the racer's code or a library prints must not get into the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    requests = _Requests()
    requests.start()
    checker = None
    while True:
        request = requests.waiting.get()
        given_up = requests.begin(request["number"])
        try:
            if checker is None:
                checker = live_check.LiveCheck()
            folder = Path(request["folder"])
            found = checker.check(
                load_settings(folder),
                request["text"].encode(),
                folder,
                request["known"],
                given_up,
                whole=request["whole"],
            )
            answer: dict[str, Any] = {"superseded": True}
            if found is not None:
                answer = plain(found) | {"problems": [placed(each) for each in found.problems]}
                if found.more:  # the page keeps the rest of the answer before
                    answer = {name: answer[name] for name in ("more", "picture", "course")}
        except Exception as error:
            answer = error_of(error)
        answers.write(json.dumps(answer, allow_nan=False).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    main()
