#!/usr/bin/env python3
"""Flies through the page of `srnerf-dag view` in a headless Chromium, and fails on any message of the console.

    python click.py SAID [FOLDER]

SAID is what `view --json` printed. The path that is recorded is left as transforms.json. Needs Playwright for Python and
Debian's chromium. With FOLDER, screenshots at 390 and 1440 pixels are left there, and how fast it was is said.
"""

import json
import sys
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

PAINTED = """() => document.getElementById("main").toDataURL()"""
SHARP = """() => document.body.dataset.fine === "1/1x2" """


def main(said, folder=None):
    url = json.loads(Path(said).read_text())["url"]
    complaints = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        for width, height in ((390, 844), (1440, 900)):
            context = browser.new_context(viewport={"width": width, "height": height}, has_touch=width < 500)
            context.grant_permissions(["clipboard-read", "clipboard-write"])
            page = context.new_page()
            page.on("console", lambda message: complaints.append(message.text))
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", lambda request: complaints.append(request.url) if elsewhere(request.url, url) else None)
            page.goto(url)
            page.select_option("#size", "160")
            fly_around(page, lambda name: shoot(page, folder, f"{name}_{width}"))
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"the page is {wide} pixels wide on a screen of {width}"
            if folder and width > 1000:
                measure(page)
            context.close()
        stranger(browser, url)
        browser.close()
    assert not complaints, complaints


def elsewhere(address, url):
    return not address.startswith((url, "blob:", "data:"))


def shoot(page, folder, name):
    if folder:
        page.evaluate("scrollTo(0, 0)")
        page.screenshot(path=str(Path(folder) / f"view_{name}.png"), full_page=True)


def fly_around(page, shoot):
    sharp(page)
    canvas = page.locator("#main")
    canvas.focus()
    box = canvas.bounding_box()

    def at(across, down):
        return box["x"] + across * box["width"], box["y"] + down * box["height"]

    def changes(what, act):
        before = page.evaluate(PAINTED)
        act()
        sharp(page)
        page.wait_for_timeout(100)
        assert page.evaluate(PAINTED) != before, f"{what} changes nothing"

    def drag(start, end, button="left"):
        page.mouse.move(*at(*start))
        page.mouse.down(button=button)
        page.mouse.move(*at(*end), steps=8)
        page.mouse.up(button=button)

    shoot("first")
    changes("the wipe", lambda: drag((0.5, 0.5), (0.3, 0.5)))
    changes("the photo", lambda: page.select_option("#b", "photo"))
    shoot("photo")
    changes("the other field", lambda: page.select_option("#b", "1"))
    canvas.focus()
    changes("holding the space bar", lambda: page.keyboard.down(" "))
    changes("letting it go", lambda: page.keyboard.up(" "))
    for key, name in (("2", "depth"), ("3", "opacity"), ("4", "normals"), ("1", "color")):
        changes(name, lambda: page.keyboard.press(key))
        assert page.input_value("#show") == name
        shoot(name)
    changes("orbiting", lambda: drag((0.7, 0.5), (0.85, 0.4)))
    assert page.input_value("#photo") == "", "it stands at no photo any more"
    shoot("orbit")
    changes("the wheel", lambda: page.mouse.wheel(0, 1000))
    changes("moving aside", lambda: drag((0.7, 0.5), (0.65, 0.55), "right"))
    changes("cameras", lambda: page.keyboard.press("v"))
    shoot("cameras")
    jump(page, canvas)
    # From one photo's place the others may all be out of sight, so the picture may stay as it is.
    page.keyboard.press("v")
    assert page.get_attribute("#frusta", "aria-pressed") == "false"
    changes("the next photo", lambda: page.keyboard.press("]"))
    copied(page)
    record(page, changes)
    changes("going back", lambda: page.click("#reset"))
    if page.evaluate("navigator.maxTouchPoints"):
        changes("a finger", lambda: touch(page, at))


def sharp(page):
    page.wait_for_timeout(50)
    page.wait_for_function(SHARP, timeout=120_000)


def jump(page, canvas):
    """Clicks about until a camera is hit."""
    box = canvas.bounding_box()
    for down in range(1, 20):
        for across in range(1, 20):
            page.mouse.click(box["x"] + across / 20 * box["width"], box["y"] + down / 20 * box["height"])
            if page.input_value("#photo"):
                return sharp(page)
    raise AssertionError("no camera can be clicked on")


def copied(page):
    page.keyboard.press("c")
    page.wait_for_timeout(200)
    rows = json.loads(page.evaluate("navigator.clipboard.readText()"))
    assert [len(row) for row in rows] == [4] * 4 and rows[3] == [0, 0, 0, 1], rows


def record(page, changes):
    page.locator("#main").focus()
    page.keyboard.press("r")
    changes("flying", lambda: page.keyboard.press("w", delay=700))
    changes("turning", lambda: page.keyboard.press("ArrowRight", delay=700))
    with page.expect_download() as download:
        page.keyboard.press("r")
    download.value.save_as("transforms.json")
    frames = json.loads(Path("transforms.json").read_text())["frames"]
    places = {json.dumps(frame["transform_matrix"]) for frame in frames}
    assert len(frames) > 5 and len(places) > 3, (len(frames), len(places))


def touch(page, at):
    session = page.context.new_cdp_session(page)

    def send(kind, points):
        points = [{"x": x, "y": y} for x, y in points]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    send("touchStart", [at(0.7, 0.5)])
    for step in range(1, 6):
        send("touchMove", [at(0.7 + 0.02 * step, 0.5)])
    send("touchEnd", [])
    send("touchStart", [at(0.4, 0.5), at(0.6, 0.5)])
    for step in range(1, 6):
        send("touchMove", [at(0.4 - 0.02 * step, 0.5), at(0.6 + 0.02 * step, 0.5)])
    send("touchEnd", [])


def measure(page):
    page.select_option("#b", "none")
    for size in ("160", "640"):
        page.select_option("#size", size)
        sharp(page)
        begun = time.monotonic()
        page.click("#reset")
        sharp(page)
        seconds = time.monotonic() - begun
        said = []
        page.locator("#main").focus()
        page.keyboard.down("ArrowRight")
        for _ in range(30):
            page.wait_for_timeout(100)
            said.append(page.inner_text("#readout"))
        page.keyboard.up("ArrowRight")
        sharp(page)
        print(f"{size} pixels wide: sharp after {seconds:.2f} s; on the way {said[-1]}; then {page.inner_text('#readout')}")


def stranger(browser, url):
    """Without the token there is nothing."""
    page = browser.new_page()
    answer = page.request.get(url[:-4] + "/")
    assert answer.status == 404 and answer.body() == b"", answer.status
    page.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
