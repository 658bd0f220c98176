"""`dr spot`: machines that a cloud may take away."""

import typer

from drcli.cli.commands.spot_watch import watch

app = typer.Typer(
    no_args_is_help=True,
    help="Watch for the end of a machine in a cloud.\n\nExample: dr-spot watch --once",
)


@app.callback()
def spot() -> None:
    """Keep `watch` a command of its own although it is the only one."""


app.command("watch")(watch)
