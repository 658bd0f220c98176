"""What people see, compared with recorded screens of 80 columns and 24 rows."""

import io
import math
from dataclasses import replace

import pytest
from rich.console import Console

from drcli.base.json_record import plain
from drcli.cli import training_display
from drcli.cli.show import drawn
from drcli.model.model_list import CheckpointEntry, ModelEntry, ModelList
from drcli.records.iteration import Laps
from drcli.records.stage import PHASES, PhaseMark, StageMark
from drcli.records.training_record import DayBudget
from drcli.run.status import CheckpointLaps, JoinedReport, PhaseReport

NOW_S = 1_000_000.0 + 75.0
ROWS = 24


def screen(rendered):
    """The plain text of a terminal of the usual size."""
    page = io.StringIO()
    console = Console(file=page, width=80, height=24, color_system=None, legacy_windows=False)
    console.print(rendered)
    return "\n".join(line.rstrip() for line in page.getvalue().splitlines())


def test_what_the_racer_typed_is_no_style():
    nothing = ModelList("bucket", "[/]", [])

    assert screen(drawn(nothing)) == ("There is no model in s3://bucket that matches [/].")


def test_a_checkpoint_is_told_in_fewer_words_in_the_list_than_on_the_page():
    best = CheckpointEntry("8_Step-4000.ckpt", 1.0, "7.61 s", str(Laps(20, [7.5, 7.72])), 2)
    model = ModelEntry("m1", 9, best, None, 1, 1, "2026-01-02T03:04:05", False)

    shown = screen(drawn(ModelList("bucket", "", [model])))

    assert best.text == "8: 2 of 20 laps clean, median 7.61 s, slowest 7.72 s"
    assert "8 (2 of 20 laps clean, median 7.61 s)" in " ".join(shown.split())
    assert plain(model)["best"]["text"] == best.text  # for the page


def test_the_live_display_of_a_training_under_way(make_report):
    shown = screen(training_display.live(make_report("running", 9), NOW_S, ROWS))

    assert shown == UNDER_WAY


def test_a_training_with_stages_and_a_second_track_shows_both(make_report, make_record):
    marked = {"stage": "base", "second_world": "willow", "second_progress": [50.0, 100.0]}
    history = [make_record(0), make_record(1, **marked, second_lap_s=[14.0])]
    stage = StageMark("base", 2, 3, "willow", "after 9 iterations", iteration=1)
    budget = DayBudget("2026-05-01", 3.2, 0.0, 8.0)
    report = make_report("running", history=history, stage=stage, budget=budget)

    shown = screen(training_display.run(report))

    assert "on reinvent_base  stage 2 of 3 (base)" in shown
    assert "Stage 2 of 3: base, on willow, 1 iteration so far; it ends after 9" in shown
    assert "On willow, checkpoint 1 drove 75 % 1/2 clean 14.00 s." in shown
    assert "Budget of 2026-05-01: 3.20 of 8 hours." in shown
    line = training_display.line(history[1])
    assert line.endswith("on willow 75 % 1/2 clean 14.00 s  stage base")
    assert "stage" not in screen(training_display.table(history[:1], 1, 200))


def test_workers_of_other_machines_have_a_line_with_their_part(make_report):
    joined = [
        JoinedReport("sim-1", "attic", "drives iteration 9", alive=True, episodes=4),
        JoinedReport("sim-2", "cellar", "drives iteration 4", alive=False, episodes=0),
    ]
    report = replace(make_report("running", 9), joined=joined)

    page = screen(training_display.run(report))
    assert "  sim-1 on attic: drives iteration 9 (4 episodes)" in page
    assert "  sim-2 on cellar: drives iteration 4 (no episodes now, silent)" in page
    assert "2 joined   trainer waits" in screen(training_display.live(report, NOW_S, ROWS))
    assert "sim-2 on cellar" in screen(training_display.live(report, NOW_S, ROWS, verbose=True))


