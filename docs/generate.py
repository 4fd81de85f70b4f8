"""Rewrite what the documentation takes from data: python docs/generate.py [--check]

Tables between `<!-- generated: NAME -->` and `<!-- end of generated: NAME -->`, in README.md, checkpoints/README.md and docs/, and
the plots of docs/figures. They are made from docs/results/format_3.csv, docs/results/results.csv (runs on data of format 4), the
paper's numbers (paper_tables.yaml), docs/cophy/claims.yaml, docs/results/columns.csv, docs/results/gpu*.csv and checkpoints/index.csv. With --check nothing is written; the command names
what differs, and exits with 1.
"""

import re
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from pathlib import Path

import yaml
from result_claims import claims
from result_entries import EntryError, entries_table
from result_listings import checkpoints, column_meanings, derenderers, gpu_renderers, gpu_steps, gpu_trainings
from result_runs import (
    COLUMNS,
    COPIES,
    CURVES,
    FORMAT_4,
    GIVEN_MORE,
    LEARNED,
    ORACLES,
    ROOT,
    SCENARIOS,
    Results,
    columns,
    in_prose,
    markdown,
    published,
    ratio,
    title,
)

from cophy.dataset.images import RENDERING
from cophy.dataset.states import COST
from cophy.report.paper_tables import ESTIMATED_IN_TESTING, PaperTable, paper_tables

BLOCK = re.compile(r"<!-- generated: (\w+) -->\n.*?<!-- end of generated: \1 -->", re.DOTALL)
NOTHING = "–"
SIZES = ("small", "paper")
PREDICTED = (*COPIES, *LEARNED, "alongside_noisy", "cophynet_feedforward", "in_sup", *ORACLES)
HEADLINES = [
    ("blocktower", "3to3"),
    ("balls", "4to4"),
    *(("collision", split) for split in ("all", "sphere_to_cylinder", "cylinder_to_sphere")),
]
BASELINES = ("copy_c", "copy_b", "copy_b_displaced", "replay", "trees")
NEWER = ("cophynet_adam", "cophynet_canonical", "gns", "transformer", "alongside_canonical")
OF_ORACLES = r"(\+max_experiments-\d+)?"  # what their runs change: on how many test experiments they are asked
TOLD_MORE = (
    "alongside_posed",
    "hypotheses",
    "in_sup",
    "in_without_pose",
    "cophynet_without_pose",
    "trees_confounders",
    "spheres",
    "noise_floor_rate",
    "noise_floor_jitter",
    *ORACLES,
)
README_COLUMNS = [
    ("blocktower", "3to3"),
    ("blocktower", "3to4"),
    ("blocktower", "4to3"),
    ("balls", "4to4"),
    ("collision", "all"),
    ("collision", "sphere_to_cylinder"),
]
README_METHODS = ("copy_b", "in", "cophynet", "alongside", "in_sup", "oracle_feedforward")
ABLATIONS = ("confounder_probe", "architecture_ablation", "confounder_impact", "stability")
CHANGED_RATE = r"(\+learning_rate-[\d.]+)?"  # as alongside has on towers of four at size=paper
PARTS = ("alongside", "alongside_no_impulses", "alongside_no_pair_memory", "alongside_no_replay")


