"""Collects the secrets that this user's files and environment hold."""

import configparser
import getpass
import json
import os
import re
import socket
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from dotenv import dotenv_values

from drcli.bucket.server.server_process import own_file
from drcli.config import secret_environment

_HARMLESS = frozenset(
    [
        "region",
        "output",
        "sso_region",
        "role_arn",
        "source_profile",
        "duration_seconds",
        "cli_pager",
        "retry_mode",
        "max_attempts",
        "s3",
        "endpoint_url",
        "addressing_style",
        "signature_version",
        "services",
        "aws_account_id",
        "sso_role_name",
        "sso_registration_scopes",
        "parameter_validation",
    ]
)
_SECRET_KEY = re.compile(
    r"secret|token|password|access_?key|cookie|credential|csrf|external_id|mfa_serial",
    re.IGNORECASE,
)
_WEBHOOK = re.compile(r"WEBHOOK", re.IGNORECASE)
_WORDS = frozenset(
    ["true", "false", "none", "null", "yes", "no", "default", "auto", "json", "text", "table"]
)
_COMMON_USERS = frozenset(
    [
        "root",
        "user",
        "users",
        "admin",
        "administrator",
        "ubuntu",
        "debian",
        "ec2-user",
        "azureuser",
        "opc",
        "runner",
        "vscode",
        "jovyan",
        "docker",
        "nobody",
        "node",
        "app",
        "home",
        "model",
        "trainer",
        "worker",
    ]
)
_LARGEST_FILE = 1 << 20


def known_secrets(
    directory: Path, data_dir: Path, environ: Mapping[str, str], home: Path
) -> dict[str, str]:
    """Secret values, and what each one is, also of other programs."""
    found: dict[str, str] = {}
    for value, kind in _everywhere(directory, data_dir, environ, home):
        plain = value.strip()
        if plain and plain.casefold() not in _WORDS:
            found.setdefault(plain, kind)
    return found


def private_words(home: Path) -> dict[str, str]:
    """What says who the user is, and what to write instead."""
    words = {str(home): "~"} if len(str(home)) > 1 else {}
    with suppress(OSError, KeyError):
        name = getpass.getuser()
        if name.casefold() not in _COMMON_USERS:
            words[name] = "(user name)"
    host = socket.gethostname()
    if host not in ("localhost", ""):
        words[host] = "(host name)"
    return words


def _everywhere(
    directory: Path, data_dir: Path, environ: Mapping[str, str], home: Path
) -> Iterator[tuple[str, str]]:
    variables = {**secret_environment.all_secrets(), **environ}
    yield from _of_variables(variables, "environment")
    for path in sorted([*directory.glob("*.env*"), *directory.glob("experiments/*/*.env*")]):
        if _is_small(path):
            with suppress(OSError, ValueError):
                values = dotenv_values(path, interpolate=False)
                texts = {name: value for name, value in values.items() if value}
                yield from _of_variables(texts, path.name)
    yield from _of_aws_files(environ, home)
    for folder in ("sso/cache", "cli/cache"):
        yield from _of_json_files(home / ".aws" / folder, f"~/.aws/{folder}")
    yield from _of_json_files(home / ".droa-cache", "~/.droa-cache")
    cache = Path(environ.get("XDG_CACHE_HOME") or home / ".cache")
    yield from _of_json_files(cache / "drcli" / "cars", "login at a car")
    for served in {data_dir, directory / "data" / "s3"}:
        yield from _of_json(own_file(served, "json"), "key of the embedded server")
    for file in (".netrc", ".git-credentials", ".pypirc"):
        yield from _of_words(home / file)


def _of_variables(values: Mapping[str, str], where: str) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if secret_environment.is_secret(name, value) or _WEBHOOK.search(name):
            kind = f"{name} of {where}"
            passwords = list(_of_address(value))
            yield from ((part, kind) for part in passwords)
            # An address as a whole is found by its pattern; its server may be named elsewhere.
            if "://" not in value or _WEBHOOK.search(name):
                yield value, kind


def _of_address(value: str) -> Iterator[str]:
    if "://" not in value:
        return
    with suppress(ValueError):
        password = urlsplit(value).password
        if password:
            yield password
            yield unquote(password)


def _of_aws_files(environ: Mapping[str, str], home: Path) -> Iterator[tuple[str, str]]:
    credentials = environ.get("AWS_SHARED_CREDENTIALS_FILE") or str(home / ".aws/credentials")
    config = environ.get("AWS_CONFIG_FILE") or str(home / ".aws/config")
    for named, all_secret in ((credentials, True), (config, False)):
        path = Path(named.replace("~", str(home), 1) if named.startswith("~/") else named)
        parser = configparser.RawConfigParser(strict=False, allow_no_value=True)
        if not _is_small(path):
            continue
        text = path.read_text("utf-8", "replace")
        try:
            parser.read_string(text)
        except configparser.Error:
            yield from _of_lines(text, path.name)
            continue
        for section in parser.sections():
            for name, value in parser.items(section):
                secret = name not in _HARMLESS and (
                    all_secret or _SECRET_KEY.search(name) or name == "credential_process"
                )
                if secret and value:
                    yield value, f"{name} of [{section}] in ~/.aws/{path.name}"


def _of_lines(text: str, name: str) -> Iterator[tuple[str, str]]:
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        if equals and key.strip() not in _HARMLESS:
            yield value, f"{key.strip()} in ~/.aws/{name}"


def _of_json_files(folder: Path, kind: str) -> Iterator[tuple[str, str]]:
    if folder.is_dir():
        for path in sorted(folder.glob("*.json")):
            yield from _of_json(path, kind)


def _of_json(path: Path, kind: str) -> Iterator[tuple[str, str]]:
    if _is_small(path):
        with suppress(OSError, ValueError, RecursionError):
            yield from ((value, kind) for value in _secrets_in(json.loads(path.read_bytes())))


def _secrets_in(value: Any, *, secret: bool = False) -> Iterator[str]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _secrets_in(inner, secret=secret or bool(_SECRET_KEY.search(str(name))))
    elif isinstance(value, list):
        for inner in value:
            yield from _secrets_in(inner, secret=secret)
    elif secret and isinstance(value, str):
        yield value


def _of_words(path: Path) -> Iterator[tuple[str, str]]:
    if not _is_small(path):
        return
    text = path.read_text("utf-8", "replace")
    for word in re.findall(r"\bpassword\s*[:=]?\s*(\S+)", text):
        yield word, f"password in ~/{path.name}"
    for address in re.findall(r"\w+://\S+", text):
        yield from ((part, f"password in ~/{path.name}") for part in _of_address(address))


def _is_small(path: Path) -> bool:
    with suppress(OSError):
        return path.is_file() and path.stat().st_size < _LARGEST_FILE and os.access(path, os.R_OK)
    return False
