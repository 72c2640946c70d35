#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Manual pages and completions say what --help says, and their readers understand them.

usage: check_manual.py pages|bash|zsh|fish --build FOLDER
Exit 77: the reader (mandoc and man, zsh, fish) is not installed.
"""

import argparse
import pathlib
import re
import shutil
import subprocess
import sys

PROGRAMS = ["stratalux-rig", "stratalux-db", "stratalux-fit", "stratalux-skin-table"]
LEAST_OPTIONS = 150  # of all programs together; fewer: the test reads nothing


def fail(what):
    sys.exit(f"FAILED: {what}")


def need(*readers):
    for reader in readers:
        if not shutil.which(reader):
            print(f"skipped: {reader} is not installed: scripts/install-deps.sh", file=sys.stderr)
            sys.exit(77)


def said(command, **options):
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    if done.returncode != 0:
        fail(f"{command}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def helps(program, path=()):
    """(path, options, commands) of the program and of each of its commands, as --help lists them."""
    lines = said([program, *path, "--help"]).splitlines()
    options, commands, section = [], [], ""
    for line in lines:
        heading = re.match(r"^(\w+):$", line)
        if heading:
            section = heading[1]
        elif section == "Options":
            entry = re.match(r"^  (-\S+)", line)
            options += entry[1].split(",") if entry else []
        elif section == "Subcommands":
            entry = re.match(r"^  (\S+)", line)
            commands += [entry[1]] if entry else []
    yield path, options, commands
    for command in commands:
        yield from helps(program, (*path, command))


def everything(build):
    count = 0
    for name in PROGRAMS:
        for path, options, commands in helps(str(build / "bin" / name)):
            count += len(options)
            yield name, path, options, commands
    if count < LEAST_OPTIONS:
        fail(f"only {count} options in all programs: --help was not understood")


def check_pages(build):
    need("mandoc", "man")
    sections = {}
    for name in PROGRAMS:
        page = build / f"share/man/man1/{name}.1"
        complaints = said(["mandoc", "-Tlint", "-W", "style", page])
        if complaints:
            fail(complaints)
        reader = subprocess.run(["man", "--warnings", "-E", "UTF-8", "-l", "-Tutf8", "-Z", page], capture_output=True, text=True, check=False)
        if reader.returncode != 0 or reader.stderr:
            fail(f"man --warnings {page}: {reader.stderr}")
        text = said(["mandoc", "-Tascii", "-O", "width=160", page])
        text = re.sub(r".\x08", "", text)
        found = re.split(r"(?m)^   ([a-z][a-z0-9 -]*)$", text)
        sections[name] = {"": found[0], **dict(zip(found[1::2], found[2::2]))}
    for name, path, options, commands in everything(build):
        section = sections[name].get(" ".join(path))
        if section is None:
            fail(f"{name}(1) has no section of the command '{' '.join(path)}'")
        listed = set(re.findall(r"(?<![\w-])--?[\w-]+", "\n".join(re.findall(r"(?m)^     ?(-.*)$", section))))
        missing = [option for option in options if option not in listed]
        if missing:
            fail(f"{name}(1), '{' '.join(path)}': lacks {missing}; has {sorted(listed)}")
        for command in commands:
            if " ".join((*path, command)) not in sections[name]:
                fail(f"{name}(1) lacks the command {command}")


def complete(script, words):
    """What bash would offer for the last of `words`."""
    quoted = " ".join("'" + word + "'" for word in words)
    program = (f'source "{script}"; COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; '
               f'function=$(complete -p {words[0]} | sed "s/.*-F \\([^ ]*\\).*/\\1/"); $function {words[0]}; '
               'printf "%s\\n" "${COMPREPLY[@]}"')
    return said(["bash", "--norc", "-c", program]).split()


def check_bash(build):
    scripts = {name: build / "share/bash-completion/completions" / name for name in PROGRAMS}
    for script in scripts.values():
        said(["bash", "-n", script])
    for name, path, options, commands in everything(build):
        words = [name, *path]
        if sorted(complete(scripts[name], [*words, "-"])) != sorted(options):
            fail(f"{' '.join(words)} -: offers {complete(scripts[name], [*words, '-'])}, --help {options}")
        if sorted(complete(scripts[name], [*words, ""])) != sorted(commands):
            fail(f"{' '.join(words)}: offers {complete(scripts[name], [*words, ''])}, --help {commands}")
    for words, offered in [
        (["stratalux-rig", "cap"], ["capture"]),
        (["stratalux-rig", "plan", "sh"], ["show"]),
        (["stratalux-db", "export", "--format", ""], ["png", "tiff"]),
        (["stratalux-db", "export", "--format", "=", "t"], ["tiff"]),
        (["stratalux-db", "export", "--format", "="], ["png", "tiff"]),
        (["stratalux-db", "export", "--out", ""], []),
        (["stratalux-fit", "run", "--mode", "f"], ["free"]),
    ]:
        if sorted(complete(scripts[words[0]], words)) != offered:
            fail(f"{words}: offers {complete(scripts[words[0]], words)} in place of {offered}")


def check_zsh(build):
    need("zsh")
    for name in PROGRAMS:
        script = build / f"share/zsh/vendor-completions/_{name}"
        said(["zsh", "-f", "-n", script])
        if not script.read_text(encoding="utf-8").startswith(f"#compdef {name}\n"):
            fail(f"{script} does not say what it completes")
    for name, path, options, _ in everything(build):
        # What _arguments and _describe would be called with.
        functions = ('_arguments() { print -rl -- "$@" }; _describe() { print -rl -- "${(@P)2}" }; '
                     '_files() { }; complete_it() { source $1 }; ')
        words = " ".join(("x", *path, "-"))
        script = build / f"share/zsh/vendor-completions/_{name}"
        text = said(["zsh", "-f", "-c", f"{functions} words=({words}); CURRENT={len(path) + 2}; complete_it {script}"])
        listed = {re.match(r"\*?(-[\w-]+)", line)[1] for line in text.splitlines() if re.match(r"\*?-", line)}
        if listed != set(options):
            fail(f"zsh, {name} {' '.join(path)}: offers {sorted(listed)}, --help {sorted(options)}")


def check_fish(build):
    need("fish")
    for name in PROGRAMS:
        said(["fish", "--no-config", "--no-execute", build / f"share/fish/vendor_completions.d/{name}.fish"])
    for name, path, options, commands in everything(build):
        script = build / f"share/fish/vendor_completions.d/{name}.fish"
        for start, wanted in (("-", options), ("", commands)):
            if not wanted:
                continue
            line = " ".join((name, *path, start))
            text = said(["fish", "--no-config", "-c", f"source {script}; complete -C '{line}'"])
            # fish offers long names for a single dash, and short ones of their own.
            listed = {entry.split("\t")[0] for entry in text.splitlines()}
            missing = [word for word in wanted if word not in listed]
            if missing:
                fail(f"fish, '{line}': lacks {missing}; offers {sorted(listed)}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("check", choices=["pages", "bash", "zsh", "fish"])
    parser.add_argument("--build", type=pathlib.Path, required=True)
    options = parser.parse_args()
    globals()[f"check_{options.check}"](options.build.resolve())


if __name__ == "__main__":
    main()
