"""Reports on a comparison: a table, how variants differ, pictures, files, TensorBoard's page."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shlex import join

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from torch_iac.analysis.bootstrap import Estimate
from torch_iac.analysis.style import save
from torch_iac.compare.hparams import differing_settings, write_experiment, write_session
from torch_iac.compare.plan import FIGURES, Comparison, count_states, ended_runs
from torch_iac.compare.plots import Curves, draw_errors, draw_improvements, draw_shares
from torch_iac.compare.results import (
    Difference,
    Measure,
    Row,
    differences_of,
    mean_of,
    measure_rows,
    measures_of,
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

MOST_PAIRED = 4
"""With more variants, the report compares each with the first only; the file has all pairs."""


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
    shown = _shown(differences, list(curves))
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


def _shown(differences: Sequence[Difference], variants: Sequence[str]) -> list[Difference]:
    """Return the differences that the report shows."""
    if len(variants) <= MOST_PAIRED:
        return list(differences)
    return [found for found in differences if found.one == variants[0]]


def _draw(
    folder: Path, curves: Mapping[str, Curves], differences: Sequence[Difference]
) -> dict[str, str]:
    """Draw the pictures, and return what each shows, by its path in the folder."""
    bars = "Bands are 95 % bootstrap intervals of the mean over robots."
    drawn: dict[str, tuple[Figure, str]] = {}
    if any(of.zone_names for of in curves.values()):
        drawn["shares"] = draw_shares(curves), f"Share of time in each zone, over time. {bars}"
    drawn["errors"] = draw_errors(curves), f"Mean error, over time. {bars}"
    panels: dict[str, dict[str, Estimate]] = {}
    for found in differences:
        if found.improvement and found.improvement.n:
            pair = f"{found.one} over {found.other}"
            title = f"{found.measure.title}\n({found.measure.better} is better)"
            panels.setdefault(title, {})[pair] = found.improvement
    if panels:
        shows = "Probability that a robot of the first variant is better than one of the second."
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
    differing = differing_settings([run for _, run in sessions])
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
        "Means over robots, with 95 % bootstrap intervals; errors are in scaled units. Where fewer "
        "robots have a measure than ended, the number is given: some never focus on a zone.",
        _measure_table(comparison, rows, measures),
        *_differences_part(comparison, differences),
        "## Over time",
        *shows,
        *_not_done(comparison),
        "## Files",
        _files_text(),
    ]
    return "\n\n".join(parts) + "\n"


def _what_was_compared(comparison: Comparison) -> str:
    last = comparison.seed + comparison.n_seeds - 1
    lines = [
        f"Seeds {comparison.seed} to {last}, at most {comparison.block} a run; options for all: "
        f"{_code(comparison.words)}.",
        "",
        "| variant | its options | runs |",
        "|---|---|---|",
    ]
    jobs = comparison.jobs()
    for variant in comparison.variants:
        states = count_states([job for job in jobs if job.variant == variant.name])
        lines.append(f"| {variant.name} | {_code(variant.words)} | {states} |")
    return "\n".join(lines)


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
            few = f", of {found.n}" if 0 < found.n < len(mine) else ""
            cells.append(_words(found) + few)
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
        by = _words(found.by)
        is_clear = found.by.low > 0 or found.by.high < 0
        pair = f"{found.one} - {found.other}"
        chance = _words(found.improvement) if found.improvement else ""
        by = f"**{by}**" if is_clear else by
        lines.append(_line([found.measure.label, pair, by, chance, str(found.by.n)]))
    reference = comparison.variants[0].name
    only = "" if len(comparison.variants) <= MOST_PAIRED else f" Only those with {reference}."
    return [
        "## Differences",
        "Robots with the same seed are paired. The difference is that of the means; in bold where "
        "its interval leaves out 0 (of twenty that are none, one will do so by chance). The "
        "probability is that of a robot of the first variant being better than any robot of the "
        f"second; equal ones count half.{only}",
        "\n".join(lines),
    ]


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
            f"- `{DIFFERENCES}`: a row for each measure and two variants, all of them",
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


def _words(found: Estimate) -> str:
    """Return a number and its interval."""
    if not found.n:
        return "none"
    if math.isnan(found.low):
        return _number(found.value)
    return f"{_number(found.value)} ({_number(found.low)} to {_number(found.high)})"


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _code(words: Sequence[str]) -> str:
    return f"`{join(words)}`" if words else "none"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
