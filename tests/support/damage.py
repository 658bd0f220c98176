"""Damage to files: bytes, JSON, settings files, archives, arrays; each from a good example."""

import copy
import io
import json
import tarfile
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

import hazards

Damage = Callable[[bytes], bytes]
"""Makes bad data of good."""

BOM = b"\xef\xbb\xbf"

_DEEP = 100_000
_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 3.5, -0.0, 1e308, -1e308, 1e-320, 2**31, 2**63, 10**25),
    *("", " ", "x", "0", "1", "nan", "\0", "\ud800", "\x1b[31m", "é", "a" * 5000, "../../x", "/"),
    *([], {}, [[]], [{}], {"": ""}, [None], [1, "a", None], {"a": {"b": {"c": []}}}),
)
_RAW = (
    *(b"NaN", b"Infinity", b"-Infinity", b"1e999", b"9" * 5000, b"0x1", b"01", b"tru", b"'a'"),
    *(b'"\\ud800"', b'"\\u0000"', b'"\xff"', b"[" * _DEEP, b"{" * 2000, b'{"a":' * _DEEP),
)
_PLACEHOLDER = "here stands something else"


def cut(data: bytes, where: float) -> bytes:
    """The first part of the data."""
    return data[: int(len(data) * where)]


def _flipped(data: bytes, places: list[tuple[float, int]]) -> bytes:
    changed = bytearray(data)
    for where, bit in places:
        if changed:
            changed[int(where * (len(changed) - 1))] ^= 1 << bit
    return bytes(changed)


def _inserted(data: bytes, where: float, more: bytes) -> bytes:
    at = int(len(data) * where)
    return data[:at] + more + data[at:]


_fraction = st.floats(0.0, 1.0)

any_bytes: st.SearchStrategy[Damage] = st.one_of(
    st.sampled_from(
        [b"", b"\n", b"\0", b"{}", b"[]", b"null", b"\xff\xfe", b"PK\x03\x04", b"a"]
    ).map(lambda new: lambda data: new),
    st.binary(max_size=64).map(lambda new: lambda data: new),
    _fraction.map(lambda where: lambda data: cut(data, where)),
    st.lists(st.tuples(_fraction, st.integers(0, 7)), min_size=1, max_size=5).map(
        lambda places: lambda data: _flipped(data, places)
    ),
    # In the first bytes, where formats keep their lengths.
    st.lists(st.tuples(st.floats(0.0, 0.001), st.integers(0, 7)), min_size=1, max_size=3).map(
        lambda places: lambda data: _flipped(data, places)
    ),
    st.tuples(
        _fraction, st.sampled_from([b"\0", b"\xff", BOM, b"\r", b"\x1b[2J", b"\n\n", b"{"])
    ).map(lambda pair: lambda data: _inserted(data, *pair)),
    st.sampled_from([2, 3]).map(lambda times: lambda data: data * times),
)
"""Damage that knows no format: cut, flipped, inserted, repeated, replaced."""


def _decoded(data: bytes) -> str:
    return data.decode("utf-8", "replace")


text: st.SearchStrategy[Damage] = st.one_of(
    any_bytes,
    st.sampled_from(["utf-16", "utf-32", "utf-8-sig", "cp037"]).map(
        lambda name: lambda data: _decoded(data).encode(name, "replace")
    ),
    st.just(lambda data: data.replace(b"\n", b"\r\n")),
    st.just(lambda data: data.replace(b"\n", b"\r")),
    st.just(lambda data: data.replace(b"\n", b"")),
    st.just(lambda data: data.rstrip(b"\n") + b"\n" + data),
    st.tuples(_fraction, hazards.texts).map(
        lambda pair: lambda data: _inserted(data, pair[0], pair[1].encode("utf-8", "surrogatepass"))
    ),
)
"""Damage to a text file: also encodings and ends of lines."""


