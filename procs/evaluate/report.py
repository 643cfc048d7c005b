"""Draws the plots of a report folder and writes its index.html, in one file with the plots inline.

evaluate starts it; the folder comes in GASTRONAUT_REPORT, an optional PLY surface in
GASTRONAUT_SURFACE. Reads metrics.json and the CSV series that evaluate wrote.
"""

import base64
import csv
import html
import json
import os
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import matplotlib.patheffects
import matplotlib.ticker
import numpy as np

FOLDER = os.environ["GASTRONAUT_REPORT"]
SURFACE = os.environ.get("GASTRONAUT_SURFACE", "")
POSE_CHANNELS = ["MAGNETIC_POSE", "VISUAL_POSE", "CAPSULE_STATE", "CAPSULE_POSE", "ESTIMATE"]

TRUTH, ESTIMATE, BAND, BOUND, BAD = "#374151", "#2563eb", "#93c5fd", "#059669", "#dc2626"
STATUS_COLOURS = ["#10b981", "#f59e0b", "#8b5cf6", "#dc2626", "#ec4899", "#6b7280"]
SENSOR_COLOURS = {"magnetic": "#ea580c", "visual": "#0891b2"}
AXIS_COLOURS = {"x": "#dc2626", "y": "#059669", "z": "#2563eb"}

plt.rcParams.update({
    "figure.dpi": 110, "font.size": 9, "axes.grid": True, "grid.alpha": 0.25,
    "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "axes.titlesize": 10, "axes.titleweight": "bold", "legend.fontsize": 8,
})

NO_TARGET, NEES_BAND = None, "band"
# Key, what it is, factor to the unit shown, unit, target, what the target holds for.
TARGETS = [
    ("MAGNETIC_POSE.ate.none.rmse", "Magnetic position error, RMS", 1e3, "mm", NO_TARGET,
     "at whatever distance"),
    ("MAGNETIC_POSE.axis_error_deg.rmse", "Magnetic axis error, RMS", 1, "°", NO_TARGET,
     "at whatever distance"),
    ("MAGNETIC_POSE.within_5cm.position.rmse", "Magnetic position error, RMS", 1e3, "mm", 0.5,
     "within 5 cm of a sensor"),
    ("MAGNETIC_POSE.within_5cm.axis_deg.rmse", "Magnetic axis error, RMS", 1, "°", 1.0,
     "within 5 cm of a sensor"),
    ("MAGNETIC_POSE.cramer_rao.position_ratio", "Position error / Cramér-Rao bound", 1, "×", 1.1,
     "when the model is exact"),
    ("MAGNETIC_POSE.cramer_rao.axis_ratio", "Axis error / Cramér-Rao bound", 1, "×", 1.1,
     "when the model is exact"),
    ("MAGNETIC_POSE.nees.mean", "Magnetic NEES, mean", 1, "", NEES_BAND, "95 % band"),
    ("VISUAL_POSE.ate.se3.rmse", "Visual trajectory, SE(3)", 1e3, "mm", 0.1, "depth given, 10 cm"),
    ("VISUAL_POSE.ate.sim3.rmse", "Visual trajectory, Sim(3)", 1e3, "mm", 0.05,
     "own depth, 20 cm, 640x480 (0.2 at 320x240)"),
    ("VISUAL_POSE.nees.mean", "Visual NEES, mean", 1, "", NEES_BAND, "95 % band"),
    ("CAPSULE_STATE.ate.none.rmse", "Fused trajectory, not aligned", 1e3, "mm", 1.25, "20 cm"),
    ("CAPSULE_STATE.rpe.5mm.trans.mean", "Drift over 5 mm", 1e3, "mm", 0.1, ""),
    ("CAPSULE_STATE.rpe.5deg.rot_deg.mean", "Drift over 5°", 1, "°", 0.1, ""),
    ("CAPSULE_STATE.nees.mean", "Fused NEES, mean", 1, "", NEES_BAND, "95 % band"),
    ("failure.undetected", "Sensor failures not noticed", 1, "", 0, ""),
    ("failure.unrecovered", "Failed sensors not taken back", 1, "", 0, ""),
    ("failure.worst.detection_delay", "Failure noticed, slowest", 1, "s", 0.5, "from its start"),
    ("failure.worst.recovery_delay", "Sensor used again, slowest", 1, "s", 1.0, "from its end"),
    ("failure.worst.ratio_to_nominal_15s", "Error in a failure / nominal error", 1, "×", 3.0,
     "first 15 s, while the other sensor works"),
    ("failure.false_alarms", "False alarms", 1, "", 0, "in 15 minutes"),
    ("DEPTH.30_to_45mm.mean_abs", "Depth, mean absolute error", 1e3, "mm", 1.5, "at 30 to 45 mm"),
    ("DEPTH.mean_abs", "Depth, mean absolute error", 1e3, "mm", NO_TARGET, "at whatever distance"),
    ("DEPTH.mean_abs_scaled", "Depth, the same after median scaling", 1e3, "mm", NO_TARGET,
     "at whatever distance"),
    ("DEPTH.coverage", "Depth, share of pixels given", 100, "%", NO_TARGET, ""),
    ("DEPTH.normalised_error", "Depth error / claimed σ, RMS", 1, "×", NO_TARGET, "honest is 1"),
    ("surface.trajectory.mean", "Map, mean distance of stable surfels", 1e3, "mm", 1.5,
     "own poses; 2.5 while the wall moves"),
    ("surface.all.mean", "Map, the same of unstable surfels too", 1e3, "mm", NO_TARGET, ""),
    ("surface.none.mean", "Map, the same not aligned", 1e3, "mm", NO_TARGET,
     "where the map is in the rig's frame"),
    ("surface.seen.trajectory.mean", "Map, mean distance from the wall as it was last seen", 1e3,
     "mm", NO_TARGET, "own poses"),
    ("surface.thickness.mean", "Map, thickness (σ along the normal), mean", 1e3, "mm", NO_TARGET,
     "two layers 1 mm apart: 0.5"),
    ("surface.thickness.share_double", "Map, share that is like two layers", 100, "%", NO_TARGET,
     ""),
    ("surface.completeness.within_1.5mm", "Surface in view with a surfel within 1.5 mm", 100, "%",
     NO_TARGET, ""),
    ("magnetic_localizer.ms_per_event.median", "Magnetic fix, median time", 1e3, "µs", 25,
     "64 x 3 channels, warm"),
]


def load_metrics():
    with open(os.path.join(FOLDER, "metrics.json"), encoding="utf-8") as file:
        return json.load(file)


def load_series(name):
    path = os.path.join(FOLDER, name + ".csv")
    if not os.path.exists(path):
        return None
    with open(path, encoding="utf-8") as file:
        columns = file.readline().strip().split(",")
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
    if rows.size == 0:
        return None
    return {column: rows[:, i] for i, column in enumerate(columns)}


def load_sensor_health():
    """Of each sensor the columns of sensor_health.csv as arrays, the cause as text."""
    path = os.path.join(FOLDER, "sensor_health.csv")
    if not os.path.exists(path):
        return {}
    with open(path, encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    sensors = {}
    for row in rows:
        sensors.setdefault(row[head.index("sensor")], []).append(row)
    return {name: {column: np.array([row[i] for row in lines],
                                    str if column in ("sensor", "cause") else float)
                   for i, column in enumerate(head)}
            for name, lines in sensors.items()}


def load_surface_points(path, wanted=6000):
    """Some vertices of a PLY file with float x y z first, ASCII or little endian."""
    with open(path, "rb") as file:
        header, count, vertex_bytes, in_vertex = [], 0, 0, False
        sizes = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2,
                 "uint16": 2, "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4,
                 "float32": 4, "double": 8, "float64": 8}
        while not header or header[-1] != ["end_header"]:
            line = file.readline()
            if not line or len(header) > 1000:
                raise ValueError(path + " is not a PLY file")
            header.append(line.decode("ascii", "replace").split())
            words = header[-1]
            if words[:1] == ["element"]:
                in_vertex = words[1] == "vertex"
                count = int(words[2]) if in_vertex else count
            elif words[:1] == ["property"] and in_vertex:
                vertex_bytes += sizes[words[1]]
        kind = next(words[1] for words in header if words[:1] == ["format"])
        if kind == "ascii":
            points = np.array([file.readline().split()[:3] for _ in range(count)], dtype=float)
        elif kind == "binary_little_endian":
            raw = np.frombuffer(file.read(count * vertex_bytes), np.uint8)
            points = raw.reshape(-1, vertex_bytes)[:, :12].copy().view("<f4").astype(float)
        else:
            raise ValueError(path + ": " + kind + " is not supported")
    return points[:: max(1, len(points) // wanted)]


def save(figure, name):
    figure.savefig(os.path.join(FOLDER, name + ".png"), bbox_inches="tight", facecolor="white")
    plt.close(figure)
    return name + ".png"


def legend_above_causes(axes):
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1.12), ncol=6, borderaxespad=0.2)


