"""Looks for barriers on a page with axe-core, where somebody has it.

AXE_SCRIPT names axe.min.js, as of `npm install axe-core`; `.ci/run` fetches it where it may.
"""

import os
from pathlib import Path
from typing import Any


def serious_findings(page: Any) -> list[str]:
    """What axe-core calls serious or critical: rule and element; nothing where it is missing."""
    script = os.environ.get("AXE_SCRIPT", "")
    if not script:
        return []
    page.evaluate(Path(script).read_text("utf-8"))
    found = page.evaluate("axe.run()")["violations"]
    return [
        f"{each['id']}: {node['html'][:200]}"
        for each in found
        if each["impact"] in ("serious", "critical")
        for node in each["nodes"]
    ]