def test_the_live_display_before_the_first_iteration(make_report):
    shown = screen(training_display.live(make_report("running"), NOW_S, ROWS))

    assert shown == BEFORE_THE_FIRST


def test_the_verbose_display_has_a_line_for_each_worker_and_for_the_time(make_report):
    lines = screen(
        training_display.live(make_report("running", 9), NOW_S, ROWS, verbose=True)
    ).splitlines()

    assert lines[2:5] == [
        "trainer: waits for rollouts of iteration 9",
        "sim-0: drives iteration 9",
        "iteration 8 took: drive 0.6 s  learn 0.7 s  exchange 0.1 s   KL 0.0021",
    ]


@pytest.mark.parametrize("verbose", [False, True])
def test_the_height_of_the_live_display_never_changes(make_report, verbose):
    looks = [
        make_report("starting"),
        make_report("running", 1),
        make_report("running", 300, prefix="a-model-with-a-name-" * 5),
        make_report("finished", 300),
    ]

    screens = [screen(training_display.live(look, NOW_S, ROWS, verbose=verbose)) for look in looks]

    assert {len(shown.split("\n")) for shown in screens} == {ROWS - 1}
    assert max(len(line) for shown in screens for line in shown.split("\n")) <= 80


@pytest.mark.parametrize(("rows", "iterations"), [(16, 5), (24, 10), (40, 17)])
def test_the_live_display_fills_the_window_with_iterations_and_curves(
    make_report, make_record, rows, iterations
):
    history = [make_record(n, best_lap_s=14.25) for n in range(60)]

    shown = screen(training_display.live(make_report("running", history=history), NOW_S, rows))

    lines = shown.splitlines()
    assert sum("14.25 s" in line and "best" not in line for line in lines) == iterations
    assert any(line.startswith("lap ") and line.endswith("best 14.25 s") for line in lines)
    assert len(lines) == rows - 1


def test_the_display_of_a_training_elsewhere_names_its_machine(make_report):
    report = make_report("running", 3, pid=None)
    report = replace(report, workers=[replace(w, host="attic", pid=None) for w in report.workers])

    shown = screen(training_display.live(report, NOW_S, ROWS))

    assert shown.endswith("Ctrl-C leaves this display; the training runs on attic.")
    assert "  sim-0 on attic: drives" in screen(training_display.run(report))


def test_a_display_that_has_ended_no_longer_speaks_of_ctrl_c(make_report):
    shown = screen(training_display.live(make_report("finished", 9), NOW_S, ROWS))

    assert "Ctrl-C" not in shown
    assert shown.startswith("finished")


def test_status_of_a_training_under_way(make_report):
    shown = screen(training_display.run(make_report("running", 9)))

    assert shown == STATUS


def test_status_of_an_ended_training_tells_why_and_leaves_the_workers_out(make_report):
    lines = screen(training_display.run(make_report("finished", 9))).splitlines()

    assert lines[0] == "Run 0: finished  s3://bucket/model  on reinvent_base"
    assert lines[1] == "All 3 evaluation laps are complete."
    assert not any("sim-0" in line for line in lines)


@pytest.mark.parametrize(
    ("score", "laps", "said"),
    [
        ("7.61 s", Laps(20, [7.5, 7.72]), "best 8: 2 of 20 laps clean, median 7.61 s, slowest"),
        ("34.2 %", Laps(5, []), "best 8 (34.2 %): 0 of 5 laps clean   last 9"),
        ("reward 99.1", Laps(1, [7.5]), "best 8 (reward 99.1): 1 of 1 lap clean, 7.50 s   last 9"),
        ("7.61 s", None, "best 8 (7.61 s)   last 9"),
    ],
)
def test_every_number_of_the_best_checkpoint_has_its_unit(make_report, score, laps, said):
    told = ("", 0) if laps is None else (str(laps), laps.clean)
    report = make_report("finished", 9, best=CheckpointEntry("8_Step-4000.ckpt", 1.0, score, *told))

    assert said in screen(training_display.live(report, NOW_S, ROWS))
    assert said.partition("   last")[0] in screen(training_display.run(report))
    assert said.partition("   last")[0].removeprefix("best ") in report.end_text()