def legend_above(axes, columns=6):
    axes.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncol=columns, borderaxespad=0.2)


def length_unit(values):
    """Factor and name of the unit that suits lengths of this size (metres)."""
    finite = values[np.isfinite(values)]
    return (1e3, "mm") if finite.size == 0 or np.max(np.abs(finite)) < 1.5 else (1.0, "m")


def label_decades(axes, values):
    """Ticks of a logarithmic axis at those of the values that it shows, in plain numbers."""
    low, high = axes.get_ylim()
    axes.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.set_yticks([value for value in values if low <= value <= high])
    axes.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))


def break_at_gaps(time, *columns):
    """Puts NaN where fixes are missing, so that lines do not bridge what was not measured."""
    if len(time) < 3:
        return (time,) + columns
    gaps = np.flatnonzero(np.diff(time) > 5 * np.median(np.diff(time))) + 1
    return tuple(np.insert(column, gaps, np.nan) for column in (time,) + columns)


class Channel:
    def __init__(self, name, series, metrics, start):
        self.name, self.series, self.metrics = name, series, metrics
        frames = metrics.get("run.time_unit") == "frames"
        self.time = series["utime"] if frames else (series["utime"] - start) * 1e-6
        self.time_label = "frame" if frames else "time [s]"
        self.usable = series["usable"] > 0
        self.with_truth = np.isfinite(series["error"])
        self.good = self.usable & self.with_truth
        prefix = name + ".status."
        self.statuses = [key[len(prefix):-len(".count")] for key in metrics
                         if key.startswith(prefix) and key.endswith(".count")]
        self.is_magnet = name == "MAGNETIC_POSE"
        self.rotation_name = "axis error" if self.is_magnet else "rotation error"

    def column(self, name):
        return self.series.get(name, np.full(len(self.time), np.nan))


def plot_trajectory(channel, surface):
    series, usable = channel.series, channel.usable
    factor, unit = length_unit(np.concatenate([series["true_x"], series["x"][usable]]))
    truth = np.stack([series["true_" + axis] for axis in "xyz"]) * factor
    truth = truth[:, np.isfinite(truth[0])]
    estimate = np.stack([series[axis] for axis in "xyz"])[:, usable] * factor
    # A line through the truth, dots for the fixes: each fix stands for itself.
    figure = plt.figure(figsize=(11, 8.5))
    for place, (a, b) in enumerate([(0, 1), (0, 2), (1, 2)]):
        axes = figure.add_subplot(2, 2, place + 1)
        axes.plot(estimate[a], estimate[b], ".", ms=2, color=ESTIMATE, alpha=0.6, label="estimate",
                  rasterized=True)
        axes.plot(truth[a], truth[b], "-", lw=1, color=TRUTH, label="truth")
        axes.set_xlabel(f"{'xyz'[a]} [{unit}]")
        axes.set_ylabel(f"{'xyz'[b]} [{unit}]")
        axes.set_aspect("equal", adjustable="datalim")
        if place == 0:
            axes.legend()
    axes = figure.add_subplot(2, 2, 4, projection="3d")
    step = max(1, estimate.shape[1] // 5000)
    if surface is not None:
        axes.scatter(*(surface.T * factor), s=0.3, color="#d1a3a3", alpha=0.25, depthshade=False)
    axes.plot(*estimate[:, ::step], ".", ms=1.5, color=ESTIMATE, alpha=0.6)
    axes.plot(*truth, "-", lw=1, color=TRUTH)
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    axes.set_zlabel(f"z [{unit}]")
    extent = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    axes.set_box_aspect(np.maximum(extent, extent.max() / 4))
    figure.suptitle(f"{channel.name}: trajectory")
    figure.tight_layout()
    return save(figure, channel.name + "_trajectory")


def draw_status(axes, channel):
    status = channel.series["status"]
    for number, name in enumerate(channel.statuses):
        times = channel.time[status == number]
        if times.size:
            axes.plot(times, np.zeros_like(times), "|", ms=14, mew=1.2,
                      color=STATUS_COLOURS[number % len(STATUS_COLOURS)], label=name,
                      rasterized=True)
    axes.set_yticks([])
    axes.grid(False)
    axes.set_ylabel("status", rotation=0, ha="right", va="center")
    axes.legend(ncol=6, loc="upper left", bbox_to_anchor=(0, -0.75), handlelength=1)


def plot_errors(channel):
    good = channel.good
    if not np.any(good):
        return None
    factor, unit = length_unit(channel.column("error")[good])
    strips = 1 if channel.statuses else 0
    figure, panels = plt.subplots(
        3 + strips, 1, figsize=(11, 8 + 0.5 * strips), sharex=True,
        gridspec_kw={"height_ratios": [3, 3, 3] + [0.5] * strips})
    position, components, rotation = panels[:3]

    def line(axes, column, scale, colour, label, **style):
        values = channel.column(column)[good] * scale
        if np.any(np.isfinite(values)):
            axes.plot(*break_at_gaps(channel.time[good], values), color=colour, label=label,
                      **{"lw": 0.9, **style})

    def band(axes, column, scale):
        sigma = channel.column(column)[good] * scale
        if np.any(np.isfinite(sigma)):
            time, sigma = break_at_gaps(channel.time[good], sigma)
            axes.fill_between(time, 0, 3 * sigma, color=BAND, alpha=0.45, lw=0, label="3 σ claimed")

    def fit_view(axes, column, sigma_column, bound_column, scale):
        """Room for errors, band and bound, but a few wild values must not flatten the rest."""
        values = channel.column(column)[good] * scale
        usual = 4 * np.percentile(values, 99)
        wanted = np.max(values)
        for other, factor in [(sigma_column, 3), (bound_column, 1)]:
            others = channel.column(other)[good] * scale * factor
            wanted = np.max(others[np.isfinite(others)], initial=wanted)
        axes.set_ylim(0, max(min(1.05 * wanted, usual), 1e-12))
        if np.max(values) > usual:
            axes.set_title(f"largest {np.max(values):.3g}, beyond the view", loc="left",
                           fontsize=8, color=BAD, fontweight="normal")

    band(position, "sigma_position", factor)
    line(position, "error", factor, ESTIMATE, "position error")
    line(position, "bound_position", factor, BOUND, "Cramér-Rao bound", ls="--")
    fit_view(position, "error", "sigma_position", "bound_position", factor)
    position.set_ylabel(f"position error [{unit}]")
    legend_above(position)
    for axis in "xyz":
        line(components, "error_" + axis, factor, AXIS_COLOURS[axis], axis, alpha=0.8)
    components.set_ylabel(f"per axis [{unit}]")
    legend_above(components)
    band(rotation, "sigma_rotation_deg", 1)
    line(rotation, "rotation_error_deg", 1, ESTIMATE, channel.rotation_name)
    line(rotation, "bound_axis_deg", 1, BOUND, "Cramér-Rao bound", ls="--")
    fit_view(rotation, "rotation_error_deg", "sigma_rotation_deg", "bound_axis_deg", 1)
    rotation.set_ylabel(channel.rotation_name + " [°]")
    legend_above(rotation)
    if channel.statuses:
        draw_status(panels[3], channel)
    panels[-1].set_xlabel(channel.time_label)
    aligned = channel.name in ("VISUAL_POSE", "ESTIMATE")
    frames = channel.metrics.get(channel.name + ".map_frames", 1)
    figure.suptitle(f"{channel.name}: errors" + (" after SE(3) alignment" if aligned else "")
                    + (f" of each of {frames} map frames" if frames > 1 else ""))
    figure.align_ylabels()
    figure.tight_layout()
    return save(figure, channel.name + "_errors")


def plot_histograms(channel):
    good = channel.good
    if not np.any(good):
        return None
    factor, unit = length_unit(channel.column("error")[good])
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.4))
    for axis, values, label in [
            (axes[0], channel.column("error")[good] * factor, f"position error [{unit}]"),
            (axes[1], channel.column("rotation_error_deg")[good], channel.rotation_name + " [°]")]:
        axis.hist(values, bins=60, color=ESTIMATE, alpha=0.75)
        for value, name, style in [(np.median(values), "median", "-"),
                                   (np.sqrt(np.mean(values**2)), "RMS", "--"),
                                   (np.percentile(values, 95), "95 %", ":")]:
            axis.axvline(value, color=TRUTH, ls=style, lw=1.2, label=f"{name} {value:.3g}")
        axis.set_xlabel(label)
        axis.set_ylabel("fixes")
        axis.legend()
    figure.suptitle(f"{channel.name}: distribution of errors")
    figure.tight_layout()
    return save(figure, channel.name + "_histogram")


