"""`dr summary`."""

from drcli.cli import console
from drcli.cli.options import AsJson
from drcli.cli.views import summary_view
from drcli.cli.working_folder import settings


def summary(as_json: AsJson = False) -> None:
    """Show settings, bucket, runs and machine on one page.

    Lists what runs in this folder under every DR_RUN_ID. Starts no server, and waits at most two
    seconds for the bucket.

    Example: dr-summary
    """
    from drcli.runs.summary import summarize

    report = summarize(settings())
    console.emit(report, summary_view.summary(report), as_json=as_json)