def test_what_comes_next_depends_on_whether_a_lap_is_clean(make_report):
    def commands(state="finished", *lap_s):
        laps = CheckpointLaps.of(8, Laps(20, lap_s))
        report = make_report(state, 9, best_laps=laps)
        return [command for command, _ in training_display.next_commands(report)]

    assert commands("finished", 7.6)[0] == "dr-evaluate --checkpoint best --laps 40"
    assert commands("stopped", 7.6)[-1] == "dr-export car --best"
    assert commands()[0] == "dr-analyze"
    assert commands()[-1] == "dr-start-training --resume"
    assert commands("failed", 7.6) == []
    assert "dr-video --checkpoint best" in commands()
    unknown = make_report("finished", 2, best_laps=None)
    offered = [command for command, _ in training_display.next_commands(unknown)]
    assert "dr-video --checkpoint last" in offered  # the best one is the untrained one yet


def test_status_of_a_failed_training_tells_what_to_do(make_report):
    report = make_report("failed", 1, message="The loss is NaN.", remedy="Lower lr.", exit_code=6)

    lines = screen(training_display.run(report)).splitlines()

    assert lines[1:3] == ["The loss is NaN.", "  Try: Lower lr."]


def test_a_dead_worker_catches_the_eye(make_report):
    report = make_report("running")
    dead = report.workers[1].__class__("sim-0", 7, False, 2, "drives iteration 0", "x.log")

    shown = screen(training_display.run(make_report("running", workers=[dead])))

    assert "sim-0 (DEAD, process 7, restarted 2 x): drives iteration 0" in shown


def test_an_evaluation_is_a_table_and_a_sentence(evaluation_report):
    shown = screen(drawn(evaluation_report))

    assert shown == EVALUATION


def test_an_evaluation_without_a_lap_names_no_best_one(evaluation_report):
    lost = replace(
        evaluation_report, checkpoint="1_Step-9.ckpt", trials=evaluation_report.trials[2:]
    )

    assert "0 of 1 lap clean; checkpoint 1_Step-9.ckpt" in screen(drawn(lost))


def test_an_iteration_fits_a_line_of_80_columns(make_record):
    laps = {"evaluation_progress": [100.0] * 20, "evaluation_lap_s": [14.5] * 20}

    line = training_display.line(make_record(8, **laps))

    assert line == (
        "   0:12 iter   8  reward   42.0  progress  34 %  eval 100 % 20/20 clean 14.50 s"
    )
    assert len(line) <= 80


def test_an_iteration_without_its_evaluation_says_so(make_record):
    line = training_display.line(make_record(8, evaluation_progress=[], evaluation_lap_s=[]))

    assert line.endswith("eval ...")


def test_a_sac_training_shows_its_own_losses_and_no_divergence(make_record):
    unknown = dict.fromkeys(("surrogate_loss", "value_loss", "kl"), math.nan)
    record = make_record(8, **unknown, actor_loss=-1.5, critic_loss=0.25, alpha=0.2)

    line = training_display.line(record, verbose=True)

    assert "actor loss -1.5000  critic loss 0.2500  alpha 0.2000" in line
    assert "KL" not in line
    assert "nan" not in line


def test_what_is_unknown_before_anything_is_learned_is_a_dash(make_record):
    unknown = dict.fromkeys(("entropy", "surrogate_loss", "value_loss", "kl"), math.nan)

    line = training_display.line(make_record(0, **unknown), verbose=True)

    assert "entropy -  policy loss -  value loss -  KL -  " in line


