#!/usr/bin/env python3
"""The ray kernel beside Embree's single-ray calls, in turns, on the same meshes and rays.

    bench_rays.py RAYS --ours target/release/examples/ray_rate --embree ./embree_rays [--threads 1] [--turns 3]

RAYS is what the peers' make_rays.py wrote. One line of JSON a mesh, kind and kernel (the best of the
turns), then the ratios. One thread is compared by CPU time, more by the clock.
"""
import argparse
import json
import math
import os
import subprocess

MESHES = ("sphere100k", "sphere850k", "room")
KINDS = ("primary", "bounce", "shadow")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rays")
    parser.add_argument("--ours", required=True)
    parser.add_argument("--embree", required=True)
    parser.add_argument("--threads", default="1")
    parser.add_argument("--turns", type=int, default=3)
    args = parser.parse_args()
    rate = "mrays_per_cpu_s" if args.threads == "1" else "mrays_s_wall"
    kernels = {"platelight": [args.ours], "embree robust": [args.embree, "--robust"], "embree": [args.embree]}
    ratios = {}
    for mesh in MESHES:
        for kind in KINDS:
            files = [os.path.join(args.rays, f"{mesh}.plm"), os.path.join(args.rays, f"{mesh}.{kind}.plr")]
            best = {}
            for _ in range(args.turns):
                for name, (program, *options) in kernels.items():
                    command = [program, *files, "--threads", args.threads, "--reps", "3", *options]
                    found = json.loads(subprocess.check_output(command))
                    if name not in best or found[rate] > best[name][rate]:
                        best[name] = found
            for name, found in best.items():
                print(json.dumps({"mesh": mesh, "set": kind, "as": name, **found}), flush=True)
            for name in ("embree robust", "embree"):
                ratio = best["platelight"][rate] / best[name][rate]
                ratios.setdefault((name, kind), []).append(ratio)
    for (name, kind), each in ratios.items():
        mean = math.exp(sum(map(math.log, each)) / len(each))
        print(json.dumps({"against": name, "set": kind, "geometric_mean": round(mean, 3), "each": [round(r, 3) for r in each]}))


if __name__ == "__main__":
    main()
