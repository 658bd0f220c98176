"""Values that programs stumble over: for options, settings, keys and paths."""

import string

from hypothesis import strategies as st

NUMBERS = (
    *("0", "-1", "1", "2", "3.5", "-0.0", "1e308", "-1e308", "1e-320", "1e400", "nan", "inf"),
    *("-inf", "NaN", "Infinity", "0x10", "1_000", "1,5", "١٢", "²", "9" * 30, "9" * 5000),
    *("2147483648", "4294967296", "9223372036854775808", "-9223372036854775809", "1.", ".5", "+1"),
)

TEXTS = (
    *("", " ", "\t", "\n", "a\nb", "a\r\nb", "-", "--", "---", "=", "a=b", "$", "$HOME", "${HOME}"),
    *("$DR_WORLD_NAME", "${", "`id`", "$(id)", "'", '"', '"a', "a'b", "\\", "\\n", "#", "a #b"),
    *("\x01", "\x1b[31mred\x1b[0m", "\x7f", "\u0085", "\u2028", "\u200b", "\ufeff", "\u202eabc"),
    *("é", "e\u0301", "日本", "🏎️", "\U0010ffff", "\udc80", "İ", "ß", "a" * 300, "x" * 5000),
    *("%s", "%", "%00", "{}", "{0}", "[bold]", "[/]", "[red", "*", "?", "[a", "**", "(", "(a|b"),
    *("None", "null", "True", "true", "yes", "False", "on", "best", "last", "model", "bucket"),
    *("DR_WORLD_NAME", "DR_WORLD_NAME=", "reinvent_base", "reinvent_bas", "trainer", "sim-0"),
    *(";", "a;b", "|", "&", "<", ">", "@", "@file", "~", "~root", ",", ":", "a:b", "a/b", "a//b"),
    *("CON", "a.", "a ", " a", ".hidden", "s3://", "s3:///", "s3://bucket", "s3://bucket/model"),
    *("s3://uploads/none", "http://", "http://127.0.0.1:1", "http://[::1", "https://a b/", "://"),
    *("http://u:p@127.0.0.1:1/x?y=z", "127.0.0.1:1", "127.0.0.1:99999", "127.0.0.1:x", "[::1]:1"),
)

PATHS = (
    *("", ".", "..", "/", "missing", "missing/deeper", "custom_files", "custom_files/", "run.env"),
    *("given/model", "given/model.tar.gz", "given/oval.npy", "given/reward.py", "given/password"),
    *("given/model/model/1_Step-144.ckpt.safetensors", "given/model/model_metadata.json"),
    *("custom_files/model_metadata.json", "custom_files/reward_function.py"),
    *("/dev/null", "/dev/full", "/dev/zero", "/proc/self/mem", "/proc/version", "given/loop"),
    *("given/dangling", "given/fifo", "given/unreadable", "given/empty", "given/binary"),
    *("run.env/inside", "x" * 300, "a/" * 3000, "given/\n", "given/é", "given/\udc80", "-", "~/x"),
)
"""Paths below the folder or of devices: nothing that could harm the machine."""

numbers = st.one_of(
    st.sampled_from(NUMBERS),
    st.integers(-(2**70), 2**70).map(str),
    st.floats(width=64).map(repr),
)

_LETTERS = st.characters(exclude_characters="\0/~.", exclude_categories=())

texts = st.one_of(
    st.sampled_from(TEXTS),
    st.text(_LETTERS, max_size=20),
    st.text(string.ascii_letters + string.digits + "-_", min_size=1, max_size=12),
)
"""No slash and no dot: what these name lies in the folder."""

paths = st.sampled_from(PATHS)

anything = st.one_of(numbers, texts, paths)


def in_environment(value: str) -> bool:
    """Whether a value can be an argument or a variable."""
    try:
        return b"\0" not in value.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        return False
