#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The page of `stratalux-rig preview` in headless Chromium, on the simulated rig: pictures, light, E-STOP, axe's rules."""
import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest

import browser

OPTIONS = None


class Preview(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp(prefix="stratalux-preview-")
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        os.makedirs(OPTIONS.pictures, exist_ok=True)
        with open(OPTIONS.axe, encoding="utf-8") as file:
            cls.axe = file.read()
        cls.browser = browser.open_chromium(cls.folder, "1280,980")
        cls.addClassCleanup(cls.browser.quit)

    def setUp(self):
        self.events = os.path.join(self.folder, "events")
        self.program = subprocess.Popen(
            [OPTIONS.program, "preview", f"--simulate={OPTIONS.scene}", "--no-scattering", "--size", OPTIONS.size,
             "--simulate-events", self.events],
            stdout=subprocess.PIPE, text=True, env={**os.environ, "STATE_DIRECTORY": "/nonexistent"})
        self.addCleanup(self.end)
        self.browser.get(json.loads(self.program.stdout.readline())["page"])
        self.until("document.getElementById('picture').naturalWidth > 0", "a picture")
        browser.complaints(self.browser)

    def end(self):
        self.program.send_signal(signal.SIGINT)
        self.assertEqual(0, self.program.wait(timeout=30))
        self.program.stdout.close()

    def until(self, condition, what, seconds=60):
        from selenium.webdriver.support.ui import WebDriverWait
        WebDriverWait(self.browser, seconds, 0.05).until(lambda b: b.execute_script(f"return {condition}"), what)

    def click(self, css):
        self.browser.find_element("css selector", css).click()

    def happen(self, line):
        with open(self.events, "w", encoding="utf-8") as fifo:
            fifo.write(line + "\n")

    def look(self, name):
        self.assertEqual([], browser.violations(self.browser, self.axe), name)
        self.assertEqual([], browser.complaints(self.browser), name)
        text = self.browser.execute_script("return document.body.innerText")
        for wrong in ("undefined", "NaN", "[object"):
            self.assertNotIn(wrong, text, name)
        browser.picture(self.browser, OPTIONS.pictures, name)

    def test_light_exposure_and_figures(self):
        number = lambda name: f"parseFloat(document.getElementById('{name}').textContent)"
        self.click("#light input[value='0']")
        self.until(f"{number('bright')} > 10", "lit")
        self.browser.execute_script(f"window.before = {number('bright')}")
        field = self.browser.find_element("id", "exposure")
        field.clear()
        field.send_keys("8")
        self.click("#expose button")
        self.until(f"Math.abs({number('bright')} / window.before - 0.5) < 0.15", "half the exposure, half the light")
        self.until(f"{number('best')} >= {number('focus')} && {number('focus')} > 0", "sharpness")
        # The cross and the frame of the figures lie on the picture itself.
        self.assertLess(self.browser.execute_script("""
            const picture = document.getElementById('picture'), place = picture.getBoundingClientRect();
            return Math.abs(place.width / place.height / (picture.naturalWidth / picture.naturalHeight) - 1);"""), 0.01)
        self.look("preview-lit")
        field.clear()
        field.send_keys("5000")
        self.click("#expose button")
        self.until("document.getElementById('refused').textContent.includes('the exposure must be in')", "refused")
        # The next pictures do not take it away; the next choice does.
        self.browser.execute_script("window.seen = document.getElementById('picture').src")
        self.until("document.getElementById('picture').src !== window.seen", "another picture")
        self.assertIn("the exposure must be in", self.browser.find_element("id", "refused").text)
        browser.complaints(self.browser)
        field.clear()
        field.send_keys("8")
        self.click("#expose button")
        self.until("document.getElementById('refused').textContent === ''", "a choice that holds")

    def test_emergency_stop_is_said_and_reset(self):
        self.click("#light input[value='1']")
        self.happen("estop press")
        self.until("document.getElementById('why').textContent.includes('emergency stop')", "said")
        self.until("document.querySelector('#light input[value=\"1\"]').disabled", "cannot be lit")
        self.look("preview-stopped")
        self.happen("estop release")
        self.click("#reset")
        self.until("document.getElementById('reset').hidden && document.querySelector('#light input[value=\"-1\"]').checked",
                   "reset, dark")


def main():
    global OPTIONS
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", required=True, help="stratalux-rig")
    parser.add_argument("--axe", required=True)
    parser.add_argument("--pictures", required=True, help="folder of the screenshots")
    parser.add_argument("--scene", default="plane")
    parser.add_argument("--size", default="348x260")
    OPTIONS, rest = parser.parse_known_args()
    if shutil.which("chromium") is None:
        print("skipped: no chromium; scripts/install-deps.sh installs it")
        return browser.SKIPPED
    return 0 if unittest.main(argv=[sys.argv[0], *rest], exit=False, verbosity=2).result.wasSuccessful() else 1


if __name__ == "__main__":
    sys.exit(main())
