"""Reads a policy from a TensorFlow checkpoint of the reference."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.base.problems import shown
from drcli.formats.reference_checkpoint import critic_from_variables, ours_from_variables
from drcli.formats.reference_layout import (
    BODIES,
    NETWORKS,
    RESCALER,
    Shape,
    differences,
    reference_layout,
)
from drcli.formats.tensorflow.bundle import Bundle, open_bundle
from drcli.learn.policy import PolicySpec
from drcli.modelfiles.model_metadata import CAMERAS, LIDARS

_NAME = re.compile(
    r"(?P<agent>main_level/agent(?:_\d+)?/main/)(?P<copy>online|global)/(?P<rest>.+)"
)
"""Trained alone (`online`) or by several processes (`global`)."""

_SAC = re.compile(r"main_level/agent(?:_\d+)?/(policy|q|v)/")

_SLOTS = re.compile(r".*/(Adam|Adam_1|RMSProp|RMSProp_1|Momentum)")
_REMEDY = "Name a checkpoint that the reference simulator or `dr-export tf-checkpoint` wrote."

_LISTED = 3


@dataclass(frozen=True)
class ReadCheckpoint:
    """A policy from a checkpoint.

    Attributes:
        network: As in model_metadata.json.
        sensors: The camera first.
        eyes: Cameras, 1 or 2.
        scan_dims: 0 without a lidar.
        weights: Under our names, without a critic if `fresh_critic`.
        notes: For the racer.
    """

    network: str
    sensors: tuple[str, ...]
    eyes: int
    scan_dims: int
    num_actions: int
    continuous: bool
    weights: dict[str, NDArray[np.float32]]
    fresh_critic: bool
    notes: list[str] = field(default_factory=list)
    algorithm: str = "clipped_ppo"


def read_reference_checkpoint(
    index: bytes, data: bytes | Sequence[bytes], origin: str
) -> ReadCheckpoint:
    """Read a policy from its `.index` and data files in order.

    Raises:
        SettingsError: It is damaged, or not one of the reference's networks.
    """
    bundle = open_bundle(index, origin)
    names = _names(bundle)
    shapes = {ours: bundle.entries[name].shape or () for ours, name in names.items()}
    sensors = _sensors(shapes, bundle.origin)
    policy = _spec(shapes, sensors, bundle.origin)
    notes: list[str] = []
    variables = {
        ours: _values(bundle, name, data, notes)
        for ours, name in names.items()
        if ours.startswith(BODIES)
    }
    weights = ours_from_variables(variables, policy, sensors)
    critic = critic_from_variables(variables)
    if critic is None:
        notes.append(
            "The critic starts fresh: the reference trains a body of its own for it, and ours uses "
            "the policy's."
        )
    others = len(bundle.entries) - len(variables)
    if others:
        notes.append(f"{others} other variables (optimizer, counters) are not used.")
    return ReadCheckpoint(
        policy.network,
        sensors,
        policy.eyes,
        policy.scan_dims,
        policy.num_actions,
        policy.continuous,
        weights | (critic or {}),
        critic is None,
        notes,
    )


def _names(bundle: Bundle) -> dict[str, str]:
    found: dict[tuple[str, str], dict[str, str]] = {}
    for name in bundle.entries:
        part = _NAME.fullmatch(name)
        if part and not _SLOTS.fullmatch(name):
            found.setdefault((part["agent"], part["copy"]), {})[part["rest"]] = name
    agents = sorted({agent for agent, _ in found})
    if len(agents) > 1:
        _refuse(bundle.origin, f"has several agents: {', '.join(agents)}")
    if agents:
        # `global` is the copy that several processes share; `online` is the one that drives.
        return found.get((agents[0], "online")) or found[agents[0], "global"]
    if any(_SAC.match(name) for name in bundle.entries):
        raise SettingsError(
            f"{bundle.origin} is a SAC model of the reference simulator, whose policy has other "
            "layers than ours.",
            remedy="Race its frozen graph, model_<N>.pb, as it is with `dr-evaluate --model FILE`.",
        )
    some = ", ".join(shown(name) for name in list(bundle.entries)[:_LISTED]) or "nothing"
    return _refuse(bundle.origin, f"has no policy of the reference simulator; it has {some}")


def _sensors(shapes: Mapping[str, Shape], origin: str) -> tuple[str, ...]:
    scopes = {name.split("/")[1] for name in shapes if name.startswith(BODIES[1])}
    scopes -= {"middleware_fc_embedder", "ppo_head_0", RESCALER}
    cameras = [name for name in CAMERAS if name in scopes]
    lidars = [name for name in LIDARS if name in scopes]
    unknown = sorted(scopes - {*cameras, *lidars})
    if unknown:
        _refuse(origin, f"has the unknown part network_1/{shown(unknown[0])}")
    if len(cameras) != 1 or len(lidars) > 1:
        names = ", ".join([*cameras, *lidars]) or "no sensor"
        _refuse(origin, f"has {names}; a policy here has one camera and at most one lidar")
    return (*cameras, *lidars)


def _spec(shapes: Mapping[str, Shape], sensors: Sequence[str], origin: str) -> PolicySpec:
    """SettingsError says how the most similar network differs."""
    head = BODIES[1] + "ppo_head_0/"
    heads = [name for name in shapes if name.startswith(head)]
    continuous = any("policy_mean" in name or "policy_log_std" in name for name in heads)
    kernel = f"{head}{'policy_mean' if continuous else 'policy_fc'}/kernel"
    num_actions = (shapes.get(kernel) or (0,))[-1]
    scan_dims = 0
    if len(sensors) > 1:
        scan_dims = (shapes.get(f"{BODIES[1]}{sensors[1]}/Dense_0/kernel") or (0,))[0]
    found = {name: shape for name, shape in shapes.items() if name.startswith(BODIES[1])}
    found.setdefault(BODIES[1] + RESCALER, ())
    fits: list[tuple[list[str], str]] = []
    for network in NETWORKS:
        wanted = reference_layout(
            network,
            sensors,
            scan_dims=scan_dims,
            num_actions=num_actions,
            continuous=continuous,
        )
        policy = {name: shape for name, shape in wanted.items() if name.startswith(BODIES[1])}
        fits.append((differences(found, policy), network))
    other, network = min(fits, key=lambda fit: len(fit[0]))
    if other:
        more = f" (and {len(other) - _LISTED} more differences)" if len(other) > _LISTED else ""
        _refuse(
            f"{origin}.index",
            f"is not a network of the reference simulator. Compared with {network}, the most "
            f"similar one: {'; '.join(other[:_LISTED])}{more}",
        )
    if num_actions < 1 or (len(sensors) > 1 and scan_dims < 1):
        _refuse(origin, "has a layer without inputs or outputs")
    eyes = 2 if sensors[0] == "STEREO_CAMERAS" else 1
    return PolicySpec(num_actions, continuous, network, eyes, scan_dims=scan_dims)


def _values(
    bundle: Bundle, name: str, data: bytes | Sequence[bytes], notes: list[str]
) -> NDArray[np.float32]:
    values: NDArray[Any] = bundle.read(name, data)
    if values.dtype != np.float32:
        if values.dtype.kind != "f":
            _refuse(f"{bundle.origin}.index", f"has weights of {values.dtype}: {shown(name)}")
        note = f"Weights of {values.dtype} were converted to float32."
        if note not in notes:
            notes.append(note)
    with np.errstate(over="ignore"):
        values = values.astype(np.float32, copy=False)
    if not np.isfinite(values).all():
        raise SettingsError(
            f"{bundle.data_names[0]}: {shown(name)} has values that are not finite.",
            remedy="Choose an earlier checkpoint of that model.",
        )
    return values


def _refuse(origin: str, what: str) -> NoReturn:
    raise SettingsError(f"{origin} {what}.", remedy=_REMEDY)
