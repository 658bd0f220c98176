"""What a spot machine does when it boots, and when its training ends.

It runs before drcli is installed, so it uses only Python's standard library. The user data
brings it, and `machine.json` with the facts that it needs.

    boot.py start    install drcli, and start the training as a service of systemd
    boot.py ended    after each end of the training: start it again, or give the machine back

Variables for tests: DRCLI_SPOT_ROOT is put before all paths, AWS_ENDPOINT_URL and
AWS_EC2_METADATA_SERVICE_ENDPOINT replace Amazon's addresses, DRCLI_SPOT_PAUSE_S all pauses.
"""

import hashlib
import hmac
import json
import os
import re
import subprocess
import sys
import time
import traceback
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ROOT = os.environ.get("DRCLI_SPOT_ROOT", "")
HOME, USER = "/opt/drcli", "drcli"
RACER, PYTHON = HOME + "/racer", HOME + "/venv/bin/python"
LEAVING = "/run/drcli/leaving"
TOLD = "/run/drcli/told"
FAILURES = "/run/drcli/failures"
"""In memory: a full disk must not keep failures from being counted."""

LOG = "/var/log/drcli-boot.log"
UNITS = "/etc/systemd/system/"
TORCH = "https://download.pytorch.org/whl/cpu"

FINAL = {
    0: "finished",
    10: "finished",  # complete, but the upload or import at its end failed
    143: "stopped",
    2: "failed",
    3: "failed",
    6: "failed",
    7: "failed",
}
"""Exit codes that forbid another start, with the reported state."""
INTERRUPTED, ELSEWHERE, LOST = 75, 9, 8
SOON_AGAIN = (INTERRUPTED, ELSEWHERE, LOST)
END_WORK_FAILED = 10
MOST_FAILURES, FAILURE_WINDOW_S = 5, 3600.0
READ_LINES, SHOWN_LINES, SHOWN_LETTERS = 60, 3, 1500
BOOT_ATTEMPTS, BOOT_PAUSE_S = 3, 60.0
LEAVE_PAUSE_S = 300.0
LAST_MINUTES = 5
"""Before the machine's end, for stopping the training."""

SERVICE = """[Unit]
Description=DeepRacer training of {stack}
Wants=network-online.target
After=network-online.target
ConditionPathExists=!{leaving}

[Service]
User={user}
WorkingDirectory={racer}
EnvironmentFile={home}/environment
ExecStart={home}/venv/bin/dr-start-training --resume-or-start --foreground
ExecStopPost=+/usr/bin/python3 {home}/boot.py ended
StandardOutput=journal+console
Restart=always
RestartForceExitStatus=75
RestartSec=20
KillMode=mixed
TimeoutStopSec=110

[Install]
WantedBy=multi-user.target
"""
END_SERVICE = """[Unit]
Description=Stop the training before the time of {stack} is over

[Service]
Type=oneshot
User={user}
WorkingDirectory={racer}
EnvironmentFile={home}/environment
ExecStart={home}/venv/bin/dr-stop-training
"""
END_TIMER = """[Unit]
Description=Stop the training before the time of {stack} is over

[Timer]
OnCalendar={moment}
AccuracySec=1s

[Install]
WantedBy=timers.target
"""


class BootFailed(Exception):
    """A step of the start failed; says so for people."""


def at(path: str) -> Path:
    return Path(ROOT + path)


def pause(seconds: float) -> None:
    time.sleep(float(os.environ.get("DRCLI_SPOT_PAUSE_S", seconds)))


unwritten: list[str] = []
"""Lines of the log for which the disk had no room."""


def log(text: str) -> None:
    line = time.strftime("%Y-%m-%dT%H:%M:%SZ ", time.gmtime()) + text
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
    try:
        at(LOG).parent.mkdir(parents=True, exist_ok=True)
        with at(LOG).open("a") as file:
            file.write(line + "\n")
    except OSError:  # the disk is full
        unwritten.append(line + "\n")


def run(*command: str) -> None:
    log("$ " + " ".join(command))
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.stdout.strip():
        log(done.stdout.strip()[-4000:])
    if done.returncode:
        last = (done.stdout.strip().splitlines() or ["without a message"])[-1]
        raise BootFailed(f"`{' '.join(command[:3])}` ended with code {done.returncode}: {last}")


