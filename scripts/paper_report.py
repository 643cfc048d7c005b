"""The page of reproduce_paper: the paper's table and figures beside ours, in one HTML file.

Figures of the paper: Turan, Almalioglu, Ornek, Araujo, Yanik, Sitti, "Magnetic-Visual Sensor
Fusion-based Dense 3D Reconstruction and Localization for Endoscopic Capsule Robots". Others are
named where they stand.
"""
import base64
import csv
import html
import io
import json

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

PAPER = "the paper"
# Millimetres.
PAPER_SURFACE = {"st0": 18.1, "st1": 19.7, "st2": 15.8, "st3": 21.7}
PAPER_AT_20_CM = {"fused": 12.5, "magnet alone": 16.0, "vision alone": 21.0}
PAPER_OTHERS_AT_20_CM = {"ORB-SLAM": 26.0, "LSD-SLAM": 30.0}
CHANNELS = {"magnet alone": ("MAGNETIC_POSE", "none", "#ea580c"),
            "vision alone": ("VISUAL_POSE", "se3", "#0891b2"),
            "fused": ("CAPSULE_STATE", "none", "#374151")}
LENGTHS = [50, 100, 150, 200]
DRIFT_LENGTHS = [2, 5, 10, 20, 50, 100]
DEPTH_BANDS = ["5_to_15mm", "15_to_30mm", "30_to_45mm", "45_to_70mm", "over_70mm"]
STOMACH_COLOURS = {"st0": "#2563eb", "st1": "#059669", "st2": "#d97706", "st3": "#9333ea"}
# 97.5 % of Student's t by degrees of freedom; beyond these it is taken as normal.
STUDENT = [0, 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228]

