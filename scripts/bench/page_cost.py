"""What the page costs a browser: processor time of its processes while Live shows a training.

    python scripts/bench page_cost FOLDER [--seconds 120] [--size 1440x900] [--page /] [--json]
        [--where 15]

FOLDER is a working folder whose console runs (`dr console start`), with a training that is under
way. Chromium without a window shows the page, which nobody touches; it needs the package
playwright and a browser. Without a graphics processor it paints and composes on the processor, as
most browsers don't: that part is told apart. With --json the last line of stdout is one object with

    core_share          by process of the browser: processor time in a second. `renderer` has the
                        page itself (scripts, layout, painting), `gpu` composes what is painted,
                        `network` receives, `browser` waits for others
    total_core_share    their sum
    console_core_share  of the console's process meanwhile
    page_ms_per_s       within the renderer's main thread: scripts, styles, layout, all tasks
    per_s               layouts and recalculations of styles in a second
    received_per_s      by topic, in 20 s after that: messages in a second, and kB
    age_ms              by picture: median and 95th percentile from the end of its step until it is
                        drawn

With --where SECONDS, the functions and the parts of the browser that take most come last; they are
measured apart, because measuring costs, too.
"""

import argparse
import base64
import json
import shutil
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import psutil
from machine import print_json
from playwright.sync_api import CDPSession, Page, sync_playwright

from drcli.web.security import cookie_name
from drcli.web.viewer_process import running_viewer

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
SETTLE_S = 15.0
TRAFFIC_S = 20.0
TASKS = ("TaskDuration", "ScriptDuration", "LayoutDuration", "RecalcStyleDuration")
COUNTS = ("LayoutCount", "RecalcStyleCount")
MOST = 15


def measure(folder: Path, seconds: float, size: str, path: str, where_s: float) -> dict[str, Any]:
    """Open the page and compare what its processes have used."""
    record = running_viewer(folder)
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if record is None or program is None:
        sys.exit(f"No console of {folder} runs." if program else f"No browser: one of {NAMES}.")
    url = f"http://{record.host}:{record.port}"
    width, height = map(int, size.split("x"))
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=FLAGS)
        context = browser.new_context(viewport={"width": width, "height": height})
        context.add_cookies(
            [{"name": cookie_name(record.token), "value": record.token, "url": url}]
        )
        page = context.new_page()
        page.goto(f"{url}/#{path}")
        page.get_by_text("Connected").wait_for()
        page.wait_for_timeout(1e3 * SETTLE_S)
        session = context.new_cdp_session(page)
        session.send("Performance.enable")
        console = psutil.Process(record.pid)
        before, page_before, console_before = _used_s(), _metrics(session), _time_s(console)
        began_s = time.monotonic()
        page.wait_for_timeout(1e3 * seconds)
        passed_s = time.monotonic() - began_s
        after, page_after, console_after = _used_s(), _metrics(session), _time_s(console)
        session.send("Performance.disable")
        shares: dict[str, float] = defaultdict(float)
        for pid, (role, used_s) in after.items():
            shares[role] += (used_s - before.get(pid, (role, 0.0))[1]) / passed_s
        per_s = {name: (page_after[name] - page_before[name]) / passed_s for name in page_after}
        found: dict[str, Any] = {
            "core_share": {role: round(share, 4) for role, share in sorted(shares.items())},
            "total_core_share": round(sum(shares.values()), 4),
            "console_core_share": round((console_after - console_before) / passed_s, 4),
            "page_ms_per_s": {name: round(1e3 * per_s[name], 2) for name in TASKS},
            "per_s": {name: round(per_s[name], 2) for name in COUNTS},
            **_traffic(page, session),
        }
        if where_s:
            found["where"] = {
                "functions_ms_per_s": _functions(session, page, where_s),
                "parts_ms_per_s": _parts(browser.new_browser_cdp_session(), page, where_s),
            }
        browser.close()
    return found


def _used_s() -> dict[int, tuple[str, float]]:
    """By process of the browser: its role, and processor time until now."""
    found = {}
    for process in psutil.Process().children(recursive=True):
        words = process.cmdline()
        if "chrom" not in process.name() and "headless" not in process.name():
            continue
        options = dict(word[2:].split("=", 1) for word in words if word[:2] == "--" and "=" in word)
        role = options.get("utility-sub-type", "").split(".")[0] or options.get("type", "browser")
        found[process.pid] = role.removesuffix("-process"), _time_s(process)
    return found


def _time_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _metrics(session: CDPSession) -> dict[str, float]:
    listed = session.send("Performance.getMetrics")["metrics"]
    return {each["name"]: each["value"] for each in listed if each["name"] in (*TASKS, *COUNTS)}