def _paths(value: Any, before: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [before]
    if isinstance(value, dict):
        found += [path for key in value for path in _paths(value[key], (*before, key))]
    elif isinstance(value, list):
        found += [path for k in range(len(value)) for path in _paths(value[k], (*before, k))]
    return found


def _changed_json(data: bytes, changes: list[tuple[float, str, Any]], raw: bytes) -> bytes:
    try:
        value = json.loads(data)
    except ValueError:
        return data
    for where, what, new in changes:
        paths = _paths(value)
        path = paths[int(where * (len(paths) - 1))]
        value = _with_change(value, path, what, new)
    written = json.dumps(value).encode()
    return written.replace(json.dumps(_PLACEHOLDER).encode(), raw)


def _with_change(value: Any, path: tuple[Any, ...], what: str, new: Any) -> Any:
    new = copy.deepcopy(new)
    if not path:
        return new if what == "replace" else value
    holder = value
    for step in path[:-1]:
        holder = holder[step]
    last = path[-1]
    if what == "replace":
        holder[last] = new
    elif what == "delete":
        del holder[last]
    elif what == "wrap":
        holder[last] = [holder[last]]
    elif what == "text":
        holder[last] = str(holder[last])
    elif isinstance(holder, dict):
        holder[str(new)[:50]] = holder[last]
    else:
        holder.append(copy.deepcopy(holder[last]))
    return value


def _doubled_keys(data: bytes) -> bytes:
    """The same keys twice, the second time with nothing in them."""
    try:
        value = json.loads(data)
    except ValueError:
        return data
    if not isinstance(value, dict):
        return data
    pairs = [f"{json.dumps(k)}: {json.dumps(v)}, {json.dumps(k)}: null" for k, v in value.items()]
    return ("{" + ", ".join(pairs) + "}").encode()


_change = st.tuples(
    _fraction,
    st.sampled_from(["replace", "replace", "replace", "delete", "wrap", "text", "add"]),
    st.sampled_from([*_VALUES, _PLACEHOLDER, _PLACEHOLDER]),
)

structure: st.SearchStrategy[Damage] = st.one_of(
    st.tuples(st.lists(_change, min_size=1, max_size=3), st.sampled_from(_RAW)).map(
        lambda pair: lambda data: _changed_json(data, *pair)
    ),
    st.just(_doubled_keys),
)
"""Damage to JSON that mostly stays JSON: types, keys, numbers, depth."""

json_file: st.SearchStrategy[Damage] = st.one_of(structure, structure, structure, text)


def json_lines(data: bytes) -> bytes:
    """The data as JSON lines, its last one not finished."""
    return data + data[: len(data) // 2]


def settings_file(names: list[str]) -> st.SearchStrategy[Damage]:
    """Damage to run.env and its like, among others settings of these names with any value."""
    lines = st.one_of(
        st.tuples(st.sampled_from(names), hazards.anything).map("=".join),
        st.tuples(st.sampled_from(names), hazards.anything).map("=".join),
        st.tuples(st.sampled_from(names), st.sampled_from(names)).map(lambda p: f"{p[0]}=${p[1]}"),
        st.tuples(st.sampled_from(names), hazards.anything).map(lambda p: f'{p[0]}="{p[1]}"'),
        st.tuples(st.sampled_from(names), hazards.anything).map(lambda p: f"export {p[0]}='{p[1]}"),
        hazards.texts,
    )
    added = st.lists(lines, min_size=1, max_size=3).map(
        lambda more: lambda data: data + "\n".join([*more, ""]).encode("utf-8", "surrogatepass")
    )
    return st.one_of(added, added, added, text)


def _member(name: str, kind: bytes, size: int, link: str) -> Damage:
    """An archive with one more member, which must not be written where its name says."""

    def damaged(_data: bytes) -> bytes:
        out = io.BytesIO()
        with tarfile.open(fileobj=out, mode="w:gz", compresslevel=1) as archive:
            info = tarfile.TarInfo(name)
            info.type, info.linkname = kind, link
            info.size = size if kind == tarfile.REGTYPE else 0
            archive.addfile(info, io.BytesIO(bytes(size)))
        return out.getvalue()

    return damaged


archive: st.SearchStrategy[Damage] = st.one_of(
    any_bytes,
    st.builds(
        _member,
        st.sampled_from(
            ["../out", "/tmp/fuzz-out", "model/../../out", "model", "a/" * 500, "x\n", ""]
        ),
        st.sampled_from(
            [
                tarfile.REGTYPE,
                tarfile.SYMTYPE,
                tarfile.LNKTYPE,
                tarfile.FIFOTYPE,
                tarfile.DIRTYPE,
                tarfile.CHRTYPE,
            ]
        ),
        st.sampled_from([0, 10, 1_000_000]),
        st.sampled_from(["/etc/passwd", "../../x", "model", ""]),
    ),
)
"""Damage to a packed model: members outside of it, links, devices."""


def _npy(array: Any, *, allow_pickle: bool = False) -> bytes:
    """The array as the bytes of a .npy file."""
    import numpy as np

    out = io.BytesIO()
    np.save(out, array, allow_pickle=allow_pickle)
    return out.getvalue()


def _array(shape: tuple[int, ...], dtype: str, fill: float) -> Damage:
    def damaged(_data: bytes) -> bytes:
        import numpy as np

        if dtype == "object":
            return _npy(np.array([{"a": 1}], dtype=object), allow_pickle=True)
        with np.errstate(all="ignore"):
            return _npy(np.full(shape, fill).astype(dtype))

    return damaged


def _values(places: list[tuple[float, float]]) -> Damage:
    def damaged(data: bytes) -> bytes:
        import numpy as np

        values = np.load(io.BytesIO(data)).copy()
        for where, new in places:
            values.flat[int(where * (values.size - 1))] = new
        return _npy(values)

    return damaged


route: st.SearchStrategy[Damage] = st.one_of(
    any_bytes,
    st.builds(
        _array,
        st.sampled_from(
            [(), (0,), (6,), (0, 6), (1, 6), (2, 6), (3, 6), (50, 5), (50, 7), (50, 2), (3, 3, 6)]
        ),
        st.sampled_from(
            ["float64", "float32", "int8", "bool", "complex128", "object", "U3", ">f8"]
        ),
        st.sampled_from([0.0, 1.0, float("nan"), float("inf"), 1e300]),
    ),
    st.lists(
        st.tuples(_fraction, st.sampled_from([0.0, 1e6, -1e6, 1e300, float("nan"), float("inf")])),
        min_size=1,
        max_size=6,
    ).map(_values),
)
"""Damage to the route file of a track."""

CODE = (
    *("", "x", "def reward_function(params):", "def reward_function(params):\n", "\tx\n  y"),
    *(
        "import sys\nsys.exit(0)",
        "import os\nos._exit(0)",
        "raise SystemExit",
        "raise SystemExit(3)",
    ),
    *("raise KeyboardInterrupt", "raise BaseException('x')", "import missing_module", "1/0"),
    *("def reward_function(params, more):\n    return 1", "reward_function = 5"),
    *("async def reward_function(params):\n    return 1", "class reward_function: pass"),
    *("def reward_function(*params):\n    return 1", "reward_function = lambda p: 1.0"),
    *("def reward_function(params):\n    yield 1", "def reward_function(params):\n    return None"),
    *(
        f"def reward_function(params):\n    {body}"
        for body in (
            *(
                "return 'x'",
                "return float('nan')",
                "return 1e400",
                "return 10**400",
                "return params",
            ),
            *("return [1]", "return True", "return 1j", "params.clear()\n    return 1.0"),
            *("raise SystemExit", "raise KeyboardInterrupt", "import os; os._exit(3)", "exit()"),
            *(
                "raise Exception(params)",
                "raise Exception('\\x00\\x1b[31m\\ud800')",
                "return int('x')",
            ),
            *("print('x' * 10**6)\n    return 1.0", "return reward_function(params)", "del params"),
            *("import os; os.close(1); os.close(2)\n    return 1.0", "return open('/dev/null')"),
            *(
                "import sys; sys.stdout = None\n    return 1.0",
                "import sys; sys.modules.clear()\n    return 1.0",
            ),
            *("import threading; threading.Thread(target=lambda: 1/0).start()\n    return 1.0",),
            *("import gc; gc.disable(); return 1.0", "import signal; signal.alarm(1); return 1.0"),
            *(
                "import os; os.chdir('/'); return 1.0",
                "import builtins; del builtins.float; return 1.0",
            ),
            *(
                "import os; os.abort()",
                "import ctypes; ctypes.string_at(0)",
                "return 1.0" + "\n" * 9999,
            ),
        )
    ),
    "def reward_function(params):\n"
    + "    if True:\n" * 1
    + "        return "
    + "(" * 300
    + "1"
    + ")" * 300,
    "x = " + "1+" * 20000 + "1\ndef reward_function(params):\n    return 1.0\n",
    "# -*- coding: nonsense -*-\ndef reward_function(params):\n    return 1.0\n",
    "# -*- coding: utf-16 -*-\ndef reward_function(params):\n    return 1.0\n",
    "def reward_function(params):\n    return 1.0\n\0",
)

program: st.SearchStrategy[Damage] = st.one_of(
    st.sampled_from(CODE).map(lambda code: lambda data: code.encode("utf-8", "surrogatepass")),
    st.sampled_from(CODE).map(
        lambda code: lambda data: data + code.encode("utf-8", "surrogatepass")
    ),
    text,
)
"""Damage to a reward function: code that ends the process, returns anything, breaks Python."""
