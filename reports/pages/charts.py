"""Convergence on log-log axes: RMSE against samples and against seconds, with the fit `MSE = b² + c N^-a`.

The dotted guide falls as 1/sqrt(N), as the error of independent samples does. RMSE is that of one
replicate, so the seconds are those of one replicate, too.
"""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from termwise.reports.pages.digits import number

# Of Okabe and Ito's colour-blind safe palette, those that stand out on white and on black; marks differ too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7F7F7F")
MARKS = ("circle", "square", "diamond", "triangle-up", "cross")
GUIDE = "#888888"

_AXES = (("samples per pixel and replicate", "samples"), ("seconds per replicate", "seconds"))


def convergence(curves: dict[str, list[dict[str, Any]]]) -> dict[str, Any] | None:
    """A plotly figure of the variants of a term, ready for JSON; None where no variant has two points.

    Parameters
    ----------
    curves : variant -> its rows against `own`, by increasing samples.
    """
    curves = {name: [row for row in rows if row["rmse"]] for name, rows in curves.items()}
    curves = {name: rows for name, rows in curves.items() if len(rows) > 1}
    if not curves:
        return None
    figure = make_subplots(cols=2, shared_yaxes=True, horizontal_spacing=0.04)
    drawn: dict[str, list[float]] = {"samples": [], "seconds": [], "y": []}
    for index, (name, rows) in enumerate(curves.items()):
        colour, mark = COLOURS[index % len(COLOURS)], MARKS[index % len(MARKS)]
        samples = np.array([row["samples"] for row in rows], float)
        rmse = np.array([row["rmse"] for row in rows])
        seconds = np.array([(row["seconds"] or np.nan) / (row["replicates"] or 1) for row in rows])
        banded = all(row["rmse_low"] and row["rmse_high"] for row in rows)
        for column, x in ((1, samples), (2, seconds)):
            if not np.isfinite(x).all():
                continue
            drawn[_AXES[column - 1][1]] += x.tolist()
            drawn["y"] += rmse.tolist()
            style: dict[str, Any] = {"legendgroup": name, "showlegend": False, "hoverinfo": "skip"}
            if banded:
                edge = [row["rmse_high"] for row in rows] + [row["rmse_low"] for row in reversed(rows)]
                band = go.Scatter(
                    x=[*x, *x[::-1]], y=edge, fill="toself", fillcolor=colour, opacity=0.18, mode="none", **style
                )
                figure.add_trace(band, 1, column)
            if (fitted := fitted_curve(rows, samples, rmse)) is not None:
                # A fit in samples: where the axis is time, samples are placed between the measured times.
                line = go.Scatter(
                    x=np.exp(np.interp(np.log(fitted[0]), np.log(samples), np.log(x))).tolist(),
                    y=fitted[1].tolist(),
                    mode="lines",
                    line={"color": colour, "width": 1.5},
                    **style,
                )
                figure.add_trace(line, 1, column)
            figure.add_trace(
                go.Scatter(
                    x=x.tolist(),
                    y=rmse.tolist(),
                    name=name + _slope(rows[-1]),
                    legendgroup=name,
                    showlegend=column == 1,
                    mode="markers" if fitted is not None else "lines+markers",
                    line={"color": colour, "width": 1.5},
                    marker={"color": colour, "symbol": mark, "size": 8},
                    hovertemplate=f"{name}<br>%{{x:.4g}} {_AXES[column - 1][1]}<br>RMSE %{{y:.3g}}<extra></extra>",
                ),
                1,
                column,
            )
            if index == 0:
                ends = np.array([x[0], x[-1]])
                figure.add_trace(
                    go.Scatter(
                        x=ends.tolist(),
                        y=(rmse[0] * np.sqrt(ends[0] / ends)).tolist(),
                        name="1/√N",
                        legendrank=2000,
                        legendgroup="guide",
                        showlegend=column == 1,
                        mode="lines",
                        line={"color": GUIDE, "width": 1.5, "dash": "dot"},
                        hoverinfo="skip",
                    ),
                    1,
                    column,
                )
    figure.update_xaxes(type="log")
    figure.update_yaxes(type="log", **_ticks(drawn["y"]))
    figure.update_yaxes(title="RMSE (radiance)", col=1)
    for column, (title, _) in enumerate(_AXES, 1):
        figure.update_xaxes(title=title, col=column)
    every = sorted(set(drawn["samples"]))
    figure.update_xaxes(tickvals=every, ticktext=[f"{n:g}" for n in every], col=1)
    figure.update_xaxes(**_ticks(drawn["seconds"]), col=2)
    legend = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}
    _plain(figure, height=400, left=70, bottom=56, legend=legend)
    return figure.to_plotly_json()


# Parts of the mean square error, as results name them and as a reader does.
PARTS = (
    ("model_gap", "model gap²"),
    ("cross", "2 gap × bias"),
    ("bias", "bias²"),
    ("variance", "variance"),
    ("total", "MSE"),
)


