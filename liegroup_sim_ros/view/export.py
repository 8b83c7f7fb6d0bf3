# SPDX-License-Identifier: Apache-2.0
"""What a page saves: a picture, a video, a page to keep. The files go to the browser's downloads."""

import io
import time
from fractions import Fraction
from importlib.util import find_spec

import numpy as np

from .server import HINT, ViewError

WIDTH, HEIGHT = 1280, 720
ANSWER = 20.0  # s, for a picture from the browser
VIDEO_RATE, MOST_VIDEO = 25, 30.0  # frames a second; s
LONGEST = 60.0  # s, about what a video takes: a slow browser draws fewer frames
DRAWN = 2.0 / 30.0  # s, until the page has drawn an instant
KEPT_RATE, MOST_KEPT = 30.0, 60.0


def picture_of(client):
    """Picture (HEIGHT, WIDTH, 3) uint8 of what a client shows, on white. Raises ViewError."""
    try:
        shown = client.get_render(height=HEIGHT, width=WIDTH, transport_format="png", timeout=ANSWER).astype(float)
    except (TimeoutError, RuntimeError):
        raise ViewError(f"the browser has sent no picture within {ANSWER:g} s: it draws slowly") from None
    opaque = shown[..., 3:] / 255.0  # the background is transparent
    return np.ascontiguousarray(shown[..., :3] * opaque + 255.0 * (1.0 - opaque)).round().astype(np.uint8)


def save_picture(page, client):
    """Picture of what a client shows, as PNG."""
    import imageio.v3 as imageio

    client.send_file_download(
        "view.png", imageio.imwrite("<bytes>", picture_of(client), extension=".png"), save_immediately=True
    )
    return "picture saved"


def _instants(page, rate, most):
    first, last = page.source.history.span()
    if last <= first:
        raise ViewError("nothing has moved yet")
    first = max(first, last - most)
    return np.arange(first, last, 1.0 / rate)


def save_video(page, client):
    """Video of the time line, at most MOST_VIDEO, as a client shows it; MP4 by PyAV.

    Its rate is VIDEO_RATE, or less if the browser draws slowly.
    """
    if find_spec("av") is None:
        raise ViewError(f"a video needs the package av: {HINT}")
    import av

    cursor, playing, panel = page.cursor, page.playing, page._panel
    notice = client.add_notification("Video", "it starts", loading=True, with_close_button=False)
    page.playing, out = False, io.BytesIO()
    panel.block("a video is saved: no control works until it is ready")
    try:
        instants = _instants(page, VIDEO_RATE, MOST_VIDEO)
        picture_of(client)  # the first one takes longer
        began = time.monotonic()
        picture_of(client)
        count = max(1, min(len(instants), int(LONGEST / (time.monotonic() - began + DRAWN))))
        rate = Fraction(VIDEO_RATE * count, len(instants)).limit_denominator(1000)
        page.say(f"video: {count} pictures, {float(rate):.3g} a second")
        with av.open(out, "w", format="mp4") as file:
            stream = file.add_stream("libx264", rate=rate)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            for k, instant in enumerate(instants[np.linspace(0, len(instants) - 1, count).round().astype(int)], 1):
                notice.body = f"picture {k} of {count}; no control works until it is ready"
                page.cursor = float(instant)
                time.sleep(DRAWN)
                picture = picture_of(client)
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            file.mux(stream.encode())
    finally:
        page.cursor, page.playing = cursor, playing
        panel.block("")
        notice.remove()
    client.send_file_download("view.mp4", out.getvalue(), save_immediately=True)
    return "video saved"


def save_html(page, client):
    """Page with the motion of the time line that needs no server."""
    server = page._server
    with page._doing:
        serializer = server.get_scene_serializer()
        frames = [page.source.history.at(t) for t in _instants(page, KEPT_RATE, MOST_KEPT)]
        for frame in frames:
            page._drawing.show(frame, page.look)
            serializer.insert_sleep(1.0 / KEPT_RATE)
        text = serializer.as_html()
    client.send_file_download("view.html", text.encode(), save_immediately=True)
    return "page saved"
