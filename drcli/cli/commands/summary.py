"""`dr summary`."""

from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings


def summary(as_json: AsJson = False) -> None:
    """Show settings, bucket, what runs, and the machine, on one page.

    What runs is shown of every DR_RUN_ID in this folder. No server is started, and the bucket has
    two seconds to answer.

    Example: dr-summary
    """
    from drcli.cli import console
    from drcli.cli.views import everyday
    from drcli.runs.summary import summarize

    report = summarize(settings())
    console.emit(report, everyday.summary(report), as_json=as_json)
