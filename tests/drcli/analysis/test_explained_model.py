"""Pictures of what moves the action of a model, for the report."""

import io

from PIL import Image

from drcli.analysis.explained_model import explained_pictures
from drcli.config.loading import load_settings
from drcli.model.model_store import ModelStore
from drcli.view.saliency.saliency_options import SaliencyOptions
from memory_bucket import MemoryBucket
from small_model import put_small_model


def test_each_step_is_one_picture_with_its_maps_and_probabilities(tmp_path):
    (tmp_path / "run.env").touch()
    bucket = MemoryBucket()
    put_small_model(bucket, "model-1")
    question = SaliencyOptions(pictures=2, spacing=20, methods=["perturbation", "grad-cam"])

    pictures = explained_pictures(load_settings(tmp_path), ModelStore(bucket, "model-1"), question)

    assert len(pictures) == 2
    for picture in pictures:
        # Camera and perturbation above Grad-CAM.
        assert Image.open(io.BytesIO(picture.png)).size == (320, 240)
        assert "Step " in picture.caption
        assert "Camera, Perturbation, Grad-CAM" in picture.caption
        assert 0.0 < sum(picture.numbers.values()) <= 1.0 + 1e-6