def write(path: str, text: str | bytes, mode: int = 0o644) -> None:
    at(path).parent.mkdir(parents=True, exist_ok=True)
    at(path).write_bytes(text.encode() if isinstance(text, str) else text)
    at(path).chmod(mode)


# The machine's own facts and keys: instance metadata, version 2.

_metadata = os.environ.get("AWS_EC2_METADATA_SERVICE_ENDPOINT", "http://169.254.169.254")
_direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def metadata(path: str, *, patience: int = 10) -> str:
    for attempt in range(patience):
        if attempt:
            pause(2)
        try:
            url = _metadata.rstrip("/") + "/latest/api/token"
            age = {"X-aws-ec2-metadata-token-ttl-seconds": "60"}
            request = urllib.request.Request(url, method="PUT", headers=age)
            token = _direct.open(request, timeout=5).read().decode()
            url = _metadata.rstrip("/") + "/latest/" + path
            request = urllib.request.Request(url, headers={"X-aws-ec2-metadata-token": token})
            text: str = _direct.open(request, timeout=5).read().decode()
            return text
        except urllib.error.HTTPError as error:
            if error.code == 404:
                return ""
        except OSError:
            pass
    return ""


class Machine:
    def __init__(self) -> None:
        told = json.loads(at("/etc/drcli/machine.json").read_text())
        self.stack, self.bucket, self.region = told["stack"], told["bucket"], told["region"]
        self.domain, self.topic, self.groups = told["domain"], told["topic"], told["groups"]
        self.ends = float(told["ends"])
        self.id = metadata("meta-data/instance-id")
        self.type = metadata("meta-data/instance-type")
        self.zone = metadata("meta-data/placement/availability-zone")
        self.market = metadata("meta-data/instance-life-cycle") or "on-demand"
        self.price = 0.0

    def going(self) -> str:
        if metadata("meta-data/spot/instance-action", patience=2):
            return "spot notice"
        if metadata("meta-data/autoscaling/target-lifecycle-state", patience=2) == "Terminated":
            return "end of the group"
        return ""

    def get(self, key: str) -> bytes:
        return self.call("s3", "GET", f"/{self.bucket}/{key}")

    def put(self, key: str, data: bytes) -> None:
        self.call("s3", "PUT", f"/{self.bucket}/{key}", body=data)

    def ask(self, service: str, version: str, action: str, **values: str) -> str:
        form = {"Action": action, "Version": version, **values}
        return self.call(service, "POST", "/", body=urllib.parse.urlencode(form).encode()).decode()

    def call(self, service: str, method: str, path: str, body: bytes = b"") -> bytes:
        last = ""
        for attempt in range(6):
            if attempt:
                pause(2**attempt)
            try:
                url, headers = self.signed(service, method, path, body)
                request = urllib.request.Request(url, body or None, headers, method=method)
                with urllib.request.urlopen(request, timeout=120) as answer:
                    data: bytes = answer.read()
                    return data
            except urllib.error.HTTPError as error:
                text = " ".join(error.read().decode(errors="replace").split())
                last = f"{service} answers {error.code} to {method} {path}: {text[:300]}"
                if error.code in (400, 404, 405):
                    break
            except OSError as error:
                last = f"{service} cannot be reached: {error}"
        raise BootFailed(last)

    def signed(
        self, service: str, method: str, path: str, body: bytes
    ) -> tuple[str, dict[str, str]]:
        """Address and headers, signed with AWS Signature Version 4."""
        base = (
            os.environ.get("AWS_ENDPOINT_URL") or f"https://{service}.{self.region}.{self.domain}"
        )
        host, path = urllib.parse.urlsplit(base).netloc, urllib.parse.quote(path, safe="/-_.~")
        role = metadata("meta-data/iam/security-credentials/").strip()
        keys = json.loads(metadata("meta-data/iam/security-credentials/" + role) or "{}")
        if "AccessKeyId" not in keys:
            raise OSError("the machine has no role yet")
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        digest = hashlib.sha256(body).hexdigest()
        form = "application/x-www-form-urlencoded; charset=utf-8"
        named = {
            "content-type": "application/octet-stream" if service == "s3" else form,
            "host": host,
            "x-amz-content-sha256": digest,
            "x-amz-date": stamp,
            "x-amz-security-token": keys["Token"],
        }
        names = ";".join(named)
        lines = "".join(f"{name}:{value}\n" for name, value in named.items())
        whole = "\n".join([method, path, "", lines, names, digest])
        scope = f"{stamp[:8]}/{self.region}/{service}/aws4_request"
        text = f"AWS4-HMAC-SHA256\n{stamp}\n{scope}\n{hashlib.sha256(whole.encode()).hexdigest()}"
        key = ("AWS4" + keys["SecretAccessKey"]).encode()
        for part in [*scope.split("/"), text]:
            key = hmac.new(key, part.encode(), hashlib.sha256).digest()
        who = f"AWS4-HMAC-SHA256 Credential={keys['AccessKeyId']}/{scope}"
        named["authorization"] = f"{who}, SignedHeaders={names}, Signature={key.hex()}"
        return base.rstrip("/") + path, named

    def mark(self, state: str, text: str = "") -> None:
        log(f"state: {state} {text}")
        now = time.time()
        before = at("/run/drcli/started")
        if not before.exists():
            write("/run/drcli/started", str(now))
        mark = {
            "instance": self.id,
            "type": self.type,
            "zone": self.zone,
            "market": self.market,
            "price": self.price,
            "started": float(before.read_text()),
            "written": now,
            "state": state,
            "text": text[:2000],
        }
        data = json.dumps(mark).encode()
        self.put(f"spot/{self.stack}/machines/{self.id}.json", data)

    def put_log(self) -> None:
        data = at(LOG).read_bytes() if at(LOG).is_file() else b""
        data += "".join(unwritten).encode()
        self.put(f"spot/{self.stack}/logs/{self.id}-boot.log", data)

    def tell(self, subject: str, text: str) -> bool:
        """Send a message to the topic, if there is one; whether that is done."""
        if not self.topic:
            return True
        about = f"{text}\n\nStack {self.stack}, instance {self.id} ({self.type}, {self.zone})."
        try:
            self.ask(
                "sns", "2010-03-31", "Publish", TopicArn=self.topic, Subject=subject, Message=about
            )
        except BootFailed as error:
            log(f"no message was sent: {error}")
            return False
        return True

    def leave(self, state: str, text: str) -> None:
        """Setting the groups to 0 ends this machine."""
        write(LEAVING, state)
        failed: list[str] = []
        steps: tuple[Callable[[], None], ...] = (lambda: self.mark(state, text), self.put_log)
        for step in steps:
            try:
                step()
            except BootFailed as error:
                failed.append(str(error))
        # An end that is tried again sends no second message.
        if not at(TOLD).exists() and self.tell(f"Training {state}: {self.stack}"[:100], text):
            write(TOLD, state)
        for group in self.groups:
            try:
                self.ask(
                    "autoscaling",
                    "2011-01-01",
                    "SetDesiredCapacity",
                    AutoScalingGroupName=group,
                    DesiredCapacity="0",
                    HonorCooldown="false",
                )
            except BootFailed as error:
                failed.append(str(error))
        if failed:
            log("; ".join(failed))
            raise BootFailed("; ".join(failed))

    def hourly_price(self, on_demand: Mapping[str, float]) -> float:
        """USD; 0 if unknown."""
        if self.market != "spot":
            return float(on_demand.get(self.type, 0.0))
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        answer = self.ask(
            "ec2",
            "2016-11-15",
            "DescribeSpotPriceHistory",
            AvailabilityZone=self.zone,
            StartTime=now,
            **{"InstanceType.1": self.type, "ProductDescription.1": "Linux/UNIX"},
        )
        found = re.search(r"<spotPrice>([0-9.]+)</spotPrice>", answer)
        return float(found[1]) if found else 0.0