UNDER_WAY = """\
running  s3://bucket/model  on reinvent_base
1:15   iteration 9   4,500 steps   370 steps/s   25 x real time
trainer waits for rollouts of iteration 9   sim-0 drives iteration 9
iter      steps   reward  progress    laps      lap       eval   median  entropy
   0        500     10.0    10.0 %    0/20            40 % 0/3              2.50
   1      1,000     14.0    13.0 %    1/20  14.25 s   40 % 0/3              2.45
   2      1,500     18.0    16.0 %    2/20  14.25 s   40 % 0/3              2.40
   3      2,000     22.0    19.0 %    3/20  14.25 s   40 % 0/3              2.35
   4      2,500     26.0    22.0 %    4/20  14.25 s   40 % 0/3              2.30
   5      3,000     30.0    25.0 %    5/20  14.25 s   40 % 0/3              2.25
   6      3,500     34.0    28.0 %    6/20  14.25 s   60 % 1/3  14.50 s     2.20
   7      4,000     38.0    31.0 %    7/20  14.25 s   80 % 2/3  14.50 s     2.15
   8      4,500     42.0    34.0 %    8/20  14.25 s        ...              2.10

progress                                                         34.0 %
         ▃▃▃▄▄▅▅▆▆
eval     ······◦◦                                                2 of 3 clean
reward      ▁▂▄▅▇█                                               42.0
         ▅▆▇██████
lap       ████████                                               best 14.25 s
          ████████
best 8: 18 of 20 laps clean, median 14.85 s, slowest 15.70 s   last 9
Ctrl-C leaves this display; dr-stop-training stops the training."""

BEFORE_THE_FIRST = """\
running  s3://bucket/model  on reinvent_base
1:15   driving the first iteration
trainer waits for rollouts of iteration 0   sim-0 drives iteration 0
iter      steps   reward  progress    laps      lap       eval   median  entropy










progress

eval
reward

lap

No checkpoint yet.
Ctrl-C leaves this display; dr-stop-training stops the training."""

STATUS = """\
Run 0: running  s3://bucket/model  on reinvent_base
  trainer (alive, process 4243): waits for rollouts of iteration 9
  sim-0 (alive, process 4243): drives iteration 9
iter      steps   reward  progress    laps      lap       eval   median  entropy
   0        500     10.0    10.0 %    0/20            40 % 0/3              2.50
   1      1,000     14.0    13.0 %    1/20  14.25 s   40 % 0/3              2.45
   2      1,500     18.0    16.0 %    2/20  14.25 s   40 % 0/3              2.40
   3      2,000     22.0    19.0 %    3/20  14.25 s   40 % 0/3              2.35
   4      2,500     26.0    22.0 %    4/20  14.25 s   40 % 0/3              2.30
   5      3,000     30.0    25.0 %    5/20  14.25 s   40 % 0/3              2.25
   6      3,500     34.0    28.0 %    6/20  14.25 s   60 % 1/3  14.50 s     2.20
   7      4,000     38.0    31.0 %    7/20  14.25 s   80 % 2/3  14.50 s     2.15
   8      4,500     42.0    34.0 %    8/20  14.25 s        ...              2.10
progress ▂▂▂▂▃▃▃▃▃                                               34.0 %
eval     ······◦◦                                                2 of 3 clean
reward   ▃▃▄▅▅▆▇▇█                                               42.0
lap       ████████                                               best 14.25 s
4,500 steps in 0:12, 370 steps/s, 25 x real time.
36 of 180 training episodes completed a lap.
newest evaluation 7: 9 of 20 laps clean, median 14.40 s, slowest 14.80 s
best 8: 18 of 20 laps clean, median 14.85 s, slowest 15.70 s   last 9"""

EVALUATION = """\
trial  progress  lap time  ended      off track  resets
    1     100 %   13.42 s  clean lap          0       0
    2     100 %   15.00 s  finished           1       1
    3      37 %    6.20 s  Off track          1       0
1 of 3 laps clean (1 reset), 2 finished, best 13.42 s; checkpoint
8_Step-4000.ckpt of model on reinvent_base."""


