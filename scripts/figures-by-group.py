#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Figures of the fit by groups of skin colour: simulated people, light to dark, captured, fitted, judged by one yardstick.

Six groups of the individual typology angle, ITA = atan((L* - 50) / b*) of CIELAB under D65, with the bounds that
dermatology uses (Del Bino & Bernerd 2013): 55, 41, 28, 10, -30 degrees. L* and b* are of the person's reflectance at
630, 532 and 465 nm, the mirrored 4 % included as instruments with a sphere measure it, taken as linear sRGB: the cameras'
three bands, not a spectrum. Each group takes the first people of
the population, from --first on, that fall into it; a person's number is the seed of the capture, so each has a head and
a surface of its own, too.

  scripts/figures-by-group.py --work /tmp/groups                         # two of each group at 696x520
  scripts/figures-by-group.py --work /tmp/small --size 348x260 --per-group 1 --json groups.json
  scripts/figures-by-group.py --work /tmp/low --scattering 0.55          # all of them with that scattering
  scripts/figures-by-group.py --work /tmp/wide --comb-period 192         # combs with lines that far apart, in columns
  scripts/figures-by-group.py --work /tmp/waves --code micro-phase       # codes other than the plan's
  scripts/figures-by-group.py --work /tmp/groups --geometry truth        # on the simulation's own surface
  scripts/figures-by-group.py --work /tmp/groups --run=--neighbours=off  # fits otherwise than as usual
  scripts/figures-by-group.py --list                                     # who they are