def read_plan(machine: Machine) -> dict[str, Any]:
    plan: dict[str, Any] = json.loads(machine.get(f"spot/{machine.stack}/install.json"))
    try:
        machine.price = machine.hourly_price(plan["on_demand_usd"])
    except BootFailed as error:
        log(f"the price is unknown: {error}")
    return plan


def install(machine: Machine, plan: dict[str, Any]) -> None:
    env = ["env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-o", "DPkg::Lock::Timeout=300"]
    run(*env, "update", "-q")
    run(*env, "install", "-y", "-q", "--no-install-recommends", *plan["packages"])
    if subprocess.run(["id", USER], capture_output=True).returncode:
        run("useradd", "--system", "--create-home", "--home-dir", HOME + "/home", USER)
    at(HOME).mkdir(parents=True, exist_ok=True)
    if not at(PYTHON).exists():
        run("python3", "-m", "venv", str(at(HOME + "/venv")))
    pip = [str(at(PYTHON)), "-m", "pip", "install", "--quiet", "--no-input"]
    source = plan["source"]
    if plan["wheel"]:
        data = machine.get(f"spot/{machine.stack}/{plan['wheel']}")
        if hashlib.sha256(data).hexdigest() != plan["sha256"]:
            raise BootFailed(f"The wheel {plan['wheel']} in the bucket is damaged or was replaced.")
        file = at(f"{HOME}/{plan['wheel']}")
        file.write_bytes(data)
        source = str(file)
    try:
        run(*pip, "--index-url", TORCH, plan["torch"])
    except BootFailed as error:
        # The usual index has it too, with libraries for graphics cards.
        log(f"{error}; the usual index is used instead")
    run(*pip, source)
    for name in plan["files"]:
        write(f"{RACER}/{name}", machine.get(f"spot/{machine.stack}/files/{name}"), 0o600)
    variables = dict(plan["environment"])
    if machine.topic:
        variables["MY_SNS_TOPIC"] = machine.topic
    if machine.price and "DR_SPOT_PRICE" not in plan["given"]:
        variables["DR_SPOT_PRICE"] = f"{machine.price:.4f}"
    write(f"{HOME}/environment", "".join(f"{k}={quoted(v)}\n" for k, v in variables.items()))
    run("chown", "-R", f"{USER}:{USER}", str(at(RACER)))