def main() -> None:
    """Write or check every page and plot."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 and name what differs")
    parser.add_argument("--results", type=Path, default=ROOT / "docs" / "results" / "format_3.csv", help="the table")
    arguments = parser.parse_args()
    results = Results(arguments.results)
    try:
        different = [*update_pages(results, arguments.check), *update_plots(results, arguments.check)]
    except EntryError as error:
        sys.exit(f"leaderboard/{error}")
    if different:
        sys.stdout.write("\n".join(different) + "\n")
        sys.exit(1 if arguments.check else 0)


def update_pages(results: Results, check: bool) -> Iterator[str]:
    """Yield the generated blocks that differ; write them unless `check`."""
    made = blocks(results)
    pages = [page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts]
    for page in [ROOT / "README.md", ROOT / "checkpoints" / "README.md", *pages]:
        old = page.read_text()
        names = BLOCK.findall(old)
        if unknown := set(names) - set(made):
            sys.exit(f"{page.relative_to(ROOT)}: no generated block {min(unknown)}; there are {', '.join(made)}")
        text = {
            name: f"<!-- generated: {name} -->\n\n{made[name]()}\n\n<!-- end of generated: {name} -->" for name in names
        }
        yield from (f"{page.relative_to(ROOT)}: {name}" for name in names if text[name] not in old)
        new = BLOCK.sub(lambda found, text=text: text[found[1]], old)
        if not check and new != old:
            page.write_text(new)


def update_plots(results: Results, check: bool) -> Iterator[str]:
    """Yield the plots that show other numbers; draw them unless `check`."""
    from result_plots import PLOTS, is_of, save

    for name, (data_of, draw) in PLOTS.items():
        path, data = ROOT / "docs" / "figures" / f"{name}.png", data_of(results)
        if not is_of(path, data):
            yield str(path.relative_to(ROOT))
            if not check:
                save(draw(data), path, data)


def blocks(results: Results) -> Mapping[str, Callable[[], str]]:
    """Return the generated blocks by name."""
    estimated = {"size": "small", "positions": ESTIMATED_IN_TESTING}
    format_4 = Results(FORMAT_4)
    seen_in_training = {**columns("blocktower"), "3to3_seen": "3→3, seen"}
    return {
        **{f"leaderboard_{scenario}": partial(leaderboard, results, scenario) for scenario in SCENARIOS},
        "ratio_to_copy_c": partial(ratio_to_copy_c, results),
        "entries": entries_table,
        "paper": paper,
        "readme": partial(readme, results),
        **{
            f"{scenario}_{size}": partial(
                every_split,
                results,
                scenario,
                size,
                seen_in_training if scenario == "blocktower" else columns(scenario),
            )
            for scenario in SCENARIOS
            for size in ("paper", "small")
        },
        **{
            f"{scenario}_estimated": partial(leaderboard, results, scenario, ("in_sup",), **estimated)
            for scenario in SCENARIOS
        },
        "table_1_paper": partial(of_paper_table, results, "human_comparison", "paper"),
        "table_1_estimated": partial(of_paper_table, results, "human_comparison_derendered", "small"),
        **{
            f"{name}_{size}": partial(of_paper_table, results, name, size)
            for name in ABLATIONS
            for size in ("paper", "small")
        },
        "table_7_small": partial(of_paper_table, results, "training_positions", "small"),
        "learning_curves": partial(learning_curves, results),
        "training_time": partial(training_time, results),
        "data_seeds": partial(data_seeds, results),
        "alongside_lead": partial(alongside_lead, results),
        "alongside_parts": partial(alongside_parts, results),
        "alongside_positions": partial(alongside_positions, results),
        "claims": partial(claims, {3: results, 4: format_4}),
        "format_4": partial(headlines, format_4),
        "format_4_splits": partial(all_splits, format_4),
        "checkpoints": partial(checkpoints, format_4),
        "derenderers": derenderers,
        "columns": column_meanings,
        "data_costs": data_costs,
        "rendering": rendering,
        "gpu_steps": gpu_steps,
        "gpu_trainings": gpu_trainings,
        "gpu_renderers": gpu_renderers,
    }


def data_costs() -> str:
    """Experiments of each dataset, and what those of size=paper cost."""
    sizes = [yaml.safe_load((ROOT / "conf/size" / f"{name}.yaml").read_text())["num_experiments"] for name in SIZES]
    counts = {key: [size[key[0]][str(key[1])] for size in sizes] for key in COST}
    rows = []
    for key in COST:
        (scenario, objects), (small, paper), (seconds, kilobytes) = key, counts[key], COST[key]
        name = f"{SCENARIOS[scenario].lower()}{f' of {objects}' if scenario != 'collision' else ''}"
        rows.append([name, f"{small:,}", f"{paper:,}", paper * seconds / 60, paper * kilobytes / 1e6])
    total = ["all", *(f"{sum(column):,}" for column in zip(*counts.values(), strict=True))]
    rows.append([*total, *(sum(row[place] for row in rows) for place in (3, 4))])
    lines = [[*names, f"{minutes:.0f}", f"{gigabytes:.1f}"] for *names, minutes, gigabytes in rows]
    return markdown(["dataset", *SIZES, "CPU minutes", "GB"], lines)


def rendering() -> str:
    """Frames per second by resolution, and disk space."""
    rates = [rates for rates, _ in RENDERING.values()]
    rows = [[f"{edge} × {edge}", *(str(rate[edge]) for rate in rates)] for edge in rates[0]]
    rows.append(["MB per experiment, 448 × 448", *(f"{megabytes}" for _, megabytes in RENDERING.values())])
    return markdown(["", *(SCENARIOS[name].lower() for name in RENDERING)], rows)


def leaderboard(results: Results, scenario: str, given_more: tuple[str, ...] = GIVEN_MORE, **names: str) -> str:
    """Test MSE: methods × splits of a scenario; the lowest of those that see what CoPhyNet sees is bold."""
    splits, learned = columns(scenario), (*LEARNED, "alongside_noisy")
    cells = {
        (method, split): results.cell("mse", scenario, split, method, **names)
        for method in (*COPIES, *learned, *given_more)
        for split in splits
    }
    best = {split: min(cell.number() for method in learned if (cell := cells[method, split])) for split in splits}

    def printed(method: str, split: str) -> str:
        cell = cells[method, split]
        text = NOTHING if cell is None else cell.short()
        is_best = cell is not None and method in learned and cell.number() == best[split]
        number, _, interval = text.partition(" ")
        return f"**{number}** {interval}" if is_best else text

    shown = [method for method in (*COPIES, *learned) if any(cells[method, split] for split in splits)]
    rows = [[title(method), *(printed(method, split) for split in splits)] for method in shown]
    line = [["*given the confounders or the simulator*", *[""] * len(splits)]]
    rows += line + [[title(method), *(printed(method, split) for split in splits)] for method in given_more]
    return markdown(["test MSE, m²", *splits.values()], rows)


def ratio_to_copy_c(results: Results) -> str:
    """MSE divided by that of copy C."""
    shown = ("copy_b", *LEARNED, "in_sup")
    rows = []
    for scenario, split, label in COLUMNS:
        copy_c = results.cell("mse", scenario, split, "copy_c")
        cells = [results.cell("mse", scenario, split, method) for method in shown]
        ratios = [ratio(cell.value, copy_c.value) if cell else NOTHING for cell in cells]
        rows.append([f"{SCENARIOS[scenario]} {label}", *ratios])
    return markdown(["MSE ÷ MSE of copy C", *map(title, shown)], rows)


def paper() -> str:
    """The paper's MSE with its ratio to the paper's copy C."""
    shown = (*COPIES, "in", "npe", "cophynet", "in_sup")
    rows = []
    for scenario, split, label in COLUMNS:
        cells = {method: published(scenario, split, method) for method in shown}
        ratios = [f"{value:.3f} ({ratio(value, cells['copy_c'])})" for value in list(cells.values())[1:]]
        rows.append([f"{SCENARIOS[scenario]} {label}", f"{cells['copy_c']:.3f}", *ratios])
    names = [f"{title(method)}{' ᵉ' if method == 'cophynet' else ''}" for method in shown]
    return markdown(["the paper's MSE, m²", *names], rows)


def readme(results: Results) -> str:
    """A few rows and columns of the leaderboard."""
    header = [
        "test MSE, m²",
        *(f"{SCENARIOS[scenario]} {columns(scenario)[split]}" for scenario, split in README_COLUMNS),
    ]
    cells = [[results.cell("mse", *column, method) for column in README_COLUMNS] for method in README_METHODS]
    return markdown(
        header,
        [
            [title(method), *(cell.marked() if cell else NOTHING for cell in row)]
            for method, row in zip(README_METHODS, cells, strict=True)
        ],
    )


def every_split(results: Results, scenario: str, size: str, splits: Mapping[str, str]) -> str:
    """A table per split with every measure."""
    parts = []
    for split, label in splits.items():
        rows = [measures(results, method, scenario, split, size) for method in PREDICTED]
        run = results.of(scenario, split, "cophynet", size=size)[0]
        head = f"{SCENARIOS[scenario]} {label}, n = {run['num_test']:,.0f}"
        parts.append(markdown([head, "MSE, m²", "share, %", "twins, %", "right twin, %", "seeds"], filter(None, rows)))
    return "\n\n".join(parts)


def measures(results: Results, method: str, scenario: str, split: str, size: str) -> list[str] | None:
    """Return a method's row with every measure; None where it was not run."""
    names = (scenario, split, method)
    if (mse := results.cell("mse", *names, size=size)) is None:
        return None
    others = [
        results.cell(measure, *names, size=size)
        for measure in ("share", "twin_difference_explained", "right_twin_chosen")
    ]
    has_seeds = not method.startswith(("copy", "oracle"))
    seeds = f"{mse.seeds}" + (f", sd {mse.deviation:.3f}" if mse.seeds > 1 else "")
    return [
        title(method),
        mse.full(),
        *(cell.full(0, 100) if cell else NOTHING for cell in others),
        seeds if has_seeds else NOTHING,
    ]


