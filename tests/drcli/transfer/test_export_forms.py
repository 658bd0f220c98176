"""Policies as single files: which checkpoint, where, and never half of one."""

import json

import pytest
from safetensors.torch import save

from drcli.base.errors import NotAvailable, SettingsError
from drcli.convert.policy_file import read_policy_file
from drcli.convert.runtimes import policy_of_file
from drcli.transfer.export_forms import Comparison, compare, export_form, plan_form, sample_inputs
from drcli.transfer.export_model import Selection
from small_policies import metadata_json, small_metadata, small_network


@pytest.fixture
def network():
    return small_network(small_metadata())


@pytest.fixture
def exporter(racer, network, monkeypatch):
    """Exports model-1, whose two checkpoints have the weights of that network."""
    racer.model_metadata(**json.loads(metadata_json()))
    racer.start()
    tensors = save({name: t.contiguous() for name, t in network.state_dict().items()})
    for number in range(2):
        racer.store("model-1").save(number, number, tensors, optimizer=b"")
    monkeypatch.setattr("drcli.transfer.export_model.open_bucket", lambda *_, **__: racer.bucket)
    monkeypatch.chdir(racer.folder)

    def export(form, out=None, *, choice="last", **options):
        return export_form(plan_form(racer.settings(), Selection(choice), form, out, **options))

    return export


@pytest.mark.parametrize("form", ["pb", "onnx", "openvino"])
def test_an_exported_file_drives_like_the_network(exporter, network, racer, form):
    pytest.importorskip({"pb": "numpy", "onnx": "onnxruntime"}.get(form, form))

    report = exporter(form)

    assert report.checkpoint == "1_Step-1.ckpt"
    assert report.file == f"model-1-chk1.{'xml' if form == 'openvino' else form}"
    assert report.same_actions == 1.0
    assert report.greatest_difference < 1e-4
    assert report.size_bytes == sum((racer.folder / f).stat().st_size for f in report.files)
    policy = policy_of_file(read_policy_file(racer.folder / report.file))
    found = compare(network, policy, *sample_inputs(network.spec, 5, seed=9))
    assert found.greatest_difference < 1e-4


def test_two_forms_share_the_metadata_and_other_files_are_kept(exporter, racer):
    exporter("pb", choice=0)
    pytest.importorskip("onnxruntime")
    exporter("onnx", choice=0)

    with pytest.raises(SettingsError, match=r"model-1-chk0\.pb exists already"):
        exporter("pb", choice=0)
    exporter("pb", choice=0, force=True)
    (racer.folder / "other.model_metadata.json").write_text("{}")
    with pytest.raises(SettingsError, match=r"other\.m.* exists already"):
        exporter("pb", racer.folder / "other.pb")


def test_a_file_of_another_ending_is_refused(exporter, racer):
    with pytest.raises(SettingsError, match=r"--out model\.pb does not end in \.onnx"):
        plan_form(
            racer.settings(),
            Selection(),
            "onnx",
            (racer.folder / "model.pb").relative_to(racer.folder),
        )


def test_a_file_that_gives_other_actions_is_not_written(exporter, racer, monkeypatch):
    before = sorted(racer.folder.iterdir())
    wrong = Comparison(32, 0.5, 0.3)
    monkeypatch.setattr("drcli.transfer.export_forms.compare", lambda *_: wrong)

    with pytest.raises(SettingsError, match=r"other actions than PyTorch: they differ by 0\.3"):
        exporter("pb")

    assert sorted(racer.folder.iterdir()) == before


@pytest.mark.parametrize(
    ("form", "install"),
    [
        ("onnx", 'pip install "drcli[onnx]"'),
        ("openvino", 'pip install "drcli[openvino]"'),
        ("tflite", "pip install tensorflow-cpu"),
    ],
)
def test_a_missing_converter_is_named_before_anything_is_read(
    exporter, racer, monkeypatch, form, install
):
    monkeypatch.setattr("drcli.base.installation.is_installed", lambda name: False)

    with pytest.raises(NotAvailable) as caught:
        plan_form(racer.settings(), Selection(), form, None)

    assert install in caught.value.remedy
