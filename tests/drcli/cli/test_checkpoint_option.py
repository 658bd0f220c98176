"""--checkpoint on command lines: what is refused before anything is read (001-46)."""

import pytest


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("upload-model -c frist-lap", "Did you mean first-lap?"),
        ("upload-model -b -c 3", "-b and -c both choose a checkpoint"),
        ("export droa --checkpoint -1", "is neither the number of a checkpoint nor a word for one"),
        ("evaluate --checkpoint newest", "is neither the number of a checkpoint"),
        ("evaluate --checkpoint 3 --model a.pb", "--model drives a file"),
        ("evaluate --opp-checkpoint 3", "needs DR_RACE_TYPE=HEAD_TO_MODEL"),
        ("start-training --resume --checkpoint best", "--resume continues with the newest"),
        ("start-training --checkpoint best", "DR_LOCAL_S3_PRETRAINED is False"),
        ("increment-training --checkpoint x", "is neither the number of a checkpoint"),
        ("import a.pb -t m --checkpoint best-lap", "models of other systems have no milestones"),
    ],
)
def test_a_choice_that_does_not_fit_is_refused(dr, working_folder, capsys, line, said):
    (working_folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model-1\n")
    (working_folder / "system.env").write_text("")

    code = dr(*line.split())

    assert code == 2
    assert said in " ".join(capsys.readouterr().err.split())
