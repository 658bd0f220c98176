"""Commands of viewer and console."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import parse_qsl, urlencode, urlsplit, urlunsplit

import typer

from drcli.base.errors import Absent
from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.open_page import open_page
from drcli.cli.stopped_process import show_stopped
from drcli.cli.working_folder import settings_or_defaults, working_folder
from drcli.web.listen import STREAM, TOPICS, USUAL_TOPIC

if TYPE_CHECKING:
    from drcli.config.run_config import WebConfig
    from drcli.config.settings import Settings
    from drcli.web.viewer_process import ViewerReport

with lazy_imports():
    from drcli.web import viewer_process


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


def _height(name: str) -> Any:
    return typer.Option(name, metavar="PIXELS", min=16, max=1080, help="Height of the pictures.")


def _quality(name: str) -> Any:
    return typer.Option(name, metavar="N", min=1, max=95, help="Quality of JPEG, 1 to 95.")


Width = Annotated[
    int,
    typer.Option(
        "-w", "--width", metavar="PIXELS", min=16, max=1920, help="Width of the pictures."
    ),
]
Height = Annotated[int, _height("--height")]
FormerHeight = Annotated[int, _height("-h")]
Quality = Annotated[int, _quality("--quality")]
FormerQuality = Annotated[int, _quality("-q")]
Topic = Annotated[str, typer.Option("-t", metavar="TOPIC", help="What the pictures show.")]

_UNUSED = "Accepted for scripts written for DeepRacer-for-Cloud; the page chooses it itself."

UnusedWidth = Annotated[int | None, typer.Option("-w", min=1, metavar="PIXELS", help=_UNUSED)]
UnusedHeight = Annotated[int | None, typer.Option("-h", min=1, metavar="PIXELS", help=_UNUSED)]
UnusedQuality = Annotated[int | None, typer.Option("-q", min=1, metavar="N", help=_UNUSED)]
UnusedTopic = Annotated[str | None, typer.Option("-t", metavar="TOPIC", help=_UNUSED)]


app = typer.Typer(
    help="Open the console, a web page on this machine: trainings, models and races.\n\n"
    "`dr console` alone starts it and opens it in a browser.\n\n"
    "Example: dr console"
)


@app.command("open")
def open_console(port: Port = None, program: Program = "", browser: Browser = True) -> None:
    """Start the console if it does not run, and open it in a browser.

    Example: dr-console open
    """
    _start(port, browser=browser, program=program)


@app.command()
def start(port: Port = None, program: Program = "", browser: Browser = False) -> None:
    """Start the console, and print its address.

    The page shows trainings live, models, evaluations and races, and does what the commands do. It
    runs in the background until dr-console stop or dr-stop-all. The address contains a token that a
    browser keeps. Only those who have it can open the page: on this machine or, with
    DR_WEBVIEWER_HOST, on others. One console serves all DR_RUN_IDs of a folder. Exits 7 without the
    extra web.

    Example: dr-console start
    """
    _start(port, browser=browser, program=program)


@app.command()
def restart(port: Port = None, program: Program = "") -> None:
    """Start the console again, with the settings of now.

    It does not need this to show new trainings or workers. Pages that are open connect again.
    Trainings and evaluations go on; a film, an export or an analysis that the page is making ends
    with the old console, and the new one says so.

    Example: dr-console restart
    """
    _start(port, again=True, browser=False, program=program)


@app.command("stop")
def stop_viewer() -> None:
    """Stop the console of this folder.

    Does nothing when none is running. Trainings and evaluations go on; a film, an export or an
    analysis that the page is making ends, and the next console says so.

    Example: dr-console stop
    """
    record = viewer_process.stop_viewer(working_folder())
    pid = None if record is None else record.pid
    show_stopped("the console", pid, none="No console is running.")


@app.command()
def status() -> None:
    """Print the address of the console, if it runs.

    Exits 1 if none is running in this folder.

    Example: dr-console status
    """
    record = viewer_process.running_viewer(working_folder())
    if record is None:
        raise Absent("No console is running.", remedy="Start it with `dr console`.")
    report = viewer_process.report_of(record, started=False)
    terminal.emit(report, report.url, folded=False)


@app.command()
def stream(
    topic: Topic = USUAL_TOPIC,
    width: Width = 480,
    height: Height = 360,
    quality: Quality = 75,
    program: Program = "",
) -> None:
    """Print the addresses of live pictures as MJPEG, one for each simulation worker.

    For scripts and players such as VLC or ffmpeg; the page of the console needs them not. Starts
    the console if it does not run. kvs_stream and main_camera show the car from behind, camera what
    it sees. An address contains the token of the console: keep it to yourself.

    Example: dr-console stream -t /racecar/camera/zed/rgb/image_rect_color
    """
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
    terminal.emit(StreamReport(topic, urls), "\n".join(urls), folded=False)
    if program and not terminal.as_json:
        open_page(urls[0], program)


# Former names, with the options of DeepRacer-for-Cloud.


def start_viewer(
    port: Port = None,
    program: Program = "",
    browser: Browser = False,
    width: UnusedWidth = None,
    height: UnusedHeight = None,
    quality: UnusedQuality = None,
    topic: UnusedTopic = None,
) -> None:
    """Start the console, and print its address, as `dr console start`.

    Example: dr-start-viewer
    """
    start(port, program, browser)


def update_viewer(
    port: Port = None,
    program: Program = "",
    width: UnusedWidth = None,
    height: UnusedHeight = None,
    quality: UnusedQuality = None,
    topic: UnusedTopic = None,
) -> None:
    """Start the console again, with the settings of now, as `dr console restart`.

    Example: dr-update-viewer
    """
    restart(port, program)


def view_stream(
    topic: Topic = USUAL_TOPIC,
    width: Width = 480,
    height: FormerHeight = 360,
    quality: FormerQuality = 75,
    program: Program = "",
) -> None:
    """Print the addresses of live pictures as MJPEG, as `dr console stream`.

    Example: dr-view-stream
    """
    stream(topic, width, height, quality, program)


def _start(port: int | None, *, again: bool = False, browser: bool, program: str) -> None:
    show_console(_started(settings_or_defaults(), port, again=again), browser, program)


def show_console(report: "ViewerReport", browser: bool, program: str) -> None:
    """Print the address of the console, and open it as the options say."""
    url = report.url or ""
    terminal.emit(report, url, folded=False)
    if report.needs_token:
        terminal.say(
            "Everybody who has this address can start trainings here. Keep it to yourself."
        )
    if (browser or program) and not terminal.as_json:
        open_page(url, program)


def _started(loaded: "Settings", port: int | None = None, *, again: bool = False) -> "ViewerReport":
    if port is not None:
        loaded = settings_or_defaults({"DR_WEBVIEWER_PORT": str(port)})
    return started_console(loaded, again=again)


def started_console(
    loaded: "Settings", *, again: bool = False, environ: Mapping[str, str] | None = None
) -> "ViewerReport":
    """Start the console of these settings if it does not run.

    `environ` is what it reads them with, if not the environment.
    """
    with terminal.waiting("Starting the console ..."):
        report = viewer_process.start_viewer(
            loaded.directory, loaded.web, again=again, environ=environ
        )
    _warn_of_old(report, loaded.web)
    return report


def _warn_of_old(report: "ViewerReport", config: "WebConfig") -> None:
    moved = report.host != config.host or (config.is_chosen and report.port != config.port)
    if (moved or report.needs_token != config.asks_token) and not report.started:
        token = "" if report.needs_token else ", and asks for no token"
        terminal.warn(
            f"The console runs already, on {report.host} port {report.port}{token}. "
            "`dr console restart` starts it again with the settings of now."
        )
