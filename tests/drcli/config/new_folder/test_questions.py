"""The questions of `dr init`."""

import pytest

from drcli.cli.commands.init import with_answers


def never(sentence: str) -> None:
    raise AssertionError(sentence)


class Racer:
    """Answers from a list, by a word of the question; Enter for all others."""

    def __init__(self, **answers: str) -> None:
        self.answers = answers
        self.asked: list[str] = []

    def __call__(self, question, default, choices=()):
        self.asked.append(question)
        return next((a for word, a in self.answers.items() if word in question), default)


def test_enter_at_every_question_trains_on_this_machine():
    values = with_answers({}, Racer(), never)

    assert values == {
        "DR_WORLD_NAME": "reinvent_base",
        "DR_RACE_TYPE": "TIME_TRIAL",
        "DR_LOCAL_S3_MODEL_PREFIX": "rl-deepracer-sagemaker",
        "DR_CLOUD": "local",
    }


def test_nothing_is_asked_about_what_an_option_has_said():
    racer = Racer()

    values = with_answers({"DR_WORLD_NAME": "bean", "DR_CLOUD": "local"}, racer, never)

    assert values["DR_WORLD_NAME"] == "bean"
    assert len(racer.asked) == 2


@pytest.mark.parametrize(("cloud", "more"), [("remote", 3), ("azure", 3), ("aws", 2), ("local", 0)])
def test_a_bucket_elsewhere_needs_a_few_words_more(cloud, more):
    racer = Racer(bucket="keeps")

    values = with_answers({"DR_CLOUD": cloud}, racer, never)

    assert len(racer.asked) == 3 + more
    assert ("DR_REMOTE_MINIO_URL" in values) == (cloud in ("remote", "azure"))


def test_an_answer_that_will_not_do_is_asked_for_again_with_the_reason():
    answers = iter(["two words", "mine"])
    reasons: list[str] = []

    def ask(question, default, choices=()):
        return next(answers) if "model" in question else default

    values = with_answers({}, ask, reasons.append)

    assert values["DR_LOCAL_S3_MODEL_PREFIX"] == "mine"
    assert len(reasons) == 1
    assert reasons[0].startswith("two words contains ' '")


def test_an_unknown_track_is_asked_for_again_until_it_is_typed_twice():
    answers = iter(["shanghia", "bowtei", "Mine", "Mine"])
    given = {"DR_RACE_TYPE": "TIME_TRIAL", "DR_LOCAL_S3_MODEL_PREFIX": "m", "DR_CLOUD": "local"}
    reasons = []

    values = with_answers(given, lambda *_: next(answers), reasons.append)

    assert values["DR_WORLD_NAME"] == "Mine"
    assert "shanghia is not a known track. Did you mean China_track?" in reasons[0]
    assert len(reasons) == 3


def test_a_track_may_be_answered_as_consoles_call_it():
    given = {"DR_RACE_TYPE": "TIME_TRIAL", "DR_LOCAL_S3_MODEL_PREFIX": "m", "DR_CLOUD": "local"}

    values = with_answers(given, lambda *_: "shanghai", never)

    assert values["DR_WORLD_NAME"] == "China_track"
