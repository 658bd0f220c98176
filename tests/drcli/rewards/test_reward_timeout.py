"""What is read out of the stacks of a process that was ended from outside Python."""

import faulthandler

import pytest

from drcli.rewards.source import stuck_place

CALLING = """
def reward_function(dump):
    dump()
"""


@pytest.mark.parametrize("folder", ["plain", "Müllers Wagen", "赛道 🏎"])
def test_the_line_of_the_reward_function_is_found_in_folders_of_any_name(tmp_path, folder):
    file = tmp_path / folder / "reward_function.py"
    file.parent.mkdir()
    file.write_text(CALLING)
    names: dict = {}
    exec(compile(CALLING, str(file), "exec"), names)
    with (tmp_path / "log").open("w+") as log:
        names["reward_function"](lambda: faulthandler.dump_traceback(log))
        log.seek(0)
        text = log.read()

    assert stuck_place(text) == (file, 3)
