"""Reports on a comparison: a table, how variants differ, pictures, files, TensorBoard's page."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shlex import join
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from torch_iac.analysis.intervals import Estimate, in_words
from torch_iac.analysis.style import save
from torch_iac.compare.hparams import (
    NOTHING,
    differing_settings,
    write_experiment,
    write_session,
)
from torch_iac.compare.plan import FIGURES, Comparison, Variant, count_states, ended_runs
from torch_iac.compare.plots import Curves, draw_errors, draw_improvements, draw_shares
from torch_iac.compare.results import (
    MANY_SEEDS,
    MOST_PAIRED,
    Difference,
    Measure,
    Row,
    differences_of,
    mean_of,
    measure_rows,
    measures_of,
    shown_pairs,
)
from torch_iac.internal.files import replace, write_table
from torch_iac.runs.reader import Run
from torch_iac.runs.schema import WINDOW
from torch_iac.runs.statistics import summed_up
from torch_iac.runs.window_sums import WindowSums

REPORT = "report.md"
MEASURES = "measures.parquet"
DIFFERENCES = "differences.parquet"
CURVES = "curves.parquet"
"""What the files of a report are called."""

FEW = "Fewer than ten seeds: intervals are wide and a difference proves little."
"""What is said of less than `MANY_SEEDS`."""


def save_report(comparison: Comparison) -> Path:
    """Write the report of the runs that have ended, and return its path.

    Raises:
        ValueError: None has ended.
    """
    runs = {name: of for name, of in ended_runs(comparison).items() if of}
    if not runs:
        raise ValueError(f"{comparison.folder} must hold a run that has ended for a report")
    measures = measures_of([run for of in runs.values() for run in of])
    rows = measure_rows(comparison, runs, measures)
    differences = differences_of(rows, measures, list(runs))
    curves = {name: Curves.of(of) for name, of in runs.items()}
    pairs = shown_pairs(list(runs))
    shown = [found for found in differences if (found.one, found.other) in pairs]
    folder = comparison.folder
    _write(folder / MEASURES, rows)
    _write(folder / DIFFERENCES, [_difference_row(found) for found in differences])
    _write(folder / CURVES, list(_curve_rows(runs)))
    pictures = _draw(folder, curves, shown)
    _tell_tensorboard(folder, runs, rows, measures)
    text = _text(comparison, rows, measures, shown, pictures)
    path = folder / REPORT
    replace(path, lambda to: to.write_text(text, encoding="utf-8"))
    return path


def _draw(
    folder: Path, curves: Mapping[str, Curves], differences: Sequence[Difference]
) -> dict[str, str]:
    """Draw the pictures, and return what each shows, by its path in the folder."""
    bars = "Bands are 95 % intervals of the mean over robots."
    drawn: dict[str, tuple[Figure, str]] = {}
    if any(of.zone_names for of in curves.values()):
        drawn["shares"] = draw_shares(curves), f"Share of time in each zone, over time. {bars}"
    to_0 = "Where one goes down to the lower edge, it reaches 0."
    drawn["errors"] = draw_errors(curves), f"Mean error, over time. {bars} {to_0}"
    panels: dict[str, dict[str, Estimate]] = {}
    for found in differences:
        if found.improvement:
            pair = f"{found.one} over {found.other}"
            title = f"{found.measure.title}\n({found.measure.better} is better)"
            panels.setdefault(title, {})[pair] = found.improvement
    if panels:
        shows = (
            "Probability that a robot of the first variant is better than one of the second, with "
            "95 % intervals; at 0.5, neither is."
        )
        drawn["improvement"] = draw_improvements(panels), shows
    (folder / FIGURES).mkdir(exist_ok=True)
    for name, (figure, _) in drawn.items():
        save(figure, folder / FIGURES / f"{name}.png")
    return {f"{FIGURES}/{name}.png": shows for name, (_, shows) in drawn.items()}


def _tell_tensorboard(
    folder: Path,
    runs: Mapping[str, Sequence[Run]],
    rows: Sequence[Row],
    measures: Sequence[Measure],
) -> None:
    """Write what TensorBoard's HParams page shows: a row a run, a column a setting or measure."""
    sessions = [(variant, run) for variant, of in runs.items() for run in of]
    differing = differing_settings([run.config for _, run in sessions])
    settings = [
        {"variant": variant, "seed": _seeds(run), **own}
        for (variant, run), own in zip(sessions, differing, strict=True)
    ]
    write_experiment(folder, settings, {measure.name: measure.label for measure in measures})
    for (_, run), own in zip(sessions, settings, strict=True):
        place = str(run.folder.relative_to(folder))
        mine = [row for row in rows if row["run"] == place]
        means = {measure.name: mean_of(mine, measure).value for measure in measures}
        write_session(run.folder, own, means, run.summary["n_decisions"])


