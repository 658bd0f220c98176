"""Draws PNG pictures without a display."""

import io
import logging
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from drcli.base.installation import lazy_imports

if TYPE_CHECKING:
    from matplotlib.figure import Figure

with lazy_imports():
    import matplotlib
    from matplotlib import figure as figures
    from matplotlib import layout_engine
    from matplotlib.backends import backend_agg

_DPI = 100
_STYLE: dict[Any, Any] = {
    "font.size": 11.0,
    "axes.titlesize": 12.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#787e86",
    "axes.grid": True,
    "grid.color": "#e2e4e6",
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "text.parse_math": False,  # a file may have dollar signs in its name
}
INK = "#262a30"
LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8c6d00", "#000000", "#56b4e9")
"""Source: Okabe and Ito, 2008, the yellow darkened."""


def png(draw: Callable[["Figure"], None], size_in: tuple[float, float]) -> bytes:
    # It warns about letters that its font lacks and about its cache.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    with matplotlib.rc_context(_STYLE), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        layout = layout_engine.ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12)
        figure = figures.Figure(size_in, dpi=_DPI, layout=layout)
        backend_agg.FigureCanvasAgg(figure)
        draw(figure)
        data = io.BytesIO()
        figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()
