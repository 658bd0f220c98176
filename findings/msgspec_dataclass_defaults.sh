#!/usr/bin/env bash
# msgspec 0.22.0.
#
# What one expects: a dataclass that msgspec has decoded equals one that Python made, in all that can
# be seen of it.
# What happens: a plain default is not stored in the decoded object, which goes on reading it from the
# class; one of `default_factory` is stored. So `vars(record)` and what builds on it (a debugger, a
# JSON encoder of `__dict__`, a pickle) lack the field, although ==, repr, asdict and replace show it.
#
# Output seen:
#
#   decoded: {'step': 1, 'laps': []}
#   made:    {'step': 1, 'speed': 2.5, 'laps': []}
#   equal: True
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "msgspec==0.22.0"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from dataclasses import dataclass, field

import msgspec


@dataclass(frozen=True)
class Record:
    step: int
    speed: float = 2.5
    laps: list[float] = field(default_factory=list)


decoded, made = msgspec.json.decode(b'{"step": 1}', type=Record), Record(1)
print("decoded:", vars(decoded))
print("made:   ", vars(made))
print("equal:", decoded == made)
sys.exit(not (decoded == made and "speed" in vars(made) and "speed" not in vars(decoded)))
PYTHON
