#!/usr/bin/env bash
# Chromium 156 (driven by playwright 1.65.2), showing an MJPEG stream (multipart/x-mixed-replace).
#
# What one expects: <img> shows a picture of the stream once all of it has come, which the browser
# knows from its Content-Length, or from the boundary that ends it.
# What happens: it shows a picture when the headers of the next one have come. So a stream of which each
# part is sent when there is something new, as cameras do, is one picture late, and the last one before
# a pause is never shown. Neither a Content-Length nor a boundary behind the picture changes this.
# What helps: to send the headers of the next part behind each picture, or the picture a second time.
#
# Output seen (red, green and blue, 0.6 s apart, then a pause):
#
#   with Content-Length: red after 0.6 s, green after 1.2 s, blue never
#   with a boundary behind it: red after 0.6 s, green after 1.2 s, blue never
#   with the next headers behind it: red after 0.0 s, green after 0.6 s, blue after 1.2 s
#   sent twice: red after 0.0 s, green after 0.6 s, blue after 1.2 s
#
# It needs Chromium: the environment variable CHROMIUM, or one on the PATH. It ends with 0 if the
# behaviour is as stated; times are not judged.
set -euo pipefail
CHROMIUM=${CHROMIUM:-$(command -v chromium-headless-shell chromium chromium-browser google-chrome | head -n 1 || true)}
[ -n "$CHROMIUM" ] || { echo "No Chromium was found: set CHROMIUM." >&2; exit 2; }
export CHROMIUM
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "playwright==1.65.2" "pillow==13.0.0"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import http.server
import io
import os
import sys
import threading
import time

from PIL import Image
from playwright.sync_api import sync_playwright

APART_S, PAUSE_S = 0.6, 3.0
BOUNDARY = b"--picture\r\n"
KIND = b"Content-Type: image/jpeg\r\n"
COLOURS = ("red", "green", "blue")
SHOWN = """
() => {
  const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
  const image = document.querySelector("img");
  if (!image || !image.naturalWidth) return "";
  context.drawImage(image, 0, 0);
  const found = [...context.getImageData(5, 5, 1, 1).data].slice(0, 3);
  return ["red", "green", "blue"][found.indexOf(Math.max(...found))];
}
"""


def jpeg(colour: str) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (32, 32), colour).save(file, "JPEG")
    return file.getvalue()


def parts(way: str, data: bytes, first: bool) -> bytes:
    """What is sent for a picture."""
    whole = BOUNDARY + KIND + b"Content-Length: %d\r\n\r\n" % len(data) + data + b"\r\n"
    if way == "with Content-Length":
        return whole
    if way == "with a boundary behind it":
        return (BOUNDARY if first else b"") + whole.removeprefix(BOUNDARY) + BOUNDARY
    if way == "with the next headers behind it":
        heads = BOUNDARY + KIND + b"\r\n"
        return (heads if first else b"") + data + b"\r\n" + heads
    return whole * 2


class Camera(http.server.BaseHTTPRequestHandler):
    way, began_s = "", 0.0

    def do_GET(self) -> None:
        self.send_response(200)
        if self.path != "/stream":
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<img src=/stream>")
            return
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=picture")
        self.end_headers()
        Camera.began_s = time.monotonic()
        try:
            for colour in COLOURS:
                self.wfile.write(parts(Camera.way, jpeg(colour), colour == COLOURS[0]))
                time.sleep(APART_S)
            time.sleep(PAUSE_S)
        except OSError:
            pass  # the page was closed

    def log_message(self, *_: object) -> None:
        """Say nothing."""


server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Camera)
threading.Thread(target=server.serve_forever, daemon=True).start()
good = True
with sync_playwright() as driver:
    browser = driver.chromium.launch(executable_path=os.environ["CHROMIUM"], args=["--no-sandbox"])
    print("Chromium", browser.version)
    ways = ("with Content-Length", "with a boundary behind it")
    for Camera.way in (*ways, "with the next headers behind it", "sent twice"):
        page, seen = browser.new_page(), {}
        Camera.began_s = 0.0
        page.goto(f"http://127.0.0.1:{server.server_port}/", wait_until="commit")
        while not Camera.began_s or time.monotonic() < Camera.began_s + 3 * APART_S + 1.0:
            colour = page.evaluate(SHOWN)
            if colour and Camera.began_s:
                seen.setdefault(colour, time.monotonic() - Camera.began_s)
            time.sleep(0.02)
        page.close()
        told = [f"{c} after {seen[c]:.1f} s" if c in seen else f"{c} never" for c in COLOURS]
        print(f"{Camera.way}: {', '.join(told)}")
        good = good and ("blue" in seen) == (Camera.way not in ways)
    browser.close()
sys.exit(not good)
PYTHON
