"""The logs of a supervisor, before and after it fails."""

import json

import pytest

from drcli.base.errors import StorageError
from drcli.records.run_record import json_log, log_file
from drcli.run import training
from unwatched import job_of


@pytest.mark.parametrize("wanted", [True, False])
def test_a_supervisor_writes_json_lines_if_the_racer_wants_them(tmp_path, monkeypatch, wanted):
    def fail(job):
        raise StorageError("Nothing answers.", remedy="Wait.")

    monkeypatch.setattr(training, "_supervise", fail)
    (tmp_path / "system.env").write_text(f"DR_LOG_JSON={wanted}\n")
    job = job_of(tmp_path)

    with pytest.raises(StorageError):
        training.supervise_job(job)

    path = log_file(tmp_path, "team/model", "supervisor")
    assert "ERROR Nothing answers. Wait." in path.read_text()
    assert json_log(path).exists() == wanted
    if wanted:
        [record] = [json.loads(line) for line in json_log(path).read_text().splitlines()]
        assert (record["process"], record["message"]) == ("supervisor", "Nothing answers. Wait.")