def _traffic(page: Page, session: CDPSession) -> dict[str, Any]:
    counts: Counter[str] = Counter()
    sizes: Counter[str] = Counter()

    def take(event: dict[str, Any]) -> None:
        frame = event["response"]
        text, size = frame["payloadData"], len(frame["payloadData"])
        if frame["opcode"] == 2:  # in base64, with two bytes before the JSON
            data, size = base64.b64decode(text), size * 3 // 4
            text = data[2 : 2 + int.from_bytes(data[:2], "big")].decode()
            topic = json.loads(text)["topic"]
        else:
            topic = json.loads(text)["topic"]
        counts[topic] += 1
        sizes[topic] += size

    session.on("Network.webSocketFrameReceived", take)
    session.send("Network.enable")
    ages: dict[str, list[float]] = defaultdict(list)
    seen: dict[str, str] = {}
    end_s = time.monotonic() + TRAFFIC_S
    while time.monotonic() < end_s:
        for label, step_s, age_ms in page.evaluate(
            "[...document.querySelectorAll('canvas[data-age-ms]')].map("
            "(each) => [each.ariaLabel, each.dataset.stepS, each.dataset.ageMs])"
        ):
            if seen.get(label) != step_s:
                ages[label].append(float(age_ms))
                seen[label] = step_s
        page.wait_for_timeout(100)
    session.send("Network.disable")
    return {
        "received_per_s": {
            topic: [round(count / TRAFFIC_S, 2), round(sizes[topic] / TRAFFIC_S / 1e3, 1)]
            for topic, count in counts.most_common()
        },
        "age_ms": {
            label: [round(median(each)), round(sorted(each)[int(0.95 * len(each))])]
            for label, each in ages.items()
        },
    }


def _functions(session: CDPSession, page: Page, seconds: float) -> dict[str, float]:
    """Of scripts: where the time itself goes, without what is called."""
    session.send("Profiler.enable")
    session.send("Profiler.start")
    page.wait_for_timeout(1e3 * seconds)
    profile = session.send("Profiler.stop")["profile"]
    names = {}
    for node in profile["nodes"]:
        frame = node["callFrame"]
        place = frame["url"].rsplit("/", 1)[-1]
        names[node["id"]] = (
            f"{frame['functionName'] or '(anonymous)'} {place}:{frame['lineNumber']}"
        )
    spent: Counter[str] = Counter()
    for node, passed_us in zip(profile["samples"], profile["timeDeltas"], strict=True):
        spent[names[node]] += passed_us
    for idle in [name for name in spent if name.startswith(("(idle)", "(program)"))]:
        del spent[idle]
    return {name: round(us / 1e3 / seconds, 2) for name, us in spent.most_common(MOST)}


def _parts(session: CDPSession, page: Page, seconds: float) -> dict[str, float]:
    """Of all processes: time of each kind of event itself, processor time of its thread."""
    events: list[dict[str, Any]] = []
    done: list[bool] = []
    names: dict[tuple[int, int], str] = {}
    session.on("Tracing.dataCollected", lambda event: events.extend(event["value"]))
    session.on("Tracing.tracingComplete", lambda _: done.append(True))
    session.send(
        "Tracing.start",
        {"traceConfig": {"includedCategories": ["toplevel", "devtools.timeline", "cc", "viz"]}},
    )
    page.wait_for_timeout(1e3 * seconds)
    session.send("Tracing.end")
    while not done:
        page.wait_for_timeout(100)
    threads: dict[tuple[int, int], list[dict[str, Any]]] = defaultdict(list)
    for event in events:
        key = event["pid"], event["tid"]
        if event["name"] == "thread_name":
            names[key] = event["args"]["name"]
        if event["ph"] == "X":
            threads[key].append(event)
    spent: Counter[str] = Counter()
    for key, listed in threads.items():
        for name, own_us in _own_times(sorted(listed, key=lambda each: float(each["ts"]))):
            spent[f"{names.get(key, '?')}: {name}"] += own_us
    return {name: round(us / 1e3 / seconds, 2) for name, us in spent.most_common(2 * MOST)}


def _own_times(listed: list[dict[str, Any]]) -> Iterator[tuple[str, int]]:
    """Time of each event without those within it."""
    around: list[tuple[float, str]] = []
    for event in listed:
        while around and around[-1][0] <= event["ts"]:
            around.pop()
        spent_us = event.get("tdur", event.get("dur", 0))
        if around:
            yield around[-1][1], -spent_us
        yield event["name"], spent_us
        around.append((event["ts"] + event.get("dur", 0), event["name"]))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--size", default="1440x900")
    parser.add_argument("--page", default="/")
    parser.add_argument("--where", type=float, default=0.0, metavar="SECONDS")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(
        options.folder.resolve(), options.seconds, options.size, options.page, options.where
    )
    for name, value in found.items():
        parts = value.items() if isinstance(value, dict) and name == "where" else [(name, value)]
        for part, each in parts:
            print(f"{part:20} {each}")
    if options.json:
        print_json(found)


if __name__ == "__main__":
    main()
