"""Options that mean the same wherever they stand."""

from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on the last line of stdout.")]
Force = Annotated[bool, typer.Option("-f", "--force", "--yes", help="Ask nothing.")]