def plot_consistency(channel):
    nees = channel.column("nees")
    chosen = channel.good & np.isfinite(nees)
    name = channel.name + ".nees."
    if not np.any(chosen) or name + "mean" not in channel.metrics:
        return None
    time, nees = channel.time[chosen], nees[chosen]
    freedom = channel.metrics[name + "degrees_of_freedom"]
    figure, axes = plt.subplots(figsize=(11, 3.4))
    axes.semilogy(time, nees, ".", ms=2, color=ESTIMATE, alpha=0.4, label="each fix",
                  rasterized=True)
    window = max(1, len(nees) // 50)
    running = np.convolve(nees, np.ones(window) / window, "valid")
    axes.semilogy(time[window // 2:window // 2 + len(running)], running, color=TRUTH, lw=1.2,
                  label=f"mean of {window}")
    axes.axhspan(channel.metrics[name + "band_low"], channel.metrics[name + "band_high"],
                 color=BOUND, alpha=0.35, label="95 % band of the mean over all")
    axes.axhline(freedom, color=BOUND, lw=0.8)
    axes.set_xlabel(channel.time_label)
    axes.set_ylabel("NEES")
    legend_above(axes)
    figure.suptitle(f"{channel.name}: can the covariance be believed? mean NEES "
                    f"{channel.metrics[name + 'mean']:.3g}, right is {freedom}")
    figure.tight_layout()
    return save(figure, channel.name + "_consistency")


def plot_magnetics(channel):
    if "chi2_per_dof" not in channel.series:
        return None
    usable = channel.usable
    figure, (chi2, background) = plt.subplots(2, 1, figsize=(11, 5), sharex=True)
    values = channel.column("chi2_per_dof")
    positive = np.isfinite(values) & (values > 0)
    for mask, colour, label in [(usable, ESTIMATE, "OK"), (~usable, BAD, "not usable")]:
        if np.any(mask & positive):
            chi2.semilogy(channel.time[mask & positive], values[mask & positive], ".", ms=2,
                          color=colour, label=label, rasterized=True)
    chi2.axhline(1, color=BOUND, lw=1)
    label_decades(chi2, (0.1, 0.2, 0.5, 1, 2, 5, 10, 100, 1000))
    chi2.set_ylabel("χ² per degree of freedom")
    legend_above(chi2)
    for axis in "xyz":
        field = channel.column("background_" + axis) * 1e6
        background.plot(*break_at_gaps(channel.time[usable], field[usable]), lw=0.9,
                        color=AXIS_COLOURS[axis], label=axis)
    background.set_ylabel("estimated background [µT]")
    background.set_xlabel(channel.time_label)
    legend_above(background)
    figure.suptitle(f"{channel.name}: fit and background")
    figure.tight_layout()
    return save(figure, channel.name + "_fit")


def plot_relative(channel):
    prefix = channel.name + ".rpe."
    lengths, means, high = [], [], []
    for key, value in channel.metrics.items():
        if key.startswith(prefix) and key.endswith("mm.trans.mean"):
            lengths.append(float(key[len(prefix):-len("mm.trans.mean")]))
            means.append(value * 1e3)
            high.append(channel.metrics[key[:-len("mean")] + "rmse"] * 1e3)
    if len(lengths) < 2:
        return None
    order = np.argsort(lengths)
    lengths, means, high = (np.array(values)[order] for values in (lengths, means, high))
    figure, axes = plt.subplots(figsize=(11, 3.2))
    axes.plot(lengths, means, "o-", color=ESTIMATE, label="mean")
    axes.plot(lengths, high, "s--", color=TRUTH, label="RMS")
    axes.set_xscale("log")
    axes.set_xticks(lengths)
    axes.set_xticklabels([f"{length:g}" for length in lengths])
    axes.minorticks_off()
    axes.set_ylim(bottom=0)
    axes.set_xlabel("length of true path between the poses [mm]")
    axes.set_ylabel("relative error [mm]")
    axes.legend()
    figure.suptitle(f"{channel.name}: relative error against length")
    figure.tight_layout()
    return save(figure, channel.name + "_relative")


def true_failures(metrics):
    """(sensor, number, start, end) of what evaluate was told."""
    for key in metrics:
        words = key.split(".")
        if len(words) == 4 and words[0] == "failure" and words[3] == "start":
            yield words[1], words[2], metrics[key], metrics[key[:-len("start")] + "end"]


def stretches(labels):
    """(first, last + 1, label) of each run of equal labels."""
    edges = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    bounds = [0, *edges.tolist(), len(labels)]
    return [(a, b, labels[a]) for a, b in zip(bounds, bounds[1:]) if b > a]


def draw_causes(axes, time, failed, causes):
    """A bar above the plot wherever the sensor counts as failed, with the cause where it fits."""
    letter = 0.0055 * (time[-1] - time[0])  # seconds that one is wide
    above = axes.get_xaxis_transform()
    nominal = "-"
    bars = [(time[first], time[min(end, len(time) - 1)], cause or "no cause")
            for first, end, cause in stretches(np.where(failed, causes, nominal))
            if cause != nominal]
    taken = []
    for begin, end, cause in sorted(bars, key=lambda bar: bar[0] - bar[1]):
        axes.plot([begin, end], [1.04, 1.04], color=BAD, lw=3, solid_capstyle="butt",
                  transform=above, clip_on=False)
        middle, half = (begin + end) / 2, letter * (len(cause) + 1) / 2
        if any(abs(middle - other) < half + other_half for other, other_half in taken):
            continue
        taken.append((middle, half))
        axes.text(middle, 1.08, cause, color=BAD, fontsize=7, ha="center", va="bottom",
                  transform=above)


def shade_failures(axes, failures, label):
    for index, (_, _, begin, end) in enumerate(failures):
        axes.axvspan(begin, end, color=SENSOR_COLOURS.get(failures[index][0], TRUTH), alpha=0.15,
                     lw=0, label=label if index == 0 else None)


def plot_failures(metrics, channels, health, start):
    """The paper's figure: what the fusion believes of each sensor, above the error it makes."""
    if not health:
        return None
    failures = list(true_failures(metrics))
    figure, panels = plt.subplots(
        len(health) + 1, 1, figsize=(11, 2.3 * len(health) + 3.4), sharex=True,
        gridspec_kw={"height_ratios": [1] * len(health) + [1.4], "hspace": 0.42, "top": 0.87})
    for axes, (name, series) in zip(panels, health.items()):
        time = (series["utime"] - start) * 1e-6
        shade_failures(axes, [each for each in failures if each[0] == name], "failed in truth")
        axes.plot(time, series["p_nominal"], color=SENSOR_COLOURS.get(name, ESTIMATE), lw=1,
                  label="switch: probability that it is nominal", rasterized=True)
        axes.plot(time, series["alpha"], color=TRUTH, lw=1.2, label="confidence α",
                  rasterized=True)
        axes.axhline(metrics["failure.threshold"], color=BAD, lw=0.8, ls=":", label="threshold")
        draw_causes(axes, time, ~(series["p_nominal"] >= metrics["failure.threshold"]),
                    series["cause"])
        axes.set_ylim(-0.03, 1.03)
        axes.set_ylabel(name)
        legend_above_causes(axes)
    axes = panels[-1]
    shade_failures(axes, failures, None)
    for channel in channels:
        style = {"MAGNETIC_POSE": ("magnetic", "magnet alone", 0.5, 0.55),
                 "VISUAL_POSE": ("visual", "vision alone, placed by SE(3)", 0.7, 0.7),
                 "CAPSULE_STATE": (None, "fused", 1.2, 1)}.get(channel.name)
        if style is None:
            continue
        sensor, label, width, alpha = style
        chosen = channel.with_truth & (channel.column("status") > 0) if sensor is None \
            else channel.good
        if not np.any(chosen):
            continue
        error = np.maximum(channel.column("error")[chosen] * 1e3, 1e-3)
        axes.semilogy(*break_at_gaps(channel.time[chosen], error), lw=width, alpha=alpha,
                      color=SENSOR_COLOURS.get(sensor, TRUTH), label=label, rasterized=True)
    axes.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    axes.set_ylabel("position error [mm]")
    axes.set_xlabel("time [s]")
    legend_above(axes)
    figure.suptitle("Which sensor is believed, and what the fused position errs by", y=0.96)
    figure.align_ylabels()
    return save(figure, "failures")


# 20 cm of trajectory in the paper (millimetres).
PAPER_AT_20_CM = {"MAGNETIC_POSE": 16.0, "VISUAL_POSE": 21.0, "CAPSULE_STATE": 12.5}
COMPARED = {"MAGNETIC_POSE": ("magnetic", "magnet alone"),
            "VISUAL_POSE": ("visual", "vision alone"), "CAPSULE_STATE": (None, "fused")}
COMPARED_LENGTHS = [50, 100, 150, 200]


def plot_comparison(metrics):
    """The paper's comparison: trajectory error against length, and its own figures as text."""
    figure, axes = plt.subplots(figsize=(11, 4))
    drawn = False
    for name, (sensor, label) in COMPARED.items():
        for alignment, line in [("none", "o-"), ("se3", "s--")]:
            given = [(length, 1e3 * metrics[key]) for length in COMPARED_LENGTHS
                     for key in [f"comparison.{length}mm.{name}.{alignment}"] if key in metrics]
            if not given:
                continue
            drawn = True
            words = "not aligned" if alignment == "none" else "SE(3)"
            axes.semilogy(*zip(*given), line, color=SENSOR_COLOURS.get(sensor, TRUTH),
                          label=f"{label}, {words}")
    if not drawn:
        plt.close(figure)
        return None
    paper = ", ".join(f"{COMPARED[name][1]} {value:g} mm"
                      for name, value in PAPER_AT_20_CM.items())
    axes.set_title(f"the paper at 200 mm: {paper}", loc="left", fontsize=8, fontweight="normal")
    axes.set_xticks(COMPARED_LENGTHS)
    low, high = axes.get_ylim()
    axes.set_ylim(low / 1.5, high * 1.5)
    label_decades(axes, [digit * 10.0**power for power in range(-3, 4) for digit in (1, 2, 5)])
    axes.set_xlabel("length of the trajectory [mm]")
    axes.set_ylabel("RMS position error [mm]")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    figure.suptitle("Trajectory error against length, mean over pieces")
    figure.tight_layout()
    return save(figure, "comparison")


def plot_depth_series(depth, start):
    time = (depth["utime"] - start) * 1e-6
    figure, (error, scale) = plt.subplots(2, 1, figsize=(11, 5), sharex=True)
    error.plot(time, depth["mean_abs"] * 1e3, color=ESTIMATE, lw=1, label="mean absolute")
    error.plot(time, depth["mean_abs_scaled"] * 1e3, color=BOUND, lw=1, label="after median scaling")
    error.plot(time, depth["bias"] * 1e3, color=BAND, lw=1, label="mean (bias)")
    error.axhline(0, color=TRUTH, lw=0.5)
    error.set_ylabel("depth error [mm]")
    legend_above(error)
    scale.axhline(1, color=TRUTH, lw=0.5)
    scale.plot(time, depth["scale"], color=TRUTH, lw=1, label="frame scale, true / estimated")
    scale.plot(time, depth["coverage"], color=BAD, lw=1, label="coverage")
    scale.set_ylabel("[1]")
    legend_above(scale)
    scale.set_xlabel("time [s]")
    figure.suptitle("DEPTH: errors and scale of the frames")
    figure.tight_layout()
    return save(figure, "DEPTH_errors")


def plot_depth_by_distance(bins):
    """Errors against true distance, above the share of pixels that are there."""
    given = bins["count"] > 0
    if not np.any(given):
        return None
    middle = 500 * (bins["near"] + bins["far"])
    # A handful of pixels at the far end would make a ragged tail.
    enough = bins["count"] > 1e-4 * bins["count"].sum()
    figure, (error, share) = plt.subplots(2, 1, figsize=(11, 5), sharex=True,
                                          gridspec_kw={"height_ratios": [3, 1]})
    bias, rmse = bins["bias"][enough] * 1e3, bins["rmse"][enough] * 1e3
    spread = np.sqrt(np.maximum(rmse**2 - bias**2, 0))
    error.fill_between(middle[enough], bias - spread, bias + spread, color=BAND, alpha=0.4, lw=0,
                       label="mean ± standard deviation")
    error.plot(middle[enough], bias, color=ESTIMATE, lw=1.2, label="mean (bias)")
    error.plot(middle[enough], bins["mean_abs"][enough] * 1e3, color=TRUTH, lw=1.2,
               label="mean absolute")
    error.axhline(0, color=TRUTH, lw=0.5)
    error.set_ylabel("depth error [mm]")
    legend_above(error)
    width = 1e3 * (bins["far"] - bins["near"])
    truth = 100 / bins["truth_pixels"].sum()
    share.bar(middle, bins["truth_pixels"] * truth, width, color="#d1d5db", label="true depth")
    share.bar(middle, bins["count"] * truth, width, color=ESTIMATE, alpha=0.6, label="estimated")
    share.set_xlim(0, 1e3 * bins["far"][bins["truth_pixels"] > 0].max())
    share.set_ylabel("pixels [%]")
    share.set_xlabel("true distance along the optical axis [mm]")
    legend_above(share)
    figure.suptitle("DEPTH: errors against true distance")
    figure.align_ylabels()
    figure.tight_layout()
    return save(figure, "DEPTH_by_distance")


def plot_visual(channel):
    if "icp_rms" not in channel.series:
        return None
    usable = channel.usable
    figure, panels = plt.subplots(4, 1, figsize=(11, 6.5), sharex=True,
                                  gridspec_kw={"height_ratios": [3, 3, 3, 0.5]})
    for axes, column, factor, label in [(panels[0], "icp_rms", 1e3, "geometric residual\nRMS [mm]"),
                                        (panels[1], "rgb_rms", 1, "photometric residual\nRMS [0..1]"),
                                        (panels[2], "inlier_fraction", 100, "inliers [%]")]:
        values = channel.column(column)[usable] * factor
        axes.plot(*break_at_gaps(channel.time[usable], values), lw=0.9, color=ESTIMATE)
        finite = values[np.isfinite(values)]
        if finite.size:
            axes.set_ylim(0, 1.05 * max(min(finite.max(), 3 * np.percentile(finite, 99)), 1e-9))
        axes.set_ylabel(label)
    draw_status(panels[3], channel)
    panels[3].set_xlabel(channel.time_label)
    figure.suptitle(f"{channel.name}: how well the frames fit the map")
    figure.align_ylabels()
    figure.tight_layout()
    return save(figure, channel.name + "_fit")


def show_picture(axes, path, title):
    axes.set_axis_off()
    axes.set_title(title, fontsize=10)
    axes.imshow(plt.imread(path), interpolation="antialiased")


def map_picture(entry, kind):
    return os.path.join(FOLDER, "map", entry["files"][kind])


def error_title(views):
    placed = {"trajectory": "map placed by the trajectory", "none": "map not aligned",
              "pairs": "map placed by picked points", "shape": "map placed by its shape"}
    return "distance from the true surface, " + placed[views["placement"]]


def error_bar(figure, axes, views):
    """A bar beside the picture, which stays as large as the others."""
    colours = plt.cm.ScalarMappable(cmap=views["error_colours"], norm=plt.Normalize(
        0, 1e3 * views["error_limit"]))
    bar = axes.inset_axes([1.01, 0.05, 0.02, 0.9])
    bar.grid(False)
    figure.colorbar(colours, cax=bar, extend="max").set_label("mm")


def plot_map_outside(views, number):
    entry = views["outside"][number]
    kinds = [("shape", "shape; " + views["drawn"]), ("albedo", "albedo, brightened"),
             ("error", error_title(views) if "error" in entry["files"] else ""),
             ("normals", "normals (red →, green ↑, blue to the eye)")]
    kinds = [(kind, title) for kind, title in kinds if kind in entry["files"]]
    height, width = plt.imread(map_picture(entry, "shape")).shape[:2]
    rows, columns = (2, 2) if len(kinds) == 4 else (1, len(kinds))
    figure, grid = plt.subplots(rows, columns, squeeze=False, figsize=(
        15, rows * (14.4 / columns * height / width + 0.35)))
    for axes, (kind, title) in zip(grid.flat, kinds):
        show_picture(axes, map_picture(entry, kind), title)
        if kind == "error":
            error_bar(figure, axes, views)
        if kind == "shape":
            metres = round_up(0.1 * width * entry["metres_per_pixel"], (1, 2, 5, 10))
            left, below = 0.03 * width, 0.97 * height
            across = metres / entry["metres_per_pixel"]
            axes.plot([left, left + across], [below, below], color="#111827", lw=3,
                      solid_capstyle="butt")
            factor, unit = (1e3, "mm") if metres < 1 else (1, "m")
            axes.text(left + across / 2, below - 0.015 * height, f"{factor * metres:g} {unit}",
                      ha="center", va="bottom", fontsize=9)
            axes.plot([], [], color="#e8480c", lw=2, label="estimated path")
            axes.plot([], [], color="white", lw=4, label="true path", path_effects=[
                matplotlib.patheffects.withStroke(linewidth=6, foreground="#4b5563")])
            axes.legend(loc="lower right", fontsize=9, ncol=2, borderaxespad=0.1)
            axes.set_xlim(-0.5, width - 0.5)
            axes.set_ylim(height - 0.5, -0.5)
    figure.tight_layout()
    return save(figure, f"map_outside_{number}")


def plot_map_frame(views, entry):
    photo = os.path.join(FOLDER, "frames", f"{entry['number']}_input.png")
    panels = [(photo, "camera picture, undistorted")] if os.path.exists(photo) else []
    panels.append((map_picture(entry, "albedo"), "map: albedo, brightened"))
    panels.append((map_picture(entry, "shape"), "map: shape"))
    if "error" in entry["files"]:
        panels.append((map_picture(entry, "error"), "map: distance from the true surface"))
    if len(panels) < 4:
        panels.append((map_picture(entry, "normals"), "map: normals"))
    height, width = plt.imread(panels[-1][0]).shape[:2]
    across = 15 / len(panels)
    figure, grid = plt.subplots(1, len(panels), figsize=(15, across * height / width + 0.7))
    for axes, (path, title) in zip(grid, panels):
        show_picture(axes, path, title)
        if "error" in os.path.basename(path):
            error_bar(figure, axes, views)
    figure.suptitle(f"frame {entry['number']}, {entry['seconds']:.2f} s: the finished map from "
                    f"there, {100 * entry['covered']:.0f} % covered ({views['drawn']})", fontsize=10)
    figure.tight_layout()
    return save(figure, f"map_frame_{entry['number']:06d}")


SURFACE_COLOURS = {"none": "#9ca3af", "trajectory": ESTIMATE, "pairs": ESTIMATE, "shape": ESTIMATE,
                   "handa": BOUND, "paper": "#8b5cf6"}


def plot_surface_errors(bins, views):
    shown = [name for name in ("pairs", "trajectory", "shape", "none", "handa", "paper")
             if name in bins and (name != "none" or views["placement"] == "none")]
    width = 1e3 * (bins["far"] - bins["near"])
    figure, (histogram, cumulative) = plt.subplots(1, 2, figsize=(11, 3.4))
    for name in shown:
        total = views["compared"]
        far = 1e3 * bins["far"]
        histogram.stairs(100 * bins[name] / total / width, 1e3 * np.append(bins["near"][0],
                                                                           bins["far"]),
                         color=SURFACE_COLOURS[name], label=SURFACE_NAMES[name],
                         fill=name == views["placement"],
                         alpha=0.35 if name == views["placement"] else 1)
        cumulative.plot(far, 100 * np.cumsum(bins[name]) / total, color=SURFACE_COLOURS[name],
                        lw=1.2, label=SURFACE_NAMES[name])
    limit = 1e3 * bins["far"][np.cumsum(bins[shown[0]]) <= 0.99 * views["compared"]].max(
        initial=bins["far"][0])  # 99 % of the first
    for axes in (histogram, cumulative):
        axes.set_xlim(0, 1.1 * limit)
        axes.set_xlabel("distance from the true surface [mm]")
        axes.legend()
    histogram.set_ylabel("surfels [% a mm]")
    cumulative.set_ylabel("surfels within [%]")
    cumulative.set_ylim(0, 100)
    figure.suptitle("Map: distances of the stable surfels from the true surface")
    figure.tight_layout()
    return save(figure, "map_errors")


def plot_map_size(sizes, start):
    figure, axes = plt.subplots(figsize=(11, 2.6))
    time = (sizes["utime"] - start) * 1e-6
    axes.plot(time, 1e-3 * sizes["surfels"], color=TRUTH, lw=1, label="all")
    axes.plot(time, 1e-3 * sizes["stable"], color=ESTIMATE, lw=1, label="stable")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("thousand surfels")
    legend_above(axes)
    figure.suptitle("Map: surfels in it")
    figure.tight_layout()
    return save(figure, "map_size")


def plot_map(metrics, start):
    pictures = [plot_map_size(load_series("map_size"), start)]
    path = os.path.join(FOLDER, "map", "views.json")
    if "map.drawn" not in metrics:
        return pictures
    with open(path, encoding="utf-8") as file:
        views = json.load(file)
    views["placement"] = metrics.get("surface.placement", "none")
    views["compared"] = metrics.get("surface.count", 0)
    views["drawn"] = "stable surfels" if metrics["map.drawn"] == "stable" else \
        f"all surfels, {100 * metrics['map.stable'] / metrics['map.surfels']:.1f} % of them stable"
    if views["compared"]:
        pictures.insert(0, plot_surface_errors(load_series("surface_histogram"), views))
    return ([plot_map_outside(views, number) for number in range(len(views["outside"]))]
            + [plot_map_frame(views, entry) for entry in views["frames"]] + pictures)


def short(text):
    """Three digits of a decimal number; other text as it is."""
    try:
        return f"{float(text):.3g}"
    except ValueError:
        return text


class FrameView:
    """The pictures of one frame as frame_views.cpp wrote them."""

    def __init__(self, entry):
        self.entry = entry
        self.number = entry["number"]

    def raw(self, kind):
        name = self.entry["files"].get(kind)
        return None if name is None else plt.imread(os.path.join(FOLDER, "frames", name))

    def millimetres(self, kind):
        picture = self.raw(kind)
        if picture is None:
            return None
        counts = np.round(picture * 65535)
        return np.where(counts > 0, counts * self.entry["metres_per_count"] * 1e3, np.nan)

    def error(self):
        truth, estimate = self.millimetres("truth"), self.millimetres("depth_at_truth")
        return None if truth is None or estimate is None else estimate - truth

    def normals(self):
        """Red: to the right, green: up, blue: to the camera, each from -1 to 1; clear: none."""
        depth = self.millimetres("depth")
        if depth is None or min(depth.shape) < 3:
            return None
        fx, fy, cx, cy = self.entry["pinhole"]
        u, v = np.meshgrid(np.arange(depth.shape[1]), np.arange(depth.shape[0]))
        points = np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth], axis=-1)
        down, right = np.gradient(points, axis=(0, 1))
        normals = np.cross(down, right)  # x right, y down: this one faces the camera
        with np.errstate(invalid="ignore", divide="ignore"):
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        colours = (1 + normals * np.array([1, -1, -1])) / 2
        given = np.all(np.isfinite(colours), axis=-1, keepdims=True)
        return np.concatenate([np.where(given, colours, 0), given], axis=-1)

    def title(self):
        parts = [f"frame {self.number}, {self.entry['seconds']:.2f} s"]
        error, truth = self.error(), self.millimetres("truth")
        if error is not None and np.any(np.isfinite(error)):
            seen = np.isfinite(error)
            scale = np.median(truth[seen]) / np.median((truth + error)[seen])
            parts.append(f"mean absolute error {np.mean(np.abs(error[seen])):.2f} mm")
            parts.append(f"frame scale {scale:.3f}")
        if self.entry.get("relative_std"):
            parts.append(f"claimed σ {100 * self.entry['relative_std']:.1f} %")
        lines = [",   ".join(parts)]
        metadata = [f"{key} {short(value)}" for key, value in self.entry["metadata"].items()]
        if metadata:
            lines.append(",   ".join(metadata))
        return "\n".join(line.replace("$", "\\$")[:200] for line in lines)


