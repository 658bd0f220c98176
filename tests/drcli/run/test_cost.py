"""Machine hours and money of a training, over all its starts."""

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.bucket.request_count import CountFile, RequestCounter
from drcli.config.loading import load_settings
from drcli.model import keys
from drcli.outside.aws.prices import SpotPrice
from drcli.records.training_record import Spending, StartSpending
from drcli.run.cost import Cost
from memory_bucket import MemoryBucket
from unwatched import Clock, ending, job_of, running


class Meter:
    """A training whose time passes when a test says so."""

    def __init__(self, folder, bucket, *lines, session="start", term=1, price=None):
        self.prices = price
        self.job = job_of(folder, *lines, session=session, term=term)
        self.clock = Clock()
        self.duty = Cost(running(self.job, bucket), ask_price=self.ask, clock=self.clock)

    def ask(self, profile):
        if not self.prices:
            raise StorageError("This is no spot instance.", remedy="Write the price.")
        return SpotPrice(self.prices.pop(0), "g4dn.2xlarge in us-east-1a")

    def train(self, hours):
        for _ in range(round(hours * 60)):
            self.clock.now_s += 60.0
            self.duty.work()
        return self.duty.spending


@pytest.fixture
def meter(tmp_path):
    bucket = MemoryBucket()
    return lambda *lines, **options: Meter(tmp_path, bucket, *lines, **options)


def test_hours_cost_their_price(meter):
    spending = meter("DR_SPOT_PRICE=0.25").train(4.0)

    assert spending.hours == pytest.approx(4.0)
    assert spending.usd == pytest.approx(1.0)


def test_without_a_price_only_hours_are_counted(meter):
    it = meter()
    spending = it.train(2.0)

    assert spending.hours == pytest.approx(2.0)
    assert spending.usd is None
    assert "USD" not in it.duty.sentences()[0]


def test_the_starts_on_all_machines_add_up(meter):
    meter("DR_SPOT_PRICE=1", session="a", term=1).train(2.0)  # its machine vanishes
    second = meter("DR_SPOT_PRICE=0.5", session="b", term=2)
    second.train(2.0)
    second.duty.finish(ending())

    third = meter("DR_SPOT_PRICE=2", session="c", term=3)
    spending = third.train(1.0)

    assert spending.starts == 3
    assert spending.hours == pytest.approx(5.0, abs=0.1)  # at most 5 minutes are lost
    assert spending.usd == pytest.approx(5.0, abs=0.1)
    assert third.duty.end_facts()["machine_hours"] == pytest.approx(5.0, abs=0.1)


def test_a_damaged_count_of_an_earlier_start_is_named_and_left_out(meter, logged):
    first = meter("DR_SPOT_PRICE=1", session="a", term=1)
    first.train(1.0)
    bucket = first.duty.bucket
    bucket.put(keys.spending("team/model", 0, "broken"), b'{"session": "x"')

    spending = meter("DR_SPOT_PRICE=1", session="b", term=2).train(1.0)

    assert spending.starts == 2
    assert spending.damaged == ["bucket/runs/team/model/spending/000000-broken.json"]
    assert logged().count("is damaged") == 1


def test_the_money_limit_ends_the_training_as_complete(meter):
    it = meter("DR_SPOT_PRICE=1", "DR_MAX_COST=3")
    it.train(2.9)
    assert it.duty.check() is None
    it.train(0.2)

    outcome = it.duty.check()

    assert outcome.code == 0
    assert "the money limit (3.00 USD) was reached" in outcome.message


def test_the_money_limit_counts_what_earlier_machines_cost(meter):
    meter("DR_SPOT_PRICE=1", session="a", term=1).train(2.0)
    it = meter("DR_SPOT_PRICE=1", "DR_MAX_COST=3", session="b", term=2)
    it.train(1.2)

    assert it.duty.check() is not None


def test_a_machine_that_slept_costs_nothing_meanwhile(meter):
    it = meter("DR_SPOT_PRICE=1")
    it.train(1.0)
    it.clock.now_s += 8 * 3600.0
    it.duty.work()

    assert it.duty.spending.hours == pytest.approx(1.0, abs=0.02)


def test_the_asked_price_changes_with_the_hours(meter):
    it = meter("DR_SPOT_PRICE=auto", price=[0.2, 0.4, 0.4, 0.4])
    spending = it.train(2.0)

    assert spending.usd == pytest.approx(0.2 + 0.4, abs=0.02)
    assert spending.price_of == "spot price of g4dn.2xlarge in us-east-1a"


def test_a_price_that_nobody_knows_is_told_and_the_training_goes_on(meter, logged):
    it = meter("DR_SPOT_PRICE=auto", "DR_MAX_COST=3")
    it.train(0.5)

    assert it.duty.check() is None
    assert "DR_MAX_COST cannot be kept" in logged()
    assert it.duty.spending.unpriced_hours == 0.0  # no price, so no statement about money
    assert it.duty.spending.usd is None


def test_a_limit_without_a_price_is_refused(tmp_path):
    (tmp_path / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=m\nDR_MAX_COST=5\n")
    (tmp_path / "system.env").write_text("")
    with pytest.raises(SettingsError, match="DR_MAX_COST=5 cannot be kept"):
        load_settings(tmp_path, environ={})


@pytest.mark.parametrize("price", ["cheap", "-1", "1e99", "nan"])
def test_a_price_that_is_none_is_refused(tmp_path, price):
    (tmp_path / "run.env").write_text(f"DR_SPOT_PRICE={price}\n")
    (tmp_path / "system.env").write_text("")
    with pytest.raises(SettingsError, match="DR_SPOT_PRICE"):
        load_settings(tmp_path, environ={})


def test_other_commands_find_the_count_in_the_folder(meter):
    it = meter("DR_SPOT_PRICE=1", "DR_MAX_COST=10")
    it.train(1.0)

    found = Spending.read(it.job.folder)

    assert found.usd == pytest.approx(1.0)
    assert found.max_usd == 10.0
    key = keys.spending("team/model", 1, "start")
    record = StartSpending.decode(it.duty.bucket.get(key))
    assert record.usd == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("hours", "system", "told"),
    [
        # 6,000 x 0.005 / 1,000 + 10,000 x 0.0004 / 1,000
        (1.0, "DR_CLOUD=aws", "requests of a night of 10 hours cost 0.0340 USD"),
        (
            1.0,
            "DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=https://s3.us-east-1.amazonaws.com",
            "requests of a night of 10 hours cost 0.0340 USD",
        ),
        (1.0, "DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=http://nas:9000", ""),
        (1.0, "DR_CLOUD=local", ""),
        (1 / 60, "DR_CLOUD=aws", ""),
    ],
)
def test_the_end_tells_requests_and_at_amazon_what_a_night_of_them_costs(
    meter, tmp_path, logged, hours, system, told
):
    (tmp_path / "system.env").write_text(f"{system}\n")
    it = meter()
    counter = RequestCounter()
    for _ in range(600):
        counter.add("PutObject")
    for _ in range(1000):
        counter.add("GetObject")
    CountFile(it.job.folder, "sim-0", "start", counter).write()
    it.train(hours)

    it.duty.finish(ending())

    assert told in logged()
    assert ("USD" in logged()) == bool(told)
    when = "per hour" if hours == 1.0 else "in 60 s"
    assert f"{when}: 600 that write or list, 1,000 that read" in logged()
