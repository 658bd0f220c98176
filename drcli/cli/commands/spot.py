"""`dr-spot`: trainings on machines of Amazon."""

import typer

from drcli.cli.commands import spot_create, spot_end, spot_look
from drcli.cli.commands.spot_watch import watch

app = typer.Typer(
    no_args_is_help=True,
    help="Train on spot machines of Amazon.\n\nExample: dr-spot prices",
)

app.command("create-base")(spot_create.create_base)
app.command()(spot_create.create)
app.command("list")(spot_look.list_all)
app.command()(spot_look.prices)
app.command()(spot_look.cost)
app.command()(spot_look.logs)
app.command()(spot_look.ssh)
app.command("add-access")(spot_create.add_access)
app.command()(spot_create.subscribe)
app.command()(spot_end.stop)
app.command()(spot_end.delete)
app.command()(watch)
