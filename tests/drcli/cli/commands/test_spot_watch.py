"""`dr spot watch` as its caller meets it."""


def test_a_program_without_a_name_is_a_wrong_command_line(dr, capsys):
    code = dr("spot", "watch", "")

    assert code == 2
    assert "The name of the program is empty." in capsys.readouterr().err