People whose capture is in --work already are not captured again (one by other options is an error), and fitted only
where the programs have changed. Exit 1: a program failed, and
the figures of the others are printed; or, with --check, in some group layers do not predict stripes better than the fit
that is blind to direction, photometric detail makes the surface's normals worse by a tenth and more, or less than nine
tenths of the truly lit skin are judged.
"""
import csv
import json
import math
import pathlib
import subprocess
import sys

from simulated_visits import called, captured, concluded, figures_parser, mean, parsed

GROUPS = [("very light", 55, 180), ("light", 41, 55), ("intermediate", 28, 41), ("tan", 10, 28), ("brown", -30, 10),
          ("dark", -180, -30)]
MODELS = [("tied", "layers"), ("homogeneous_local_albedo", "mean layers"), ("direction_blind", "blind")]


def ita_deg(red, green, blue):
    xyz = [0.4124564 * red + 0.3575761 * green + 0.1804375 * blue, 0.2126729 * red + 0.7151522 * green + 0.0721750 * blue,
           0.0193339 * red + 0.1191920 * green + 0.9503041 * blue]

    def f(t):
        return t ** (1 / 3) if t > (6 / 29) ** 3 else t / (3 * (6 / 29) ** 2) + 4 / 29
    y, z = f(xyz[1]), f(xyz[2] / 1.08883)
    return math.degrees(math.atan2(116 * y - 16 - 50, 200 * (y - z)))


def group_of(ita):
    return next(name for name, low, high in GROUPS if low <= ita <= high)


def choose(bin_folder, first, per_group):
    text = subprocess.run([bin_folder / "stratalux-skin-table", "population", "--first", str(first), "--people", "3000",
                           "--csv", "-"], check=True, capture_output=True, text=True).stdout
    chosen = {name: [] for name, _, _ in GROUPS}
    for row in csv.DictReader(text.splitlines()):
        ita = ita_deg(*(float(row[f"reflectance_{nm}"]) for nm in (630, 532, 465)))
        of = chosen[group_of(ita)]
        if len(of) < per_group:
            of.append({"person": int(row["person"]), "ita_deg": ita, "melanin": float(row["melanin"]),
                       "scattering": float(row["scattering"])})
    return chosen


def judge(args, person):
    scene = "" if args.scattering is None else f"[skin]\nscattering = {args.scattering}\n"
    rig = "" if args.comb_period is None else f"[plan]\ncomb_period = {args.comb_period}\n"
    options = ["--exposure", "auto", "--seed", person["person"], "--size", args.size]
    if args.code is not None:
        options.append(f"--code={args.code}")
    try:
        store, log = captured(args.bin, args.work, f"person-{person['person']}", options, scene, rig)
        done = json.loads(called(args.bin, log, "stratalux-fit", "run", "latest", "--geometry", args.geometry, "--json",
                                 *args.run, "--store", store))
    except RuntimeError as error:
        print(f"error: person {person['person']}: {error}", file=sys.stderr)
        return False
    metrics = json.loads((pathlib.Path(done["folder"]) / "metrics.json").read_text())
    person["depth_rms_mm"] = metrics["truth"]["depth_rms_mm"]
    person["normals"] = metrics.get("normals")
    covered = [c for c in metrics["coverage"] if c["geometry"] == args.geometry]
    person["judged"] = sum(c["judged"] for c in covered) / sum(c["lit_skin"] for c in covered)
    person["nrmse"] = {}
    for p in metrics["prediction"]:
        if p["part"] == "total" and p["direct"] == "predicted" and p["geometry"] == args.geometry:
            person["nrmse"].setdefault(p["model"], {}).setdefault(p["light"], []).append(p["nrmse_without_noise"])
    for lights in person["nrmse"].values():
        for light, values in lights.items():
            lights[light] = sum(values) / len(values)
    return True


def table(chosen):
    lights = ("stripe", "white", "spot")
    head = ["group", "people", "ITA", "melanin", "judged", "depth rms, mm"]
    head += [f"{light}, {name}" for light in lights for _, name in MODELS]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    by_light = {light: [] for light in lights}
    for name, _, _ in GROUPS:
        people = [p for p in chosen[name] if "nrmse" in p]
        if not people:
            lines.append(f"| {name} | 0 |" + " |" * (len(head) - 2))
            continue
        row = [name, str(len(people)), " ".join(f"{p['ita_deg']:.0f}" for p in people),
               " ".join(f"{100 * p['melanin']:.1f} %" for p in people), f"{100 * mean(p['judged'] for p in people):.1f} %",
               f"{mean(p['depth_rms_mm'] for p in people):.3f}"]
        for light in lights:
            for model, _ in MODELS:
                error = mean(p["nrmse"][model][light] for p in people)
                row.append(f"{100 * error:.2f}")
                if model == "tied":
                    by_light[light].append(error)
        lines.append("| " + " | ".join(row) + " |")
    for light, errors in by_light.items():
        if errors and min(errors) > 0:
            lines.append(f"{light}: the worst group has {max(errors) / min(errors):.2f} times the best one's error")
        elif errors:  # of few quads of a coarse camera's spots the noise may be larger than all of the error
            lines.append(f"{light}: the best group's error is below its noise")
    return "\n".join(lines)


def normals_table(chosen):
    """Of both normals on skin: medians and rms, the specular one in the place of the diffuse as what filtering is worth."""
    def told(errors):
        return f"{mean(e['median_deg'] for e in errors):.2f} ({mean(e['rms_deg'] for e in errors):.2f})"
    if not any(p.get("normals") for people in chosen.values() for p in people):
        return ""
    head = ["group", "people", "surface", "specular"] + [f"{c}: {what}" for c in "RGB" for what in ("diffuse", "in its place")]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    medians = []
    for name, _, _ in GROUPS:
        found = [p["normals"] for p in chosen[name] if p.get("normals")]
        if not found:
            continue
        row = [name, str(len(found)), told([n["surface"] for n in found]), told([n["specular"] for n in found])]
        for c in range(3):
            row += [told([n["diffuse"][c][kind] for n in found]) for kind in ("filtered", "unfiltered")]
        medians.append(mean(d["filtered"]["median_deg"] for n in found for d in n["diffuse"]))
        lines.append("| " + " | ".join(row) + " |")
    lines.append(f"diffuse normals: the worst group's median is {max(medians) / min(medians):.2f} times the best one's")
    return "normals against the truth on skin, degrees, median (rms)\n" + "\n".join(lines)


def faults(chosen):
    for name, people in chosen.items():
        judged = [p for p in people if "nrmse" in p]
        if not judged:
            yield f"{name}: nobody was judged"
            continue
        layers, blind = (mean(p["nrmse"][model]["stripe"] for p in judged) for model in ("tied", "direction_blind"))
        if not layers < blind:
            yield f"{name}: stripes {100 * layers:.2f} % by layers, {100 * blind:.2f} % by the blind fit"
        normals = [p["normals"] for p in judged if p.get("normals")]
        if not normals:
            yield f"{name}: no normals were judged"
        else:
            fused, surface = (mean(n[kind]["rms_deg"] for n in normals) for kind in ("specular", "surface"))
            if not fused <= 1.1 * surface:
                yield f"{name}: specular normals off by {fused:.2f} degrees rms, the surface's alone by {surface:.2f}"
        covered = mean(p["judged"] for p in judged)
        if not covered >= 0.9:
            yield f"{name}: {100 * covered:.1f} % of the truly lit skin judged"


def main():
    parser = figures_parser(__doc__, "696x520")
    parser.add_argument("--per-group", type=int, default=2, help="people of each group (2)")
    parser.add_argument("--first", type=int, default=1000, help="first number of the population to look at (1000)")
    parser.add_argument("--scattering", type=float, help="scattering of all people, instead of their own")
    parser.add_argument("--comb-period", type=int, help="columns between a comb's lines, instead of the plan's")
    parser.add_argument("--code", help="code of the columns, instead of the plan's")
    parser.add_argument("--geometry", choices=["reconstructed", "truth"], default="reconstructed",
                        help="the surface that the fit is based on (reconstructed)")
    parser.add_argument("--run", action="append", default=[], metavar="OPTION",
                        help="an option of stratalux-fit run, as --run=--neighbours=off; may be repeated")
    parser.add_argument("--list", action="store_true", help="only list who would be captured")
    args = parsed(parser)
    chosen = choose(args.bin, args.first, args.per_group)
    if args.list:
        for name, people in chosen.items():
            for p in people:
                print(f"{name}: person {p['person']}, ITA {p['ita_deg']:.0f} degrees, melanin {100 * p['melanin']:.1f} %, "
                      f"scattering {p['scattering']:.2f}")
        return 0 if all(len(people) == args.per_group for people in chosen.values()) else 1
    people = [p for name, _, _ in GROUPS for p in chosen[name]]
    ok = True
    for k, person in enumerate(people):
        print(f"person {person['person']} ({k + 1} of {len(people)}), ITA {person['ita_deg']:.0f} degrees", file=sys.stderr)
        ok = judge(args, person) and ok
    print(table(chosen))
    print(normals_table(chosen))
    return concluded(args, chosen, faults(chosen), ok)


if __name__ == "__main__":
    sys.exit(main())
