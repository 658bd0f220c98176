"""What is checked before an evaluation starts."""

import pytest

from drcli.base.errors import SettingsError
from drcli.runs.evaluation_plan import prepare_evaluation


@pytest.mark.parametrize("world", ["nowhere", "Oval_track"])
def test_a_track_that_is_not_installed_is_refused_before_anything_is_said(
    trained, monkeypatch, world
):
    monkeypatch.setattr("drcli.runs.evaluation_plan.open_bucket", lambda *_, **__: trained.bucket)
    trained.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", f"DR_WORLD_NAME={world}")
    said: list[str] = []

    with pytest.raises(SettingsError, match=f"DR_WORLD_NAME={world} is"):
        prepare_evaluation(trained.settings(), on_progress=said.append)

    assert said == []