def round_up(value, steps=(1, 1.5, 2, 3, 5, 7, 10)):
    """The next of 1, 1.5, 2, 3, 5, 7, 10, 15, ..."""
    power = 10 ** np.floor(np.log10(value))
    return next(step * power for step in steps
                if step * power >= value * (1 - 1e-9))


def plot_frame(frame, error_limit, no_photo):
    figure, axes = plt.subplots(2, 4, figsize=(16, 6.2), gridspec_kw={"wspace": 0.2, "hspace": 0.14})

    def show(axis, picture, title, absent, **style):
        axis.set_xticks([])
        axis.set_yticks([])
        axis.grid(False)
        axis.set_title(title, fontsize=9)
        axis.set_facecolor("#d1d5db")  # seen where there is no value
        if picture is None:
            axis.text(0.5, 0.5, absent, ha="center", va="center", color="#374151",
                      transform=axis.transAxes)
            return
        shown = axis.imshow(picture, interpolation="nearest", **style)
        if picture.ndim == 2:  # the bar stands beside the picture, which stays as large as the others
            bar = axis.inset_axes([1.02, 0, 0.035, 1])
            bar.grid(False)
            figure.colorbar(shown, cax=bar)

    photo, albedo, vessels = frame.raw("input"), frame.raw("albedo"), frame.raw("vessels")
    depth, truth, error = frame.millimetres("depth"), frame.millimetres("truth"), frame.error()
    masked, mask_title = photo, "left out (red)"
    if albedo is not None:
        empty = albedo == 0
        mask_title = f"left out (red): {100 * np.mean(empty):.1f} %"
        base = photo if photo is not None and photo.shape[:2] == albedo.shape else \
            np.repeat(albedo[..., None], 3, axis=2)
        masked = np.where(empty[..., None], 0.35 * base + 0.65 * np.array([0.9, 0.1, 0.1]), base)
    show(axes[0][0], photo, "input, undistorted", no_photo)
    show(axes[0][1], masked if albedo is not None else None, mask_title, "no ALBEDO")
    show(axes[0][2], vessels, "vessel response [0..1]", "no VESSELS", cmap="magma", vmin=0, vmax=1)
    show(axes[0][3], albedo, "albedo, vessels enhanced [0..1]", "no ALBEDO", cmap="gray", vmin=0,
         vmax=1)

    known = [picture[np.isfinite(picture)] for picture in (truth, depth) if picture is not None]
    known = next((values for values in known if values.size), np.array([0.0, 1.0]))
    low, high = np.percentile(known, [1, 99])
    given = 0 if depth is None else 100 * np.mean(np.isfinite(depth))
    distance = {"cmap": "viridis", "vmin": low, "vmax": max(high, low + 1e-3)}
    show(axes[1][0], depth, f"depth [mm], {given:.1f} % given", "no DEPTH", **distance)
    show(axes[1][1], frame.normals(), "normals (red →, green ↑, blue to the lens)",
         "no DEPTH")
    show(axes[1][2], truth, "true depth [mm]", "no truth", **distance)
    error_title = "depth error [mm]"
    if error is not None and np.any(np.isfinite(error)):
        percentiles = np.percentile(error[np.isfinite(error)], [5, 50, 95])
        error_title += "; 5, 50, 95 %: " + ", ".join(f"{value:+.1f}" for value in percentiles)
    show(axes[1][3], error, error_title, "no truth", cmap="RdBu_r", vmin=-error_limit,
         vmax=error_limit)
    figure.suptitle(frame.title(), fontsize=10)
    return save(figure, f"frame_{frame.number:06d}")


