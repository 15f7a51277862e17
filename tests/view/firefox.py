#!/usr/bin/env python3
"""Flies through the page of `srnerf-dag view` in a headless Firefox, Debian's, by its own remote protocol (Marionette).

    python firefox.py SAID [FOLDER]

SAID is what `view --json` printed. With FOLDER, a screenshot is left there.
"""

import base64
import json
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PORT = 2828
SHARP = "return document.body.dataset.fine === '1/1x2'"
PAINTED = "return document.getElementById('main').toDataURL()"


class Firefox:
    """A browser that does what it is told: a length, a colon, and JSON, each way."""

    def __init__(self, profile):
        command = ["firefox-esr", "--headless", "--marionette", "--profile", profile, "--no-remote"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.socket = self.connect()
        self.rest = b""
        self.receive()
        self.number = 0
        self.tell("WebDriver:NewSession", {})

    @staticmethod
    def connect():
        for _ in range(600):
            try:
                return socket.create_connection(("127.0.0.1", PORT), timeout=180)
            except OSError:
                time.sleep(0.2)
        raise AssertionError("Firefox does not answer")

    def tell(self, command, parameters):
        self.number += 1
        message = json.dumps([0, self.number, command, parameters]).encode()
        self.socket.sendall(b"%d:%s" % (len(message), message))
        _, number, error, result = self.receive()
        assert number == self.number and not error, error
        return result

    def receive(self):
        while b":" not in self.rest:
            self.rest += self.socket.recv(1 << 16)
        length, self.rest = self.rest.split(b":", 1)
        while len(self.rest) < int(length):
            self.rest += self.socket.recv(1 << 16)
        message, self.rest = self.rest[: int(length)], self.rest[int(length) :]
        return json.loads(message)

    def ask(self, script):
        return self.tell("WebDriver:ExecuteScript", {"script": script, "args": []})["value"]

    def press(self, key, seconds=0):
        pause = {"type": "pause", "duration": int(1000 * seconds)}
        keys = [{"type": "keyDown", "value": key}, pause, {"type": "keyUp", "value": key}]
        self.tell("WebDriver:PerformActions", {"actions": [{"type": "key", "id": "keys", "actions": keys}]})

    def drag(self, start, end):
        moves = [("pointerMove", start), ("pointerDown", None), ("pointerMove", end), ("pointerUp", None)]
        steps = [
            {"type": kind, "button": 0} if spot is None else {"type": kind, "x": spot[0], "y": spot[1], "duration": 300}
            for kind, spot in moves
        ]
        self.tell("WebDriver:PerformActions", {"actions": [{"type": "pointer", "id": "mouse", "actions": steps}]})

    def quit(self):
        self.tell("Marionette:Quit", {"flags": ["eForceQuit"]})
        self.process.wait(60)


def main(said, folder=None):
    url = json.loads(Path(said).read_text())["url"]
    with tempfile.TemporaryDirectory() as profile:
        firefox = Firefox(profile)
        try:
            fly_around(firefox, url)
            if folder:
                shot = firefox.tell("WebDriver:TakeScreenshot", {"full": True})["value"]
                Path(folder, "view_firefox.png").write_bytes(base64.b64decode(shot))
        finally:
            firefox.quit()


def fly_around(firefox, url):
    firefox.tell("WebDriver:Navigate", {"url": url})
    firefox.ask("window.wrong = []; addEventListener('error', (event) => window.wrong.push(event.message))")
    firefox.ask("const size = document.getElementById('size'); size.value = 160; size.dispatchEvent(new Event('change'))")
    sharp(firefox)

    def changes(what, act):
        before = firefox.ask(PAINTED)
        act()
        sharp(firefox)
        assert firefox.ask(PAINTED) != before, f"{what} changes nothing"

    firefox.ask("document.getElementById('main').focus()")
    left, top, width, height = firefox.ask(
        "const box = document.getElementById('main').getBoundingClientRect(); return [box.x, box.y, box.width, box.height]"
    )

    def at(across, down):
        return int(left + across * width), int(top + down * height)

    changes("the wipe", lambda: firefox.drag(at(0.5, 0.5), at(0.3, 0.5)))
    changes("depth", lambda: firefox.press("2"))
    changes("colour", lambda: firefox.press("1"))
    changes("orbiting", lambda: firefox.drag(at(0.7, 0.5), at(0.75, 0.45)))
    changes("flying", lambda: firefox.press("w", 0.5))
    changes("cameras", lambda: firefox.press("v"))
    changes("a photo", lambda: firefox.press("]"))
    assert firefox.ask("return document.getElementById('readout').textContent").count("|") >= 3
    assert firefox.ask("return window.wrong") == []


def sharp(firefox):
    time.sleep(0.3)
    for _ in range(1200):
        if firefox.ask(SHARP):
            return time.sleep(0.2)
        time.sleep(0.1)
    raise AssertionError(firefox.ask("return document.getElementById('readout').textContent"))


if __name__ == "__main__":
    main(*sys.argv[1:])
