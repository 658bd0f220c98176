"""cloud-init's user data, with the boot program."""

import base64
import gzip
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import yaml

MOST_BYTES = 16_384
"""Amazon's limit."""


def user_data(bucket: str, groups: Sequence[str], topic: str, ends: float) -> str:
    """Names such as ${AWS::Region} are for CloudFormation; `ends` is Unix seconds, 0 for never."""
    facts = {
        "stack": "${AWS::StackName}",
        "bucket": bucket,
        "region": "${AWS::Region}",
        "domain": "${AWS::URLSuffix}",
        "topic": topic,
        "groups": list(groups),
        "ends": ends,
    }
    program = files("drcli.spot").joinpath("boot.py").read_bytes()
    packed = base64.b64encode(gzip.compress(program, 9, mtime=0)).decode()
    content: dict[str, Any] = {
        "write_files": [
            {
                "path": "/etc/drcli/machine.json",
                "permissions": "0644",
                "content": json.dumps(facts) + "\n",
            },
            {
                "path": "/opt/drcli/boot.py",
                "permissions": "0755",
                "encoding": "gz+b64",
                "content": packed,
            },
        ],
        "runcmd": [["python3", "/opt/drcli/boot.py", "start"]],
    }
    text = "#cloud-config\n" + yaml.safe_dump(content, sort_keys=False, width=1_000_000)
    if len(text) > MOST_BYTES:
        raise ValueError(f"the user data have {len(text)} bytes, more than {MOST_BYTES}")
    return text
