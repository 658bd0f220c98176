"""Access to a stack: addresses of machines and of mail."""

import ipaddress
from typing import Any

from drcli.base.errors import SettingsError
from drcli.spot.aws_account import Account
from drcli.spot.stacks import Stack
from drcli.store.s3_errors import error_code


def subscribe(account: Account, topic: str, email: str) -> None:
    """The receiver of the mail must agree first."""
    with account.trying(f"send messages to {email}"):
        account.client("sns").subscribe(TopicArn=topic, Protocol="email", Endpoint=email)


def add_access(account: Account, stack: Stack, address: str) -> str:
    """Open port 22 of a stack to one address; returns its range.

    Raises:
        SettingsError: It is not a single address.
    """
    from botocore.exceptions import ClientError

    try:
        single = ipaddress.ip_address(address.removesuffix("/32").removesuffix("/128"))
    except ValueError as error:
        raise SettingsError(
            f"'{address[:80]}' is not the address of one machine.",
            remedy="Give your own public address, as in 203.0.113.7.",
        ) from error
    if single.is_unspecified or single.is_private:
        raise SettingsError(
            f"{single} is not an address that machines at Amazon see.",
            remedy="Give your public address, which https://checkip.amazonaws.com shows.",
        )
    note = "drcli: added by dr-spot add-access"
    rule: dict[str, Any] = {"IpProtocol": "tcp", "FromPort": 22, "ToPort": 22}
    if single.version == 4:
        rule["IpRanges"] = [{"CidrIp": f"{single}/32", "Description": note}]
    else:
        rule["Ipv6Ranges"] = [{"CidrIpv6": f"{single}/128", "Description": note}]
    with account.trying(f"open port 22 for {single}"):
        try:
            account.client("ec2").authorize_security_group_ingress(
                GroupId=stack.outputs["Firewall"], IpPermissions=[rule]
            )
        except ClientError as error:
            if error_code(error) != "InvalidPermission.Duplicate":
                raise
    return f"{single}/{32 if single.version == 4 else 128}"
