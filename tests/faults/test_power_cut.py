"""What a power cut of the whole machine leaves of a training."""

import pytest

from power_cut import PowerCuts, why_not

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(600)]


@pytest.mark.skipif(bool(why_not()), reason=f"A power cut cannot be tried here: {why_not()}.")
def test_a_power_cut_costs_at_most_the_open_iteration_and_the_one_before(tmp_path):
    trial = PowerCuts(tmp_path / "trial")
    try:
        [cut] = trial.run(cuts=1)

        assert cut.findings == [], cut
        assert trial.audit() == []
    finally:
        trial.close()