def waterfall(split: dict[str, list[float]]) -> dict[str, Any]:
    """The parts of a mean square error one upon the other, each with its interval, and their sum.

    Parameters
    ----------
    split : part -> value and ends of its interval, radiance²; the cross term, and any part by chance, may be negative.
    """
    value, low, high = (np.array([split[name][k] for name, _ in PARTS]) for k in range(3))
    base = np.concatenate([[0.0], np.cumsum(value[:-2]), [0.0]])
    figure = go.Figure(
        go.Bar(
            x=[label for _, label in PARTS],
            y=value.tolist(),
            base=base.tolist(),
            marker={"color": [COLOURS[4], COLOURS[3], COLOURS[1], COLOURS[0], COLOURS[2]]},
            error_y=_bars(value, low, high, thickness=1.2, width=5),
            customdata=value.tolist(),
            hovertemplate="%{x}<br>%{customdata:.3g} radiance²<extra></extra>",
            showlegend=False,
        )
    )
    figure.update_yaxes(title="mean square error (radiance²)", tickformat=".2~g")
    _plain(figure, height=400, left=90, bottom=40)
    return figure.to_plotly_json()


def p_histograms(tiles: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Counts of p by size of the tiles, dashed what they are under the null; None where no tile varies.

    Parameters
    ----------
    tiles : of each size, as `reports.statistics.tiles.summary` gives it.
    """
    shown = [size for size in tiles if sum(size["histogram"])]
    if not shown:
        return None
    figure = make_subplots(cols=len(shown), horizontal_spacing=0.06)
    for column, size in enumerate(shown, 1):
        counts = size["histogram"]
        expected = sum(counts) / len(counts)
        middles = (np.arange(len(counts)) + 0.5) / len(counts)
        figure.add_trace(
            go.Bar(
                x=middles.tolist(),
                y=counts,
                width=1 / len(counts),
                marker={"color": COLOURS[0], "line": {"width": 0}},
                hovertemplate="p about %{x:.3f}: %{y} tiles<extra></extra>",
                showlegend=False,
            ),
            1,
            column,
        )
        figure.add_trace(
            go.Scatter(
                x=[0, 1],
                y=[expected, expected],
                mode="lines",
                line={"color": GUIDE, "width": 1.5, "dash": "dash"},
                hovertemplate=f"under the null {expected:.3g}<extra></extra>",
                showlegend=False,
            ),
            1,
            column,
        )
        figure.update_xaxes(title=f"p, tiles of {size['side']} px", col=column)
    figure.update_xaxes(range=[0, 1])
    figure.update_yaxes(rangemode="tozero", nticks=6)
    figure.update_yaxes(title="tiles", col=1)
    _plain(figure, height=300, left=60, bottom=44, bargap=0)
    return figure.to_plotly_json()


def error_against_time(ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> dict[str, Any]:
    """RMSE against seconds of rendering: our variants in colours, Mitsuba's settings grey, the fastest of them dark.

    Parameters
    ----------
    ours, theirs : curves of a benchmark of terms: `setting`, `samples`, `rmse`, `seconds`, `seconds_low`,
        `seconds_high`; of ours `floor`, of theirs `kept`.
    """
    figure = go.Figure()
    # A setting that no target keeps is drawn first, without a name of its own: hundreds of names say nothing.
    for curve in sorted(theirs, key=lambda curve: bool(curve["kept"])):
        kept = bool(curve["kept"])
        figure.add_trace(
            _curve(curve, f"Mitsuba: {curve['setting']}", GUIDE, MARKS[_sampler(curve)])
            | {"showlegend": kept, "opacity": 1.0 if kept else 0.3, "legendrank": 1500}
        )
    drawn = []
    for index, curve in enumerate(ours):
        colour = COLOURS[index % len(COLOURS)]
        ends = _bars(curve["seconds"], curve["seconds_low"], curve["seconds_high"], thickness=1, width=2)
        figure.add_trace(_curve(curve, f"ours: {curve['setting']}", colour, MARKS[index]) | {"error_x": ends})
        if curve["floor"]:
            figure.add_trace(
                {
                    "x": [curve["seconds"][0], curve["seconds"][-1]],
                    "y": [curve["floor"]] * 2,
                    "mode": "lines",
                    "line": {"color": colour, "width": 1.5, "dash": "dot"},
                    # The page says what dots are: a long name would take the plot's room.
                    "showlegend": False,
                    "hovertemplate": f"bias of {curve['setting']} at its last point %{{y:.3g}}<extra></extra>",
                }
            )
            drawn.append(curve["floor"])
    drawn += [value for curve in (*ours, *theirs) for value in curve["rmse"]]
    times = [value for curve in (*ours, *theirs) for value in curve["seconds"]]
    _log_axes(figure, ("seconds of rendering", times), ("RMSE (radiance)", drawn))
    # Rows of names take their height from the plot.
    figure.update_layout(height=460)
    return figure.to_plotly_json()


def _sampler(curve: dict[str, Any]) -> int:
    """The place of a setting's sampler among the marks."""
    names = ("independent", "multijitter", "orthogonal", "ldsampler")
    return names.index(curve["setting"].split()[0]) if curve["setting"].split()[0] in names else len(names)


def _curve(curve: dict[str, Any], name: str, colour: str, mark: str) -> dict[str, Any]:
    return {
        "type": "scatter",
        "x": curve["seconds"],
        "y": curve["rmse"],
        "customdata": curve["samples"],
        "name": name,
        "mode": "lines+markers",
        "line": {"color": colour, "width": 1.5},
        "marker": {"color": colour, "symbol": mark, "size": 7},
        "hovertemplate": f"{name}<br>%{{customdata}} samples a pixel<br>%{{x:.4g}} s<br>RMSE %{{y:.3g}}<extra></extra>",
    }


def scaling(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Nanoseconds a unit against the value of one axis, from its least to its greatest time."""
    figure = go.Figure()
    values = [row["value"] for row in rows]
    each = np.array([row["per_unit_ns"] for row in rows])
    factor = each / np.array([row["seconds"] for row in rows])
    low, high = (factor * np.array([row[name] for row in rows]) for name in ("seconds_low", "seconds_high"))
    unit = rows[0]["unit"]
    figure.add_trace(
        {
            "type": "scatter",
            "x": values,
            "y": each.tolist(),
            "mode": "lines+markers",
            "line": {"color": COLOURS[0], "width": 1.5},
            "marker": {"color": COLOURS[0], "size": 8},
            "error_y": _bars(each, low, high, thickness=1, width=3),
            "showlegend": False,
            "hovertemplate": f"%{{x}} {rows[0]['axis']}<br>%{{y:.4g}} ns a {unit}<extra></extra>",
        }
    )
    _log_axes(figure, (rows[0]["axis"], values), (f"nanoseconds a {unit}", [*low.tolist(), *high.tolist()]))
    # From a tenth to ten times the median: what is flat looks flat.
    middle = np.log10(np.median(each))
    figure.update_yaxes(range=[middle - 1.0, middle + 1.0], **_ticks([10 ** (middle - 1), 10 ** (middle + 1)]))
    figure.update_layout(height=300, margin={"t": 8})
    return figure.to_plotly_json()


def _log_axes(figure: go.Figure, x: tuple[str, list[float]], y: tuple[str, list[float]]) -> None:
    figure.update_xaxes(type="log", title=x[0], **_ticks(x[1]))
    figure.update_yaxes(type="log", title=y[0], **_ticks(y[1]))
    legend = {"orientation": "h", "y": -0.2, "yanchor": "top", "x": 0, "font": {"size": 11}}
    _plain(figure, height=400, left=70, bottom=56, legend=legend)


def _plain(figure: go.Figure, *, height: int, left: int, bottom: int, **layout: Any) -> None:
    """No frame and no ground of its own: the page's shows."""
    figure.update_layout(template="none", height=height, margin={"l": left, "r": 16, "t": 16, "b": bottom}, **layout)
    figure.update_layout(paper_bgcolor="rgba(0,0,0,0)", plot_bgcolor="rgba(0,0,0,0)")


def _bars(value: Any, low: Any, high: Any, *, thickness: float, width: int) -> dict[str, Any]:
    """Error bars from low to high."""
    above, below = np.subtract(high, value).tolist(), np.subtract(value, low).tolist()
    ends = {"array": above, "arrayminus": below}
    return {"type": "data", "symmetric": False, **ends, "thickness": thickness, "width": width}


def fitted_curve(
    rows: list[dict[str, Any]], samples: np.ndarray, rmse: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Samples and fitted RMSE; c, which the results do not hold, is the least-squares one for their a and b²."""
    slope, floor = rows[-1]["slope"], rows[-1]["floor"]
    if slope is None or floor is None:
        return None
    fall, square = (samples / samples[0]) ** -slope, rmse**2
    weight = 1.0 / square**2
    scale = np.sum(weight * fall * (square - floor)) / np.sum(weight * fall**2)
    dense = np.geomspace(samples[0], samples[-1], 4 * len(samples) - 3)
    fitted = floor + scale * (dense / samples[0]) ** -slope
    return (dense, np.sqrt(fitted)) if (fitted > 0).all() else None


def _ticks(values: list[float]) -> dict[str, Any]:
    """Ticks at 1, 2 and 5 times the powers of ten, written out; powers alone over more than two decades."""
    values = [value for value in values if value > 0]
    if not values:
        return {}
    low, high = (int(np.floor(np.log10(end))) for end in (min(values), max(values)))
    steps = (1, 2, 5) if np.log10(max(values) / min(values)) <= 2.5 else (1,)
    ticks = [float(f"{step}e{decade}") for decade in range(low - 1, high + 2) for step in steps]
    return {"tickvals": ticks, "ticktext": [number(tick, 1) for tick in ticks]}


def _slope(row: dict[str, Any]) -> str:
    return "" if row["slope"] is None else f"  (MSE ∝ N<sup>−{row['slope']:.2f}</sup>)"