def plot_frames(metrics):
    """All with the same colours for errors, so that they can be compared."""
    with open(os.path.join(FOLDER, "frames", "frames.json"), encoding="utf-8") as file:
        frames = [FrameView(entry) for entry in json.load(file)]
    errors = [error[np.isfinite(error)] for error in (frame.error() for frame in frames)
              if error is not None]
    errors = np.abs(np.concatenate(errors)) if errors else np.array([])
    limit = round_up(max(np.percentile(errors, 90), 0.1)) if errors.size else 1
    no_photo = "no usable picture" if "messages.CAMERA.count" in metrics else \
        "no pictures in the log\n(replay without --keep-images)"
    return [plot_frame(frame, limit, no_photo) for frame in frames]


def number(value):
    if isinstance(value, bool) or value is None:
        return "–"
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ")
    return f"{value:.4g}"


def summary_rows(metrics):
    rows = []
    for key, label, factor, unit, target, remark in TARGETS:
        value = metrics.get(key)
        if value is None:
            continue
        if target is NO_TARGET:
            met, wanted = None, "–"
        elif target is NEES_BAND:
            base = key[: -len("mean")]
            low, high = metrics[base + "band_low"], metrics[base + "band_high"]
            met, wanted = low <= value <= high, f"{low:.3g} to {high:.3g}"
        else:
            met, wanted = factor * value <= target, f"≤ {target:g} {unit}"
        mark = {None: "", True: '<span class="yes">✓ met</span>',
                False: '<span class="no">✗ missed</span>'}[met]
        rows.append(f"<tr><td>{label}</td><td class=n>{number(float(factor * value))} {unit}</td>"
                    f"<td class=n>{wanted}</td><td>{mark}</td><td class=dim>{remark}</td></tr>")
    return "".join(rows)


