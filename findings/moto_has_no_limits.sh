#!/usr/bin/env bash
# moto 5.2.5, asked by boto3 1.44.5.
#
# What one expects: what passes against moto passes against Amazon S3.
# What happens: moto refuses wrong conditions, short parts and ranges as S3 does, but it does not know
# these limits of S3: a key has at most 1,024 bytes, a listing at most 1,000 keys, DeleteObjects
# takes at most 1,000 keys, and a bucket name has neither capitals nor underscores.
# Source of the limits: the Amazon S3 API reference (ListObjectsV2, DeleteObjects) and user guide
# (object key naming, bucket naming rules).
#
# Output seen:
#
#   a key of 2,000 bytes: 200
#   a listing with MaxKeys=5000: 1005 keys, truncated: False
#   DeleteObjects of 1,001 keys: 1001 deleted
#   making the bucket My_Bucket: 200
#
# It ends with 0 if the behaviour is as stated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "moto[s3]==5.2.5" "boto3==1.44.5"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import os
import sys

import boto3
from moto import mock_aws

names = {"AWS_ACCESS_KEY_ID": "k", "AWS_SECRET_ACCESS_KEY": "s", "AWS_DEFAULT_REGION": "us-east-1"}
os.environ |= names
with mock_aws():
    s3 = boto3.client("s3")
    s3.create_bucket(Bucket="bucket")
    long = s3.put_object(Bucket="bucket", Key="k" * 2000, Body=b"")
    long_code = long["ResponseMetadata"]["HTTPStatusCode"]
    print(f"a key of 2,000 bytes: {long_code}")
    for n in range(1004):
        s3.put_object(Bucket="bucket", Key=f"n/{n}", Body=b"")
    page = s3.list_objects_v2(Bucket="bucket", MaxKeys=5000)
    count, truncated = len(page["Contents"]), page["IsTruncated"]
    print(f"a listing with MaxKeys=5000: {count} keys, truncated: {truncated}")
    keys = [{"Key": f"n/{n}"} for n in range(1001)]
    deleted = len(s3.delete_objects(Bucket="bucket", Delete={"Objects": keys})["Deleted"])
    print(f"DeleteObjects of 1,001 keys: {deleted} deleted")
    made = s3.create_bucket(Bucket="My_Bucket")["ResponseMetadata"]["HTTPStatusCode"]
    print(f"making the bucket My_Bucket: {made}")
sys.exit(0 if (long_code, count, deleted, made) == (200, 1005, 1001, 200) else 1)
PYTHON
