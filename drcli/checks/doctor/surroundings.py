"""Examines cloud, spot instance, container, limits, locale and time zone."""

import locale
import os
import time
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from zoneinfo import TZPATH

from drcli.base.confinement import FREEDOMS, offered
from drcli.base.system_calls import Limit, soft_limit
from drcli.checks.doctor.findings import Finding
from drcli.workers.reward_access import freedoms_told

METADATA_PATIENCE_S = 1.0
LEAST_OPEN_FILES = 512
"""A supervisor with ten workers has about a hundred."""

LEAST_PROCESSES = 512
"""Threads count too; each process has some dozens."""

_ROOT = Path("/")
_DMI = ("sys_vendor", "product_name", "bios_vendor", "board_vendor", "chassis_asset_tag")
_AZURE_TAG = "7783-7084-3265-9085-8269-3286-77"
"""Other machines under Hyper-V have another one."""

_HYPERVISORS = {
    "qemu": "QEMU",
    "vmware": "VMware",
    "innotek": "VirtualBox",
    "parallels": "Parallels",
    "xen": "Xen",
    "microsoft corporation": "Hyper-V",
    "openstack": "OpenStack",
}
_HOSTERS = {
    "alibaba": "Alibaba Cloud",
    "digitalocean": "DigitalOcean",
    "hetzner": "Hetzner",
    "oraclecloud": "Oracle Cloud",
    "scaleway": "Scaleway",
    "vultr": "Vultr",
    "linode": "Linode",
}
_SPOT = {
    "Amazon EC2": (
        "http://169.254.169.254",
        "/latest/meta-data/instance-life-cycle",
        {},
        "spot",
    ),
    "Google Cloud": (
        "http://169.254.169.254",
        "/computeMetadata/v1/instance/scheduling/preemptible",
        {"Metadata-Flavor": "Google"},
        "TRUE",
    ),
    "Azure": (
        "http://169.254.169.254",
        "/metadata/instance/compute/priority?api-version=2021-02-01&format=text",
        {"Metadata": "true"},
        "Spot",
    ),
}
"""Source: the clouds' pages on their metadata services."""


@dataclass(frozen=True)
class Place:
    """Where this process runs; texts are empty if unknown."""

    cloud: str
    kind: str
    layers: tuple[str, ...]


def where_it_runs(environ: Mapping[str, str], root: Path = _ROOT) -> Place:
    """From files and variables, without the network."""
    dmi = {name: _text(root / "sys/class/dmi/id" / name) for name in _DMI}
    every = " ".join(dmi.values()).casefold()
    layers = tuple(_layers(environ, root))
    if "amazon ec2" in every or _text(root / "sys/hypervisor/uuid").startswith("ec2"):
        return Place("Amazon EC2", dmi["product_name"], layers)
    if dmi["product_name"] == "Google Compute Engine" or dmi["sys_vendor"] == "Google":
        return Place("Google Cloud", "", layers)
    if dmi["chassis_asset_tag"] == _AZURE_TAG:
        return Place("Azure", "", layers)
    cloud = next((name for word, name in _HOSTERS.items() if word in every), "")
    kind = next((name for word, name in _HYPERVISORS.items() if word in every), "")
    return Place(cloud, kind, layers)


def examine_place(environ: Mapping[str, str], root: Path = _ROOT) -> Iterator[Finding]:
    place = where_it_runs(environ, root)
    spot = is_spot(place.cloud, environ) if place.cloud in _SPOT else None
    name = f"{place.cloud} {place.kind}".strip() or "no cloud recognised"
    parts = [name, *place.layers]
    if spot is not None:
        parts[0] += ", a spot instance" if spot else ", not a spot instance"
    facts = {"cloud": place.cloud, "kind": place.kind, "layers": list(place.layers), "spot": spot}
    yield Finding("place", "ok", "; ".join(parts), facts=facts)


def is_spot(cloud: str, environ: Mapping[str, str]) -> bool | None:
    """Whether the machine may be taken away, if its cloud says it."""
    address, path, headers, yes = _SPOT[cloud]
    if cloud == "Amazon EC2":
        if environ.get("AWS_EC2_METADATA_DISABLED", "").casefold() == "true":
            return None
        address = environ.get("AWS_EC2_METADATA_SERVICE_ENDPOINT", address).rstrip("/")
        wanted = {"X-aws-ec2-metadata-token-ttl-seconds": "60"}
        token = _ask(f"{address}/latest/api/token", wanted, "PUT")
        headers = {"X-aws-ec2-metadata-token": token} if token else {}
    answer = _ask(address + path, headers, "GET")
    return None if answer is None else answer.strip() == yes


