#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the commands of our pages as they are written: blocks of ```sh, and lines behind "$ " in blocks without a language.

The programs are those that `cmake --install` of the build puts into a folder of the test's own.

A block that cannot run here has `<!-- not run: REASON -->` in the line before it; the reason is printed and counted. All
blocks of a page run in one shell, in order, in a folder of the page's own in which the sources' docs/ are found.

usage: run_pages.py --build FOLDER --source FOLDER PAGE ...
"""

import argparse
import os
import pathlib
import re
import resource
import shutil
import subprocess
import sys
import tempfile

MARK = re.compile(r"^<!-- not run: (?P<reason>\S.{9,}) -->$")


class Block:
    def __init__(self, line, language):
        self.line = line  # of its first command
        self.language = language
        self.text = []
        self.reason = None

    def commands(self):
        if self.language == "sh":
            return self.text
        if self.language == "":
            return [line[2:] for line in self.text if line.startswith("$ ")]
        return []


def blocks_of(page):
    """The page's blocks with commands; what is wrong with its marks ends the test."""
    found, block, reason = [], None, None
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if block is not None:
            if line == "```":
                if block.commands():
                    found.append(block)
                elif block.reason:
                    sys.exit(f"{page}:{block.line}: a mark, but no command in its block")
                block = None
            else:
                block.text.append(line)
        elif line.startswith("```"):
            block, reason, mark = Block(number + 1, line[3:].strip()), None, reason
            block.reason = mark
        elif "not run" in line and line.startswith("<!--"):
            mark = MARK.match(line)
            if not mark:
                sys.exit(f"{page}:{number}: a mark is `<!-- not run: REASON -->`, with a reason")
            reason = mark["reason"]
        elif reason is not None:
            sys.exit(f"{page}:{number}: the mark before stands in front of no block")
    return found


def install(build, prefix):
    """Everything lies where it belongs, and the units name what was installed."""
    subprocess.run(["cmake", "--install", build, "--prefix", prefix], check=True, stdout=subprocess.DEVNULL)
    programs = ["stratalux-rig", "stratalux-db", "stratalux-fit", "stratalux-skin-table"]
    wanted = [f"bin/{program}" for program in programs]
    wanted += [f"share/stratalux/{table}_table.bin" for table in ("skin", "subcutis", "wax")]
    wanted += ["share/doc/stratalux/privacy.md"]
    wanted += ["share/doc/stratalux/examples/rig.toml", "lib/sysusers.d/stratalux.conf", "lib/tmpfiles.d/stratalux.conf"]
    wanted += ["lib/udev/rules.d/60-stratalux.rules", "lib/systemd/system/stratalux-safe.service"]
    for unit in ("purge", "verify", "pull"):
        wanted += [f"lib/systemd/system/stratalux-{unit}.service", f"lib/systemd/system/stratalux-{unit}.timer"]
    for name in wanted:
        if not (prefix / name).is_file():
            sys.exit(f"cmake --install: {name} is missing")
    unit = (prefix / "lib/systemd/system/stratalux-purge.service").read_text(encoding="utf-8")
    for text in (f"ExecStart={prefix}/bin/stratalux-db purge", f"file://{prefix}/share/doc/stratalux/privacy.md"):
        if text not in unit:
            sys.exit(f"cmake --install: the unit does not say {text}")


def run(page, blocks, options, folder):
    script = ["set -euo pipefail"]
    for block in blocks:
        script.append(f"echo '# {page.name}:{block.line}' >&2")
        script += block.commands()
    (folder / "docs").symlink_to(options.source / "docs")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("STRATALUX_")}
    environment.update(
        PATH=f"{folder.parent}/installed/bin:{os.environ['PATH']}",
        HOME=str(folder),
        STATE_DIRECTORY=str(folder / "state"),
        STRATALUX_STORE="store",
        STRATALUX_CACHE=str(folder.parent / "cache"),
        STRATALUX_EXAMPLE_SIZE="232x174",
        STRATALUX_EXAMPLE_PHOTONS="40000",
    )
    (folder / "state").mkdir()
    with open(folder / "said", "w+", encoding="utf-8", errors="replace") as said:
        code = subprocess.run(["bash", "-c", "\n".join(script)], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
                              stdout=said, stderr=subprocess.STDOUT, check=False).returncode
        said.seek(0)
        lines = [line for line in said.read().splitlines() if " % (" not in line]
    if code != 0:
        print("\n".join(lines[-60:]))
        print(f"{page}: FAILED, exit code {code}; the last line with '# {page.name}:LINE' names the block")
    return code == 0


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--source", type=pathlib.Path, required=True)
    parser.add_argument("pages", nargs="+")
    options = parser.parse_args()
    scratch = pathlib.Path(tempfile.mkdtemp(prefix="stratalux-pages-"))
    good = True
    try:
        install(options.build, scratch / "installed")
        for name in options.pages:
            page = options.source / name
            blocks = blocks_of(page)
            left = [block for block in blocks if block.reason]
            runs = [block for block in blocks if not block.reason]
            folder = scratch / page.stem
            folder.mkdir()
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            good = run(page, runs, options, folder) and good
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"{name}: {len(runs)} blocks run in {seconds:.0f} processor seconds, {len(left)} not run")
            for block in left:
                print(f"  {name}:{block.line}: not run: {block.reason}")
            if not runs:
                print(f"{name}: FAILED, no block runs at all")
                good = False
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    sys.exit(0 if good else 1)


main()
