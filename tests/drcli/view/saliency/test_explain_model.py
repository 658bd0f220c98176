"""Episodes of an untrained policy, explained and written down."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from drcli.base.errors import SettingsError
from drcli.config.loading import load_settings
from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.model.model_store import ModelStore
from drcli.view.saliency import explain_model
from drcli.view.saliency import explain_model as saliency_page
from drcli.view.saliency.explained_episode import explain_episode
from drcli.view.saliency.explanation_pictures import decision, lidar_finding, still
from drcli.view.saliency.maps import ExplainedPolicy, saliency_maps
from drcli.view.saliency.saliency_options import SaliencyOptions
from memory_bucket import MemoryBucket
from reference_model import LAST, reference_model
from small_model import put_small_model
from small_policies import metadata_json, small_metadata, small_network

QUICK = SaliencyOptions(pictures=3, spacing=20)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A working folder, and a bucket with the untrained models "model-1" and "smooth"."""
    folder = tmp_path_factory.mktemp("racer")
    (folder / "system.env").write_text("")
    (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model-1\n")
    bucket = MemoryBucket()
    put_small_model(bucket, "model-1")
    put_small_model(bucket, "smooth", **json.loads(metadata_json("sac")))
    for name, data in reference_model().items():
        bucket.put(f"theirs/{name}", data)
    return folder, bucket


def explain(home, question=QUICK, prefix="model-1", **settings):
    folder, bucket = home
    loaded = load_settings(folder, flags=settings)
    return explain_model.explain_checkpoint(loaded, ModelStore(bucket, prefix), "last", question)


@pytest.fixture(scope="module")
def answer(home):
    """An explained episode, and the name of its checkpoint."""
    return explain(home)


def test_an_episode_ends_with_the_picture_before_its_end(answer):
    explained, name = answer

    episode = explained.episode
    assert name == "5_Step-500.ckpt"
    assert episode.outcome in ("Off track", "Lap complete")
    assert len(episode.frames) == len(episode.rows) == explained.outputs.steering_deg.size
    assert explained.chosen[0] == 0
    assert explained.chosen[-1] == episode.steps - 1
    assert episode.last.steps == episode.rows[-1].steps + 1


def test_a_checkpoint_of_the_reference_is_explained_from_its_weights(home):
    explained, name = explain(home, prefix="theirs")

    assert name == LAST
    assert explained.episode.rows


@pytest.mark.parametrize("prefix", ["model-1", "smooth"])
def test_the_page_needs_no_network_and_runs_no_script(answer, home, tmp_path, prefix):
    explained, _ = answer if prefix == "model-1" else explain(home, prefix=prefix)
    odd = explain_model.ExplainedEpisode(
        "<script>alert(1)</script>", *list(vars(explained).values())[1:]
    )
    page = tmp_path / "page.html"

    explain_model.write_page(page, odd)

    text = page.read_text("utf-8")
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert "default-src 'none'" in text
    assert not re.search(r'(?:src|href)="(?!data:)', text)
    assert text.count("<img ") == 3 * 4
    assert not list(tmp_path.glob("*.tmp"))


def test_the_report_tells_what_was_found_and_where_it_was_written(answer, tmp_path):
    explained, name = answer
    stills = explain_model.write_stills(tmp_path / "a" / "b", explained)

    report = explain_model.report_of(explained, "model-1", name, None, stills)

    json.dumps(vars(report), default=vars, allow_nan=False)
    assert [step.picture for step in report.steps] == stills
    with Image.open(stills[0]) as picture:
        assert picture.width > 4 * 480
    for step in report.steps:
        assert sum(map(sum, step.ninths["perturbation"])) == pytest.approx(1.0, abs=1e-3)
    assert len(report.lap["probabilities"]) == explained.episode.steps
    assert np.allclose(np.sum(report.lap["probabilities"], axis=1), 1.0, atol=1e-3)
    assert len(report.lap["value"]) == explained.episode.steps


def test_steps_are_counted_as_in_a_trace(home, answer):
    last = answer[0].episode.rows[-1].steps

    explained, _ = explain(home, SaliencyOptions(steps=[2, 1, 2], methods=["hires-cam"]))

    assert [explained.episode.rows[step].steps for step in explained.chosen] == [1, 2]
    with pytest.raises(SettingsError, match=rf"no step {last + 1}: Off track after step {last}"):
        explain(home, SaliencyOptions(steps=[last + 1], methods=["hires-cam"]))


def test_a_frozen_graph_has_maps_but_no_critic(home, tmp_path):
    folder, _ = home
    metadata = small_metadata()
    network = small_network(metadata)
    path = tmp_path / "policy.pb"
    path.write_bytes(encode_policy(weights_of(network), network.spec, metadata.sensor))
    (tmp_path / "model_metadata.json").write_bytes(metadata_json())
    settings = load_settings(folder)

    explained = explain_model.explain_file(settings, path, None, QUICK)

    assert set(explained.saliency.maps) == {"perturbation", "hires-cam", "grad-cam"}
    assert explained.outputs.value is None
    assert any("no critic" in note for note in explained.notes)
    ours = saliency_maps(
        ExplainedPolicy(network, metadata),
        explained.episode.frames[list(explained.chosen)],
        methods=["hires-cam"],
    )
    np.testing.assert_allclose(
        explained.saliency.maps["hires-cam"], ours.maps["hires-cam"], atol=1e-4
    )
    with pytest.raises(SettingsError, match=r"policy\.pb cannot be explained"):
        explain_model.explain_file(settings, path, None, SaliencyOptions(target="value"))


def test_a_model_drives_alone_in_a_race_between_two(home):
    question = SaliencyOptions(pictures=1, methods=["hires-cam"])

    explained, _ = explain(home, question, DR_RACE_TYPE="HEAD_TO_MODEL")

    assert explained.notes == (
        "The model drives alone here, although DR_RACE_TYPE is HEAD_TO_MODEL.",
    )


def test_a_lidar_gets_a_sentence_in_the_page_and_in_the_pictures(answer):
    explained, _ = answer
    metadata = replace(explained.subject.metadata, sensor=("FRONT_FACING_CAMERA", "SECTOR_LIDAR"))
    subject = ExplainedPolicy(explained.subject.policy, metadata)
    lidar = np.zeros((3, 8), np.float32)
    lidar[1, 3], lidar[2, 3] = 0.25, 0.0001
    found = replace(explained, subject=subject, saliency=replace(explained.saliency, lidar=lidar))

    sentences = [lidar_finding(found, number) for number in range(3)]

    assert sentences[0] == "Lidar: it meets nothing, or what it meets does not matter here."
    assert sentences[1].startswith("Lidar: the sector from ")
    assert "25.0% of the probability would change." in sentences[1]
    assert "less than 0.1% of the probability" in sentences[2]
    assert sentences[1] in saliency_page.section(found)
    assert still(found, 1).shape[0] > still(explained, 1).shape[0]
    assert lidar_finding(explained, 0) == ""


def test_a_lidar_without_its_map_is_mentioned(answer):
    explained, _ = answer
    metadata = small_metadata(sensor=["FRONT_FACING_CAMERA", "SECTOR_LIDAR"])
    subject = ExplainedPolicy(small_network(metadata), metadata)
    episode = replace(explained.episode, scans=np.zeros((explained.episode.steps, 8), np.float32))

    found = explain_episode("m", subject, episode, [0], methods=["hires-cam"])

    assert "Only --method perturbation explains what the lidar contributes." in found.notes


def test_a_critic_that_expects_nothing_has_no_minus_sign(answer):
    explained, _ = answer
    nothing = replace(explained.outputs, value=np.full(explained.episode.steps, -0.0))

    text = decision(replace(explained, outputs=nothing), 0)

    assert text.endswith("The critic expects 0.")
