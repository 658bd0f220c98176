"""`dr saliency` as its caller meets it: what cannot be explained is named."""


def test_a_folder_is_not_the_prefix_of_a_model(dr, working_folder, capsys):
    assert dr("saliency", str(working_folder)) == 3

    told = " ".join(capsys.readouterr().err.split())
    assert "is not the prefix of a model" in told
    assert "--model" in told


def test_a_policy_file_that_does_not_exist_is_named(dr, working_folder, capsys):
    assert dr("saliency", "--model", "gone") == 3

    assert "gone does not exist" in capsys.readouterr().err
