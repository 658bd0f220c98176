"""Where a model is found: in our bucket, a folder, an archive; and what is refused."""

import gzip
import io
import shutil
import tarfile
import zipfile

import pytest

from drcli.analysis.model_source import find_models
from drcli.base.errors import SettingsError
from simtraces import mean_reward, put, write_model


@pytest.fixture
def in_bucket(settings):
    """Folder of the objects of our bucket."""
    folder = settings.directory / "data" / "s3" / "bucket"
    folder.mkdir(parents=True)
    return folder


def test_the_model_of_run_env_is_found_without_a_name(read, in_bucket):
    write_model(in_bucket / "team" / "model-1")

    run = read(None)

    assert (run.name, run.origin) == ("team/model-1", "s3://bucket/team/model-1")
    assert list(run.iterations["mean_reward"]) == [mean_reward(n) for n in range(5)]


@pytest.mark.parametrize("what", ["team/other", "team/other/", "s3://bucket/team/other"])
def test_a_model_of_our_bucket_is_found_by_its_prefix_or_address(read, in_bucket, what):
    write_model(in_bucket / "team" / "other")

    assert read(what).name == "team/other"


def test_a_model_inside_another_is_not_one_of_its_workers(read, in_bucket):
    write_model(in_bucket / "team", iterations=2)
    write_model(in_bucket / "team" / "1", iterations=3)

    assert len(read("team").iterations) == 2
    assert len(read("team/1").iterations) == 3


def test_a_missing_model_is_named_with_the_one_that_was_meant(read, in_bucket):
    write_model(in_bucket / "team" / "model-7")

    with pytest.raises(SettingsError, match="nothing at s3://bucket/team/modell-7") as refused:
        read("team/modell-7")

    assert "Did you mean team/model-7?" in refused.value.remedy


def test_a_folder_above_several_models_is_refused_with_their_names(read, in_bucket):
    write_model(in_bucket / "a", iterations=1)
    write_model(in_bucket / "b", iterations=1)

    with pytest.raises(SettingsError, match="contains 2 models: a, b"):
        read(in_bucket)


def test_the_parts_of_a_running_training_are_read_with_the_whole_file(read, in_bucket):
    folder = write_model(in_bucket / "team" / "model-1", evaluations=0)
    shutil.rmtree(folder / "training-simtrace")
    metrics = folder / "metrics" / "TrainingMetrics.json"
    whole = metrics.read_text()
    head, records = '{"metrics": [', whole.partition("[")[2].partition("], ")[0].split("}, ")
    end = whole[whole.index("], ") :]
    metrics.write_text(head + "}, ".join(records[:10]) + "}" + end)
    put(
        folder,
        "metrics/TrainingMetrics.json.part-000000",
        (head + "}, ".join(records) + end).encode(),
    )

    assert len(read(None).iterations) == 5


def packed(folder, path, top="model"):
    end = path.suffix.removeprefix(".")
    with tarfile.open(path, "w" if end == "tar" else f"w:{end}") as archive:
        archive.add(folder, arcname=top)
    return path