def _seeds(run: Run) -> str:
    """Return the seeds of a run as a text, since TensorBoard gives numbers five digits."""
    first, last = run.seeds[0], run.seeds[-1]
    return str(first) if first == last else f"{first} to {last}"


def _text(
    comparison: Comparison,
    rows: Sequence[Row],
    measures: Sequence[Measure],
    differences: Sequence[Difference],
    pictures: Mapping[str, str],
) -> str:
    """Return the report."""
    shows = [f"{what}\n\n![{what}]({path})" for path, what in pictures.items()]
    parts = [
        "# Comparison",
        _what_was_compared(comparison),
        "## Measures",
        _about_measures(rows),
        _measure_table(comparison, rows, measures),
        *_differences_part(comparison, differences),
        "## Over time",
        *shows,
        *_not_done(comparison),
        "## Files",
        _files_text(),
    ]
    return "\n\n".join(parts) + "\n"


def _about_measures(rows: Sequence[Row]) -> str:
    robots = Counter(row["variant"] for row in rows)
    about = (
        "Means over robots, in parentheses their 95 % intervals (Student's t); *in all* means that "
        "every robot has this value. Errors are in scaled units. Where fewer robots have a measure "
        "than ended, the number is given: some never focus on a zone."
    )
    return f"{about} {FEW}" if min(robots.values()) < MANY_SEEDS else about


def _what_was_compared(comparison: Comparison) -> str:
    last = comparison.seed + comparison.n_seeds - 1
    seeds = f"seeds {comparison.seed} to {last}" if comparison.seed < last else f"seed {last}"
    options = f"; options for all: `{join(comparison.words)}`" if comparison.words else ""
    of_runs = f", at most {comparison.block} a run" if comparison.block > 1 else ""
    lines = [
        f"Robots with {seeds}{of_runs}{options}.",
        "",
        "| variant | its options, or the settings in which it differs | runs |",
        "|---|---|---|",
    ]
    configs = [variant.experiment.to_json() for variant in comparison.variants]
    jobs = comparison.jobs()
    for variant, own in zip(comparison.variants, differing_settings(configs), strict=True):
        states = count_states([job for job in jobs if job.variant == variant.name])
        lines.append(_line([variant.name, _what_differs(variant, own), states]))
    return "\n".join(lines)


def _what_differs(variant: Variant, settings: Mapping[str, Any]) -> str:
    """Return a variant's options or, if it was not described by any, its own settings."""
    if variant.words:
        return f"`{join(variant.words)}`"
    own = [
        f"{name}={value}"
        for name, value in settings.items()
        if value != NOTHING or re.fullmatch(r"\w+\.kind", name)  # a whole part is missing
    ]
    return ", ".join(f"`{of}`" for of in own) or NOTHING


def _measure_table(comparison: Comparison, rows: Sequence[Row], measures: Sequence[Measure]) -> str:
    by_variant = {
        variant.name: [row for row in rows if row["variant"] == variant.name]
        for variant in comparison.variants
    }
    heads = ["measure", "better", *by_variant]
    lines = [_line(heads), "|---" * len(heads) + "|"]
    for measure in measures:
        cells = []
        for mine in by_variant.values():
            found = mean_of(mine, measure)
            robots = "robot" if found.n == 1 else "robots"
            few = f", {found.n} {robots}" if 0 < found.n < len(mine) else ""
            cells.append(in_words(found) + few)
        lines.append(_line([measure.label, measure.better or "", *cells]))
    return "\n".join(lines)


