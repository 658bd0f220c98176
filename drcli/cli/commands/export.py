"""`dr export`."""

import typer

from drcli.cli.commands import export_car, export_forms, export_reference

app = typer.Typer(
    no_args_is_help=True,
    help="Write a model in the form of other systems.\n\nExample: dr-export car -b",
)

app.command("car")(export_car.export_car)
app.command("tf-checkpoint")(export_reference.tf_checkpoint)
app.command()(export_reference.droa)
for _command in (export_forms.pb, export_forms.onnx, export_forms.tflite, export_forms.openvino):
    app.command()(_command)
