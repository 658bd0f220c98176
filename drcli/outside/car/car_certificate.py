"""Checks that a car is the one it was before.

No authority has signed its certificate. As with SSH, the first login keeps the fingerprint, and
later connections must match.
"""

import hashlib
import socket
from typing import Any

from drcli.base.installation import lazy_imports
from drcli.outside.car.car_address import CarAddress, CarError, CarLogin

with lazy_imports():
    import ssl

    import requests
    from requests import adapters

CONNECT_TIMEOUT_S = 5.0


def read_fingerprint(address: CarAddress) -> str:
    """SHA-256 of a car's certificate now, or CarError."""
    context = _unchecked()
    try:
        place = (address.host, address.port)
        with (
            socket.create_connection(place, timeout=CONNECT_TIMEOUT_S) as plain,
            context.wrap_socket(plain, server_hostname=address.host) as connection,
        ):
            certificate = connection.getpeercert(binary_form=True)
    except OSError as e:  # ssl.SSLError is one, too
        raise unreachable(address, e) from e
    if certificate is None:
        raise CarError(
            f"{address.place} shows no certificate, so it is not a car.",
            remedy="Correct --car or DR_CAR_ADDRESS.",
        )
    return hashlib.sha256(certificate).hexdigest()


def readable(fingerprint: str) -> str:
    pairs = (fingerprint[i : i + 2] for i in range(0, len(fingerprint), 2))
    return ":".join(pairs).upper()


def trusting_session(login: CarLogin) -> "requests.Session":
    """Accepts only the car of a login; uses no proxy."""

    class Unsigned(adapters.HTTPAdapter):
        def init_poolmanager(self, *args: Any, **named: Any) -> None:
            pinned = login.fingerprint if login.trust == "fingerprint" else None
            context = _unchecked()
            super().init_poolmanager(*args, ssl_context=context, assert_fingerprint=pinned, **named)

    session = requests.Session()
    session.trust_env = False  # no proxy, no .netrc: a car is in the same network
    session.verify = login.ca_file if login.trust == "ca" else False
    if login.trust != "ca":
        session.mount("https://", Unsigned())
    return session


def _unchecked() -> "ssl.SSLContext":
    """Authorities take 0.1 s to load."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def unreachable(address: CarAddress, error: BaseException) -> CarError:
    causes = list(_causes(error))
    text = " ".join(str(cause) for cause in causes)
    if any(isinstance(cause, socket.gaierror) for cause in causes) or "resolve" in text:
        return CarError(
            f"There is no host called {address.host} in this network.",
            remedy="Correct --car or DR_CAR_ADDRESS, or give the number that the car's network "
            "page shows, such as 192.168.1.50.",
        )
    if "ingerprint" in text:
        return CarError(
            f"The car at {address.place} shows another certificate than at the first login, so "
            "another machine may answer there; nothing was sent to it.",
            remedy="If you know why (another car under this address, or new software), accept the "
            f"new certificate with `dr-car login --new-certificate --car {address.place}`.",
        )
    tls = next((cause for cause in causes if isinstance(cause, ssl.SSLCertVerificationError)), None)
    if tls is not None or "CERTIFICATE_VERIFY_FAILED" in text:
        reason = getattr(tls, "verify_message", "") or "it cannot be verified"
        return CarError(
            f"The certificate of the car at {address.place} was not accepted: {reason}.",
            remedy="Give the file of the authority that signed it with "
            f"`dr-car login --ca FILE --car {address.place}`, or leave --ca out to accept the "
            "certificate itself.",
        )
    if any(isinstance(cause, ssl.SSLError) for cause in causes) or "SSL" in text:
        return CarError(
            f"{address.place} does not speak https.",
            remedy="Correct the port in --car or DR_CAR_ADDRESS; cars use 443.",
        )
    if any(isinstance(cause, ConnectionRefusedError) for cause in causes):
        return CarError(
            f"{address.place} refuses connections: nothing serves a web page at that port.",
            remedy="Wait until the car has started (about a minute), or correct --car or "
            "DR_CAR_ADDRESS.",
        )
    return CarError(
        f"The car at {address.place} cannot be reached: {_reason(causes)}.",
        remedy="Check that the car is switched on and in the same network as this machine, and "
        "that --car or DR_CAR_ADDRESS is right.",
    )


def _causes(error: BaseException) -> "list[BaseException]":
    found: list[BaseException] = []
    waiting: list[object] = [error]
    while waiting:
        one = waiting.pop(0)
        if isinstance(one, BaseException) and one not in found:
            found.append(one)
            waiting += [getattr(one, "reason", None), one.__cause__, one.__context__, *one.args]
    return found


def _reason(causes: "list[BaseException]") -> str:
    if any(isinstance(cause, TimeoutError) for cause in causes):
        return "no answer"
    for cause in causes:
        if (
            isinstance(cause, OSError)
            and cause.strerror
            and not str(cause.strerror).startswith("[")
        ):
            return cause.strerror[0].lower() + cause.strerror[1:]
    return "no answer" if "imed out" in str(causes) else "the connection broke"