def error_rows(metrics, channels):
    rows = []
    for channel in channels:
        get = lambda key: metrics.get(channel.name + "." + key)
        factor, unit = length_unit(channel.column("error")[channel.good])
        length = lambda key: "–" if get(key) is None else f"{get(key) * factor:.4g} {unit}"
        rotation = "axis_error_deg" if channel.is_magnet else "rotation_error_deg"
        angle = lambda key: "–" if get(key) is None else f"{get(key):.3g}°"
        share = get("availability")
        cells = [f"{number(get('with_truth'))} / {number(get('count'))}",
                 "–" if share is None else f"{100 * share:.1f} %", length("ate.none.rmse"),
                 length("ate.none.median"), length("ate.none.max"), length("ate.se3.rmse"),
                 length("ate.sim3.rmse"),
                 "–" if get("ate.sim3.scale") is None else f"{get('ate.sim3.scale'):.4f}", angle(rotation + ".rmse")]
        rows.append(f"<tr><td>{channel.name}</td>"
                    + "".join(f"<td class=n>{cell}</td>" for cell in cells) + "</tr>")
    return "".join(rows)


SURFACE_NAMES = {"none": "not aligned", "trajectory": "placed by the trajectory",
                 "pairs": "placed by picked points", "shape": "placed by its shape",
                 "handa": "then aligned, Handa 2014", "paper": "then aligned, the paper's way",
                 "all": "unstable surfels too, not aligned further",
                 "seen.none": "not aligned, against the wall as last seen",
                 "seen.trajectory": "placed by the trajectory, against the wall as last seen",
                 "seen.pairs": "placed by picked points, against the wall as last seen"}


