"""Which cloud a machine belongs to, told by its mainboard."""

import pytest

from drcli.clouds import providers
from drcli.clouds.providers.microsoft import AZURE_ASSET_TAG
from drcli.clouds.registry import cloud_of_machine, find_clouds


@pytest.mark.parametrize(
    ("texts", "cloud"),
    [
        ({"sys_vendor": "Amazon EC2", "product_name": "g5.xlarge"}, "aws"),
        ({"sys_vendor": "Xen", "bios_version": "4.11.amazon"}, "aws"),
        ({"sys_vendor": "Google", "product_name": "Google Compute Engine"}, "gcp"),
        ({"sys_vendor": "Microsoft Corporation", "chassis_asset_tag": AZURE_ASSET_TAG}, "azure"),
        ({"sys_vendor": "Microsoft Corporation", "product_name": "Surface Laptop"}, None),
        ({"sys_vendor": "Google", "product_name": "Eve"}, None),
        ({"sys_vendor": "LENOVO", "product_name": "20XW"}, None),
        ({}, None),
    ],
)
def test_the_mainboard_tells(tmp_path, texts, cloud):
    for name, text in texts.items():
        (tmp_path / name).write_text(f"{text}\n")

    assert cloud_of_machine({}, tmp_path) == cloud


def test_a_variable_with_the_address_of_a_service_tells_too(tmp_path):
    assert cloud_of_machine({"AWS_EC2_METADATA_SERVICE_ENDPOINT": "http://x"}, tmp_path) == "aws"
    assert cloud_of_machine({"GCE_METADATA_HOST": "x:80"}, tmp_path) == "gcp"


def test_a_module_among_the_providers_is_all_that_a_cloud_needs(tmp_path, monkeypatch):
    (tmp_path / "hetzner.py").write_text(
        "from drcli.clouds.cloud import Cloud, Notice\n"
        "class Notices:\n"
        "    name = 'Hetzner'\n"
        "    def ask(self):\n"
        "        return [Notice('hetzner', 'interruption', 'terminate', 60.0, 'It goes.')]\n"
        "CLOUD = Cloud('hetzner', 'Hetzner', '', lambda dmi: False, lambda *_: Notices())\n"
    )
    monkeypatch.setattr(providers, "__path__", [*providers.__path__, str(tmp_path)])

    clouds = find_clouds()

    assert list(clouds) == ["aws", "gcp", "hetzner", "azure"]
    source = clouds["hetzner"].source({}, "")
    assert source is not None
    assert [notice.seconds_left for notice in source.ask()] == [60.0]
