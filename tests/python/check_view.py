"""The live page in a headless Chromium: served by `slipsense view`, and as one file with the pipeline as WebAssembly.

    check_view.py SLIPSENSE PAGE.html EPISODE.npz CAN.log MODEL.slipnet OUT_DIR

SLIPSENSE is the command, PAGE.html what `cargo xtask web` made, EPISODE.npz the bundled episode, CAN.log what `demo` wrote
about it. Pictures of the page go into OUT_DIR. The browser is driven by its own remote debugging protocol. Times are printed,
not checked: they belong to the computer.
"""

import atexit
import base64
import json
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request
import zipfile

import numpy
import websocket

from checks import require

CHROMIUM = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            "--window-size=1280,1000", "--remote-debugging-port=0", "--remote-allow-origins=*"]
TIMEOUT_S = 60
FRAME_RATE_HZ = 240
PAGE_BYTES_MAX = 3e6


def until(what, answer, pause_s=0.1):
    """The first answer that is true."""
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end:
        found = answer()
        if found:
            return found
        time.sleep(pause_s)
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
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            sys.exit(f"error: {expression}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def open(self, url):
        """Go to a page, whose elements are there afterwards."""
        self.call("Page.navigate", url=url)
        loaded = f"document.readyState == 'complete' && location.href.startsWith({json.dumps(url)})"
        until(f"{url} is loaded", lambda: self.value(loaded))

    def drop(self, *files):
        """Drop files, each a name and bytes, on the page."""
        made = ", ".join(f"new File([Uint8Array.fromBase64({json.dumps(base64.b64encode(data).decode())})], {json.dumps(name)})"
                         for name, data in files)
        self.value(f"""(() => {{ const dataTransfer = new DataTransfer();
          for (const file of [{made}]) dataTransfer.items.add(file);
          document.dispatchEvent(new DragEvent("drop", {{ dataTransfer, cancelable: true }})); }})()""")

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
        atexit.register(self.process.kill)
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
    text = browser.value("document.querySelector('.time')?.textContent ?? ''")
    return int(text.rsplit(" ", 1)[1]) if text else -1


def go_to(browser, frame):
    browser.value(f"playing = false; goTo({frame})")
    until(f"frame {frame} is shown", lambda: shown(browser) == frame)


def is_on(browser, lamp, session=0):
    return browser.value(f"sessions[{session}].$('{lamp}').classList.contains('on')")


def all_known(browser, frames):
    until("all frames are known", lambda: browser.value("sessions.length && sessions[0].marks.length") == frames)


def recording(browser, slipsense, predictions, out):
    view = View(slipsense, "--port", "0")
    browser.open(view.url)
    frames = len(predictions["slip"])
    all_known(browser, frames)
    until("it plays", lambda: 100 < shown(browser) < frames - 1)

    marks = numpy.array(browser.value("Array.from(sessions[0].marks)"))
    require(((marks & 1) == predictions["slip"]).all() and ((marks >> 1 & 1) == predictions["may_begin"]).all()
            and ((marks >> 4 & 3) == predictions["class"]).all(),
            f"slip, may begin and class of {frames} frames are where `slipsense run` has them")
    browser.press("Home")
    browser.value("playing = false")
    go_to(browser, 0)
    events = browser.value("Array.from(sessions[0].events.options, (event) => Number(event.value))")
    edges = sorted(int(start) for bit in (1, 2, 8, 64)
                   for start in numpy.flatnonzero(numpy.diff((marks & bit) != 0, prepend=False) & ((marks & bit) != 0)))
    require(events == edges, f"the list has all {len(edges)} events: true slips, may begin, slip, faults")
    browser.press("n")
    until("key n", lambda: shown(browser) == edges[0])
    browser.value("sessions[0].events.selectedIndex = 2; sessions[0].events.dispatchEvent(new Event('change'))")
    until("a click on an event", lambda: shown(browser) == edges[2])
    require(True, f"key n goes to the first event, frame {edges[0]}; a click on the third one to frame {edges[2]}")
    slip = int(numpy.flatnonzero(predictions["slip"])[0])
    go_to(browser, slip)
    require(is_on(browser, "slip"), f"frame {slip}: the slip lamp is on")
    go_to(browser, slip - 1)
    require(not is_on(browser, "slip"), "and off a frame earlier")
    for key, shift, move in [("ArrowRight", False, 1), ("ArrowLeft", False, -1), ("ArrowRight", True, FRAME_RATE_HZ)]:
        before = browser.value(POSITION)
        browser.press(key, shift)
        require(browser.value(POSITION) == min(before + move, frames - 1), f"{key}{' with shift' if shift else ''}: {move:+} frames")

    go_to(browser, slip + 100)
    for canvas, sensor in [("canvas.pad", 0), ("canvas.pad", 1)]:
        require(browser.value(BRIGHT.format(canvas, sensor)) > 20, f"{canvas} {sensor} shows pressure")
    require(browser.value(BRIGHT.format("canvas.mel", 0)) > 1000, "the waterfall shows sound")
    require(browser.value("document.querySelector('.health').textContent") == "healthy", "sensor 1 is healthy")
    picture = out / "view.png"
    browser.picture(picture)
    print(f"  picture: {picture}")
    records = b"".join(urllib.request.urlopen(f"{view.url}0/records?from={first}").read()
                       for first in range(0, frames, FRAME_RATE_HZ))
    view.close()
    return records


def repeated(path, episode, sensors, seconds):
    """An episode repeated for `seconds`, its first sensor as all of `sensors`."""
    arrays = numpy.load(episode)
    piezo, xl, xl_end = (numpy.take(arrays[name], [0] * sensors, axis) for name, axis in [("piezo", 1), ("xl", 0), ("xl_end", 1)])
    times = -(-seconds * FRAME_RATE_HZ // len(piezo))
    samples = xl.shape[1]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        def write(name, shape, dtype, blocks):
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                numpy.lib.format.write_array_header_1_0(
                    entry, {"descr": numpy.dtype(dtype).str, "fortran_order": False, "shape": shape})
                for block in blocks:
                    entry.write(numpy.ascontiguousarray(block, dtype).tobytes())
        write("piezo", (times * len(piezo), *piezo.shape[1:]), "<u2", (piezo for _ in range(times)))
        write("xl", (sensors, times * samples, 3), "<i2", (of_one for of_one in xl for _ in range(times)))
        write("xl_end", (times * len(xl_end), sensors), "<u4", (xl_end + time * samples for time in range(times)))
        write("meta", arrays["meta"].shape, "|u1", [arrays["meta"]])
    return times * len(piezo)


def figures(browser, slipsense, episode, out):
    """Pictures a second with three sensors, and how long an hour takes to open."""
    path = out / "repeated.npz"
    repeated(path, episode, 3, 20)
    view = View(slipsense, str(path), "--port", "0")
    browser.open(view.url)
    until("three sensors are shown", lambda: shown(browser) > FRAME_RATE_HZ and browser.value("sessions[0].panels.length") == 3)
    browser.value("document.getElementById('fps').textContent = ''")
    rate = until("the rate is shown", lambda: browser.value("document.getElementById('fps').textContent"))
    print(f"  three sensors: {rate}, drawn without a graphics card")
    browser.picture(out / "three.png")
    for sensors in [3, 1]:
        view.close()
        frames = repeated(path, episode, sensors, 3600)
        start = time.monotonic()
        view = View(slipsense, str(path), "--port", "0")
        browser.open(view.url)
        until("the first picture", lambda: shown(browser) > 0, 0.02)
        print(f"  an hour, sensors: {sensors}, {path.stat().st_size / 1e6:.0f} MB: {time.monotonic() - start:.2f} s from the "
              f"command to a picture that moves, {browser.value('sessions[0].marks.length')} of {frames} frames decided by then")
    until("more than a minute is known", lambda: browser.value("sessions[0].marks.length") > 90 * FRAME_RATE_HZ)
    go_to(browser, 70 * FRAME_RATE_HZ)
    require(not browser.value("sessions[0].$('minute').parentElement.hidden")
            and browser.value(BRIGHT.format("canvas.minute", 0)) > 1000, "the last minute has its strip")
    browser.picture(out / "hour.png")
    view.close()
    path.unlink()


# All records of a session, Base64.
RECORDS = """(async () => { let all = []; const { end, chunk } = sessions[0].state;
  for (let first = 0; first < end; first += chunk) all.push(new Uint8Array((await sessions[0].get(`records?from=${first}`)).buffer));
  return new Uint8Array(await new Blob(all).arrayBuffer()).toBase64(); })()"""
# Milliseconds that the pipeline takes for an episode.
SPEED = """(async () => { const get = await fromFile(files.recordings[0], null, 42), start = performance.now();
  for (;;) { const state = JSON.parse(new TextDecoder().decode((await get("state")).buffer));
    if (state.ended) return performance.now() - start; } })()"""


def without_server(browser, page, episode, model, predictions, records, log, out):
    """The page as a file: the pipeline runs in the browser."""
    require(page.stat().st_size < PAGE_BYTES_MAX, f"the page without a server: {page.stat().st_size / 1e6:.2f} MB")
    browser.open(page.as_uri())
    browser.drop(("episode.npz", episode.read_bytes()))
    frames = len(predictions["slip"])
    all_known(browser, frames)
    own = base64.b64decode(browser.value(RECORDS))
    size = len(own) // frames
    rows = numpy.frombuffer(own, numpy.uint8).reshape(frames, size)
    logits = rows[:, 20:32].copy().view("<i4")
    require((logits == predictions["logits"]).all(), f"WebAssembly: {3 * frames} logits are those of `slipsense run`")
    require((rows[:, 17] & 1 == predictions["slip"]).all() and (rows[:, 17] >> 1 & 1 == predictions["may_begin"]).all()
            and (rows[:, 16] == predictions["class"]).all(), f"WebAssembly: flags and class of {frames} frames too")
    require(own == records, f"WebAssembly: maps, log-mel and all else in {len(own)} bytes are those of `slipsense view`")
    speed = frames / FRAME_RATE_HZ / (browser.value(SPEED) / 1e3)
    require(speed > 1, f"WebAssembly: the episode of two sensors {speed:.0f} times faster than it was recorded")

    problem = "document.getElementById('problem').textContent"
    broken = bytearray(model.read_bytes())
    broken[8] ^= 1
    for name, data, said in [("notes.txt", b"hello\n", "line 1"), ("cut.npz", episode.read_bytes()[:5000], "cut short"),
                             ("other.slipnet", bytes(broken), "other.slipnet"), ("grasp.mcap", b"\x89MCAP0\r\n", "convert")]:
        browser.drop((name, data))
        shown_problem = f"{problem} || sessions[0].state?.problem"
        until(f"{name} is refused", lambda: said in (browser.value(shown_problem) or ""))
        print(f"  {name}: {browser.value(shown_problem)}")
    browser.drop(("episode.npz", episode.read_bytes()), ("mine.slipnet", model.read_bytes()))
    until("two networks side by side", lambda: browser.value("sessions.length == 2 && sessions[1].marks.length") == frames)
    require(browser.value("document.getElementById('problem').hidden"), "no problem is left")
    slip = int(numpy.flatnonzero(predictions["slip"])[0])
    go_to(browser, slip)
    require(is_on(browser, "slip") and is_on(browser, "slip", 1), "two networks side by side show the same frame")
    browser.picture(out / "two.png")
    browser.drop(("can.log", log.read_bytes()))
    all_known(browser, frames)
    require(True, "a candump log without a server")


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
    connection = "sessions[0].$('problem').textContent"
    until("the end is shown", lambda: "ended" in browser.value(connection))
    until("the last frame of the log is shown", lambda: shown(browser) == 767)
    require(browser.value("sessions[0].panels.length") == 2, "the last frame of the log stays on the page")
    view.close()
    until("a lost connection is shown", lambda: "no connection" in browser.value(connection))
    view = View(slipsense, "--port", port)
    until("the page comes back", lambda: browser.value(connection) == "" and browser.value("sessions[0].state.name") == "bundled episode")
    until("and draws", lambda: shown(browser) > 0)
    require(True, "the stream's end, a lost server and its return")
    view.close()


def main():
    slipsense, *paths = sys.argv[1:]
    page, episode, log, model, out = (pathlib.Path(path).resolve() for path in paths)
    subprocess.run([slipsense, "run", episode, "--out", out / "run"], check=True, stdout=subprocess.DEVNULL)
    predictions = numpy.load(out / "run/predictions.npz")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(folder)
        try:
            records = recording(browser, slipsense, predictions, out)
            live(browser, slipsense, log)
            without_server(browser, page, episode, model, predictions, records, log, out)
            figures(browser, slipsense, episode, out)
            require(not browser.errors, f"no script failed: {browser.errors}")
        finally:
            browser.close()


if __name__ == "__main__":
    main()
