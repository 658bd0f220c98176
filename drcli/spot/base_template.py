"""CloudFormation template of what trainings share."""

from typing import Any

from drcli.spot.training_template import KIND_TAG, STACK_TAG

UNFINISHED_DAYS = 2


def base_template(stack: str) -> Any:
    """The bucket outlives the stack: `dr-spot delete` asks before it deletes models."""
    tags = [
        {"Key": STACK_TAG, "Value": stack},
        {"Key": KIND_TAG, "Value": "base"},
        {"Key": "Name", "Value": f"drcli {stack}"},
    ]
    rule = {
        "Id": "unfinished-uploads",
        "Status": "Enabled",
        "AbortIncompleteMultipartUpload": {"DaysAfterInitiation": UNFINISHED_DAYS},
    }
    encryption = {"ServerSideEncryptionByDefault": {"SSEAlgorithm": "AES256"}}
    whole = [{"Fn::GetAtt": ["Bucket", "Arn"]}, {"Fn::Sub": "${Bucket.Arn}/*"}]
    return {
        "AWSTemplateFormatVersion": "2010-09-09",
        "Description": "drcli: bucket and topic of trainings; made by dr-spot create-base",
        "Resources": {
            "Bucket": {
                "Type": "AWS::S3::Bucket",
                "DeletionPolicy": "Retain",
                "UpdateReplacePolicy": "Retain",
                "Properties": {
                    "BucketEncryption": {
                        "ServerSideEncryptionConfiguration": [encryption],
                    },
                    "PublicAccessBlockConfiguration": {
                        "BlockPublicAcls": True,
                        "BlockPublicPolicy": True,
                        "IgnorePublicAcls": True,
                        "RestrictPublicBuckets": True,
                    },
                    "LifecycleConfiguration": {"Rules": [rule]},
                    "Tags": tags,
                },
            },
            "BucketPolicy": {
                "Type": "AWS::S3::BucketPolicy",
                "Properties": {
                    "Bucket": {"Ref": "Bucket"},
                    "PolicyDocument": {
                        "Version": "2012-10-17",
                        "Statement": [
                            {
                                "Sid": "OnlyEncryptedConnections",
                                "Effect": "Deny",
                                "Principal": "*",
                                "Action": "s3:*",
                                "Resource": whole,
                                "Condition": {"Bool": {"aws:SecureTransport": "false"}},
                            }
                        ],
                    },
                },
            },
            "Topic": {
                "Type": "AWS::SNS::Topic",
                "Properties": {"DisplayName": "DeepRacer", "Tags": tags},
            },
        },
        "Outputs": {
            "Bucket": {"Value": {"Ref": "Bucket"}},
            "Topic": {"Value": {"Ref": "Topic"}},
        },
    }
