"""`dr export`: writes a model in the formats of other systems."""

import typer

from drcli.cli.commands import export_car

app = typer.Typer(
    no_args_is_help=True,
    help="Write a model in the format of another system.\n\nExample: dr-export car -b",
)

app.command("car")(export_car.export_car)