def _differences_part(comparison: Comparison, differences: Sequence[Difference]) -> list[str]:
    if not differences:
        return []
    lines = [
        _line(["measure", "variants", "difference", "first is better with probability", "seeds"]),
        "|---" * 5 + "|",
    ]
    for found in differences:
        by = f"**{in_words(found.by)}**" if found.is_clear else in_words(found.by)
        pair = f"{found.one} - {found.other}"
        chance = in_words(found.improvement) if found.improvement else ""
        lines.append(_line([found.measure.label, pair, by, chance, str(found.by.n)]))
    return ["## Differences", _about_differences(comparison, differences), "\n".join(lines)]


def _about_differences(comparison: Comparison, differences: Sequence[Difference]) -> str:
    reference = comparison.variants[0].name
    only = f" Only those with {reference}." if len(comparison.variants) > MOST_PAIRED else ""
    if max(found.by.n for found in differences) < MANY_SEEDS:
        bold = f"{FEW} So none is in bold."
    else:
        bold = (
            f"In bold is what is left after Holm's correction for all {len(differences)} "
            "differences of the table: were there none in truth, anything would be in bold in one "
            f"comparison of twenty. Nothing is with fewer than {MANY_SEEDS} seeds. An interval "
            "alone is not corrected: of twenty differences that are none, about one leaves out 0."
        )
    return (
        "Robots with the same seed are paired. The difference is that of the means, in parentheses "
        f"its 95 % interval (Student's t). {bold}\n\nThe probability is that of a robot of the "
        "first variant being better than one of the second; equal ones count half, so 0.5 "
        "is no difference. Its interval, Clopper and Pearson's for a share of as many robots, is "
        f"wide enough for any values.{only}"
    )


def _not_done(comparison: Comparison) -> list[str]:
    """Return which runs have not ended, and why."""
    lines = []
    for job in comparison.jobs():
        if job.state == "failed":
            lines.append(
                f"- {job.name} failed: {job.reason} (`{job.log.relative_to(comparison.folder)}`)"
            )
        elif job.state != "done":
            lines.append(f"- {job.name}: {count_states([job]).removeprefix('1 ')}")
    return ["## Not done", "\n".join(lines)] if lines else []


def _files_text() -> str:
    return "\n".join(
        [
            f"- `{MEASURES}`: a row a robot, a column a measure",
            f"- `{DIFFERENCES}`: a row for each measure and two variants, all of them; `p` is the "
            "p-value of the difference (paired t test), `p_holm` the same after Holm's correction",
            f"- `{CURVES}`: a row for each robot, zone and {WINDOW} decisions, and one for all "
            "zones together (`zone` is null)",
            "- a folder for each variant, with its run folders and what they had to say (`*.log`)",
            "- for TensorBoard (`tensorboard --logdir` and this folder): its HParams page has a "
            "row a run",
        ]
    )


def _difference_row(found: Difference) -> Row:
    nothing = Estimate(math.nan, math.nan, math.nan, 0)
    chance = found.improvement or nothing
    return {
        "measure": found.measure.name,
        "better": found.measure.better,
        "one": found.one,
        "other": found.other,
        "n_seeds": found.by.n,
        "difference": found.by.value,
        "difference_low": found.by.low,
        "difference_high": found.by.high,
        "improvement": chance.value,
        "improvement_low": chance.low,
        "improvement_high": chance.high,
        "p": found.p,
        "p_holm": found.p_holm,
    }


def _curve_rows(runs: Mapping[str, Sequence[Run]]) -> Iterable[Row]:
    for variant, of in runs.items():
        for run in of:
            window = min(WINDOW, run.n_decisions)
            kept = summed_up(run, "error", window)
            yield from _cells(variant, run, kept.total(2), [None], window)
            if run.zone_names:
                yield from _cells(variant, run, kept, run.zone_names, window)


def _cells(
    variant: str, run: Run, kept: WindowSums, zones: Sequence[str | None], window: int
) -> Iterable[Row]:
    """Return a row for each window, robot and zone of some sums."""
    means = kept.means("error")
    for at, agent, place in np.ndindex(*means.shape):
        yield {
            "variant": variant,
            "seed": run.seeds[agent],
            "step": at * window,
            "zone": zones[place],
            "share": kept.counts[at, agent, place] / window,
            "error": float(means[at, agent, place]),
        }


def _write(path: Path, rows: Sequence[Row]) -> None:
    if rows:
        names = list(rows[0])
        columns = {n: pa.array([row[n] for row in rows], from_pandas=True) for n in names}
        write_table(path, pa.table(columns))


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
