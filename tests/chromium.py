"""Debian's chromium, and what its pages show."""

import io
import shutil
import time

import numpy as np
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def pixels(page):
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), np.int16)


def seen(page, is_as_wanted):
    """Return what a page shows once it is as wanted, or whatever it shows after a minute."""
    end = time.monotonic() + 60.0
    while not is_as_wanted(picture := pixels(page)) and time.monotonic() < end:
        page.wait_for_timeout(100)
    return picture


def share_unlike(picture, other, by):
    """Share of the pixels that differ by more than so much of 255."""
    return np.mean(np.abs(picture - other).max(axis=2) > by)


def terrain_share(picture):
    """Share of the pixels that have a colour: the page itself is white, its text grey."""
    return np.mean(np.ptp(picture, axis=2) > 15)
