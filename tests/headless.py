"""A headless Chromium whose pictures are arrays of pixels."""

import io

import numpy as np
from PIL import Image

from osc_contact.lab.visual import browser


class Browser(browser.Browser):
    """One page; `with Browser(address) as page: page.run("1 + 1")`."""

    def picture(self, file=None):
        """Pixels (height, width, 3) of the page, after two more of its frames."""
        png = self.png()
        if file is not None:
            file.write_bytes(png)
        return pixels_of(Image.open(io.BytesIO(png)))

    def visit(self, address, width=1280, height=860, ready=browser.READY):
        """Open another page, or the same anew, in a window of this size (CSS pixels)."""
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.request("Emulation.setDeviceMetricsOverride", **screen)
        for url in ("about:blank", address):
            self.request("Page.navigate", url=url)
        self.until(f"document.readyState === 'complete' && {ready}")

    def __enter__(self):
        return self


def pixels_of(picture):
    return np.asarray(picture.convert("RGB")).astype(int)


def near(pixels, colour, tolerance=24):
    """Number of pixels with approximately the colour ``#RRGGBB``."""
    expected = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(pixels - expected).max(axis=2) <= tolerance).sum())
