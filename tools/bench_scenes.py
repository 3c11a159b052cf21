#!/usr/bin/env python3
"""Platelight and its rivals on a truth scene, in turns: error and CPU seconds of each.

    bench_scenes.py SCENE --peers DIR --program target/release/platelight --work DIR [--python PYTHON] RUN...

A RUN is `ours:error=0.1`, `ours:samples=16,plain` (plain: not denoised) or a rival as the peers' bench.py
has it: `cycles:spp=16,border,denoise`, `mitsuba:spp=64,border`. Everyone gets the true camera and light;
`[surroundings]` and `[[lamp]]` are those of the scene's own shot.toml, and only ours can use them.
One line of JSON a run: CPU seconds of the rendering and of the whole process, and the metrics of compare.py.
"""
import argparse
import json
import os
import re
import resource
import subprocess
import sys


def cpu_of_children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def write_shot(scene, folder, denoise):
    """The shot a user would write who knew the camera and the light exactly."""
    os.makedirs(folder, exist_ok=True)
    truth = json.load(open(os.path.join(scene, "truth.json")))
    lens = truth["intrinsics"]
    camera = {key: lens[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    camera.update(
        platelight_camera=1,
        distortion="brown-conrady",
        coefficients=[lens[key] for key in ("k1", "k2", "p1", "p2", "k3")],
        world_from_camera=truth["plate_camera_to_world"][:3],
    )
    json.dump(camera, open(os.path.join(folder, "camera.json"), "w"))
    own = open(os.path.join(scene, "shot.toml")).read()
    sections = re.findall(r"^\[+(?:surroundings|lamp)\]+[^\n]*\n(?:(?!\[).*\n)*", own, re.MULTILINE)
    ball = re.search(r"\bball\b.*?[,{ \n]at = (\[.*?\])", own, re.DOTALL)
    at = f", at = {ball.group(1)}" if sections and ball else ""
    props = f'[[local]]\nfile = "{scene}/props.glb"\n' if os.path.exists(f"{scene}/props.glb") else ""
    open(os.path.join(folder, "shot.toml"), "w").write(
        f'[plate]\nfile = "{scene}/plate.exr"\nrelative_exposure = 1.0\n'
        '[camera]\nfile = "camera.json"\n[pose]\nfile = "camera.json"\n'
        f'[probe]\npanorama = {{ file = "{scene}/env_latlong.exr"{at} }}\nclipped = "accept"\n'
        f'[support]\nmesh = "{scene}/support.glb"\nalbedo = "plate"\n{props}'
        f'[[object]]\nfile = "{scene}/objects.glb"\n{"".join(sections)}'
        f'[render]\nerror = 0.01\ndenoise = "{denoise}"\n'
    )


def run_ours(args, scene, options):
    folder = os.path.join(args.work, os.path.basename(scene))
    write_shot(scene, folder, "off" if "plain" in options else "auto")
    out = os.path.join(folder, "out")
    stop = [word for option in options if "=" in option for word in ("--" + option).split("=")]
    before = cpu_of_children()
    subprocess.run([args.program, "run", folder + "/shot.toml", "--out", out, "-q", *stop], check=True, stdout=subprocess.DEVNULL)
    total = cpu_of_children() - before
    render = json.load(open(out + "/report.json"))["render"]
    return out + "/composite.exr", {"cpu_render": render["cpu_seconds"], "cpu_total": round(total, 2), "samples": render["samples"]}


def run_rival(args, scene, tool, options):
    picture = os.path.join(args.work, f"{os.path.basename(scene)}_{tool}.exr")
    words = [word for option in options for word in ("--" + option).split("=")]
    command = [args.python, os.path.join(args.peers, f"{tool}_insert.py"), scene, "--out", picture, *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    cost = json.loads([line for line in done.stdout.splitlines() if line.startswith("{")][-1])
    return picture, {key: round(cost[key], 2) for key in ("cpu_render", "cpu_total")}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--peers", required=True)
    parser.add_argument("--program", required=True)
    parser.add_argument("--work", required=True)
    parser.add_argument("--python", default=sys.executable, help="has bpy and mitsuba")
    args = parser.parse_args()
    sys.path.insert(0, args.peers)
    from compare import Scene, metrics, read_exr

    scene = os.path.abspath(args.scene)
    truth = Scene(scene)
    for run in args.runs:
        tool, _, options = run.partition(":")
        options = [option for option in options.split(",") if option]
        picture, cost = run_ours(args, scene, options) if tool == "ours" else run_rival(args, scene, tool, options)
        found = metrics(read_exr(picture), truth, True, None)
        shown = ("object_mean", "shadow_ratio", "shadow_error", "flip", "rel_rmse", "outside_max")
        line = {"scene": os.path.basename(scene), "run": run, **cost}
        print(json.dumps({**line, **{key: round(float(found[key]), 4) for key in shown}}), flush=True)


if __name__ == "__main__":
    main()
