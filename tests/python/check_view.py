"""The page of `slipsense view` in a headless Chromium: it loads, draws, plays, scrubs, shows the slip when it is, and
survives that the stream ends and comes back.

    check_view.py SLIPSENSE PREDICTIONS.npz CAN.log OUT_DIR

SLIPSENSE is the command; PREDICTIONS.npz and CAN.log are what its `demo` wrote about the bundled episode. A picture
of the page goes into OUT_DIR. The browser is driven by its own remote debugging protocol.
"""

import base64
import json
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request

import numpy
import websocket

from checks import require

CHROMIUM = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            "--window-size=1280,1000", "--remote-debugging-port=0", "--remote-allow-origins=*"]
TIMEOUT_S = 60
FRAME_RATE_HZ = 240


def until(what, answer):
    """The first answer that is true."""
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end:
        found = answer()
        if found:
            return found
        time.sleep(0.1)
    sys.exit(f"error: {what}: not within {TIMEOUT_S} s")


class Browser:
    """A page of a Chromium of its own."""

    def __init__(self, folder):
        self.process = subprocess.Popen([*CHROMIUM, f"--user-data-dir={folder}", "about:blank"],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port_file = pathlib.Path(folder) / "DevToolsActivePort"
        until("the browser starts", lambda: port_file.exists() and len(port_file.read_text().split()) == 2)
        port = port_file.read_text().split()[0]
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        page = next(page for page in pages if page["type"] == "page")
        self.socket = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=TIMEOUT_S)
        self.number = 0
        self.errors = []
        self.call("Runtime.enable")
        self.call("Page.enable")

    def call(self, method, **parameters):
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv())
            if message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(message["params"]["exceptionDetails"]["exception"]["description"])
            if message.get("id") == self.number:
                if "error" in message:
                    sys.exit(f"error: {method}: {message['error']}")
                return message["result"]

    def value(self, expression):
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in result:
            sys.exit(f"error: {expression}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def open(self, url):
        """Go to a page, whose elements are there afterwards."""
        self.call("Page.navigate", url=url)
        loaded = f"document.readyState == 'complete' && location.href.startsWith({json.dumps(url)})"
        until(f"{url} is loaded", lambda: self.value(loaded))

    def press(self, key, shift=False):
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, modifiers=8 if shift else 0)

    def picture(self, path):
        data = self.call("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))

    def close(self):
        self.process.kill()
        self.process.wait()


class View:
    """`slipsense view`, until it is closed."""

    def __init__(self, slipsense, *arguments, **options):
        self.process = subprocess.Popen([slipsense, "view", *arguments], stdout=subprocess.PIPE, text=True, **options)
        self.url = self.process.stdout.readline().strip()
        if not self.url.startswith("http://127.0.0.1:"):
            sys.exit(f"error: slipsense view said {self.url!r}")

    def close(self):
        self.process.kill()
        self.process.wait()


POSITION = "Math.floor(position)"
# Bright pixels of a canvas.
BRIGHT = """(() => {{ const c = document.querySelectorAll('{}')[{}];
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 0; i < d.length; i += 4) if (d[i] + d[i + 1] + d[i + 2] > 150) n++; return n; }})()"""


def shown(browser):
    """Sequence number of the frame on the page, -1 before the first."""
    text = browser.value("document.getElementById('time').textContent")
    return int(text.rsplit(" ", 1)[1]) if text else -1


def go_to(browser, frame):
    browser.value(f"playing = false; seek({frame})")
    until(f"frame {frame} is shown", lambda: shown(browser) == frame)


def recording(browser, slipsense, predictions, out):
    view = View(slipsense, "--port", "0")
    browser.open(view.url)
    frames = len(predictions["slip"])
    until("all frames are known", lambda: browser.value("typeof marks !== 'undefined' && marks.length") == frames)
    until("it plays", lambda: 100 < shown(browser) < frames - 1)
    rate = until("the frame rate is shown", lambda: browser.value("document.getElementById('fps').textContent"))
    print(f"  two sensors: {rate}, drawn without a graphics card")

    marks = numpy.array(browser.value("Array.from(marks)"))
    require(((marks & 1) == predictions["slip"]).all() and ((marks >> 1 & 1) == predictions["may_begin"]).all(),
          f"slip and may begin of {frames} frames are where `slipsense demo` has them")
    browser.press("Home")
    browser.value("playing = false")
    go_to(browser, 0)
    browser.press("n")
    first = int(numpy.flatnonzero((marks & (2 | 8)) != 0)[0])
    until("key n", lambda: shown(browser) == first)
    require(True, f"key n goes to the first slip, frame {first}")
    slip = int(numpy.flatnonzero(predictions["slip"])[0])
    go_to(browser, slip)
    require(browser.value("document.getElementById('slip').classList.contains('on')"), f"frame {slip}: the slip lamp is on")
    go_to(browser, slip - 1)
    require(not browser.value("document.getElementById('slip').classList.contains('on')"), "and off a frame earlier")
    for key, shift, move in [("ArrowRight", False, 1), ("ArrowLeft", False, -1), ("ArrowRight", True, FRAME_RATE_HZ)]:
        before = browser.value(POSITION)
        browser.press(key, shift)
        require(browser.value(POSITION) == min(before + move, frames - 1), f"{key}{' with shift' if shift else ''}: {move:+} frames")

    go_to(browser, slip + 100)
    for canvas, sensor in [("canvas.pad", 0), ("canvas.pad", 1)]:
        require(browser.value(BRIGHT.format(canvas, sensor)) > 20, f"{canvas} {sensor} shows pressure")
    require(browser.value(BRIGHT.format("canvas.mel", 0)) > 1000, "the waterfall shows sound")
    logits = predictions["logits"][slip + 100].tolist()
    read = browser.value("record(Math.floor(position)).logits.map((x) => Math.round(x * 256))")
    require(read == [(logit + 2) >> 2 for logit in logits], f"frame {slip + 100}: logits {logits} as predicted")
    picture = out / "view.png"
    browser.picture(picture)
    print(f"  picture: {picture}")
    view.close()


def live(browser, slipsense, log):
    """A bus that ends, a server that goes away and comes back on the same port."""
    view = View(slipsense, "-", "--port", "0", stdin=subprocess.PIPE)
    port = view.url.rsplit(":", 1)[1].strip("/")
    browser.open(view.url)
    lines = log.read_text().splitlines(keepends=True)
    half = len(lines) // 2
    view.process.stdin.write("".join(lines[:half]))
    view.process.stdin.flush()
    first = until("the newest frame is shown", lambda: shown(browser) > 300 and shown(browser))
    view.process.stdin.write("".join(lines[half:]))
    view.process.stdin.flush()
    until("and the next ones", lambda: shown(browser) > first + 300)
    require(browser.value("following"), "a live bus is followed")
    view.process.stdin.close()
    connection = "document.getElementById('connection').textContent"
    until("the end is shown", lambda: "ended" in browser.value(connection))
    require(shown(browser) == 767 and browser.value("panels.length") == 2, "the last frame of the log stays on the page")
    view.close()
    until("a lost connection is shown", lambda: "no connection" in browser.value(connection))
    view = View(slipsense, "--port", port)
    until("the page comes back", lambda: browser.value(connection) == "" and browser.value("state.name") == "bundled episode")
    until("and draws", lambda: shown(browser) > 0)
    require(True, "the stream's end, a lost server and its return")
    view.close()


def main():
    slipsense, predictions, log, out = sys.argv[1], numpy.load(sys.argv[2]), pathlib.Path(sys.argv[3]), pathlib.Path(sys.argv[4])
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(folder)
        try:
            recording(browser, slipsense, predictions, out)
            live(browser, slipsense, log)
            require(not browser.errors, f"no script failed: {browser.errors}")
        finally:
            browser.close()


if __name__ == "__main__":
    main()
