"""Commands of viewer and console."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated
from urllib.parse import parse_qsl, urlencode, urlsplit, urlunsplit

import typer

from drcli.cli import console
from drcli.cli.open_page import open_page
from drcli.cli.options import AsJson
from drcli.cli.stopped_process import show_stopped
from drcli.cli.working_folder import settings_or_defaults, working_folder

if TYPE_CHECKING:
    from drcli.config.run_config import WebConfig
    from drcli.config.settings import Settings
    from drcli.web.viewer_process import ViewerReport

USUAL_TOPIC = "/racecar/deepracer/kvs_stream"


@dataclass(frozen=True)
class StreamReport:
    """Addresses of live pictures."""

    topic: Annotated[str, "What they show."]
    urls: Annotated[list[str], "One address for each simulation worker, in their order."]


Browser = Annotated[
    bool, typer.Option("--open/--no-open", help="Open it in a browser, if there is a display.")
]
Program = Annotated[
    str,
    typer.Option("-b", metavar="PROGRAM", help="Open it with this program, such as firefox."),
]
Port = Annotated[
    int | None,
    typer.Option("-p", metavar="PORT", min=1, max=65_535, help="Port; else DR_WEBVIEWER_PORT."),
]
Width = Annotated[
    int, typer.Option("-w", metavar="PIXELS", min=16, max=1920, help="Width of the pictures.")
]
Height = Annotated[
    int, typer.Option("-h", metavar="PIXELS", min=16, max=1080, help="Height of the pictures.")
]
Quality = Annotated[
    int, typer.Option("-q", metavar="N", min=1, max=95, help="Quality of JPEG, 1 to 95.")
]
Topic = Annotated[str, typer.Option("-t", metavar="TOPIC", help="What the pictures show.")]

_UNUSED = "Accepted for scripts written for DeepRacer-for-Cloud; the page chooses it itself."

UnusedWidth = Annotated[int | None, typer.Option("-w", min=1, metavar="PIXELS", help=_UNUSED)]
UnusedHeight = Annotated[int | None, typer.Option("-h", min=1, metavar="PIXELS", help=_UNUSED)]
UnusedQuality = Annotated[int | None, typer.Option("-q", min=1, metavar="N", help=_UNUSED)]
UnusedTopic = Annotated[str | None, typer.Option("-t", metavar="TOPIC", help=_UNUSED)]


def start_viewer(
    port: Port = None,
    program: Program = "",
    browser: Browser = False,
    width: UnusedWidth = None,
    height: UnusedHeight = None,
    quality: UnusedQuality = None,
    topic: UnusedTopic = None,
    as_json: AsJson = False,
) -> None:
    """Start the console, a web page on this machine, and print its address.

    The page shows trainings live, models, evaluations and races, and does what the commands do. It
    runs in the background until dr-stop-viewer or dr-stop-all. The address contains a token that a
    browser keeps. Only those who have it can open the page: on this machine or, with
    DR_WEBVIEWER_HOST, on others. One console serves all DR_RUN_IDs of a folder. Exits 7 without the
    extra web.

    Example: dr-start-viewer
    """
    _start(port, as_json=as_json, browser=browser, program=program)


def console_page(
    port: Port = None, program: Program = "", browser: Browser = True, as_json: AsJson = False
) -> None:
    """Start the console, a web page on this machine, and open it in a browser.

    As dr-start-viewer, which prints its address only.

    Example: dr console
    """
    _start(port, as_json=as_json, browser=browser, program=program)


def update_viewer(
    port: Port = None,
    program: Program = "",
    width: UnusedWidth = None,
    height: UnusedHeight = None,
    quality: UnusedQuality = None,
    topic: UnusedTopic = None,
    as_json: AsJson = False,
) -> None:
    """Start the console again, with the settings of now.

    It does not need this to show new trainings or workers. Pages that are open connect again.
    Trainings and evaluations go on; a film, an export or an analysis that the page is making ends
    with the old console, and the new one says so.

    Example: dr-update-viewer
    """
    _start(port, again=True, as_json=as_json, browser=False, program=program)


def stop_viewer(as_json: AsJson = False) -> None:
    """Stop the console of this folder.

    Does nothing when none is running. Trainings and evaluations go on; a film, an export or an
    analysis that the page is making ends, and the next console says so.

    Example: dr-stop-viewer
    """
    from drcli.web.viewer_process import stop_viewer

    record = stop_viewer(working_folder())
    pid = None if record is None else record.pid
    show_stopped("the console", pid, none="No console is running.", as_json=as_json)


def view_stream(
    topic: Topic = USUAL_TOPIC,
    width: Width = 480,
    height: Height = 360,
    quality: Quality = 75,
    program: Program = "",
    as_json: AsJson = False,
) -> None:
    """Print the addresses of live pictures as MJPEG, one for each simulation worker.

    For scripts and players such as VLC or ffmpeg; the page of the console needs them not. Starts
    the console if it does not run. kvs_stream and main_camera show the car from behind, camera what
    it sees. An address contains the token of the console: keep it to yourself.

    Example: dr-view-stream -t /racecar/camera/zed/rgb/image_rect_color
    """
    from drcli.web.listen import STREAM, TOPICS

    if topic not in TOPICS:
        raise typer.BadParameter(
            f"there is no topic {topic[:200]}; there are {', '.join(TOPICS)}.",
            param_hint="-t",
        )
    loaded = settings_or_defaults()
    report = _started(loaded)
    query = {"topic": topic, "quality": quality, "width": width, "height": height}
    page = urlsplit(report.url or "")
    token = dict(parse_qsl(page.query))
    urls = [
        urlunsplit((*page[:2], STREAM, urlencode({**query, **worker, **token}, safe="/"), ""))
        for worker in ({"worker": k} if k else {} for k in range(loaded.workers))
    ]
    console.emit(StreamReport(topic, urls), "\n".join(urls), as_json=as_json, folded=False)
    if program and not as_json:
        open_page(urls[0], program)


def _start(
    port: int | None, *, again: bool = False, as_json: bool, browser: bool, program: str
) -> None:
    report = _started(settings_or_defaults(), port, again=again)
    url = report.url or ""
    console.emit(report, url, as_json=as_json, folded=False)
    if report.needs_token:
        console.say("Everybody who has this address can start trainings here. Keep it to yourself.")
    if (browser or program) and not as_json:
        open_page(url, program)


def _started(loaded: "Settings", port: int | None = None, *, again: bool = False) -> "ViewerReport":
    from drcli.web.viewer_process import start_viewer

    if port is not None:
        loaded = settings_or_defaults({"DR_WEBVIEWER_PORT": str(port)})
    with console.waiting("Starting the console ..."):
        report = start_viewer(loaded.directory, loaded.web, again=again)
    _warn_of_old(report, loaded.web)
    return report


def _warn_of_old(report: "ViewerReport", config: "WebConfig") -> None:
    moved = report.host != config.host or (config.is_chosen and report.port != config.port)
    if (moved or report.needs_token != config.asks_token) and not report.started:
        token = "" if report.needs_token else ", and asks for no token"
        console.warn(
            f"The console runs already, on {report.host} port {report.port}{token}. "
            "`dr-update-viewer` starts it again with the settings of now."
        )
