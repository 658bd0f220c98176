"""Draws the pages of the console: docs/pictures/console-NAME.png, also dark and as on a phone.

    python scripts/docs console FOLDER [--into docs/pictures] [--wait 5]

FOLDER is a working folder with a training that runs or has ended. Its console is started if it does
not run. A picture is made of every page in the menu. Needs Playwright and Chromium.
"""

import argparse
import shutil
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from drcli.config.loading import load_settings
from drcli.web.viewer_process import start_viewer

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")

KINDS = {"": (1280, "light"), "-dark": (1280, "dark"), "-phone": (360, "light")}
"""Ending of the name, width in pixels, and theme."""

HIGHEST_PX = 2400

COLORS = 128
"""Of a picture: few, so that the file is small."""


def main() -> None:
    """Visit every page, and write the pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--into", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--wait", type=float, default=5.0, help="seconds for a page to fill")
    options = parser.parse_args()
    settings = load_settings(options.folder.resolve())
    url = start_viewer(settings.directory, settings.web).url
    program = next(filter(None, map(shutil.which, NAMES)), None)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-gpu"]
        )
        for ending, (width, theme) in KINDS.items():
            context = browser.new_context(
                viewport={"width": width, "height": 800},
                color_scheme="dark" if theme == "dark" else "light",
            )
            page = context.new_page()
            page.goto(str(url))
            links = page.locator("#pages a")
            links.first.wait_for()
            for k in range(links.count()):
                name = links.nth(k).inner_text().lower().replace(" ", "-")
                links.nth(k).click()
                page.wait_for_timeout(1000 * options.wait)
                _save(page, options.into / f"console-{name}{ending}.png")
            context.close()
        browser.close()


def _save(page: Any, path: Path) -> None:
    """Write a picture of the page with few colours."""
    page.screenshot(path=path, full_page=True)
    with Image.open(path) as picture:
        shown = picture.convert("RGB").crop((0, 0, picture.width, min(picture.height, HIGHEST_PX)))
    shown.quantize(COLORS).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
