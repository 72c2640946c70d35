#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Who may include whom (docs/conventions.md). Prints each violation as file:line:text; exit 1 if there is any.

  scripts/check-includes.py [ROOT]
"""
import os
import pathlib
import re
import sys

ROOTS = ["shared", "db", "firmware-host", "fitter"]
# Each folder may include only itself and those before it.
ORDERS = {
    "shared": "base units image geometry transport pattern capture config http manual",
    "db": "base keys segment ledger catalogue care privacy transfer interchange apps",
    "fitter": "image export sensor structured_light mixture reconstruction separation motion skin photometric srd "
              "scattering render profiles session stages calibration evaluation report pipeline batch apps",
}
TRUTH = r'"db/segment/truth_segment\.h"'
ROOMS_OF_SQLITE = r"base|keys|catalogue|care|privacy"


def lines_of(folders):
    """(file, number, text) of all sources and headers below the folders."""
    for folder in folders:
        for path, names, files in os.walk(folder):
            names.sort()
            for name in sorted(files):
                if name.endswith((".h", ".cc")):
                    file = f"{path}/{name}"
                    text = pathlib.Path(file).read_text(errors="replace")
                    yield from ((file, number, line) for number, line in enumerate(text.splitlines(), 1))


class Check:
    def __init__(self):
        self.lines = list(lines_of(ROOTS))
        self.includes = [(file, number, line, match[1]) for file, number, line in self.lines
                         if (match := re.search(r'#include ([<"].*)', line))]
        self.bad = False

    def tell(self, file, number, line, why):
        print(f"{file}:{number}:{line}   <- {why}")
        self.bad = True

    def forbid(self, folders, header, why, unless=None):
        """No file of the folders includes what matches, unless its name matches `unless`."""
        below, wanted = re.compile(rf"(?:{folders})/"), re.compile(header)
        for file, number, line, included in self.includes:
            if below.match(file) and wanted.match(included) and not (unless and re.fullmatch(unless, file)):
                self.tell(file, number, line, why)

    def only_in(self, place, headers, what):
        """Only files that match may include these headers."""
        self.forbid("|".join(ROOTS), rf'[<"](?:{headers})', what, unless=place)

    def one_adapter(self, folder, headers, what):
        """Those sources lie in the folder, and there is but one."""
        self.only_in(rf"{folder}/[^/]*\.cc", headers, f"{what} only in one adapter .cc of {folder}")
        adapters = {file: (number, line) for file, number, line, included in self.includes
                    if file.startswith(folder + "/") and file.endswith(".cc") and re.match(rf'[<"](?:{headers})', included)}
        if len(adapters) > 1:
            for file in adapters:
                print(f"{file}   <- {what} in more than one adapter")
            self.bad = True

    def family(self, prefix, headers, what):
        """The sources that include them are named for it (one lists the devices, one drives them); what they share of
        its types is PREFIX_handles.h, which is theirs alone."""
        sources = rf"{prefix}_[a-z0-9_]*\.cc"
        self.only_in(rf"{sources}|{prefix}_handles\.h", headers,
                     f"{what} only in the sources {prefix}_*.cc and their {prefix}_handles.h")
        self.only_in(sources, rf"{prefix}_handles\.h", f"{prefix}_handles.h only in the sources {prefix}_*.cc")

    def headers_show_only_ours(self):
        """Headers of db and firmware-host show the standard library, our own types and Eigen: no library's header, no
        library's type. (db/base/sqlite.h, which db alone includes, names two of SQLite's without saying what they are.)
        A program's own command line (apps/command.h) is no public header, nor is what a family's sources share."""
        private = re.compile(r".*/apps/command\.h|firmware-host/(camera/v4l2|projector/kms)_handles\.h")
        ours = re.compile(r'.*#include (<[a-z_]+>|<Eigen/[A-Za-z]+>|"(shared|db|firmware-host)/[^"]+")')
        types = re.compile(r"(?:.*[^A-Za-z_])?(?:sqlite3|gpiod_[a-z]|gpiod::|v4l2_[a-z]|libcamera::|drm[A-Z_]|cv::|ceres::|"
                           r"nlohmann::|toml::|CLI::|png_[a-z]|XXH)")
        for file, number, line in self.lines:
            if not file.endswith(".h") or not file.startswith(("db/", "firmware-host/")) or private.fullmatch(file):
                continue
            if "#include " in line:
                if not ours.match(line):
                    self.tell(file, number, line, "a header that shows more than the standard library, Eigen and ours")
            elif file != "db/base/sqlite.h" and types.match(line.split("//")[0]):
                self.tell(file, number, line, "a type of a library in a header")

    def one_way(self, parent, folders):
        for at, folder in enumerate(folders):
            later = folders[at + 1:]
            if later:
                self.forbid(f"{parent}/{folder}", rf'"{parent}/(?:{"|".join(later)})/',
                            f"{parent}/{folder} stands above what it includes")


def main():
    os.chdir(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).resolve().parent.parent)
    c = Check()
    c.forbid("shared", r'"(db|firmware-host|fitter)/', "shared includes upward")
    c.forbid("db", r'"(firmware-host|fitter)/', "db includes upward")
    c.forbid("firmware-host", r'"fitter/', "the controller includes the fitter")
    c.forbid("fitter", r'"firmware-host/', "the fitter includes the controller")
    c.forbid("firmware-host|shared|fitter", TRUTH, "truth is for evaluation alone", unless=r"fitter/evaluation/.*")

    # Libraries stay where they are wrapped.
    c.only_in(r"db/(base|catalogue)/[^/]*\.cc", "sqlite3", "sqlite3 only in the sources of db/base and db/catalogue")
    c.only_in(r"fitter/.*", r"(opencv2|ceres)/|opencv\.hpp", "OpenCV and Ceres only in fitter")
    c.one_adapter("firmware-host/gpio", r"gpiod\.h", "libgpiod")
    c.family("firmware-host/camera/v4l2", r"linux/videodev2\.h|linux/v4l2", "V4L2")
    c.one_adapter("firmware-host/camera", "libcamera/", "libcamera")
    c.family("firmware-host/projector/kms", r"xf86drm|drm/|libdrm/|drm[_a-z]*\.h", "DRM")
    c.one_adapter("shared/http", r"microhttpd\.h", "libmicrohttpd")
    c.one_adapter("firmware-host/kiosk", r"qrencode\.h", "libqrencode")
    c.one_adapter("firmware-host/preview", r"jpeglib\.h", "libjpeg")
    c.headers_show_only_ours()
    c.only_in(rf"db/({ROOMS_OF_SQLITE})/[^/]*\.cc|db/catalogue/[^/]*\.h", r"db/base/sqlite\.h",
              "db/base/sqlite.h only in the rooms of db that ask the index")

    for parent, folders in ORDERS.items():
        c.one_way(parent, folders.split())
    for folder in sorted(f.name for f in os.scandir("fitter") if f.is_dir()) if os.path.isdir("fitter") else []:
        if folder not in ORDERS["fitter"].split():
            print(f"fitter/{folder}/   <- a folder of fitter that has no place among the others")
            c.bad = True
    for file in sorted(f.name for f in os.scandir("db") if f.name.endswith((".h", ".cc"))) if os.path.isdir("db") else []:
        print(f"db/{file}   <- a file of db has a room")
        c.bad = True
    return 1 if c.bad else 0


if __name__ == "__main__":
    sys.exit(main())
