"""Opens policies for explanation."""

from pathlib import Path

from drcli.base.errors import SettingsError
from drcli.formats.build_network import build_policy, load_arrays, load_weights
from drcli.formats.policy_file import PolicyFile, read_policy_file
from drcli.formats.read_graph import read_graph
from drcli.formats.runtimes import policy_of_file
from drcli.formats.stored_checkpoint import driving_graph, load_checkpoint
from drcli.learn.actor_critic import ActorCritic
from drcli.modelfiles.network_shape import Design
from drcli.saliency.policy_outputs import ExplainedPolicy
from drcli.store.bucket import Bucket


def open_policy(bucket: Bucket, prefix: str, checkpoint: str) -> ExplainedPolicy:
    """The policy of a checkpoint, such as `5_Step-500`.

    Raises:
        ObjectMissing: A file of the model.
        ObjectDamaged: The checkpoint.
        ProblemsError: A parameter file is wrong.
        SettingsError: Weights and parameter files do not fit.
    """
    graph = driving_graph(bucket, prefix, checkpoint)
    if graph is not None:
        return ExplainedPolicy(policy_of_file(graph), graph.metadata, is_complete=False)
    found = load_checkpoint(bucket, prefix, checkpoint)
    design = Design.of_record(bucket, prefix, found.record)
    model = build_policy(design.metadata, design.parameters)
    load_weights(model, found.tensors, found.record.name)
    fresh_critic = bool(found.record.counters.critic_warmup)
    return ExplainedPolicy(model, design.metadata, is_complete=not fresh_critic)


def open_policy_file(path: Path, metadata: Path | None = None) -> ExplainedPolicy:
    """From a frozen graph, ONNX, OpenVINO, TensorFlow Lite or a car's archive.

    Frozen graphs of the reference and ours get gradients, but no critic. Others run in engines.

    Raises:
        SettingsError: File or metadata is missing, damaged, or unfit.
        NotAvailable: The engine is not installed.
    """
    file = read_policy_file(path, metadata)
    policy = _network(file) or policy_of_file(file)
    return ExplainedPolicy(policy, file.metadata, is_complete=False)


def _network(file: PolicyFile) -> ActorCritic | None:
    if file.form != "pb":
        return None
    try:
        found = read_graph(file.data, file.origin)
    except SettingsError:
        return None  # an engine may run it; if not, it says what is wrong with the file
    metadata, space = file.metadata, file.metadata.action_space
    theirs = found.num_actions, found.continuous, found.eyes, found.scan_dims
    if theirs != (space.num_actions, space.continuous, metadata.eyes, metadata.scan_dims):
        return None
    model = ActorCritic(found.spec)
    load_arrays(model, found.weights)
    return model.eval()
