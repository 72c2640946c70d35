# SPDX-License-Identifier: Apache-2.0
"""What the scripts that state figures share: their options, programs called with a log, captures that are made once."""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile


def figures_parser(doc, size):
    """With the options that all of them have."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = pathlib.Path(__file__).resolve().parent.parent
    parser.add_argument("--bin", type=pathlib.Path, default=root / "build/release/bin", help="where the programs are")
    parser.add_argument("--work", type=pathlib.Path, help="folder that keeps stores and logs (default: they are not kept)")
    parser.add_argument("--size", default=size, help=f"size of the camera ({size})")
    parser.add_argument("--check", action="store_true", help="exit 1 if something falls short")
    parser.add_argument("--json", type=pathlib.Path, help="also write the figures to this file")
    return parser


def parsed(parser):
    """Its arguments; a folder that goes with them where --work is not given."""
    args = parser.parse_args()
    if args.work is None:
        args.scratch = tempfile.TemporaryDirectory(prefix="stratalux-figures-")
        args.work = pathlib.Path(args.scratch.name)
    args.work.mkdir(parents=True, exist_ok=True)
    return args


def mean(values):
    values = list(values)
    return sum(values) / len(values)


def concluded(args, figures, faults, ok=True):
    """Exit code, with the figures written where --json says and, with --check, each of the faults told."""
    if args.json:
        args.json.write_text(json.dumps(figures, indent=1) + "\n")
    for fault in faults if args.check else ():
        print(f"error: {fault}", file=sys.stderr)
        ok = False
    return 0 if ok else 1


def called(bin_folder, log, program, *arguments):
    """What it prints on stdout; stderr goes to `log`. RuntimeError where it fails; 3 is degraded, as far as it goes."""
    with open(log, "a") as out:
        done = subprocess.run([bin_folder / program, *map(str, arguments)], stdout=subprocess.PIPE, stderr=out, text=True)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{program} {' '.join(map(str, arguments))} ended with {done.returncode}: {log}")
    return done.stdout


def captured(bin_folder, work, name, options, scene="", rig=""):
    """Store `work`/`name` and its log. `scene` and `rig`: text of the files that the capture is given; a path of its own
    for a scene that names other files.

    A capture that is there is used again if it was whole and made by the same options; another one is a RuntimeError.
    """
    store, log, said = work / name, work / f"{name}.log", work / f"{name}.capture.json"
    file_of_scene = scene if isinstance(scene, pathlib.Path) else None
    what = {"options": list(map(str, options)), "scene": file_of_scene.read_text() if file_of_scene else scene, "rig": rig}
    if said.exists():
        if json.loads(said.read_text()) != what:
            raise RuntimeError(f"{store} was captured with other options than these ({said}); give another --work")
        return store, log
    if store.exists():
        raise RuntimeError(f"{store} holds a capture that did not end ({log}); remove it, or give another --work")
    if scene and not file_of_scene:
        file_of_scene = work / f"{name}.scene.toml"
        file_of_scene.write_text(scene)
    arguments = [f"--simulate={file_of_scene}" if file_of_scene else "--simulate"]
    if rig:
        (work / f"{name}.rig.toml").write_text(rig)
        arguments.append(f"--config={work / f'{name}.rig.toml'}")
    called(bin_folder, log, "stratalux-rig", "capture", *arguments, *options, "--store", store)
    said.write_text(json.dumps(what, indent=1) + "\n")
    return store, log