def quoted(value: str) -> str:
    """As both systemd and a shell read it."""
    if re.fullmatch(r"[\w@%+=:,./-]*", value):
        return value
    return '"' + re.sub(r'(["\\$`])', r"\\\1", value) + '"'


def start_service(machine: Machine) -> None:
    names = {"stack": machine.stack, "user": USER, "home": HOME, "racer": RACER, "leaving": LEAVING}
    write(UNITS + "drcli-training.service", SERVICE.format(**names))
    run("systemctl", "daemon-reload")
    if machine.ends:
        last = time.gmtime(machine.ends - 60 * LAST_MINUTES)
        moment = time.strftime("%Y-%m-%d %H:%M:%S UTC", last)
        write(UNITS + "drcli-end.service", END_SERVICE.format(**names))
        write(UNITS + "drcli-end.timer", END_TIMER.format(moment=moment, **names))
        run("systemctl", "daemon-reload")
        run("systemctl", "enable", "--now", "drcli-end.timer")
    run("systemctl", "enable", "--now", "--no-block", "drcli-training.service")


def start() -> int:
    """Three attempts, then give the machine back."""
    machine = Machine()
    if machine.ends and machine.ends - time.time() < 60 * (LAST_MINUTES + 1):
        leave_at_last(machine, "stopped", "The time of the stack is over.")
        return 0
    problem = ""
    for attempt in range(BOOT_ATTEMPTS):
        if attempt:
            pause(BOOT_PAUSE_S)
        try:
            machine.mark("booting", problem)
            plan = read_plan(machine)
            install(machine, plan)
            machine.mark("starting")
            start_service(machine)
            machine.mark("training")
            machine.put_log()
        except Exception as error:
            problem = str(error) if isinstance(error, BootFailed) else traceback.format_exc()
            log(f"attempt {attempt + 1} of {BOOT_ATTEMPTS} failed: {problem}")
        else:
            return 0
    leave_at_last(machine, "failed", f"The machine could not be set up: {problem}")
    return 1


