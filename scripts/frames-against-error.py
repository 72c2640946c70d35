#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Frames against error: simulated people, captured once each and fitted as if a shorter visit had been captured.

Every row is a subset of the same visit (`stratalux-fit run --frames N`, docs/capture-plan.md, "Fewer frames"). What a
fit is judged by is the same in all rows: the held-out projector's stripe, white and spot lights of the whole visit, on
skin by the truth. All light is rendered (`direct: predicted`, part `total`), noise of the target taken off. Frames too
few for codes stand on the true surface alone; rows of the true surface say what is lit by the truth in every row, the
first of them by a fit of all frames that a fit reads.

  scripts/frames-against-error.py --work /tmp/frames                          # person 1 at 696x520
  scripts/frames-against-error.py --work /tmp/frames --people 1,2,3 --json frames.json
  scripts/frames-against-error.py --size 232x174 --frames 128,24 --geometry truth --check     # small, held to its limits

Seconds: frames times the mean of a frame in `stratalux-rig plan show --simulate` (default plan and exposure); the frames
that only the comparison reads are not among them. People whose capture is in --work already (by the same options;
another is an error), and fits that are there, are not made again. Exit 1: a program failed; or, with --check, fewer
frames predict stripes better by a tenth than all do (figures that mix up), or at 128 frames or more layers predict them
no better than the fit that is blind to direction or less than nine tenths of the truly lit skin are judged.
"""
import json
import pathlib
import subprocess
import sys

from simulated_visits import called, captured, concluded, figures_parser, mean, parsed

MODELS = [("tied", "layers"), ("homogeneous_local_albedo", "mean layers"), ("direction_blind", "blind")]
LIGHTS = ("stripe", "white", "spot")
LEAST_FOR_SURFACE = 96  # of the default plan; `stratalux-fit run` says so


def read(args, program, *arguments):
    return subprocess.run([args.bin / program, *map(str, arguments)], check=True, capture_output=True, text=True).stdout


def figures(metrics, geometry):
    row = {"depth_rms_mm": metrics["truth"]["depth_rms_mm"]}
    covered = [c for c in metrics["coverage"] if c["geometry"] == geometry]
    row["judged"] = sum(c["judged"] for c in covered) / sum(c["lit_skin"] for c in covered)
    row["nrmse"] = {}
    for p in metrics["prediction"]:
        if p["part"] == "total" and p["direct"] == "predicted" and p["geometry"] == geometry:
            row["nrmse"].setdefault(p["model"], {})[p["light"]] = p["nrmse_without_noise"]
    return row


def fit(args, store, log, frames, whole, geometry):
    # Of the true surface what is lit is the truth's word in every row but that of an unthinned fit: so none is.
    asked = min(frames, whole - 1) if geometry == "truth" else frames
    options = ["run", "latest", "--store", store, "--maps", "off", "--geometry", geometry, "--json"]
    done = json.loads(called(args.bin, log, "stratalux-fit", *options, "--frames", asked))
    row = {"frames": frames, "geometry": geometry, "left_out": done.get("frames", {}).get("left_out", []),
           "read": done.get("frames", {}).get("kept", whole)}
    row.update(figures(json.loads((pathlib.Path(done["folder"]) / "metrics.json").read_text()), geometry))
    return row


def person(args, seed, plan):
    options = ["--exposure", "auto", "--seed", seed, "--size", args.size]
    store, log = captured(args.bin, args.work, f"person-{seed}", options)
    rows = []
    for geometry in args.geometry:
        for frames in args.frames:
            if geometry == "reconstructed" and frames < LEAST_FOR_SURFACE:
                continue
            print(f"person {seed}: {frames} frames, {geometry} surface", file=sys.stderr)
            rows.append(fit(args, store, log, frames, plan["frames"], geometry))
    return {"person": seed, "rows": rows}


def averaged(people):
    """Each row's mean over the people."""
    rows = []
    for same in zip(*(p["rows"] for p in people)):
        row = dict(same[0])
        row["depth_rms_mm"] = mean(r["depth_rms_mm"] for r in same)
        row["judged"] = mean(r["judged"] for r in same)
        row["nrmse"] = {m: {l: mean(r["nrmse"][m][l] for r in same) for l in LIGHTS} for m, _ in MODELS}
        rows.append(row)
    return rows


def table(rows, plan):
    head = ["surface", "frames", "seconds", "left out of each projector's", "judged", "depth rms, mm"]
    head += [f"{light}: {name}" for light in LIGHTS for _, name in MODELS]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for r in rows:
        cells = [r["geometry"], str(r["frames"]), f"{r['frames'] * plan['seconds'] / plan['frames']:.1f}",
                 ", ".join(r["left_out"]) or "nothing", f"{100 * r['judged']:.1f} %", f"{r['depth_rms_mm']:.3f}"]
        cells += [f"{100 * r['nrmse'][model][light]:.2f}" for light in LIGHTS for model, _ in MODELS]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def faults(rows):
    stripes = {(r["geometry"], r["frames"]): r["nrmse"]["tied"]["stripe"] for r in rows}
    for r in rows:
        what, error = f"{r['frames']} frames, {r['geometry']} surface", r["nrmse"]["tied"]["stripe"]
        most = max(frames for geometry, frames in stripes if geometry == r["geometry"])
        whole = stripes[r["geometry"], most]
        if error < 0.9 * whole:
            yield f"{what}: stripes {100 * error:.2f} %, {100 * whole:.2f} % with all frames"
        if r["frames"] >= 128 and not error < r["nrmse"]["direction_blind"]["stripe"]:
            yield f"{what}: stripes {100 * error:.2f} %, {100 * r['nrmse']['direction_blind']['stripe']:.2f} % blind"
        if r["frames"] >= 128 and not r["judged"] >= 0.9:
            yield f"{what}: {100 * r['judged']:.1f} % of the truly lit skin judged"


def numbers(text):
    return [int(n) for n in text.split(",")]


def main():
    parser = figures_parser(__doc__, "696x520")
    parser.add_argument("--people", type=numbers, default=[1], help="seeds of their captures (1)")
    parser.add_argument("--frames", type=numbers, default=[500, 256, 128, 64, 24],
                        help="limits on the number of frames (500,256,128,64,24)")
    parser.add_argument("--geometry", type=lambda t: t.split(","), default=["reconstructed", "truth"],
                        help="surfaces (reconstructed,truth)")
    args = parsed(parser)
    plan = json.loads(read(args, "stratalux-rig", "plan", "show", "--simulate", "--json"))
    people = []
    try:
        for seed in args.people:
            people.append(person(args, seed, plan))
            if args.json:
                args.json.write_text(json.dumps(people, indent=1) + "\n")
    except (RuntimeError, subprocess.CalledProcessError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    rows = averaged(people)
    print(table(rows, plan))
    return concluded(args, people, faults(rows))


if __name__ == "__main__":
    sys.exit(main())
