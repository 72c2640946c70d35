#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""docs/night.md against the night that scripts/test.sh runs: the same parts, the same turns; each night what takes no
turn and one turn; all of the parts within as many nights as there are turns.

  tests/docs/night_parts.py SOURCE BUILD        BUILD: of a preset that scripts/test.sh knows; else exit 77
"""
import pathlib
import re
import subprocess
import sys


PRESETS = {"release": [], "asan": ["--asan"]}


def main():
    source, build = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    if build.parent != source / "build" or build.name not in PRESETS:
        print(f"skipped: scripts/test.sh knows nothing of {build}")
        return 77

    def ask(*parts):
        return subprocess.run([source / "scripts/test.sh", *PRESETS[build.name], "--night", *parts, "--list"],
                              capture_output=True, text=True)

    def listed(*parts):
        done = ask(*parts)
        done.check_returncode()
        return set(done.stdout.split())
    page = (source / "docs/night.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    said, turns = set(), {}
    for row in rows:
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        names = set(re.findall(r"`([a-z0-9-]+)`", cells[0]))
        said |= names
        if cells[-1] != "every night":
            turns.setdefault(cells[-1], set()).update(names)
    faults = []

    def hold(what, is_so):
        if not is_so:
            faults.append(what)
    everything = listed("all")
    hold(f"docs/night.md names {sorted(said)}, ctest has {sorted(everything)}", said == everything)
    in_turns = set()
    for turn, names in turns.items():
        hold(f"turn {turn}: docs/night.md says {sorted(names)}, it runs {sorted(listed(turn))}",
             listed(turn) == names)
        in_turns |= names
    tonight = listed()
    always = everything - in_turns
    hold(f"what takes no turn is left out tonight: {sorted(always - tonight)}", always <= tonight)
    hold(f"tonight is no turn whole and alone: {sorted(tonight - always)}", tonight - always in turns.values())
    hold("a part that nobody knows is taken", ask("nobody").returncode == 2)
    for fault in faults:
        print(f"error: {fault}", file=sys.stderr)
    print(f"{len(everything)} parts, {len(always)} of them every night, {len(turns)} turns")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