def of_paper_table(results: Results, table_id: str, size: str) -> str:
    """A table of the paper with methods as rows: our number, then the paper's in italics; empty rows are left out."""
    table = next(table for table in paper_tables() if table.id == table_id)
    rows: dict[str, dict[str, str]] = defaultdict(dict)
    for row, column, names, number in table.cells():
        if names.get("model") not in ("oracle_initial_velocity", "oracle_confounders"):
            head, under = (column, row) if table.methods_in == "columns" else (row, column)
            rows[head][under] = of_paper_cell(results, table, names, number, size)
    shown = {head: cells for head, cells in rows.items() if set(cells.values()) != {NOTHING}}
    return markdown(
        ["ours *(the paper's)*", *next(iter(shown.values()))],
        [[in_prose(head), *cells.values()] for head, cells in shown.items()],
    )


def of_paper_cell(results: Results, table: PaperTable, names: dict[str, str], number: float | None, size: str) -> str:
    """Return our number and the paper's; nothing where we have none."""
    if "model" not in names:  # human participants
        return NOTHING
    digits = 1 if names["metric"].startswith("pixel") else table.digits
    keys = {key: names[key] for key in ("model", "ablation", "positions")}
    cell = results.cell(names["metric"], names["scenario"], names["split"], keys, size=size)
    if cell is None:
        return NOTHING
    if number is None:
        return cell.short(digits, table.scale)
    printed = f"{number:g}" if names["metric"].startswith("pixel") else f"{number:.{digits}f}"
    return cell.short(digits, table.scale) + f" *({printed})*"


