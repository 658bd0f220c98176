"""The user data of a spot machine: a small file for cloud-init, with the boot program in it."""

import base64
import gzip
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import yaml

MOST_BYTES = 16_384
"""Amazon takes no more."""


def user_data(bucket: str, groups: Sequence[str], topic: str, ends: float) -> str:
    """The text that cloud-init gets; names such as ${AWS::Region} are for CloudFormation.

    Args:
        bucket: Of the models.
        groups: The groups of machines that the end of a training sets to 0.
        topic: Address of the topic, or a name for CloudFormation.
        ends: When the group ends, in Unix seconds; 0 for never.
    """
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