def zipped(folder, path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in folder.rglob("*"):
            archive.write(file, f"model/{file.relative_to(folder)}")
    return path


def packed_on_a_mac(folder, path):
    """What the Finder makes: beside each file another one with its attributes."""
    zipped(folder, path)
    with zipfile.ZipFile(path, "a") as archive:
        for name in archive.namelist():
            above, _, last = name.rpartition("/")
            archive.writestr(f"__MACOSX/{above}/._{last}", b"\0\5\x16\7")
    return path


@pytest.mark.parametrize(
    ("pack", "name"),
    [
        (packed, "model.tar.gz"),
        (packed, "model.tar.bz2"),
        (packed, "model.tar.xz"),
        (packed, "model.tar"),
        (zipped, "model.zip"),
        (packed_on_a_mac, "model.zip"),
    ],
)
def test_an_archive_is_read_in_memory_whatever_its_top_folder(read, tmp_path, pack, name):
    archive = pack(write_model(tmp_path / "files"), tmp_path / name)

    run = read(archive)

    assert (run.name, run.origin) == ("model", str(archive))
    assert list(run.iterations["mean_reward"]) == [mean_reward(n) for n in range(5)]


def test_what_comes_before_the_damage_of_an_archive_is_analysed(read, tmp_path):
    archive = packed(write_model(tmp_path / "files"), tmp_path / "model.tar.gz")
    data = gzip.decompress(archive.read_bytes())
    cut = gzip.compress(data[: len(data) * 3 // 4])
    archive.write_bytes(cut)

    run = read(archive)

    assert any("is truncated" in text for text in run.problems)
    assert len(run.iterations) > 0


def test_an_archive_bomb_is_refused_before_it_fills_the_memory(read, tmp_path):
    archive = tmp_path / "bomb.tar.gz"
    with tarfile.open(archive, "w:gz") as made:
        info = tarfile.TarInfo("training-simtrace/0-iteration.csv")
        info.size = 64 << 20
        made.addfile(info, io.BytesIO(bytes(info.size)))

    with pytest.raises(SettingsError, match="unpacks to more than 100 times its size"):
        read(archive)


def test_a_zip_bomb_is_refused(read, tmp_path):
    archive = tmp_path / "bomb.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("training-simtrace/0-iteration.csv", bytes(64 << 20))

    with pytest.raises(SettingsError, match="times its size"):
        read(archive)


@pytest.mark.parametrize("name", ["model.tar.gz", "model.zip"])
def test_a_file_that_is_no_archive_is_refused_by_its_name(read, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"PK\x03\x04 but no more" if name.endswith("zip") else b"no archive at all")

    with pytest.raises(SettingsError, match=name):
        read(path)


@pytest.mark.parametrize("what", ["s3://", "s3://bucket/a b", "/no/such/folder", "./nothing"])
def test_what_does_not_exist_is_refused(read, what):
    with pytest.raises(SettingsError):
        read(what)


def test_an_empty_folder_is_refused(read, tmp_path):
    (tmp_path / "empty").mkdir()

    with pytest.raises(SettingsError, match="is empty"):
        read(tmp_path / "empty")


@pytest.mark.parametrize(
    ("names", "layout", "root"),
    [
        (["training-simtrace/0-iteration.csv"], "drfc", ""),
        (["m/training-simtrace/0-iteration.csv"], "drfc", "m/"),
        (["0/training-simtrace/0-iteration.csv"], "drfc-workers", ""),
        (["m/11/training-simtrace/0-iteration.csv"], "drfc-workers", "m/"),
        (["m/sim-trace/training/training-simtrace/0-iteration.csv"], "console", "m/"),
        (
            ["m/sim-trace/training/2026-01-02T03:04:05.678Z-a/training-simtrace/0-iteration.csv"],
            "droa",
            "m/",
        ),
        (["0-iteration.csv", "1-iteration.csv"], "drfc", ""),
        (["m/model/model_metadata.json", "m/metrics/TrainingMetrics.json"], "upload", "m/"),
        (["m/metrics/evaluation/evaluation-20260102030405.json"], "upload", "m/"),
    ],
)
def test_every_layout_is_known_by_its_names(names, layout, root):
    [found] = find_models(names)

    assert (found.layout, found.root) == (layout, root)


def test_files_that_are_no_model_are_none():
    assert find_models(["a/b.csv", "x.json", "training-simtrace/readme.txt"]) == []


def console_archive(tmp_path):
    """An archive as the console made it, with a log instead of traces."""
    folder = tmp_path / "console"
    lines = [
        " * /WORLD_NAME: reinvent_base",
        "Action space from file: [{'steering_angle': -20.0, 'speed': 1.5}]",
        "Using the following hyper-parameters",
        '{\n  "num_episodes_between_training": 2,\n  "lr": 0.0003\n}',
    ]
    for number in range(4):
        for step in range(1, 5):
            status = "prepare" if step == 1 else "off_track" if step == 4 else "in_progress"
            lines.append(
                f"[agent-9] SIM_TRACE_LOG:{number},{step},3.1500,0.6834,0.0,-20.00,1.50,0,"
                f"{0.0 if step == 1 else 1.0:.4f},{step == 4},True,{step:.4f},1,17.71,"
                f"{100 * number + step / 15:.4f},{status},0.00,0,1700000000.0"
            )
    lines.append("SIM_TRACE_LOG:3,5,3.15")
    lines.append(lines[-2].replace("3.1500", "1e300"))
    put(
        folder, "logs/training/training-20260102030405-abc-robomaker.log", "\n".join(lines).encode()
    )
    return packed(folder, tmp_path / "model.tar.gz")


def trace_lines(episodes, fields=19):
    """A log with four steps of each episode."""
    lines = []
    for number in episodes:
        for step in range(1, 5):
            status = "prepare" if step == 1 else "off_track" if step == 4 else "in_progress"
            row = (
                f"{number},{step},3.1500,0.6834,0.0,-20.00,1.50,0,1.0000,{step == 4},True,"
                f"{step:.4f},1,17.71,{100 * number + step / 15:.4f},{status},0.00,0,1700000000.0"
            )
            lines.append("SIM_TRACE_LOG:" + ",".join(row.split(",")[:fields]))
    return "\n".join([*lines, ""]).encode()


def test_the_simulation_logs_of_two_starts_follow_each_other_whatever_lies_beside_them(
    read, tmp_path
):
    folder = tmp_path / "console"
    parameters = b'Using the following hyper-parameters\n{"num_episodes_between_training": 2}\n'
    for start in range(2):
        name = f"logs/training/training-2026010203040{start}-a"
        put(folder, f"{name}-robomaker.log", parameters + trace_lines(range(4)))
        put(folder, f"{name}-sagemaker.log", b"Training> Name=main_level/agent\n")

    run = read(packed(folder, tmp_path / "model.tar.gz"))

    assert list(run.iterations["episodes"]) == [2, 2, 2, 2]
    assert set(run.episodes["worker"]) == {0}


def test_logs_of_several_workers_are_told_apart_and_rolled_parts_put_together(read, tmp_path):
    folder = write_model(tmp_path / "model", iterations=0, evaluations=0)
    put(folder, "ip/hyperparameters.json", b'{"num_episodes_between_training": 4}')
    put(folder, "logs/robomaker/sim-0.log.part-000002", trace_lines(range(2, 4)))
    put(folder, "logs/robomaker/sim-0.log.part-000001", trace_lines(range(2)))
    put(folder, "logs/robomaker/sim-0.log", trace_lines(range(4, 6)))
    put(folder, "logs/robomaker/joined-away.log", trace_lines(range(2)))
    put(folder, "logs/sagemaker/trainer.log", b"nothing\n")

    run = read(folder)

    assert list(run.iterations["episodes"]) == [4, 2, 2]
    assert sorted(set(run.episodes["worker"])) == [0, 1]


@pytest.mark.parametrize(("fields", "known"), [(16, False), (17, False), (18, False), (19, True)])
def test_a_wall_clock_that_a_log_does_not_have_is_unknown(read, tmp_path, fields, known):
    log = tmp_path / "sim.log"
    log.write_bytes(trace_lines(range(4), fields))

    run = read(log)

    assert run.steps["wall_clock"].notna().all() == known
    assert run.steps["wall_clock"].isna().all() != known


def test_the_log_of_a_console_stands_in_for_missing_traces(read, tmp_path):
    run = read(console_archive(tmp_path))

    assert list(run.iterations["episodes"]) == [2, 2]
    assert list(run.iterations["mean_reward"]) == [3.0, 3.0]
    assert run.world == "reinvent_base"
    assert run.hyperparameters["lr"] == 0.0003
    assert run.actions is not None
    assert any("2 damaged lines" in text for text in run.problems)
