"""Convergence on log-log axes: RMSE against samples and against seconds, with the fit `MSE = b² + c N^-a`.

The dotted guide falls as 1/sqrt(N), as the error of independent samples does. RMSE is that of one
replicate, so the seconds are those of one replicate, too.
"""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from reports.page.digits import number

# Of Okabe and Ito's colour-blind safe palette, those that stand out on white and on black; marks differ too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7F7F7F")
MARKS = ("circle", "square", "diamond", "triangle-up", "cross")
GUIDE = "#888888"

_AXES = (("samples per pixel and replicate", "samples"), ("seconds per replicate", "seconds"))


def convergence(curves: dict[str, list[dict[str, Any]]]) -> dict[str, Any] | None:
    """A plotly figure of the variants of a term, ready for JSON.

    Parameters
    ----------
    curves : variant -> its rows against `own`, by increasing samples.

    Returns
    -------
    dict or None
        None where no variant has two points.
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
                    x=[*x, *x[::-1]],
                    y=edge,
                    fill="toself",
                    fillcolor=colour,
                    opacity=0.18,
                    mode="none",
                    **style,
                )
                figure.add_trace(band, 1, column)
            if (fitted := _fit(rows, samples, rmse)) is not None:
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
    figure.update_layout(
        template="none",
        height=400,
        margin={"l": 70, "r": 16, "t": 16, "b": 56},
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
    )
    return figure.to_plotly_json()


def _fit(
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