def all_splits(results: Results) -> str:
    """Test MSE with data seed 0: a table per size and scenario, methods × splits."""
    parts = []
    for size, scenario in product(SIZES, SCENARIOS):
        splits, rows = columns(scenario), []
        for method in (*BASELINES, *LEARNED, "alongside_noisy", *NEWER, *TOLD_MORE):
            cells = [results.cell("mse", scenario, split, method, size=size, change=OF_ORACLES) for split in splits]
            if any(cells):
                rows.append([title(method), *(cell.marked() if cell else NOTHING for cell in cells)])
        if rows:
            parts.append(markdown([f"{SCENARIOS[scenario]}, size={size}: test MSE, m²", *splits.values()], rows))
    return "\n\n".join(parts)


def headlines(results: Results) -> str:
    """A table per split of size=small, with both data seeds."""
    measures = {"mse": (3, 1), "twin_difference_explained": (0, 100), "share": (0, 100)}
    parts = []
    for scenario, split in HEADLINES:
        rows = []
        for method in (*BASELINES, *LEARNED, *NEWER, *TOLD_MORE):
            cells = {
                (measure, seed): results.cell(measure, scenario, split, method, size="small", change=change)
                for measure in measures
                for seed, change in enumerate((OF_ORACLES, rf"\+data_seed-1{OF_ORACLES}"))
            }
            texts = [cell.full(*measures[measure]) if cell else NOTHING for (measure, _), cell in cells.items()]
            trained = [cell for (measure, _), cell in cells.items() if measure == "mse" and cell]
            spread = ", ".join(f"{cell.deviation:.3f}" for cell in trained if cell.seeds > 1) or NOTHING
            if trained:
                rows.append([title(method), *texts, str(max(cell.seeds for cell in trained)), spread])
        names = ["MSE, m²", "twins, %", "share, %"]
        head = [f"{SCENARIOS[scenario]} {columns(scenario)[split]}"]
        head += [f"{name}, data seed {seed}" for name in names for seed in (0, 1)]
        if rows:
            parts.append(markdown([*head, "seeds", "sd of the MSE"], rows))
    return "\n\n".join(parts)


