#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The visitor's screen as stratalux-display.service shows it: its own command, cage and Chromium, on a virtual display; a
controller that dies and comes back, a browser that dies."""
import argparse
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request

import browser

OPTIONS = None
SIZE = "1024x768"  # of the window in which cage's X11 back-end shows its output
ACCOUNT = "nobody"  # cage refuses to run as root


def setting(unit, name):
    """The last of that name in a unit's file."""
    with open(unit, encoding="utf-8") as file:
        return [line.split("=", 1)[1].strip() for line in file if line.startswith(name + "=")][-1]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def children(pid):
    with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
        return [int(child) for child in file.read().split()]


class Display(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="stratalux-display-")
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        os.chmod(self.folder, 0o755)
        self.runtime = os.path.join(self.folder, "run")
        os.mkdir(self.runtime, 0o700)
        self.account = []
        if os.getuid() == 0:
            shutil.chown(self.runtime, ACCOUNT)
            self.account = ["setpriv", "--reuid", ACCOUNT, "--regid", "nogroup", "--clear-groups"]
        self.port = free_port()
        self.config = os.path.join(self.folder, "rig.toml")
        with open(self.config, "w", encoding="utf-8") as file:
            file.write(f"[kiosk.page]\nport = {self.port}\n")
        self.page = f"http://127.0.0.1:{self.port}/"
        read, write = os.pipe()
        self.x = self.begin(["Xvfb", "-displayfd", str(write), "-screen", "0", SIZE + "x24", "-nolisten", "tcp"], pass_fds=[write])
        os.close(write)
        with os.fdopen(read, encoding="ascii") as file:
            self.display = ":" + file.readline().strip()
        self.controller = self.start_controller()
        with urllib.request.urlopen(self.page + "page/visitor.css", timeout=10) as answer:
            accent = re.search(r"--accent:\s*#([0-9a-f]{6})", answer.read().decode()).group(1)
        self.accent = bytes.fromhex(accent)

    def begin(self, command, **options):
        log = open(os.path.join(self.folder, os.path.basename(command[0]) + ".log"), "ab")
        self.addCleanup(log.close)
        process = subprocess.Popen(command, stdout=options.pop("stdout", log), stderr=log, **options)
        self.addCleanup(self.end, process)
        return process

    @staticmethod
    def end(process):
        if process.poll() is None:
            process.kill()
        process.wait(timeout=30)
        if process.stdout:
            process.stdout.close()

    def start_controller(self):
        controller = self.begin(
            [OPTIONS.rig, "kiosk", "--simulate", "--no-scattering", "--size", "174x130", "--config", self.config,
             "--store", os.path.join(self.folder, "store"), "--page"], stdout=subprocess.PIPE, text=True,
            env={**os.environ, "STATE_DIRECTORY": os.path.join(self.folder, "state")})
        self.assertEqual(self.page, json.loads(controller.stdout.readline())["page"])
        return controller

    def start_screen(self):
        command = setting(OPTIONS.unit, "ExecStart").replace("${STRATALUX_PAGE}", self.page)
        command = command.replace("/run/stratalux-display", self.runtime).split()
        return self.begin(self.account + ["env", "-i"] + [f"{k}={v}" for k, v in self.environment().items()] + command)

    def environment(self):
        return {"PATH": "/usr/bin:/bin", "HOME": self.runtime, "XDG_RUNTIME_DIR": self.runtime, "DISPLAY": self.display,
                "WLR_BACKENDS": "x11", "WLR_RENDERER": "pixman", "WLR_LIBINPUT_NO_DEVICES": "1"}

    def accent_share(self):
        """Of the screen, in the colour of the button that begins a visit; None: there is no screen to look at."""
        sockets = [name for name in os.listdir(self.runtime) if re.fullmatch(r"wayland-\d+", name)]
        if not sockets:
            return None
        looked = subprocess.run(
            self.account + ["env", "-i", *[f"{k}={v}" for k, v in self.environment().items()],
                            "WAYLAND_DISPLAY=" + sockets[-1], "grim", "-t", "ppm", "-"],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=60, check=False)
        if looked.returncode != 0:
            return None
        kind, size, depth, pixels = looked.stdout.split(b"\n", 3)
        self.assertEqual((b"P6", SIZE.replace("x", " ").encode(), b"255"), (kind, size, depth))
        return sum(pixels[i:i + 3] == self.accent for i in range(0, len(pixels), 3)) / (len(pixels) / 3)

    def until(self, what, condition, seconds=120):
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                for name in os.listdir(self.folder):
                    if name.endswith(".log"):
                        with open(os.path.join(self.folder, name), "rb") as file:
                            sys.stderr.write(f"{name}: {file.read()[-2000:].decode(errors='replace')}\n")
                self.fail(f"not within {seconds} s: {what}")
            time.sleep(0.2)

    def shows_the_button(self):
        return (self.accent_share() or 0) > 0.005

    def test_shows_the_page_and_finds_a_controller_again(self):
        screen = self.start_screen()
        self.until("the idle screen", self.shows_the_button)
        self.end(self.controller)
        self.until("a screen that says that it waits", lambda: self.accent_share() == 0)
        self.controller = self.start_controller()
        self.until("the idle screen again", self.shows_the_button)
        screen.send_signal(signal.SIGTERM)
        screen.wait(timeout=float(setting(OPTIONS.unit, "TimeoutStopSec").rstrip("s")))

    def test_a_browser_that_dies_ends_the_screen_and_the_next_one_shows_the_page(self):
        self.assertEqual("always", setting(OPTIONS.unit, "Restart"))
        screen = self.start_screen()
        self.until("the idle screen", self.shows_the_button)
        for child in children(screen.pid):
            with open(f"/proc/{child}/comm", encoding="utf-8") as file:
                if file.read().startswith("chrom"):
                    os.kill(child, signal.SIGKILL)
        screen.wait(timeout=30)
        self.start_screen()
        self.until("the idle screen of another browser", self.shows_the_button)


def main():
    global OPTIONS
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", required=True)
    parser.add_argument("--unit", required=True)
    OPTIONS, rest = parser.parse_known_args()
    missing = [name for name in ("cage", "chromium", "Xwayland", "Xvfb", "grim", "setpriv") if not shutil.which(name)]
    if missing:
        print("skipped: no " + ", ".join(missing), file=sys.stderr)
        return browser.SKIPPED
    return not unittest.main(argv=[sys.argv[0], *rest], exit=False, verbosity=2).result.wasSuccessful()


if __name__ == "__main__":
    sys.exit(main())
