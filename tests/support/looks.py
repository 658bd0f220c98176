"""How a page looks and is reached: at three sizes, light and dark, and with the keyboard alone."""

from pathlib import Path
from typing import Any

from axe import serious_findings

SIZES = ((390, 844), (768, 1024), (1440, 900))
MOST_PARTS = 8
"""Of a control that Tab goes through, such as date and time."""

LOOKS = Path(__file__).with_suffix(".js").read_text("utf-8").rstrip().removesuffix(";")


def faults(page: Any) -> list[str]:
    """What is cut, has no text, or is a barrier by axe-core, at each size and in both schemes."""
    found = []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        for theme in ("light", "dark"):
            page.emulate_media(color_scheme=theme)
            page.locator(f"html[data-theme={theme}]").wait_for(state="attached")
            said = [*page.evaluate(f"{LOOKS}.cut()"), *serious_findings(page)]
            found += [f"{width} px, {theme}: {each}" for each in said]
    return found


def unreached(page: Any) -> list[str]:
    """Controls that Tab does not reach, or that do not show that they have the focus."""
    names = page.evaluate(f"{LOOKS}.controls()")
    left, found, last = dict(enumerate(names)), [], []
    for _ in range(len(names) + 60):
        page.keyboard.press("Tab")
        at = page.evaluate(f"{LOOKS}.focused()")
        if at is None:  # between the end of the page and its beginning
            continue
        last = [at, *last][:MOST_PARTS]
        if last.count(at) == MOST_PARTS:
            found.append(f"keeps the focus: {at['name']}")
            break
        if at["key"] is not None:
            left.pop(int(at["key"]), None)
        if not at["isMarked"]:
            found.append(f"has the focus without a mark: {at['name']}")
        if not at["isInView"] or at["isCovered"]:
            found.append(f"has the focus and is not seen: {at['name']}")
        if at["takesTab"]:
            page.keyboard.press("Escape")
        if not left:
            break
    return found + [f"is not reached: {each}" for each in left.values()]