def learning_curves(results: Results) -> str:
    """MSE and twin difference explained over the number of training experiments."""
    counts = {700: "700", 2800: "2,800", 8400: "8,400 ᵇ", 7000: "8,400 ᵇ", 14000: "14,000", 28310: "28,310"}
    heads, rows = list(dict.fromkeys(counts.values())), defaultdict(lambda: dict.fromkeys(heads, NOTHING))
    for point in results.learning_curves():
        text = f"{point['mse'].number()}; {point['twin_difference_explained'].number(0, 100)} %"
        rows[point["scenario"], point["method"]][counts[point["num_train"]]] = text
    named = [[f"{SCENARIOS[scenario]}, {title(method)}", *row.values()] for (scenario, method), row in rows.items()]
    return markdown(["training experiments", *heads], named)


def training_time(results: Results) -> str:
    """Minutes of the shortest training."""
    kinds = [(method, size) for size in ("small", "paper") for method in ("in", "cophynet", "alongside")]
    rows = []
    for scenario, split in (("blocktower", "3to3"), ("blocktower", "4to4"), ("balls", "4to4"), ("collision", "all")):
        trainings = [results.of(scenario, split, method, CHANGED_RATE, size=size) for method, size in kinds]
        seconds = [min(run["training_seconds"] for run in runs if run["training_seconds"] > 0) for runs in trainings]
        rows.append([f"{SCENARIOS[scenario]} {columns(scenario)[split]}", *(f"{each / 60:.0f}" for each in seconds)])
    return markdown(["minutes", *(f"{title(method)}, {size}" for method, size in kinds)], rows)


def data_seeds(results: Results) -> str:
    """The same rows on two datasets of size=small."""
    rows = []
    for scenario, split in CURVES.items():
        for method in (*COPIES, "in", "cophynet", "in_sup"):
            cells = [
                results.cell(measure, scenario, split, method, size="small", change=change)
                for measure in ("mse", "twin_difference_explained")
                for change in ("", r"\+data_seed-1")
            ]
            scaled = [cell.full(0, 100) if place > 1 else cell.full() for place, cell in enumerate(cells)]
            rows.append([f"{SCENARIOS[scenario]}, {title(method)}", *scaled])
    return markdown(
        ["size=small", "MSE, data seed 0", "MSE, data seed 1", "twins, %, seed 0", "twins, %, seed 1"], rows
    )


def alongside_lead(results: Results) -> str:
    """CoPhyNet as published, with as much CPU time and with SOAP, and alongside; size=small."""
    kinds = (("cophynet", ""), ("cophynet", r"\+max_epochs-55"), ("cophynet", r"\+optimizer-soap"), ("alongside", ""))
    rows = []
    for scenario, split, label in COLUMNS:
        cells = [results.cell("mse", scenario, split, name, size="small", change=change) for name, change in kinds]
        rows.append([f"{SCENARIOS[scenario]} {label}", *(cell.short() if cell else NOTHING for cell in cells)])
    return markdown(["MSE, m², size=small", "CoPhyNet", "CoPhyNet, 55 epochs", "CoPhyNet, SOAP", "alongside"], rows)


def alongside_parts(results: Results) -> str:
    """One part left out at a time; size=small."""
    rows = []
    for model in PARTS:
        names = {"model": model, "ablation": "full"}
        cells = [
            results.cell(measure, *column, names, size="small")
            for column in CURVES.items()
            for measure in ("mse", "twin_difference_explained")
        ]
        pairs = zip(cells[::2], cells[1::2], strict=True)
        rows.append([f"`{model}`", *(f"{mse.short()}; {twins.number(0, 100)} %" for mse, twins in pairs)])
    return markdown(
        ["MSE, m²; twins", *(f"{SCENARIOS[name]} {columns(name)[split]}" for name, split in CURVES.items())], rows
    )


def alongside_positions(results: Results) -> str:
    """True and estimated positions; size=small."""
    rows = []
    for method in ("cophynet", "alongside", "alongside_noisy"):
        for positions, label in (("ground_truth", "true"), (ESTIMATED_IN_TESTING, "estimated")):
            cells = [
                results.cell("mse", *column, method, size="small", positions=positions) for column in CURVES.items()
            ]
            rows.append([title(method), label, *(cell.short() for cell in cells)])
    return markdown(
        ["MSE, m²", "positions", *(f"{SCENARIOS[name]} {columns(name)[split]}" for name, split in CURVES.items())], rows
    )


if __name__ == "__main__":
    main()
