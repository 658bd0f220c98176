"""Names that servers take for a bucket."""

import pytest

from drcli.config.loading import load_settings
from drcli.config.value_types import follows_s3


@pytest.mark.parametrize("name", ["bucket", "my-races", "a.b.c", "2024", "xyz", "a" * 63])
def test_names_that_s3_takes(name):
    assert follows_s3(name)


@pytest.mark.parametrize(
    "name",
    ["Races", "my_races", "ab", "a" * 64, "-races", "races-", "a..b", "a.-b", "192.168.1.5", "rä"],
)
def test_names_that_s3_refuses(name):
    assert not follows_s3(name)


@pytest.mark.parametrize("cloud", ["remote", "azure"])
def test_a_server_of_somebody_else_may_be_less_strict(folder, cloud):
    folder.write("system.env", f"DR_CLOUD={cloud}\nDR_REMOTE_MINIO_URL=http://nas:9000\n")
    folder.write("run.env", "DR_LOCAL_S3_BUCKET=My_Races\n")

    assert load_settings(folder.path, environ={}).bucket == "My_Races"
