"""Why a server could not be reached, in a few words."""

_WORDS = {
    "NameResolutionError": "its name is unknown",
    "gaierror": "its name is unknown",
    "ConnectionRefusedError": "it refuses the connection",
    "ConnectionResetError": "it closed the connection",
    "RemoteDisconnected": "it closed the connection",
    "IncompleteRead": "it closed the connection too early",
    "SSLCertVerificationError": "nobody whom this machine trusts has signed it",
}


def cause_of(error: BaseException) -> str:
    seen: list[BaseException] = []
    waiting: list[object] = [error]
    while waiting:
        one = waiting.pop()
        if isinstance(one, BaseException) and one not in seen:
            seen.append(one)
            waiting += [one.__cause__, one.__context__, getattr(one, "reason", None), *one.args]
    known = [_WORDS[type(one).__name__] for one in seen if type(one).__name__ in _WORDS]
    if known:
        return known[-1]
    systems = [one.strerror for one in seen if isinstance(one, OSError) and one.strerror]
    return (systems[-1] if systems else type(error).__name__).rstrip(".")
