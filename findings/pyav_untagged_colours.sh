#!/usr/bin/env bash
# PyAV 18.1.0 (H.264 by its x264), shown by Chromium 156 (driven by playwright 1.65.2).
#
# What one expects: a video that is encoded from RGB pictures shows their colours, at every size.
# What happens: PyAV converts RGB with the matrix of BT.601 at every size, and writes nothing about
# colours into the file. A browser then takes a video of fewer than 720 rows for BT.601, and a larger one
# for BT.709: the same frames are right in 640 x 480 and wrong in 1280 x 720. A player that goes by
# BT.601 always, as PyAV itself, shows nothing of it.
# What helps: reformat(dst_colorspace=BT.709), and colorspace, color_primaries, color_trc and color_range
# of the stream's codec context. The matrix alone does not help.
#
# Output seen (the pictures are 40, 160, 60 on the left and 240, 150, 20 on the right):
#
#   640 x 480, as PyAV does by itself: 40 160 61 and 240 150 20
#   1280 x 720, as PyAV does by itself: 30 143 61 and 250 151 20
#   1280 x 720, BT.709 and named: 39 160 63 and 240 150 27
#
# It needs Chromium: the environment variable CHROMIUM, or one on the PATH. It ends with 0 if the
# behaviour is as stated.
set -euo pipefail
CHROMIUM=${CHROMIUM:-$(command -v chromium-headless-shell chromium chromium-browser google-chrome | head -n 1 || true)}
[ -n "$CHROMIUM" ] || { echo "No Chromium was found: set CHROMIUM." >&2; exit 2; }
export CHROMIUM
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "av==18.1.0" "numpy==2.4.6" "playwright==1.65.2"
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import base64
import io
import os
import sys

import av
import numpy as np
from playwright.sync_api import sync_playwright

LEFT, RIGHT = (40, 160, 60), (240, 150, 20)
BT709, LIMITED = 1, 1
SHOW = """
async () => {
  const video = document.querySelector("video");
  for (let k = 0; k < 100 && video.readyState < 2; k++)
    await new Promise((go) => setTimeout(go, 100));
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
  const context = canvas.getContext("2d");
  context.drawImage(video, 0, 0);
  return [10, canvas.width - 10].map((x) => [...context.getImageData(x, 10, 1, 1).data].slice(0, 3));
}
"""


def encoded(columns: int, rows: int, named: bool) -> bytes:
    picture = np.empty((rows, columns, 3), np.uint8)
    picture[:, : columns // 2], picture[:, columns // 2 :] = LEFT, RIGHT
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as output:
        stream = output.add_stream("libx264", rate=15, options={"crf": "1"})
        stream.width, stream.height, stream.pix_fmt = columns, rows, "yuv420p"
        if named:
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = BT709
            context.color_range = LIMITED
        for _ in range(5):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            if named:
                frame = frame.reformat(format="yuv420p", dst_colorspace=BT709)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return file.getvalue()


good = True
with sync_playwright() as driver:
    browser = driver.chromium.launch(executable_path=os.environ["CHROMIUM"], args=["--no-sandbox"])
    print("Chromium", browser.version)
    for columns, rows, named in ((640, 480, False), (1280, 720, False), (1280, 720, True)):
        page = browser.new_page()
        data = base64.b64encode(encoded(columns, rows, named)).decode()
        page.set_content(f'<video muted src="data:video/mp4;base64,{data}"></video>')
        left, right = page.evaluate(SHOW)
        how = "BT.709 and named" if named else "as PyAV does by itself"
        print(f"{columns} x {rows}, {how}: {' '.join(map(str, left))} and {' '.join(map(str, right))}")
        off = int(np.abs(np.subtract(left + right, LEFT + RIGHT)).max())
        good = good and (off < 9 if named or rows < 720 else off > 9)
        page.close()
    browser.close()
sys.exit(not good)
PYTHON
