#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""stratalux-db serve in headless Chromium: what a person sees, with mouse, with keyboard alone, and by axe's rules."""
import argparse
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
import zlib

import browser

OPTIONS = None

REPORT = """<!doctype html><html lang="en"><head><title>Report</title><style>p { color: #123 }</style></head><body>
<h1>Report</h1><p id="said">not run</p><p id="reached">nothing</p><script>
document.getElementById('said').textContent = 'run';
fetch('/sessions').then(() => { document.getElementById('reached').textContent = 'the server'; }, () => {});
try { document.cookie; document.getElementById('reached').textContent = 'cookies'; } catch (error) {}
</script></body></html>"""


def write_png(path, width, height, level):
    rows = b"".join(b"\0" + bytes((x * level // width + y) % 256 for x in range(width)) for y in range(height))
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
                   chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


class Store:
    """Two rigs, a visitor, hostile names, a fit with a report."""

    def __init__(self, folder):
        self.folder = os.path.join(folder, "store")
        self.pictures = os.path.join(folder, "pictures")
        os.makedirs(self.pictures)
        self.run("init")
        for number in range(4):
            write_png(os.path.join(self.pictures, f"g{number}.png"), 64, 48, 60 * number + 40)
        self.run("consent", "give", "--visitor", "v-5f3a91c2", "--text-version", "2026-03", "--language", "de",
                 "--scope", "fit,research")
        self.visit = self.take("visitor", "kiosk-1", 'visitor = "v-5f3a91c2"')
        self.hostile = self.take("calibration", "<img src=x onerror=alert(1)>")
        fit = os.path.join(self.folder, "sessions", self.visit, "fits", "f1", "report")
        os.makedirs(fit)
        with open(os.path.join(fit, "index.html"), "w", encoding="utf-8") as file:
            file.write(REPORT)
        with open(os.path.join(fit, "..", "metrics.json"), "w", encoding="utf-8") as file:
            file.write('{"fit": {"divergence": 0.5, "pixels": 10}}')
        self.run("reindex")

    def run(self, *arguments):
        return subprocess.run([OPTIONS.program, *arguments, "--store", self.folder], check=True, timeout=120,
                              capture_output=True, text=True).stdout

    def take(self, kind, rig, more=""):
        manifest = os.path.join(self.pictures, "m.toml")
        with open(manifest, "w", encoding="utf-8") as file:
            file.write(f"""[import]
rig = "{rig}"
kind = "{kind}"
{more}
camera_width = 64
camera_height = 48
bit_depth = 8
projector_width = 64
projector_height = 48
[[file]]
sequence = "g#.png"
first = 0
patterns = ["gray columns bit=0/6", "gray columns bit=0/6 inverse", "gray columns bit=1/6", "white"]
""")
        self.run("import", "--manifest", manifest)
        return json.loads(self.run("ls", "--limit", "1", "--json"))[0]["session"]


class Pages(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp(prefix="stratalux-web-")
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        cls.store = Store(cls.folder)
        cls.server = subprocess.Popen([OPTIONS.program, "serve", "--store", cls.store.folder, "--json", "--no-open"],
                                      stdout=subprocess.PIPE, text=True)
        cls.addClassCleanup(cls.end_server)
        text = ""
        while not text.rstrip().endswith("}"):
            line = cls.server.stdout.readline()
            assert line, "the server ended before it said where it is"
            text += line
        cls.link = json.loads(text)["url"]
        cls.base = cls.link.split("/?")[0]
        cls.browser = browser.open_chromium(cls.folder)
        cls.addClassCleanup(cls.browser.quit)
        cls.browser.get(cls.link)

    @classmethod
    def end_server(cls):
        cls.server.terminate()
        cls.ended = cls.server.wait(timeout=20)
        cls.server.stdout.close()
        assert cls.ended == 0, cls.ended

    def open(self, place):
        self.browser.get(self.base + place)
        return self.browser.find_element("tag name", "body").text

    # A click or a key begins to go somewhere; the page before is still there for a while.
    def arrive(self, is_there):
        from selenium.webdriver.support.ui import WebDriverWait
        WebDriverWait(self.browser, 30).until(
            lambda b: is_there(b.current_url) and b.execute_script("return document.readyState") == "complete")

    def complaints(self):
        return browser.complaints(self.browser)

    def places(self):
        visit, hostile = self.store.visit, self.store.hostile
        queries = [name["query"] if "query" in name else name["name"] for name in
                   json.loads(self.store.run("query", "--list", "--json"))]
        return ["/", "/sessions", f"/sessions/{visit}", f"/sessions/{hostile}", f"/sessions/{visit}/frames",
                f"/sessions/{visit}/frames/0", f"/sessions/{visit}/fits/f1", "/queries", "/consent",
                "/deletions"] + [f"/queries/{name}" for name in queries]

    def test_the_link_leaves_no_token_in_the_address(self):
        self.open("/")
        self.assertNotIn("token", self.browser.current_url)
        self.assertEqual([], [c for c in self.browser.execute_script("return document.cookie").split(";") if c])

    def test_pages_load_without_a_complaint_of_the_browser(self):
        self.complaints()
        for place in self.places():
            self.assertIn("Stratalux store", self.open(place), place)
            self.assertEqual([], self.complaints(), place)

    def violations(self, axe):
        return browser.violations(self.browser, axe)

    def test_axe_finds_nothing(self):
        with open(OPTIONS.axe, encoding="utf-8") as file:
            axe = file.read()
        self.open("/sessions")
        self.browser.execute_script("document.querySelector('label').remove()")
        self.assertIn("select-name", "".join(self.violations(axe)), "axe would find nothing anywhere")
        for scheme in ("light", "dark"):
            browser.media(self.browser, prefers_color_scheme=scheme)
            for place in self.places():
                self.open(place)
                self.assertEqual([], self.violations(axe), f"{place}, {scheme}")
        browser.media(self.browser)

    def test_filters_choose_sessions(self):
        from selenium.webdriver.support.ui import Select
        self.open("/sessions")
        self.assertEqual(2, len(self.browser.find_elements("css selector", "tbody tr")))
        Select(self.browser.find_element("id", "kind")).select_by_visible_text("visitor")
        self.browser.find_element("css selector", "button[type=submit]").click()
        self.arrive(lambda url: "kind=visitor" in url)
        rows = self.browser.find_elements("css selector", "tbody tr")
        self.assertEqual(1, len(rows))
        self.assertIn(self.store.visit, rows[0].text)
        self.assertEqual("visitor", Select(self.browser.find_element("id", "kind")).first_selected_option.text)

    def test_thumbnails_appear(self):
        from selenium.webdriver.support.ui import WebDriverWait
        for place in ("/sessions", f"/sessions/{self.store.visit}/frames", f"/sessions/{self.store.visit}/frames/0"):
            self.open(place)
            WebDriverWait(self.browser, 30).until(lambda b: b.execute_script(
                "const all = [...document.images]; return all.length > 0 && all.every(i => i.complete);"))
            self.assertTrue(self.browser.execute_script("return [...document.images].every(i => i.naturalWidth >= 32)"),
                            place)

    def test_hostile_names_are_text(self):
        text = self.open("/sessions")
        self.assertIn("<img src=x onerror=alert(1)>", text)
        self.assertEqual([], self.browser.find_elements("css selector", "img[src=x]"))

    def follow(self, href):
        from selenium.webdriver.common.keys import Keys
        reached = browser.press_until(self.browser, Keys.TAB, lambda e: (e.get_attribute("href") or "").endswith(href))
        self.assertTrue(reached, f"the keyboard does not get to {href}")
        browser.press(self.browser, Keys.ENTER)
        self.arrive(lambda url: url.endswith(href))

    def test_the_keyboard_alone_opens_a_session_and_its_report(self):
        self.open("/")
        place = f"/sessions/{self.store.visit}"
        for href in ("/sessions", place, f"{place}/fits/f1", f"{place}/fits/f1/files/report/index.html"):
            self.follow(href)
        self.assertEqual("Report", self.browser.find_element("tag name", "h1").text)

    def test_a_report_runs_by_itself_and_reaches_nothing(self):
        import time
        self.open(f"/sessions/{self.store.visit}/fits/f1/files/report/index.html")
        self.assertEqual("run", self.browser.find_element("id", "said").text)
        time.sleep(0.5)
        self.assertEqual("nothing", self.browser.find_element("id", "reached").text)
        self.complaints()

    def test_a_narrow_window_scrolls_in_one_direction(self):
        self.browser.set_window_size(500, 900)
        for place in self.places():
            self.open(place)
            wide = self.browser.execute_script(
                "return document.documentElement.scrollWidth - document.documentElement.clientWidth")
            self.assertLessEqual(wide, 0, place)
        self.browser.set_window_size(1280, 900)


def main():
    global OPTIONS
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", required=True)
    parser.add_argument("--axe", required=True)
    OPTIONS, rest = parser.parse_known_args()
    if shutil.which("chromium") is None:
        print("skipped: no chromium; scripts/install-deps.sh installs it")
        return browser.SKIPPED
    return 0 if unittest.main(argv=[sys.argv[0], *rest], exit=False, verbosity=2).result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