plt.rcParams.update({
    "figure.dpi": 110, "font.size": 9, "axes.grid": True, "grid.alpha": 0.25,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "axes.titlesize": 10, "axes.titleweight": "bold", "legend.fontsize": 8,
})

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1f2937;background:#f3f4f6;margin:0}
main{max-width:1080px;margin:0 auto;padding:24px 16px 64px}
h1{font-size:26px;margin:8px 0}h2{font-size:19px;margin:0 0 12px}
section{background:#fff;border-radius:10px;padding:18px 22px;margin:16px 0;
box-shadow:0 1px 3px rgba(0,0,0,.08);overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:14px}
th{text-align:left;color:#6b7280;font-weight:600;border-bottom:2px solid #e5e7eb;padding:6px 10px}
td{border-bottom:1px solid #f0f1f3;padding:6px 10px}.n{text-align:right;
font-variant-numeric:tabular-nums;white-space:nowrap}th.n{text-align:right}
.dim{color:#6b7280;font-size:13px}.yes{color:#047857;font-weight:600}
.no{color:#b91c1c;font-weight:600}.bad{background:#fef2f2;border-left:5px solid #dc2626}
.facts span{display:inline-block;margin:0 28px 6px 0;color:#4b5563}.facts b{color:#111827}
img{max-width:100%;display:block;margin:10px auto}pre{white-space:pre-wrap;font-size:12px}
"""


class Run:
    """What is known of one finished sequence."""

    def __init__(self, runner, chain):
        self.chain, self.name = chain, chain.name
        self.evaluated, self.maps = runner.folder(chain.evaluate), runner.folder(chain.maps)
        self.metrics = json.loads((self.evaluated / "metrics.json").read_text())
        self.seconds = {step.name.rsplit(".", 1)[1]: runner.note(step)["seconds"]
                        for step in chain.steps if runner.note(step)}
        self.stomach = getattr(chain, "stomach", "st0")
        self.camera = getattr(chain, "camera", "capsule_320x240")
        self.seed = getattr(chain, "seed", 1)

    def get(self, key, factor=1.0):
        value = self.metrics.get(key)
        return np.nan if value is None else factor * value

    def cpu_ms_per_frame(self):
        return 1e3 * self.get("replay.cpu_seconds") / self.get("DEPTH.count")


def finished(runner, chain):
    return chain is not None and runner.note(chain.evaluate) and runner.note(chain.maps)


def mean_and_interval(runs, value):
    """The mean over the runs, and half of the 95 % confidence interval of the mean over the seeds
    (nan for one seed): of each seed the mean over its runs is one sample."""
    by_seed = {}
    for run in runs:
        number = value(run)
        if np.isfinite(number):
            by_seed.setdefault(run.seed, []).append(number)
    means = [np.mean(values) for values in by_seed.values()]
    if not means:
        return np.nan, np.nan
    freedom = len(means) - 1
    if freedom < 1:
        return means[0], np.nan
    student = STUDENT[freedom] if freedom < len(STUDENT) else 1.96
    return np.mean(means), student * np.std(means, ddof=1) / np.sqrt(len(means))


def show(pair, unit="", digits=3):
    mean, half = pair
    if not np.isfinite(mean):
        return "–"
    text = f"{mean:.{digits}g}" if abs(mean) >= 1e-3 or mean == 0 else "&lt; 0.001"
    if np.isfinite(half):
        text += f" ± {half:.2g}"
    return text + (" " + unit if unit else "")


def table(head, rows):
    """Heads that start with '#' stand above numbers."""
    cells = "".join(f"<th class=n>{name[1:]}</th>" if name.startswith("#") else f"<th>{name}</th>"
                    for name in head)
    body = "".join("<tr>" + "".join(
        f"<td{' class=n' if name.startswith('#') else ''}>{cell}</td>"
        for name, cell in zip(head, row)) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"


def picture(figure, alt):
    data = io.BytesIO()
    figure.savefig(data, format="png", bbox_inches="tight", facecolor="white")
    plt.close(figure)
    text = base64.b64encode(data.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(alt)}" src="data:image/png;base64,{text}">'


def section(title, body, kind=""):
    return f'<section class="{kind}"><h2>{html.escape(title)}</h2>{body}</section>'


def dim(text):
    return f"<p class=dim>{text}</p>"


# Summary: what, the paper's or best known figure, our figure, target.

def summary(runs, failure, timing):
    def over(key, factor=1.0):
        return mean_and_interval(runs, lambda run: run.get(key, factor))

    rows = []

    def row(what, theirs, ours, unit, target, remark=""):
        met = None if target is None or not np.isfinite(ours[0]) else bool(ours[0] <= target)
        mark = {None: "", True: "<span class=yes>✓ met</span>",
                False: "<span class=no>✗ missed</span>"}[met]
        rows.append((what, theirs, show(ours, unit), "–" if target is None else
                     f"≤ {target:g} {unit}", mark, remark, met))

    row("Surface, mean error over the stomachs", "18.8 mm (15.8 to 21.7)",
        over("surface.paper.mean", 1e3), "mm", 1.5, "the paper's protocol: ICP to the end")
    row("Surface, the same where fusion puts the map", "–", over("surface.none.mean", 1e3), "mm",
        1.5, "in the rig's frame, not aligned at all")
    row("Fused trajectory of 20 cm", "12.5 mm",
        over("comparison.200mm.CAPSULE_STATE.none", 1e3), "mm", 1.25, "RMS, not aligned")
    row("Magnet alone, 20 cm", "16 mm", over("comparison.200mm.MAGNETIC_POSE.none", 1e3), "mm",
        None, "RMS, not aligned")
    row("Vision alone, 20 cm", "21 mm", over("comparison.200mm.VISUAL_POSE.se3", 1e3), "mm", None,
        "RMS after SE(3); each map frame aligned by itself")
    row("Drift over 5 mm", "0.5 mm", over("CAPSULE_STATE.rpe.5mm.trans.mean", 1e3), "mm", 0.1)
    row("Drift over 5°", "0.5° at most", over("CAPSULE_STATE.rpe.5deg.rot_deg.mean"), "°", 0.1,
        "mean")
    row("Magnetic fix", "2.1 mm (Son 2016)", over("MAGNETIC_POSE.ate.none.rmse", 1e3), "mm", 0.5,
        "RMS; target within 5 cm of the array")
    row("Magnetic fix, axis", "6.7° (Son 2016)", over("MAGNETIC_POSE.axis_error_deg.rmse"), "°",
        1.0, "RMS; target within 5 cm of the array")
    row("Depth from one picture", "4.15 mm RMS (learned, C3VD)",
        over("DEPTH.30_to_45mm.mean_abs", 1e3), "mm", 1.5, "mean absolute at 30 to 45 mm")
    if timing is not None:
        row("A frame through the whole pipeline", "45 ms, peak 52 (GPU, 8 cores)",
            (timing["ms_per_frame"], np.nan), "ms", 45,
            f"replay of {timing['name']} with nothing beside it: time / frames; target: the 99th "
            "percentile, live")
    if failure is not None:
        def of(key):
            return failure.get(key), np.nan
        row("Failure noticed, slowest", "seen in a plot", of("failure.worst.detection_delay"), "s",
            0.5)
        row("Sensor used again, slowest", "seen in a plot", of("failure.worst.recovery_delay"),
            "s", 1.0)
        row("Error in a failure / nominal", "–", of("failure.worst.ratio_to_nominal_15s"), "×",
            3.0, "first 15 s")
        row("False alarms", "–", of("failure.false_alarms"), "", 0,
            f"in {failure.get('run.seconds'):.0f} s")
    head = ["what", "#the paper or best known", "#ours", "#target", "", ""]
    missed = [f"{row[0]}: {row[2]}, target {row[3]}" for row in rows if row[6] is False]
    return table(head, [row[:6] for row in rows]), missed


def surface_table(runs):
    figures = ["rmse", "mean", "median", "std", "min", "max"]
    rows = []
    for stomach, theirs in PAPER_SURFACE.items():
        chosen = [run for run in runs if run.stomach == stomach]
        if not chosen:
            continue
        cells = [show(mean_and_interval(chosen, lambda run, f=figure: run.get(
            f"surface.paper.{f}", 1e3))) for figure in figures]
        complete = mean_and_interval(chosen, lambda run: run.get(
            "surface.completeness.within_1.5mm", 100))
        rows.append([stomach.capitalize(), f"{theirs:g}", *cells,
                     show(mean_and_interval(chosen, lambda run: run.get("surface.none.mean", 1e3))),
                     show(complete, "%")])
    return dim("Distances of the stable surfels from the true surface in millimetres, mean over "
               "the cameras, ± half the 95 % confidence interval over the seeds (none for one "
               "seed). The paper's protocol: iterated closest points until the RMSE changes by "
               "less than 0.001 cm, but from the trajectory's placement instead of six picked pairs. "
               "Of the paper's table the means are known to us. Our stomachs are the virtual rig's, "
               "not the paper's four; last: the share of the surface in view with a surfel within "
               "1.5 mm.") + table(
        ["stomach", "#paper, mean", *(f"#{figure}" for figure in ("RMSE", "mean", "median", "std",
                                                                  "min", "max")),
         "#mean, not aligned", "#complete"], rows)


def matrix(runs, value, unit):
    cameras = sorted({run.camera for run in runs})
    rows = [[stomach.capitalize()] + [show(mean_and_interval(
        [run for run in runs if (run.stomach, run.camera) == (stomach, camera)], value), unit)
        for camera in cameras] for stomach in sorted({run.stomach for run in runs})]
    return table([""] + ["#" + camera.replace("capsule_", "") for camera in cameras], rows)


def plot_with_interval(axes, places, pairs, colour, label, style="o-"):
    means = np.array([pair[0] for pair in pairs])
    halves = np.nan_to_num(np.array([pair[1] for pair in pairs]))
    good = np.isfinite(means)
    places = np.asarray(places, float)
    axes.plot(places[good], means[good], style, color=colour, label=label, ms=4)
    if np.any(halves > 0):
        axes.fill_between(places[good], (means - halves)[good], (means + halves)[good],
                          color=colour, alpha=0.2, lw=0)


def plain_decades(axes):
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.set_yticks([tick for power in range(-3, 4) for tick in np.array([1, 2, 5]) * 10.0**power
                     if low <= tick <= high])
    axes.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    axes.set_ylim(low, high)


def plot_lengths(runs):
    figure, axes = plt.subplots(figsize=(9.5, 4.2))
    for label, (channel, alignment, colour) in CHANNELS.items():
        pairs = [mean_and_interval(runs, lambda run, n=length: run.get(
            f"comparison.{n}mm.{channel}.{alignment}", 1e3)) for length in LENGTHS]
        words = " (SE(3))" if alignment == "se3" else ""
        plot_with_interval(axes, LENGTHS, pairs, colour, f"{label}{words}")
        axes.plot([200], [PAPER_AT_20_CM[label]], "*", ms=11, color=colour,
                  label=f"{label}, {PAPER}")
    for (label, value), marker in zip(PAPER_OTHERS_AT_20_CM.items(), "Pd"):
        axes.plot([200], [value], marker, color="#9ca3af", label=f"{label}, {PAPER}")
    axes.set_xticks(LENGTHS)
    axes.set_xlabel("length of the trajectory [mm]")
    axes.set_ylabel("RMS position error [mm]")
    plain_decades(axes)
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return picture(figure, "trajectory error against length")


def plot_drift(runs):
    figure, (translation, rotation) = plt.subplots(1, 2, figsize=(11, 3.8))
    for label, (channel, _, colour) in CHANNELS.items():
        for axes, kind, factor in [(translation, "trans", 1e3), (rotation, "rot_deg", 1)]:
            pairs = [mean_and_interval(runs, lambda run, n=length: run.get(
                f"{channel}.rpe.{n}mm.{kind}.mean", factor)) for length in DRIFT_LENGTHS]
            plot_with_interval(axes, DRIFT_LENGTHS, pairs, colour, label)
    translation.plot([5], [0.5], "*", ms=11, color=CHANNELS["fused"][2], label=f"fused, {PAPER}")
    turns = ", ".join(f"{label} {show(mean_and_interval(runs, lambda run: run.get(key)))}°"
                      for label, (channel, _, _) in CHANNELS.items()
                      for key in [f"{channel}.rpe.5deg.rot_deg.mean"])
    rotation.set_title(f"after a turn of 5°: {turns}; {PAPER} at most 0.5°", fontsize=8,
                       fontweight="normal")
    translation.set_ylabel("translational error [mm]")
    rotation.set_ylabel("rotational error [°]")
    for axes in (translation, rotation):
        axes.set_xscale("log")
        axes.set_xticks(DRIFT_LENGTHS)
        axes.set_xticklabels([str(length) for length in DRIFT_LENGTHS])
        axes.minorticks_off()
        axes.set_xlabel("length of the true path between the poses [mm]")
        plain_decades(axes)
    translation.legend()
    figure.tight_layout()
    return picture(figure, "translational and rotational error")


def plot_depth(runs):
    figure, axes = plt.subplots(figsize=(9.5, 3.6))
    places = np.arange(len(DEPTH_BANDS))
    for stomach, colour in STOMACH_COLOURS.items():
        chosen = [run for run in runs if run.stomach == stomach]
        if chosen:
            pairs = [mean_and_interval(chosen, lambda run, b=band: run.get(
                f"DEPTH.{b}.mean_abs", 1e3)) for band in DEPTH_BANDS]
            plot_with_interval(axes, places, pairs, colour, stomach.capitalize())
    axes.plot([1.6, 2.4], [1.5, 1.5], "--", color="#059669", label="target at 30 to 45 mm")
    axes.axhline(4.15, ls=":", color="#9ca3af", label="learned depth on C3VD (RMS)")
    axes.set_xticks(places)
    axes.set_xticklabels([band.replace("_", " ").replace("mm", " mm") for band in DEPTH_BANDS])
    axes.set_xlabel("true distance")
    axes.set_ylabel("mean absolute depth error [mm]")
    plain_decades(axes)
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return picture(figure, "depth error")


def read_columns(path):
    with open(path, encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    return {name: [row[i] for row in rows] for i, name in enumerate(head)}


def plot_failures(run):
    health = read_columns(run.evaluated / "sensor_health.csv")
    utime, alpha, nominal = (np.array(health[name], float)
                             for name in ("utime", "alpha", "p_nominal"))
    sensor = np.array(health["sensor"])
    truth = read_columns(run.evaluated / "GROUND_TRUTH_POSE.csv")
    start = float(truth["utime"][0])
    figure, panels = plt.subplots(3, 1, figsize=(11, 6), sharex=True,
                                  gridspec_kw={"height_ratios": [1, 1, 1.3]})
    spans = [(key.split(".")[1], run.metrics[key], run.metrics[key[:-len("start")] + "end"])
             for key in run.metrics
             if key.startswith("failure.") and key.endswith(".start")]
    for axes, name in zip(panels, ("visual", "magnetic")):
        chosen = sensor == name
        time = (utime[chosen] - start) * 1e-6
        axes.plot(time, nominal[chosen], lw=0.9, color="#2563eb", label="P(s = nominal)")
        axes.plot(time, alpha[chosen], lw=1.2, color="#d97706", label="α")
        axes.set_ylim(-0.05, 1.05)
        axes.set_ylabel(name)
        axes.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncol=2, borderaxespad=0.1)
    state = read_columns(run.evaluated / "CAPSULE_STATE.csv")
    usable = np.array(state["usable"], float) > 0
    time = (np.array(state["utime"], float) - start) * 1e-6
    panels[2].semilogy(time[usable], 1e3 * np.array(state["error"], float)[usable], lw=0.8,
                       color="#374151")
    panels[2].set_ylabel("fused error [mm]")
    panels[2].set_xlabel("time [s]")
    for name, begin, end in spans:
        colour = {"visual": "#0891b2", "magnetic": "#ea580c"}.get(name, "#9ca3af")
        for axes in [panels[0 if name == "visual" else 1], panels[2]]:
            axes.axvspan(begin, end, color=colour, alpha=0.15, lw=0)
    figure.align_ylabels()
    return picture(figure, "switch variables and alpha")


# Maps.

def read_surfels(path):
    with open(path, "rb") as file:
        count = 0
        while True:
            line = file.readline()
            if not line:
                raise ValueError(f"{path} is no PLY file")
            if line.startswith(b"element vertex"):
                count = int(line.split()[2])
            if line == b"end_header\n":
                break
        kind = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 3), ("radius", "<f4"),
                         ("confidence", "<f4")])
        return np.frombuffer(file.read(count * kind.itemsize), kind)


class View:
    """A parallel view of a map from where most of it turns its face to the eye."""

    def __init__(self, surfels, like=None, width=460, height=330):
        """`like`: a view to take the scale and the brightness from."""
        points = surfels["p"].astype(float)
        self.middle = np.median(points, axis=0)
        towards = surfels["n"].astype(float).mean(axis=0)
        self.depth = towards / max(np.linalg.norm(towards), 1e-9)  # to the eye
        spread = (points - self.middle) - np.outer((points - self.middle) @ self.depth, self.depth)
        _, _, axes = np.linalg.svd(spread[:: max(1, len(spread) // 5000)], full_matrices=False)
        self.right = axes[0]
        self.up = np.cross(self.depth, self.right)
        plane = np.stack([self.right, self.up])
        low, high = np.percentile(spread @ plane.T, [0.2, 99.8], axis=0)
        self.middle += (low + high) / 2 @ plane
        self.size = (height, width)
        self.scale = 0.94 * min(width / (high - low)[0], height / (high - low)[1])
        levels = surfels["c"].max(axis=1)
        self.gain = 255 / max(np.percentile(levels, 98), 1)
        if like:
            self.scale, self.gain = like.scale, like.gain

    def shows(self, surfels):
        """Whether most of the surfels turn their face to the eye: one of another frame need not."""
        return len(surfels) and np.mean(surfels["n"].astype(float) @ self.depth > 0.05) > 0.5

    def draw(self, surfels):
        height, width = self.size
        image = np.full((height * width, 3), 255, np.uint8)
        facing = surfels["n"].astype(float) @ self.depth
        surfels, facing = surfels[facing > 0.05], facing[facing > 0.05]
        if len(surfels):
            points = surfels["p"].astype(float) - self.middle
            u = width / 2 + self.scale * (points @ self.right)
            v = height / 2 - self.scale * (points @ self.up)
            order = np.argsort(points @ self.depth, kind="stable")  # the nearest painted last
            colour = np.clip(surfels["c"] * self.gain, 0, 255) * (0.35 + 0.65 * facing)[:, None]
            reach = np.clip(np.ceil(self.scale * surfels["radius"]), 1, 4).astype(int)
            largest = reach.max()
            pixels, colours, ranks = [], [], []
            rank = np.empty(len(order), int)
            rank[order] = np.arange(len(order))
            for dv in range(-largest, largest + 1):
                for du in range(-largest, largest + 1):
                    chosen = du * du + dv * dv <= reach * reach
                    x = np.round(u[chosen]).astype(int) + du
                    y = np.round(v[chosen]).astype(int) + dv
                    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
                    pixels.append((y * width + x)[inside])
                    colours.append(colour[chosen][inside])
                    ranks.append(rank[chosen][inside])
            pixels, ranks = np.concatenate(pixels), np.concatenate(ranks)
            last = np.argsort(ranks, kind="stable")
            image[pixels[last]] = np.concatenate(colours)[last].astype(np.uint8)
        return image.reshape(height, width, 3)


def plot_maps(runs, frames):
    """One run a stomach, the finest camera there is."""
    parts = []
    for stomach in PAPER_SURFACE:
        chosen = [run for run in runs if run.stomach == stomach and run.seed == 1]
        chosen.sort(key=lambda run: ("640" not in run.camera, run.camera))
        if not chosen:
            continue
        run = chosen[0]
        files = [(frame, run.maps / f"map_after_{frame}.ply") for frame in frames]
        files = [(frame, path) for frame, path in files if path.exists()]
        if not files:
            continue
        surfels = [read_surfels(path) for _, path in files]
        stable = [cloud[cloud["confidence"] >= 3] for cloud in surfels]
        surfels = [few if 2 * len(few) > len(cloud) else cloud
                   for few, cloud in zip(stable, surfels)]
        view = View(surfels[-1])
        figure, panels = plt.subplots(1, len(files), figsize=(3.4 * len(files), 2.9),
                                      squeeze=False)
        for axes, (frame, _), cloud in zip(panels[0], files, surfels):
            settled = view.shows(cloud)
            axes.imshow((view if settled else View(cloud, view)).draw(cloud))
            axes.set_axis_off()
            axes.set_title(f"after {frame} frames: {len(cloud):,} surfels".replace(",", " ")
                           + ("" if settled else "\n(not yet in the rig's frame)"),
                           fontsize=9, fontweight="normal")
        metres = 0.02
        panels[0][-1].plot([20, 20 + metres * view.scale], [318, 318], color="#111827", lw=2.5)
        panels[0][-1].text(20 + metres * view.scale / 2, 310, "20 mm", ha="center", va="bottom",
                           fontsize=8)
        figure.suptitle(f"{stomach.capitalize()} through {run.camera.replace('capsule_', '')}",
                        fontsize=10)
        figure.tight_layout()
        parts.append(picture(figure, f"maps of {stomach}"))
    return "".join(parts)


def timing_table(runs, failure):
    processes = ["depth_estimator", "visual_slam", "magnetic_localizer", "sensor_fusion",
                 "occupancy_mapper"]
    rows = []
    for camera in sorted({run.camera for run in runs}):
        chosen = [run for run in runs if run.camera == camera]
        cells = [show(mean_and_interval(chosen, Run.cpu_ms_per_frame))]
        for process in processes:
            cells.append(" / ".join(show((mean_and_interval(chosen, lambda run, key=key: run.get(
                f"{process}.ms_per_event.{key}"))[0], np.nan)) for key in ("median", "p99")))
        cells.append(show(mean_and_interval(chosen, lambda run: run.get(
            "replay.peak_resident_bytes", 1e-6)), "MB"))
        rows.append([camera.replace("capsule_", ""), *cells])
    steps = []
    for run in runs + ([failure] if failure else []):
        steps.append([run.name] + [f"{run.seconds.get(step, float('nan')):.1f}"
                                   for step in ("record", "replay", "evaluate", "maps")])
    return dim("Milliseconds. A frame: processor time of all processes, all threads; then median / "
               "99 % of each process's events (visual_slam's and sensor_fusion's median are of "
               "their small events), while sequences ran beside each other on the same cores, one "
               "thread each.") + table(
        ["camera", "#a frame", *(f"#{process}" for process in processes), "#memory"], rows) + \
        dim("<br>Seconds of each step.") + table(
        ["sequence", "#record", "#replay", "#evaluate", "#maps"], steps)


def read_timing(runner, step):
    """Of the replay that had the machine to itself; None where it was not run."""
    if step is None or not runner.note(step):
        return None
    path = runner.folder(step) / "derived.lcmlog.timing.json"
    timing = json.loads(path.read_text())
    frames = timing["processes"]["depth_estimator"]["events"]
    return {"name": step.sequence, "ms_per_frame": 1e3 * timing["wall_seconds"] / frames}


def write(out, runner, chains, failures, timed, about):
    runs = [Run(runner, chain) for chain in chains if finished(runner, chain)]
    failure = Run(runner, failures) if finished(runner, failures) else None
    versions = sorted({str(run.metrics.get("run.code_version")) for run in runs})
    facts = "".join(f"<span>{name} <b>{html.escape(str(value))}</b></span>" for name, value in [
        ("date", about["date"]), ("machine", about["machine"]), ("run", about["settings"]),
        ("at a time", about["jobs"]), ("this time took", f"{about['minutes']:.1f} min"),
        ("gastronaut", ", ".join(versions))])
    parts = [f'<h1>The paper, reproduced on the virtual rig</h1><div class="facts">{facts}</div>',
             dim("The paper: Turan, Almalioglu, Örnek, Araujo, Yanik, Sitti, “Magnetic-Visual "
                 "Sensor Fusion-based Dense 3D Reconstruction and Localization for Endoscopic "
                 "Capsule Robots”. Its figures are of ex-vivo stomachs and a real rig with a GPU "
                 "and 8 cores; ours are of a simulated rig: they say that the method is built "
                 "right, not what it would reach on tissue."
                 + (" This is the quick run: four of the sixteen pairs of stomach and camera, half "
                    "the frame rate, one seed and hence no confidence intervals." if about["quick"]
                    else ""))]
    if about["problems"]:
        parts.append(section("Sequences that failed", "<pre>" + "\n\n".join(
            html.escape(f"{name}: {text}") for name, text in about["problems"].items()) + "</pre>",
            "bad"))
    summary_table = ""
    if runs:
        summary_table, missed = summary(runs, failure, read_timing(runner, timed))
        parts.append(section("The paper's figures, ours, and the targets", summary_table))
        if missed:
            parts.append(section("Missed", "<ul>" + "".join(
                f"<li>{html.escape(text)}</li>" for text in missed) + "</ul>", "bad"))
        parts.append(section("Table I: reconstructed surface against the true one",
                             surface_table(runs)))
        parts.append(section("Stomachs and cameras", "".join(
            f"<h3>{title}</h3>" + matrix(runs, value, unit) for title, value, unit in [
                ("Surface, mean error (the paper's protocol)",
                 lambda run: run.get("surface.paper.mean", 1e3), "mm"),
                ("Fused trajectory of 20 cm, RMS",
                 lambda run: run.get("comparison.200mm.CAPSULE_STATE.none", 1e3), "mm"),
                ("Depth, mean absolute error, all distances",
                 lambda run: run.get("DEPTH.mean_abs", 1e3), "mm"),
                ("VISUAL_POSE, share of the time available",
                 lambda run: run.get("VISUAL_POSE.availability", 100), "%"),
                ("Map frames (a loop closure, a map set anew or settled in the rig begins one)",
                 lambda run: run.get("VISUAL_POSE.map_frames")
                 if "VISUAL_POSE.map_frames" in run.metrics else 1.0, "")])))
        parts.append(section("Trajectory error against length", plot_lengths(runs) + dim(
            "Mean over pieces of the true path that every channel followed, over all sequences; "
            "bands: 95 % confidence interval over the seeds. Stars: the paper's figures at 20 cm. "
            "Not aligned, but for vision alone, which has no place of its own in the rig.")))
        parts.append(section("Translational and rotational error", plot_drift(runs) + dim(
            "Relative error, mean, against the length of the true path between the two poses; of "
            "vision alone only pairs in the same map frame. The magnet's roll is the truth's.")))
        parts.append(section("Depth error", plot_depth(runs)))
    if failure is not None:
        parts.append(section("Switch variables and confidence while sensors fail",
                             plot_failures(failure) + dim(
                                 "Shaded: the sensor is of no use in truth (as in the paper: "
                                 "vision for 29 s, the magnet for 14 s; then both for 2 s).")))
    if runs:
        parts.append(section("Reconstructed maps while they grow", plot_maps(
            runs, about["map_frames"]) + dim(
            "Seen from where most of the map turns its face to the eye; albedo, brightened.")))
        parts.append(section("Times", timing_table(runs, failure)))
        links = "".join(f'<li><a href="steps/{run.evaluated.name}/index.html">{run.name}</a></li>'
                        for run in runs + ([failure] if failure else []))
        parts.append(section("Reports of each sequence", f"<ul>{links}</ul>"))
    page = out / "index.html"
    partial = out / "index.html.partial"
    partial.write_text('<!doctype html><html lang="en"><meta charset="utf-8">'
                       '<meta name="viewport" content="width=device-width,initial-scale=1">'
                       "<title>gastronaut: the paper reproduced</title>"
                       f"<style>{STYLE}</style><main>{''.join(parts)}</main></html>\n",
                       encoding="utf-8")
    partial.rename(page)
    return page