def examine_confinement() -> Iterator[Finding]:
    left = set(FREEDOMS) - offered()
    text = freedoms_told(left) or "reads no keys, opens no sockets, sends no signals to others"
    yield Finding("reward", "ok", text, facts={"free": sorted(left)})


def examine_limits(root: Path = _ROOT) -> Iterator[Finding]:
    files = soft_limit("open_files")
    threads = _threads(root)
    facts = {"open_files": files, "processes": threads}
    wrong = False
    if files is not None and files < LEAST_OPEN_FILES:
        wrong = True
        text = f"this shell allows only {files:,} open files."
        yield Finding("limits", "warning", text, "Run `ulimit -n 4096` before the start.", facts)
    if threads is not None and threads < LEAST_PROCESSES:
        wrong = True
        text = f"only {threads:,} processes and threads are allowed here."
        remedy = "Raise `ulimit -u`, or the limit of the container (`--pids-limit`)."
        yield Finding("limits", "warning", text, remedy, facts)
    others: tuple[tuple[str, Limit, str], ...] = (
        ("memory of a process", "memory", "-v"),
        ("size of a file", "file_size", "-f"),
    )
    for name, limit, option in others:
        if soft_limit(limit) is not None:
            wrong = True
            text = f"the {name} is limited, which may end a training."
            yield Finding("limits", "warning", text, f"Run `ulimit {option} unlimited`.", facts)
    if not wrong:
        count = "any number of" if files is None else f"{files:,}"
        yield Finding("limits", "ok", f"{count} open files", facts=facts)


def examine_language(environ: Mapping[str, str]) -> Iterator[Finding]:
    wrong = False
    name = next((environ[key] for key in ("LC_ALL", "LC_CTYPE", "LANG") if environ.get(key)), "C")
    encoding = locale.getencoding()
    zone = environ.get("TZ", "")
    facts = {"locale": name, "encoding": encoding, "time_zone": time.strftime("%Z")}
    if encoding.casefold().replace("-", "") != "utf8":
        wrong = True
        text = f"the character set of {name} is {encoding}, not UTF-8; some characters are lost."
        yield Finding("locale", "warning", text, "Set LANG=C.UTF-8.", facts)
    if zone and not _is_zone(zone):
        wrong = True
        text = f"TZ={zone} is not a time zone of this machine; times are shown in UTC."
        yield Finding("locale", "warning", text, "Correct TZ, or install tzdata.", facts)
    if time.time() < 1_735_689_600:  # 2025
        wrong = True
        text = f"the clock of this machine says {time.strftime('%Y-%m-%d')}."
        yield Finding("locale", "problem", text, "Set it: `sudo timedatectl set-ntp true`.", facts)
    if not wrong:
        yield Finding("locale", "ok", f"{name}; time zone {facts['time_zone']}", facts=facts)


def _layers(environ: Mapping[str, str], root: Path) -> Iterator[str]:
    if environ.get("KUBERNETES_SERVICE_HOST"):
        yield "in Kubernetes"
    elif (root / ".dockerenv").exists():
        yield "in a Docker container"
    elif (root / "run/.containerenv").exists():
        yield "in a Podman container"
    elif environ.get("container"):
        yield f"in a container ({environ['container']})"
    if environ.get("SLURM_JOB_ID"):
        yield "in a Slurm job"
    if environ.get("SKYPILOT_TASK_ID"):
        yield "in a SkyPilot job"
    if environ.get("INVOCATION_ID"):
        yield "in a systemd service"
    if "microsoft" in _text(root / "proc/sys/kernel/osrelease").casefold():
        yield "in WSL"


def _ask(address: str, headers: Mapping[str, str], method: str) -> str | None:
    request = urllib.request.Request(address, headers=dict(headers), method=method)
    # No proxy knows this address.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(request, timeout=METADATA_PATIENCE_S) as answer:
            return str(answer.read(4096).decode("utf-8", "replace"))
    except (OSError, ValueError):
        return None


def _threads(root: Path) -> int | None:
    limits = []
    if os.getuid() != 0:  # root may have any number
        soft = soft_limit("processes")
        limits += [] if soft is None else [soft]
    for file in ("sys/fs/cgroup/pids.max", "sys/fs/cgroup/pids/pids.max"):
        text = _text(root / file)
        limits += [int(text)] if text.isdigit() else []
    return min(limits, default=None)


def _is_zone(zone: str) -> bool:
    name = zone.removeprefix(":")
    if any(character.isdigit() or character in ",<" for character in name):
        return True  # such as CET-1CEST
    return any((Path(folder) / name).is_file() for folder in ("/", *TZPATH))


def _text(file: Path) -> str:
    try:
        return file.read_text("utf-8", "replace").strip()
    except OSError:
        return ""
