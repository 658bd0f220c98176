"""Google Compute Engine: preemptible machines, maintenance that ends a machine."""

from collections.abc import Mapping

from drcli.clouds.cloud import Cloud, MetadataService, Notice, silent

GOOGLE_HOST = "metadata.google.internal"

GOOGLE_NOTICE_S = 30.0
"""Source: Compute Engine docs."""

GOOGLE_MAINTENANCE_S = 60.0


class GoogleNotices:
    name = "Google Compute Engine"

    def __init__(self, service: MetadataService) -> None:
        self._service = service

    def ask(self) -> list[Notice]:
        found = []
        if self._read("instance/preempted") == "TRUE":
            text = f"Google preempts this machine; it is switched off in {GOOGLE_NOTICE_S:.0f} s."
            found.append(Notice("gcp", "interruption", "preempt", GOOGLE_NOTICE_S, text))
        if self._read("instance/maintenance-event") == "TERMINATE_ON_HOST_MAINTENANCE":
            text = "Google announces maintenance that ends this machine."
            found.append(Notice("gcp", "interruption", "terminate", GOOGLE_MAINTENANCE_S, text))
        return found

    def is_spot(self) -> bool:
        return self._read("instance/scheduling/preemptible") == "TRUE"

    def _read(self, path: str) -> str:
        answer = self._service.ask(f"computeMetadata/v1/{path}", {"Metadata-Flavor": "Google"})
        if answer.status == 404:
            return ""
        if answer.status != 200 or answer.headers.get("metadata-flavor") != "Google":
            raise silent(f"of Google answers {answer.status} for {path}")
        return answer.text


def _source(environment: Mapping[str, str], address: str) -> GoogleNotices:
    host = environment.get("GCE_METADATA_HOST", "").strip() or GOOGLE_HOST
    return GoogleNotices(MetadataService(address or (host if "://" in host else f"http://{host}")))


CLOUD = Cloud(
    "gcp",
    GoogleNotices.name,
    "GCE_METADATA_HOST",
    lambda dmi: dmi["sys_vendor"] == "Google" and dmi["product_name"].startswith("Google"),
    _source,
)
