"""Maps of small networks, some of which look at a known part of the picture only."""

import numpy as np
import pytest
import torch

from drcli.convert.runtimes import policy_of_model
from drcli.learn.policy import Observation, decide
from drcli.view.saliency.maps import ExplainedPolicy, NotExplainable, saliency_maps
from drcli.view.saliency.policy_outputs import outputs_of
from small_policies import small_metadata, small_network

STEREO = {"sensor": ["STEREO_CAMERAS"], "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"}
LIDAR = {"sensor": ["FRONT_FACING_CAMERA", "SECTOR_LIDAR"]}


def subject(head="discrete", *, stack=1, **changes):
    metadata = small_metadata(head, **changes)
    network = small_network(metadata, stack=stack)
    network.returns.scale.fill_(2.0)  # a critic that has learned nothing expects nothing
    return ExplainedPolicy(network, metadata)


def pictures(explained, count=1):
    spec = explained.policy.spec
    generator = np.random.default_rng(3)
    frames = generator.integers(0, 256, (count, spec.channels, 120, 160)).astype(np.uint8)
    scans = generator.integers(0, 2, (count, spec.scan_dims)).astype(np.float32)
    return frames, scans


def looking_left(head="discrete"):
    """A policy whose dense layer ignores the right half of the convolutions' pixels."""
    explained = subject(head)
    weight = explained.policy.body.dense[0].weight
    pixels = explained.policy.body.convolutions[-1].out_channels
    with torch.no_grad():
        kept = torch.zeros(6, weight.shape[1] // 6 // pixels, pixels)
        kept[:, : kept.shape[1] // 2] = 1.0
        weight *= kept.flatten()
    return explained


@pytest.mark.parametrize("head", ["discrete", "continuous", "sac"])
@pytest.mark.parametrize("method", ["perturbation", "hires-cam"])
def test_a_map_lights_up_where_the_policy_looks(head, method):
    explained = looking_left(head)
    frames, _ = pictures(explained)

    values = saliency_maps(explained, frames, methods=[method], spacing=20).maps[method][0, 0]

    assert values.max() > 0.0
    assert values[:, :80].sum() > 20 * values[:, 110:].sum()


@pytest.mark.parametrize(
    ("explained", "target"),
    [
        (subject(neural_network="DEEP_CONVOLUTIONAL_NETWORK_DEEP"), "action"),
        (subject("continuous", neural_network="DEEP_CONVOLUTIONAL_NETWORK"), "steering"),
        (subject("continuous"), "speed"),
        (subject("sac", stack=2), "value"),
        (subject("sac"), "action"),
        (subject(**STEREO), "steering"),
        (subject(**LIDAR), "value"),
    ],
    ids=["deep", "continuous", "speed", "stacked sac", "sac", "stereo", "lidar"],
)
def test_every_kind_of_policy_has_every_map(explained, target):
    frames, scans = pictures(explained)

    found = saliency_maps(explained, frames, scans, target=target, spacing=20)

    assert set(found.maps) == {"perturbation", "hires-cam", "grad-cam"}
    for values in found.maps.values():
        assert values.shape == (1, explained.policy.spec.eyes, 120, 160)
        assert np.isfinite(values).all()
        assert (values >= 0.0).all()
        assert values.max() > 0.0
    assert (found.lidar is None) == (explained.policy.spec.scan_dims == 0)


def test_the_eyes_of_a_stereo_camera_have_maps_of_their_own():
    explained = subject(**STEREO)
    with torch.no_grad():
        explained.policy.body.convolutions[0].weight[:, 1] = 0.0  # blind on the right eye
    frames, _ = pictures(explained)

    left, right = saliency_maps(explained, frames, methods=["perturbation"], spacing=20).maps[
        "perturbation"
    ][0]

    assert left.max() > 0.0
    assert right.max() < 1e-7


def test_a_picture_without_details_has_nothing_to_blur():
    explained = subject()
    frames = np.full((1, 1, 120, 160), 90, np.uint8)

    found = saliency_maps(explained, frames, methods=["perturbation"], spacing=20)

    assert found.maps["perturbation"].max() < 1e-7


def test_the_lidar_map_names_the_only_sector_that_matters():
    explained = subject(**LIDAR)
    lidar = explained.policy.body.lidar[0]
    with torch.no_grad():
        lidar.weight *= (torch.arange(8) == 5).float()
    frames, scans = pictures(explained)
    scans[:] = 1.0

    found = saliency_maps(explained, frames, scans, methods=["perturbation"], spacing=20)

    assert explained.sensors.sectors == 8
    assert found.lidar.shape == (1, 8)
    assert np.flatnonzero(found.lidar[0] > 1e-7).tolist() == [5]


@pytest.mark.parametrize("head", ["discrete", "continuous", "sac"])
def test_outputs_are_what_the_policy_drives_with(head):
    explained = subject(head)
    frames, scans = pictures(explained, 3)
    seen = Observation.of_arrays(frames, scans, np.empty((3, 0), np.float32))
    noise = np.zeros((3, explained.policy.spec.noise_dims), np.float32)
    driven = decide(explained.policy, seen, noise, np.ones(3, np.bool_))

    found = outputs_of(explained, seen)

    steering_deg, speed_mps = explained.actions.requests(driven.actions)
    np.testing.assert_allclose(found.steering_deg, steering_deg, atol=1e-3)
    np.testing.assert_allclose(found.speed_mps, speed_mps, atol=1e-4)
    np.testing.assert_allclose(found.value, driven.values, rtol=1e-4)
    if head == "discrete":
        np.testing.assert_allclose(found.probabilities.sum(axis=1), 1.0)
        assert found.chosen.tolist() == driven.actions.tolist()
        assert (found.entropy > 0.0).all()
    else:
        assert (found.low <= found.high).all()
        assert (found.low <= found.expected + 1e-9).all()


def test_the_graph_of_an_engine_has_the_perturbation_map_of_its_network():
    explained = subject()
    engine = ExplainedPolicy(
        policy_of_model(explained.policy, explained.metadata, "pb", "a graph"),
        explained.metadata,
        is_complete=False,
    )
    frames, _ = pictures(explained)

    ours = saliency_maps(explained, frames, methods=["perturbation"], spacing=20)
    theirs = saliency_maps(engine, frames, spacing=20)

    assert set(theirs.maps) == {"perturbation"}
    assert theirs.outputs.value is None
    np.testing.assert_allclose(
        theirs.maps["perturbation"], ours.maps["perturbation"], rtol=1e-3, atol=1e-6
    )


def test_what_a_policy_does_not_have_is_told():
    explained = subject()
    engine = ExplainedPolicy(
        policy_of_model(explained.policy, explained.metadata, "pb", "a graph"), explained.metadata
    )
    frames, _ = pictures(explained)

    with pytest.raises(NotExplainable, match="gradients"):
        saliency_maps(engine, frames, methods=["grad-cam"])
    imported = ExplainedPolicy(explained.policy, explained.metadata, is_complete=False)
    for file in (engine, imported):
        with pytest.raises(NotExplainable, match="no critic in the file"):
            saliency_maps(file, frames, target="value", spacing=20)


@pytest.mark.parametrize(
    "frames",
    [
        np.zeros((1, 2, 120, 160), np.uint8),
        np.zeros((1, 1, 60, 160), np.uint8),
        np.zeros((1, 1, 120, 160), np.float32),
    ],
)
def test_frames_of_another_camera_are_refused(frames):
    with pytest.raises(ValueError, match=r"\(n, 1, 120, 160\)"):
        saliency_maps(subject(), frames)
