import math

import pytest
import torch
from torch import nn
from torch.nn import functional
from torch.utils.flop_counter import FlopCounterMode

from drcli.learn.encoders import Encoder, compute_in, in_blocks, kernel_in_blocks
from drcli.learn.policy import Observation, PolicySpec
from observations import camera_only

SHALLOW = "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
MIDDLE = "DEEP_CONVOLUTIONAL_NETWORK"
DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"
COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"


@pytest.mark.parametrize(
    ("network", "eyes", "parameters"),
    [
        (SHALLOW, 1, 5_839_520),
        (SHALLOW, 2, 5_841_568),
        (MIDDLE, 1, 28_742_176),
        (MIDDLE, 2, 57_621_984),
        (DEEP, 1, 2_776_640),
        (DEEP, 2, 28_982_624),
    ],
)
def test_the_bodies_have_as_many_parameters_as_the_reference_s(network, eyes, parameters):
    encoder = _shapes_only(PolicySpec(2, network=network, eyes=eyes))

    assert sum(p.numel() for p in encoder.parameters()) == parameters


@pytest.mark.parametrize(("values", "branch"), [(64, 82_432), (8, 68_096)])
def test_a_lidar_adds_a_branch_and_its_features_to_the_next_layer(values, branch):
    without = _shapes_only(PolicySpec(2))
    with_lidar = _shapes_only(PolicySpec(2, scan_dims=values))

    added = sum(p.numel() for p in with_lidar.parameters()) - sum(
        p.numel() for p in without.parameters()
    )

    assert added == branch + 256 * 512


@pytest.mark.parametrize("network", [SHALLOW, MIDDLE, DEEP, COMPACT])
@pytest.mark.parametrize("eyes", [1, 2])
@pytest.mark.parametrize("stack", [1, 3])
@pytest.mark.parametrize("scan_dims", [0, 64])
def test_every_body_turns_what_is_seen_into_so_many_features(network, eyes, stack, scan_dims):
    spec = PolicySpec(2, network=network, eyes=eyes, stack=stack, scan_dims=scan_dims)
    seen = Observation(
        torch.zeros((5, eyes * stack, 120, 160), dtype=torch.uint8, device="meta"),
        torch.zeros((5, scan_dims), device="meta"),
        torch.zeros((5, 0), device="meta"),
    )
    encoder = _shapes_only(spec)

    features = encoder(seen)

    assert features.shape == (5, encoder.features)


@pytest.mark.parametrize(
    "spec",
    [
        PolicySpec(2, network=SHALLOW),
        PolicySpec(2, network=DEEP, stack=2),
        PolicySpec(2, network=COMPACT, eyes=2, scan_dims=8),
    ],
)
def test_a_body_equals_the_same_layers_written_plainly_on_pixels_from_0_to_1(spec):
    torch.manual_seed(0)
    encoder = Encoder(spec)
    seen = _random(spec, steps=3)

    features = encoder(seen)

    torch.testing.assert_close(features, _plainly(encoder, seen), rtol=1e-4, atol=1e-5)


def test_kernels_are_glorot_uniform_and_biases_zero():
    encoder = Encoder(PolicySpec(2, network=COMPACT))
    kernel = encoder.convolutions[1].weight
    bound = math.sqrt(6.0 / ((16 + 32) * 4 * 4))

    largest = kernel.abs().max().item()

    assert 0.99 * bound < largest <= bound
    assert all(not p.any() for name, p in encoder.named_parameters() if name.endswith("bias"))


def test_the_lidar_s_features_come_after_the_camera_s():
    spec = PolicySpec(2, network=COMPACT, scan_dims=8)
    encoder = Encoder(spec)
    seen = _random(spec, steps=1)
    with torch.no_grad():
        encoder.dense[0].weight[:, -256:] = 0.0

    before, after = encoder(seen), encoder(seen._replace(scan=seen.scan + 1.0))

    assert torch.equal(before, after)


def test_the_compact_body_needs_less_than_a_fifth_of_the_shallow_one_s_arithmetic():
    flops = []
    for name in (SHALLOW, COMPACT):
        with torch.device("meta"), FlopCounterMode(display=False) as counter:
            seen = camera_only(torch.empty((1, 1, 120, 160), dtype=torch.uint8))
            Encoder(PolicySpec(2, network=name))(seen).sum().backward()
        flops.append(counter.get_total_flops())

    assert flops[1] < flops[0] / 5