def test_a_race_against_a_model_shows_both_and_names_the_winner(evaluation_report):
    own = replace(evaluation_report, trials=evaluation_report.trials[:2])
    slower = [replace(trial, lap_s=trial.lap_s + 1.0) for trial in own.trials]
    race = replace(own, opponent=replace(own, prefix="rival", trials=slower))

    shown = screen(drawn(race))

    assert "8_Step-4000.ckpt of rival on" in shown
    assert shown.splitlines()[-1] == "model wins, 2.00 s ahead of rival."


def test_more_laps_win_against_a_faster_time(evaluation_report):
    race = replace(
        evaluation_report,
        opponent=replace(evaluation_report, prefix="rival", trials=evaluation_report.trials[:1]),
    )

    assert screen(drawn(race)).splitlines()[-1] == "model wins with more finished laps."


def test_nobody_wins_a_race_that_nobody_finished(evaluation_report):
    lost = replace(
        evaluation_report,
        trials=[replace(trial, status="Off track") for trial in evaluation_report.trials],
    )

    assert "Nobody wins." in screen(drawn(replace(lost, opponent=lost)))


def test_a_collapse_is_told_in_every_display(make_report):
    told = "Warning: completion fell from 98 % to 41 %; best is 37"
    collapsed = make_report("running", 9, warning=told.removeprefix("Warning: "))

    assert told in screen(training_display.run(collapsed))
    assert told in screen(training_display.live(collapsed, NOW_S, ROWS))


@pytest.mark.parametrize("columns", [1, 10, 24, 40])
def test_curves_are_drawn_in_any_window(make_record, columns):
    drawn = training_display.curves([make_record(1), make_record(2)], columns, 54)

    assert [line.plain.split()[0] for line in drawn] == ["progress", "eval", "reward", "lap"]


def test_the_phase_of_a_training_with_a_teacher_fits_into_one_line(make_report, make_record):
    laps = {"full_laps": 64, "episodes": 64, "best_lap_s": 15.87}
    history = [make_record(n, phase="teacher", evaluation_progress=[], **laps) for n in range(3)]
    phase = PhaseReport.of(PhaseMark("teacher"), history)
    best = CheckpointEntry("0_Step-0.ckpt", None)
    report = replace(
        make_report("stopped", history=history), phase=phase, best=best, last=best, best_laps=None
    )

    lines = screen(training_display.live(report, NOW_S, ROWS)).splitlines()

    assert "Phase 1 of 3, teacher (sees the track, no camera): 64 of 64 laps, best 15.87 s" in lines
    assert len(lines) <= 24
    assert not any(line.endswith("…") for line in lines)
    assert lines[-1].endswith("checkpoints are evaluated from the next phase on")
    assert training_display.line(history[0]).endswith("eval -  phase teacher")
    assert "phase 1 of 3" in screen(training_display.run(report)).casefold()
    assert "It ended in the phase teacher" in report.end_text()
    assert [command for command, _ in training_display.next_commands(report)] == [
        "dr-start-training --resume"
    ]


def test_each_phase_has_a_line_that_fits(make_record):
    for name in PHASES:
        mark = PhaseMark(name)
        record = make_record(0, phase=name, full_laps=40, episodes=40, best_lap_s=15.87)
        shown = PhaseReport.of(mark, [record])
        assert len(shown.text) <= 80
        assert PhaseReport.of(mark, []).text == f"{mark}: begins"


def test_the_distance_of_a_student_from_its_teacher_stands_where_losses_stand(make_record):
    record = make_record(0, phase="distillation", imitation_loss=0.0123)

    assert "imitation loss 0.0123" in training_display.line(record, verbose=True)


def test_an_evaluation_says_how_far_the_best_lap_is_from_the_limit(evaluation_report):
    limit = "7.61 s: 35 % above the limit of this car on this track (5.64 s)"
    lost = ["waypoints 20 to 26: 0.31 s (0.93 s, the line 0.62 s)", "waypoints 3 to 9: 0.20 s"]
    report = replace(evaluation_report, limit=limit, lost=lost)

    shown = " ".join(screen(drawn(report)).split())

    assert f"{limit}. Most time is lost at {'; '.join(lost)}." in shown