def surface_section(metrics):
    if not any(key.startswith("surface.") for key in metrics):
        return ""
    percent = lambda key: f"{100 * metrics['surface.completeness.' + key]:.1f} %"
    rows = []
    for name, label in SURFACE_NAMES.items():
        get = lambda key: metrics.get(f"surface.{name}.{key}")
        if get("mean") is None:
            continue
        cells = [f"{1e3 * get(key):.3f}" for key in ("rmse", "mean", "median", "std", "min", "max")]
        cells += [f"{100 * get('within_' + limit):.1f} %" for limit in ("1.5mm", "2.5mm")
                  if get("within_" + limit) is not None]
        cells += ["–"] * (8 - len(cells))
        moved = "" if get("moved") is None else (
            f"moved {1e3 * get('moved'):.2f} mm and {get('turned_deg'):.2f}° "
            f"in {get('iterations')} steps")
        rows.append(f"<tr><td>{label}</td>" + "".join(f"<td class=n>{cell}</td>" for cell in cells)
                    + f"<td class=dim>{moved}</td></tr>")
    words = (f"<p class=dim>{number(metrics['map.stable'])} stable surfels of "
             f"{number(metrics['map.surfels'])}; distance from each to the nearest point of the "
             "true surface, in millimetres. ")
    seen = [metrics[key] for key in ("surface.seen.trajectory.count", "surface.seen.pairs.count",
                                         "surface.seen.none.count")
            if key in metrics]
    if seen:
        words += (f"As last seen: from {number(seen[0])} spread over them to the true depth of the "
                  "last picture in view of them before they were last measured. ")
    if "surface.thickness.mean" in metrics:
        get = lambda key: metrics["surface.thickness." + key]
        words += (f"Thickness, the standard deviation along the normal of the surfels around one: "
                  f"{1e3 * get('mean'):.3f} mm in the mean, median {1e3 * get('median'):.3f} mm, "
                  f"{1e3 * get('p90'):.3f} mm for 90 %; {100 * get('share_double'):.2f} % is as "
                  "thick as two layers a fortieth of the working distance apart. ")
    if "surface.completeness.within_1.5mm" in metrics:
        words += (f"{percent('seen_share')} of the surface was in view from the true poses; of "
                  f"that, {percent('within_1.5mm')} has a stable surfel within 1.5 mm, "
                  f"{percent('within_2.5mm')} within 2.5 mm (of all surfels "
                  f"{percent('all.within_1.5mm')} and {percent('all.within_2.5mm')}).")
    return words + "</p>" + table(
        ["map", "#RMS", "#mean", "#median", "#std", "#min", "#max", "#within 1.5 mm",
         "#within 2.5 mm", ""], "".join(rows))


DEFORMATION_NAMES = {"frame": "frame to model", "local_loop": "local loop closure",
                     "global_loop": "global loop closure"}


def deformation_rows(metrics):
    rows = []
    for kind, label in DEFORMATION_NAMES.items():
        get = lambda key: metrics.get(f"deformation.{kind}.{key}")
        if get("count") is None:
            continue
        length = lambda key: "–" if get(key) is None else f"{1e3 * get(key):.3f} mm"
        cells = [number(get("count")), length("error_before"), length("error_after"),
                 length("largest_move")]
        rows.append(f"<tr><td>{label}</td>" + "".join(f"<td class=n>{cell}</td>" for cell in cells)
                    + "</tr>")
    return "".join(rows)


def status_rows(channels):
    rows = []
    for channel in channels:
        if len(channel.statuses) < 2:
            continue
        for status in channel.statuses:
            get = lambda key: channel.metrics.get(f"{channel.name}.status.{status}.{key}")
            count = get("count")
            share = 100 * count / max(1, channel.metrics[channel.name + ".count"])
            factor, unit = length_unit(channel.column("error")[channel.good])
            error = "–" if get("position.rmse") is None else \
                f"{factor * get('position.rmse'):.4g} {unit}"
            rows.append(f"<tr><td>{channel.name}</td><td>{status}</td><td class=n>{number(count)}"
                        f"</td><td class=n>{share:.1f} %</td><td class=n>{error}</td></tr>")
    return "".join(rows)


def failure_rows(metrics):
    rows = []
    for sensor, number_, start, end in true_failures(metrics):
        get = lambda key: metrics.get(f"failure.{sensor}.{number_}.{key}")
        after = lambda key, otherwise: otherwise if get(key) is None else f"{get(key):.2f} s"
        length = lambda key: "–" if get(key) is None else f"{1e3 * get(key):.2f} mm"
        ratio = lambda key: "–" if get(key) is None else f"{get(key):.2f} ×"
        cells = [f"{start:g} – {end:g} s", after("detection_delay", "never"),
                 f"{100 * get('missed_share'):.1f} %", after("recovery_delay", "never"),
                 length("error.rmse"), length("error.max"), ratio("ratio_to_nominal"),
                 ratio("ratio_to_nominal_15s"), f"{length('jump')} / {length('jump_of_truth')}"]
        rows.append(f"<tr><td>{html.escape(sensor)}</td>"
                    + "".join(f"<td class=n>{cell}</td>" for cell in cells) + "</tr>")
    return "".join(rows)


def failures_section(metrics):
    if "failure.threshold" not in metrics:
        return ""
    suffix = ".false_alarms.count"
    words = "; ".join(
        f"{html.escape(name)}: {number(metrics[f'failure.{name}.false_alarms.count'])} false alarms"
        f" ({metrics[f'failure.{name}.false_alarms.seconds']:.2f} s)"
        for name in (key[len("failure."):-len(suffix)] for key in metrics if key.endswith(suffix)))
    if "failure.nominal.error.rmse" in metrics:
        nominal = 1e3 * metrics["failure.nominal.error.rmse"]
        words += (f"; position error while nothing is amiss {nominal:.2f} mm RMS. Jump: the "
                  "largest step between two states within a second of the sensor's return, and what the "
                  "capsule moved in it.")
    return f"<p class=dim>{words}</p>" + table(
        ["sensor", "#failed", "#noticed after", "#missed", "#recovered after", "#RMS error", "#max",
         "#/ nominal", "#/ nominal, 15 s", "#jump / true"], failure_rows(metrics))


def comparison_rows(metrics):
    rows = []
    for name, (_, label) in COMPARED.items():
        if f"{name}.count" not in metrics:
            continue
        cells = []
        for length in COMPARED_LENGTHS:
            get = lambda key: metrics.get(f"comparison.{length}mm.{name}.{key}")
            cells.append("–" if get("se3") is None else
                         (f"{1e3 * get('none'):.3g} / " if get("none") is not None else "")
                         + f"{1e3 * get('se3'):.3g} mm ({get('count')} / {get('followed')})")
        cells.append(f"{PAPER_AT_20_CM[name]:g} mm")
        for key, factor, unit in [("rpe.5mm.trans.mean", 1e3, " mm"),
                                  ("rpe.5deg.rot_deg.mean", 1, "°")]:
            value = metrics.get(f"{name}.{key}")
            cells.append("–" if value is None else f"{factor * value:.3g}{unit}")
        rows.append(f"<tr><td>{label}</td>" + "".join(f"<td class=n>{cell}</td>" for cell in cells)
                    + "</tr>")
    return "".join(rows)


def comparison_section(metrics):
    rows = comparison_rows(metrics)
    if not rows or not any(key.startswith("comparison.") for key in metrics):
        return ""
    words = ("<p class=dim>RMS position error over pieces of the true path that begin every 20 mm, "
             "mean over the pieces that all of the channels followed, that is had usable poses for "
             "90 % of (in brackets: their number / those that this one followed): not aligned / "
             "aligned by SE(3), never with scale; vision alone has no place of its own in the rig. "
             "Then what a motion of 5 mm errs by, and a turn of 5° (mean; the paper: 0.5 mm and "
             "0.5°); the magnet's roll is taken from the truth.</p>")
    return words + table([""] + [f"#{length} mm" for length in COMPARED_LENGTHS]
                         + ["#paper, 200 mm", "#over 5 mm", "#over 5°"], rows)


def distance_rows(metrics):
    rows = []
    for band in ("5_to_15mm", "15_to_30mm", "30_to_45mm", "45_to_70mm", "over_70mm"):
        get = lambda key: metrics.get(f"DEPTH.{band}.{key}")
        if not get("count"):
            continue
        length = lambda key: f"{1e3 * get(key):.3g} mm"
        cells = [number(get("count")), f"{100 * get('coverage'):.1f} %", length("mean_abs"),
                 length("rmse"), f"{100 * get('relative'):.2g} %", length("bias")]
        rows.append(f"<tr><td>{band.replace('_', ' ').replace('mm', ' mm')}</td>"
                    + "".join(f"<td class=n>{cell}</td>" for cell in cells) + "</tr>")
    return "".join(rows)