def test_checkpoints_from_before_there_were_several_bodies_still_load():
    torch.manual_seed(0)
    encoder, other = Encoder(PolicySpec(2)), Encoder(PolicySpec(2))
    now = encoder.state_dict()
    old = {
        f"{name}.{kind}": now[f"{present}.{kind}"]
        for name, present in [
            ("conv1", "convolutions.0"),
            ("conv2", "convolutions.1"),
            ("conv3", "convolutions.2"),
            ("dense", "dense.0"),
        ]
        for kind in ("weight", "bias")
    }

    other.load_state_dict(old)

    seen = camera_only(torch.full((1, 1, 120, 160), 99, dtype=torch.uint8))
    assert torch.equal(encoder(seen), other(seen))


def _shapes_only(spec: PolicySpec) -> Encoder:
    with torch.device("meta"):
        return Encoder(spec)


def _random(spec: PolicySpec, steps: int) -> Observation:
    draw = torch.Generator().manual_seed(1)
    return Observation(
        torch.randint(0, 256, (steps, spec.channels, 120, 160), dtype=torch.uint8, generator=draw),
        torch.rand((steps, spec.scan_dims), generator=draw),
        torch.empty((steps, 0)),
    )


def _plainly(encoder: Encoder, seen: Observation) -> torch.Tensor:
    """The body layer by layer, dense layers on pixels as convolutions with a 1x1 kernel."""
    x = seen.frames.float() / 255.0
    for layer in encoder.convolutions:
        x = functional.conv2d(x, layer.weight, layer.bias, layer.stride).relu()
    for layer in encoder.per_pixel:
        x = functional.conv2d(x, layer.weight[:, :, None, None], layer.bias).relu()
    x = nn.Flatten()(x.movedim(1, 3))
    scan = seen.scan
    for layer in encoder.lidar:
        scan = layer(scan).relu()
    x = torch.cat([x, scan], dim=1)
    for layer in encoder.dense:
        x = layer(x).relu()
    return x


@pytest.mark.parametrize(("kernel", "stride"), [(8, 4), (5, 2), (3, 1), (8, 8), (2, 4)])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_a_convolution_of_blocks_is_the_convolution_of_the_picture(kernel, stride, channels):
    torch.manual_seed(1)
    frames = torch.randint(0, 256, (2, channels, 120, 160), dtype=torch.uint8)
    weight = torch.randn(4, channels, kernel, kernel, dtype=torch.float64)

    cut = in_blocks(frames, stride)
    count, _, height, width, _ = cut.shape
    pixels = cut.permute(0, 1, 4, 2, 3).reshape(count, -1, height, width).double()
    found = functional.conv2d(pixels, kernel_in_blocks(weight, stride))

    torch.testing.assert_close(found, functional.conv2d(frames.double(), weight, stride=stride))


@pytest.mark.parametrize("network", [SHALLOW, DEEP, COMPACT])
@pytest.mark.parametrize(("eyes", "stack"), [(1, 1), (1, 3), (2, 1)])
@pytest.mark.parametrize("scan_dims", [0, 8])
def test_a_body_in_bfloat16_sees_the_same_cut_or_not(network, eyes, stack, scan_dims):
    torch.manual_seed(1)
    spec = PolicySpec(2, network=network, eyes=eyes, stack=stack, scan_dims=scan_dims)
    encoder = Encoder(spec)
    frames = torch.randint(0, 256, (2, eyes * stack, 120, 160), dtype=torch.uint8)
    seen = Observation(frames, torch.rand(2, scan_dims), torch.zeros(2, 0))
    with torch.no_grad():
        exact = encoder(seen)
        encoder.to(torch.bfloat16)
        found = encoder(seen)
        cut = in_blocks(frames, encoder.block) if encoder.block > 1 else frames
        again = encoder(seen._replace(frames=cut))

    assert torch.equal(found, again)
    torch.testing.assert_close(found.float(), exact, rtol=0.05, atol=0.02 * exact.max().item())


def test_a_format_is_left_again_when_weights_are_loaded():
    torch.manual_seed(1)
    model = nn.Sequential(Encoder(PolicySpec(2, network=COMPACT)), nn.Linear(256, 2))
    weights = {name: tensor.clone() for name, tensor in model.state_dict().items()}

    compute_in(model, torch.bfloat16)
    assert model[0].dense[0].weight.dtype is torch.bfloat16
    assert model[1].weight.dtype is torch.float32
    compute_in(model, torch.float32)
    model.load_state_dict(weights)

    assert all(torch.equal(model.state_dict()[name], weights[name]) for name in weights)
