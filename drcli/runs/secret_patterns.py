"""Patterns of unknown secrets: by a name before them, or their form."""

import re
from dataclasses import dataclass

_SECRET_NAME = (
    r"(?:secret|passw(?:or)?d|passphrase|\bpwd|token|credential|access[_-]?key|api[_-]?key"
    r"|private[_-]?key|account[_-]?key|shared[_-]?key|auth[_-]?key|accesskeyid|signature|cookie"
    r"|csrf|session[_-]?id|authorization|webhook)[\w.-]*"
)
_SECRET_WORDS = (
    "secret",
    "passw",
    "passphrase",
    "pwd",
    "token",
    "credential",
    "key",
    "signature",
    "cookie",
    "csrf",
    "session",
    "authorization",
    "webhook",
)
_VALUE = r"(?!\(hidden)(\"(?:[^\"\\\n]|\\.)+\"|'(?:[^'\\\n]|\\.)+'|[^\s,;&\"'}\])]+)"
_TAIL = r"[^\s\"'<>\\)]*"


@dataclass(frozen=True)
class Pattern:
    """The group `keep` stays; without any of `needs` a text cannot match."""

    kind: str
    expression: "re.Pattern[str]"
    needs: tuple[str, ...] = ()

    def may_be_in(self, low: str) -> bool:
        return not self.needs or any(word in low for word in self.needs)


def _pattern(kind: str, expression: str, needs: tuple[str, ...] = ()) -> Pattern:
    return Pattern(kind, re.compile(expression, re.IGNORECASE), needs)


PATTERNS = (
    # A header with several words; the next patterns see only one.
    _pattern(
        "HTTP header",
        r"(?P<keep>\b(?:proxy-)?authorization[\"']?\s*[:=]\s*[bu]?[\"']?)(?!\(hidden)[^\n\"']+",
        ("authorization",),
    ),
    _pattern(
        "HTTP header",
        r"(?P<keep>\b(?:set-)?cookie[\"']?\s*:\s*[bu]?[\"']?)(?!\(hidden)[^\n\"']+",
        ("cookie",),
    ),
    _pattern("bearer token", r"(?P<keep>\bbearer\s+)[\w.~+/=-]{8,}", ("bearer",)),
    _pattern("password in an address", r"(?P<keep>\b[a-z][a-z0-9+.-]*://)[^\s/\"'<>]+@", ("://",)),
    _pattern(
        "address of a webhook",
        rf"(?P<keep>https?://(?:hooks\.slack\.com|(?:\w+\.)?discord(?:app)?\.com|api\.telegram\.org"
        rf"|[\w.-]*webhook[\w.-]*|[\w.-]*\.logic\.azure\.com[:\d]*|ntfy\.sh|hooks?\.[\w.-]+)/){_TAIL}",
        ("://",),
    ),
    _pattern(
        "address of a webhook",
        rf"(?P<keep>https?://[^\s/\"'<>]+/)(?=[^\s\"'<>]*(?:hook|token|secret)){_TAIL}",
        ("://",),
    ),
    _pattern(
        "query of an address", rf"(?P<keep>\b\w+://[^\s?\"'<>]+\?)(?!\(hidden){_TAIL}", ("://",)
    ),
    _pattern(
        "signature of an address",
        r"(?P<keep>\b(?:X-Amz-[\w-]+|AWSAccessKeyId|sig)=)(?!\(hidden)[^\s&\"'<>]+",
        ("x-amz-", "awsaccesskeyid", "sig="),
    ),
    _pattern(
        "AWS key id",
        r"\b(?-i:A(?:KIA|SIA|ROA|IDA|GPA|NPA|NVA|BIA|CCA))(?-i:[A-Z0-9]{12,})",
        ("akia", "asia", "aroa", "aida", "agpa", "anpa", "anva", "abia", "acca"),
    ),
    _pattern(
        "AWS account number",
        r"(?P<keep>\barn:aws[\w-]*:[\w-]*:[\w-]*:)\d{12}",
        ("arn:aws",),
    ),
    _pattern("web token", r"\beyJ[\w-]{8,}\.[\w-]+(?:\.[\w-]*)?", ("eyj",)),
    _pattern(
        "token of a service",
        r"\b(?:gh[pousr]_\w{20,}|github_pat_\w{20,}|glpat-[\w-]{16,}|xox[abeprs]-[\w-]{10,}"
        r"|sk-[\w-]{20,}|hf_\w{20,}|AIza[\w-]{30,}|npm_\w{30,}|pypi-[\w-]{20,}|SG\.[\w-]{16,}\.[\w-]+"
        r"|ya29\.[\w-]{20,}|\d{8,10}:AA[\w-]{30,})",
        (
            "ghp_",
            "gho_",
            "ghu_",
            "ghs_",
            "ghr_",
            "github_pat_",
            "glpat-",
            "xox",
            "sk-",
            "hf_",
            "aiza",
            "npm_",
            "pypi-",
            "sg.",
            "ya29.",
            ":aa",
        ),
    ),
    _pattern(
        "value of a secret name",
        rf"(?P<keep>{_SECRET_NAME}[\"']?\s*(?:=>|[:=])\s*){_VALUE}",
        _SECRET_WORDS,
    ),
    _pattern(
        "option of a command",
        rf"(?P<keep>\s--?[\w-]*{_SECRET_NAME}\s+)(?!\(hidden)\S+",
        _SECRET_WORDS,
    ),
    _pattern(
        "option of a command",
        r"(?P<keep>\s(?:-u\s*|--user[ =]))[^\s:]+:\S+",
        (" -u", "\t-u", "\n-u", "--user"),
    ),
    _pattern("e-mail address", r"\b[\w.+-]+@[\w-]+(?:\.[\w-]+)+", ("@",)),
)
LIKE_A_KEY = re.compile(r"(?<![A-Za-z0-9/+=_-])[A-Za-z0-9/+]{40}(?![A-Za-z0-9/+=_-])")
"""AWS secret keys have no other mark."""

KEY_BLOCK = re.compile(
    r"-----BEGIN [A-Z0-9 ]*PRIVATE KEY( BLOCK)?-----.*?"
    r"(?:-----END [A-Z0-9 ]*PRIVATE KEY( BLOCK)?-----|(?=\n[^\n]*[^A-Za-z0-9+/=\s:,\\-])|\Z)",
    re.DOTALL,
)
KEY_END = re.compile(r"(?:[A-Za-z0-9+/=]{16,}\s*\n)+[^\n]*-----END [A-Z0-9 ]*PRIVATE KEY[^\n]*")


def is_like_a_key(word: str) -> bool:
    """As mixed as random letters."""
    classes = (str.isupper, str.islower, str.isdigit)
    mixed = all(any(has(letter) for letter in word) for has in classes)
    return mixed and len(set(word)) >= 16