def constancy(metrics):
    rows = "".join(
        f"<tr><td>{label}</td>" + "".join(
            f"<td class=n>{number(metrics.get(f'{kind}.{figure}'))}</td>"
            for figure in ("spread", "contrast", "spread_over_contrast", "local_contrast",
                           "spread_over_local_contrast")) + "</tr>"
        for kind, label in [("albedo", "ALBEDO"), ("luminance", "luminance of the picture"),
                            ("clahe", "the same with equalised contrast (CLAHE)")]
        if f"{kind}.spread" in metrics)
    if not rows:
        return ""
    words = (f"<p class=dim>{number(metrics['constancy.points'])} points followed for up to 2 s "
             "with true depth and pose; their distance from the lens changed by a factor of "
             f"{metrics['constancy.distance_ratio']:.2f} (median). Spread: standard deviation of a "
             "point's values / their mean, median over the points; contrast: the same over the "
             "mean values of the points of a picture, to which the lamp's fall-off across the "
             "picture adds; local contrast: between neighbours alone.</p>")
    return words + table(["", "#spread", "#contrast", "#spread / contrast", "#local contrast",
                          "#spread / local contrast"], rows)


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
.dim{color:#6b7280;font-size:13px}.yes{color:#047857;font-weight:600}.no{color:#b91c1c;font-weight:600}
.facts span{display:inline-block;margin:0 28px 6px 0;color:#4b5563}.facts b{color:#111827}
.warn{background:#fffbeb;border-left:5px solid #f59e0b}.bad{background:#fef2f2;border-left:5px solid #dc2626}
ul{margin:0;padding-left:20px}img{max-width:100%;display:block;margin:10px auto}
details summary{cursor:pointer;color:#374151;font-weight:600}code{font-size:13px}
"""


def inline(picture):
    with open(os.path.join(FOLDER, picture), "rb") as file:
        data = base64.b64encode(file.read()).decode("ascii")
    return f'<img alt="{html.escape(picture)}" src="data:image/png;base64,{data}">'


def section(title, body, kind=""):
    return f'<section class="{kind}"><h2>{html.escape(title)}</h2>{body}</section>' if body else ""


def table(head, rows):
    """Heads that start with '#' stand above numbers."""
    cells = "".join(f'<th class=n>{name[1:]}</th>' if name.startswith("#") else f"<th>{name}</th>"
                    for name in head)
    return f"<table><tr>{cells}</tr>{rows}</table>" if rows else ""


def page(metrics, channels, plots):
    text = lambda key: html.escape(str(metrics[key]))
    facts = []
    for key, label in [("run.log", "log"), ("run.ground_truth", "ground truth"),
                       ("run.configuration", "configuration"),
                       ("run.code_version", "recorded with"),
                       ("run.evaluate_version", "evaluated with")]:
        if key in metrics:
            facts.append(f"<span>{label} <b>{text(key)}</b></span>")
    if "run.seconds" in metrics:
        facts.append(f"<span>duration <b>{metrics['run.seconds']:.1f} s</b></span>")
    for key, label, factor, unit in [("replay.wall_seconds", "replay took", 1, "s"),
                                     ("replay.cpu_seconds", "CPU", 1, "s"),
                                     ("replay.peak_resident_bytes", "peak memory", 1e-6, "MB")]:
        if key in metrics:
            facts.append(f"<span>{label} <b>{factor * metrics[key]:.1f} {unit}</b></span>")
    parts = [f'<h1>gastronaut report</h1><div class="facts">{"".join(facts)}</div>']
    if metrics.get("run.damage"):
        parts.append(section("The log is damaged", text("run.damage"), "bad"))
    notes = [html.escape(value) for key, value in metrics.items() if key.startswith("note.")]
    if notes:
        parts.append(section("To be known", "<ul>" + "".join(f"<li>{note}</li>" for note in notes)
                             + "</ul>", "warn"))
    parts.append(section("Targets", table(["what", "#measured", "#target", "", "target holds"],
                                          summary_rows(metrics))))
    parts.append(section("Depth by true distance", table(
        ["distance", "#pixels", "#given", "#mean absolute", "#RMS", "#relative", "#bias"],
        distance_rows(metrics))))
    parts.append(section("Does a surface point keep its value?", constancy(metrics)))
    parts.append(section("Errors", table(
        ["channel", "#scored / all", "#available", "#RMS", "#median", "#max", "#RMS SE(3)",
         "#RMS Sim(3)", "#scale", "#rotation"], error_rows(metrics, channels))))
    parts.append(section("Sensor failures", failures_section(metrics)))
    parts.append(section("Trajectory error against length", comparison_section(metrics)))
    parts.append(section("Status", table(["channel", "status", "#frames or fixes", "#share",
                                          "#RMS position error"], status_rows(channels))))
    parts.append(section("Map against the true surface", surface_section(metrics)))
    parts.append(section("Bends of the map", table(
        ["by", "#number", "#constraints err before", "#and after", "#largest move of a node"],
        deformation_rows(metrics))))
    for title, pictures in plots:
        parts.append(section(title, "".join(inline(picture) for picture in pictures if picture)))
    suffix = ".ms_per_event.median"
    timings = "".join(
        f"<tr><td>{html.escape(name)}</td><td class=n>{number(metrics[name + '.events'])}</td>"
        + "".join(f"<td class=n>{number(float(metrics[name + '.ms_per_event.' + figure]))}</td>"
                  for figure in ("median", "p99", "max")) + "</tr>"
        for name in (key[:-len(suffix)] for key in metrics if key.endswith(suffix)))
    parts.append(section("Time per event", table(
        ["process", "#events", "#median [ms]", "#99 % [ms]", "#max [ms]"], timings)))
    counts = "".join(
        f"<tr><td>{html.escape(name)}</td><td class=n>{number(metrics[key])}</td>"
        f"<td class=n>{metrics[f'messages.{name}.bytes'] / 1e6:.2f} MB</td>"
        f"<td class=n>{number(metrics.get(f'messages.{name}.corrupt', 0))}</td></tr>"
        for key, name in ((key, key[len("messages."):-len(".count")]) for key in metrics
                          if key.startswith("messages.") and key.endswith(".count")))
    parts.append(section("Messages", table(["channel", "#messages", "#size", "#damaged"], counts)))
    rows = "".join(f"<tr><td><code>{html.escape(key)}</code></td><td class=n>"
                   f"{html.escape(str(value) if isinstance(value, str) else number(value))}"
                   "</td></tr>" for key, value in metrics.items())
    parts.append(f"<section><details><summary>All {len(metrics)} figures (metrics.json)</summary>"
                 f"<table>{rows}</table></details></section>")
    return ('<!doctype html><html lang="en"><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<title>gastronaut: {html.escape(str(metrics.get('run.log', '')))}</title>"
            f"<style>{STYLE}</style><main>{''.join(parts)}</main></html>\n")


def main():
    metrics = load_metrics()
    surface = load_surface_points(SURFACE) if SURFACE else None
    truth = load_series("GROUND_TRUTH_POSE")
    series = {name: load_series(name) for name in POSE_CHANNELS}
    series = {name: values for name, values in series.items()
              if values is not None and f"{name}.count" in metrics}
    depth = load_series("DEPTH") if "DEPTH.count" in metrics else None
    starts = [values["utime"][0] for values in list(series.values()) + [truth, depth]
              if values is not None]
    start = min(starts) if starts else 0
    channels = [Channel(name, values, metrics, start) for name, values in series.items()]
    plots = [("Sensor failures over time",
              [plot_failures(metrics, channels, load_sensor_health(), start)]),
             ("Magnet, vision and both", [plot_comparison(metrics)])]
    for channel in channels:
        plots.append((channel.name, [
            plot_trajectory(channel, surface), plot_errors(channel), plot_histograms(channel),
            plot_consistency(channel), plot_relative(channel), plot_magnetics(channel),
            plot_visual(channel)]))
    if "map.messages" in metrics:
        plots.append(("Map", plot_map(metrics, start)))
    if depth is not None:
        plots.append(("DEPTH", [plot_depth_series(depth, start),
                                plot_depth_by_distance(load_series("DEPTH_by_distance"))]))
    if metrics.get("frames.shown"):
        plots.append(("Pictures", plot_frames(metrics)))
    with open(os.path.join(FOLDER, "index.html"), "w", encoding="utf-8") as file:
        file.write(page(metrics, channels, plots))


try:
    main()
except (OSError, ValueError) as problem:
    sys.exit(f"report.py: {problem}")
