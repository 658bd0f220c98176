"""All clouds that drcli knows: the modules in `providers`."""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from drcli.clouds import providers
from drcli.clouds.cloud import Cloud

DMI_FOLDER = Path("/sys/class/dmi/id")
_DMI = ("sys_vendor", "product_name", "chassis_asset_tag", "bios_version")


def find_clouds() -> dict[str, Cloud]:
    names = sorted(module.name for module in iter_modules(providers.__path__))
    clouds = (import_module(f"{providers.__name__}.{name}").CLOUD for name in names)
    return {cloud.name: cloud for cloud in clouds}


CLOUDS: Mapping[str, Cloud] = find_clouds()


def cloud_of_machine(environment: Mapping[str, str], dmi: Path = DMI_FOLDER) -> str | None:
    """By environment and mainboard, without network; None for other machines."""
    for cloud in CLOUDS.values():
        if environment.get(cloud.variable):
            return cloud.name
    texts = {name: _text(dmi / name) for name in _DMI}
    return next((cloud.name for cloud in CLOUDS.values() if cloud.owns(texts)), None)


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace").strip()
    except OSError:
        return ""
