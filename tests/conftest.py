"""How hypothesis behaves here: the same examples every time, and no stopwatch."""

from hypothesis import HealthCheck, settings

# Some tests write each example over the last one's file, in a folder that all of them share.
SUPPRESSED = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]

# A busy machine makes slow examples, which says nothing about the code; and what CI tries on one
# day it must try on every day, or a red run cannot be looked into.
settings.register_profile(
    "drcli", deadline=None, derandomize=True, suppress_health_check=SUPPRESSED
)
settings.load_profile("drcli")