def leave_at_last(machine: Machine, state: str, text: str) -> None:
    """Without a training nothing else would end a machine that has no network now."""
    while True:
        try:
            machine.leave(state, text)
        except Exception as error:
            log(f"the machine cannot be given back yet: {error}")
            pause(LEAVE_PAUSE_S)
        else:
            return


def ended() -> int:
    how, status = os.environ.get("EXIT_CODE", "exited"), os.environ.get("EXIT_STATUS", "0")
    code = int(status) if how == "exited" and status.isdigit() else 1
    said = f"The training ended with code {status}."
    if how != "exited":
        memory = os.environ.get("SERVICE_RESULT") == "oom-kill"
        why = " because the memory of the machine ran out" if memory else ""
        said = f"The training was ended by signal {status}{why}."
    if FINAL.get(code) in ("finished", "stopped"):
        said = f"{said} {recorded_end(code)}".rstrip()
    else:
        said = f"{said} {last_words(only_errors=code in SOON_AGAIN)}".rstrip()
    log(said)
    machine = Machine()
    try:
        answer(machine, code, said)
    except BootFailed as error:
        log(str(error))
    return 0


def answer(machine: Machine, code: int, said: str) -> None:
    """Give the machine back, or let the training start again."""
    continues = True
    try:
        continues = read_plan(machine)["continues"]
    except BootFailed as error:
        log(f"the plan cannot be read: {error}")
    if code in FINAL:
        leave_or_retry(machine, FINAL[code], said)
        return
    if code == INTERRUPTED and (why := machine.going()):
        if not continues:
            machine.leave("interrupted", f"{said} Reason: {why}. It is not continued elsewhere.")
            return
        write(LEAVING, why)  # otherwise this machine would take the model back
        machine.mark("interrupted", f"{said} Reason: {why}.")
    elif code in SOON_AGAIN:
        machine.mark("waiting", f"{said} It is started again.")
    else:
        recent = failures()
        if len(recent) >= MOST_FAILURES:
            said = f"{said} It failed {len(recent)} times within an hour."
            leave_or_retry(machine, "failed", said)
            return
        machine.mark("restarting", f"{said} It is started again.")
    machine.put_log()


def leave_or_retry(machine: Machine, state: str, text: str) -> None:
    """If Amazon cannot be reached, the next end of the service tries again."""
    try:
        machine.leave(state, text)
    except BootFailed:
        at(LEAVING).unlink(missing_ok=True)
        raise


def last_words(*, only_errors: bool) -> str:
    """What the training has printed last: its errors and remedies, or else its last lines."""
    command = ["journalctl", "--quiet", "--no-pager", "--output=cat", f"--lines={READ_LINES}"]
    command += [f"_SYSTEMD_INVOCATION_ID={os.environ.get('INVOCATION_ID', '')}"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=30)
    except (OSError, subprocess.TimeoutExpired) as error:
        log(f"the last lines of the training cannot be read: {error}")
        return ""
    lines = [line.strip() for line in done.stdout.decode(errors="replace").splitlines()]
    lines = [line for line in lines if line]
    errors = [k for k, line in enumerate(lines) if line.startswith("Error: ")]
    if errors:
        return " ".join(lines[errors[0] :])[:SHOWN_LETTERS]
    return "" if only_errors else " ".join(lines[-SHOWN_LINES:])[-SHOWN_LETTERS:]


def recorded_end(code: int) -> str:
    """How a training ended as wanted, and what to do about work at its end that failed."""
    for path in at(RACER).glob("data/runs/*/run.json"):
        try:
            record = json.loads(path.read_text())
            if record["exit_code"] == code:
                return f"{record['message']} {record['remedy']}"
        except (OSError, ValueError, KeyError) as error:
            log(f"{path} says nothing: {error}")  # a machine must end without it too
    complete = "It is complete, but the upload or import at its end failed."
    return complete if code == END_WORK_FAILED else ""


def failures() -> list[float]:
    now = time.time()
    before = at(FAILURES).read_text().split() if at(FAILURES).exists() else []
    recent = [float(when) for when in before if now - float(when) < FAILURE_WINDOW_S] + [now]
    write(FAILURES, "\n".join(map(str, recent)))
    return recent


if __name__ == "__main__":
    sys.exit({"start": start, "ended": ended}[sys.argv[1]]())
