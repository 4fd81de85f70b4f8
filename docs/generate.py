"""Rewrite what the documentation takes from data: python docs/generate.py [--check]

Tables between `<!-- generated: NAME -->` and `<!-- end of generated: NAME -->`, in README.md, checkpoints/README.md and docs/, and
the plots of docs/figures. They are made from docs/results/results.csv, the paper's numbers (paper_tables.yaml),
docs/cophy/claims.yaml, docs/results/columns.csv, docs/results/gpu*.csv, checkpoints/index.csv, leaderboard/*.yaml, conf/size/ and
the costs that src/ states. With --check nothing is written;
the command names what differs, and exits with 1.
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
    COMPETING,
    COPIES,
    CURVES,
    GIVEN_MORE,
    OF_ORACLES,
    ROOT,
    SCENARIOS,
    SIZES,
    TABLE,
    Results,
    column_title,
    columns,
    in_prose,
    markdown,
    published,
    ratio,
    title,
)

from cophy.dataset.images import RENDERING
from cophy.dataset.states import COST
from cophy.report.paper_tables import ESTIMATED_IN_TESTING, PaperTable, methods, paper_tables

BLOCK = re.compile(r"<!-- generated: (\w+) -->\n.*?<!-- end of generated: \1 -->", re.DOTALL)
NOTHING = "–"
HEADLINES = [*CURVES.items(), ("collision", "sphere_to_cylinder"), ("collision", "cylinder_to_sphere")]
FULL_TABLES_ONLY = ("copy_b_displaced", "cophynet_adam", "noise_floor_rate", "noise_floor_jitter")
README_COLUMNS = [
    ("blocktower", "3to3"),
    ("blocktower", "3to4"),
    ("blocktower", "4to3"),
    ("balls", "4to4"),
    ("collision", "all"),
    ("collision", "sphere_to_cylinder"),
]
README_METHODS = ("copy_b", "trees", "in", "cophynet", "transformer", "alongside", "hypotheses", "in_sup")
RATIOS = ("copy_b", "in", "npe", "cophynet", "transformer", "alongside", "in_sup")
ABLATIONS = ("confounder_probe", "architecture_ablation", "confounder_impact", "stability")
PARTS = ("alongside", "alongside_no_impulses", "alongside_no_pair_memory", "alongside_no_replay")


def main() -> None:
    """Write or check every page and plot."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 and name what differs")
    parser.add_argument("--results", type=Path, default=TABLE, help="the table")
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
    writers = blocks(results)
    pages = [page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts]
    for page in [ROOT / "README.md", ROOT / "checkpoints" / "README.md", *pages]:
        old = page.read_text()
        names = BLOCK.findall(old)
        if unknown := set(names) - set(writers):
            sys.exit(f"{page.relative_to(ROOT)}: no generated block {min(unknown)}; there are {', '.join(writers)}")
        text = {
            name: f"<!-- generated: {name} -->\n\n{writers[name]()}\n\n<!-- end of generated: {name} -->"
            for name in names
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
    return {
        **{f"leaderboard_{scenario}": partial(leaderboard, results, scenario) for scenario in SCENARIOS},
        "collision_paper": partial(leaderboard, results, "collision", size="paper"),
        **{f"{scenario}_full": partial(every_split, results, scenario) for scenario in SCENARIOS},
        "ratio_to_copy_c": partial(ratio_to_copy_c, results),
        "entries": entries_table,
        "paper": paper,
        "readme": partial(readme, results),
        "table_1": partial(paper_table, results, "human_comparison"),
        **{name: partial(paper_table, results, name) for name in ABLATIONS},
        "learning_curves": partial(learning_curves, results),
        "training_time": partial(training_time, results),
        "data_seeds": partial(data_seeds, results),
        "alongside_parts": partial(alongside_parts, results),
        "estimated": partial(estimated, results),
        "claims": partial(claims, results),
        "checkpoints": partial(checkpoints, results),
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


def is_on_leaderboard(name: str) -> bool:
    """Return whether a method is on the leaderboard; the full tables have all, Table 6 the ablations of CoPhyNet."""
    method = methods()[name]
    return name not in FULL_TABLES_ONLY and (method.model != "cophynet" or method.ablation == "full")


def leaderboard(results: Results, scenario: str, **names: str) -> str:
    """Test MSE: methods × splits of a scenario; the lowest of those that see what CoPhyNet sees is bold."""
    splits = columns(scenario)
    cells = {
        method: {split: results.cell("mse", scenario, split, method, **names) for split in splits}
        for method in (*COMPETING, *GIVEN_MORE)
        if is_on_leaderboard(method)
    }
    cells = {method: row for method, row in cells.items() if any(row.values())}
    best = {
        split: min(
            (c.number() for method in COMPETING if (c := cells.get(method, {}).get(split))), key=float, default=""
        )
        for split in splits
    }

    def printed(method: str, split: str) -> str:
        if (cell := cells[method][split]) is None:
            return NOTHING
        number, _, interval = cell.short().partition(" ")
        is_best = method in COMPETING and cell.number() == best[split]
        return f"**{number}** {interval}" if is_best else f"{number} {interval}"

    rows = {method: [title(method), *(printed(method, split) for split in splits)] for method in cells}
    competing, others = ([rows[each] for each in methods if each in rows] for methods in (COMPETING, GIVEN_MORE))
    heading = [["*given more*", *[""] * len(splits)]]
    return markdown(["test MSE, m²", *splits.values()], [*competing, *heading, *others])


def ratio_to_copy_c(results: Results) -> str:
    """MSE divided by that of copy C."""
    rows = []
    for scenario, split, _ in COLUMNS:
        copy_c = results.cell("mse", scenario, split, "copy_c")
        cells = [results.cell("mse", scenario, split, method) for method in RATIOS]
        ratios = [ratio(cell.value, copy_c.value) if cell else NOTHING for cell in cells]
        rows.append([column_title(scenario, split), *ratios])
    return markdown(["MSE ÷ MSE of copy C", *map(title, RATIOS)], rows)


def paper() -> str:
    """The paper's MSE with its ratio to the paper's copy C."""
    shown = (*COPIES, "in", "npe", "cophynet", "in_sup")
    rows = []
    for scenario, split, _ in COLUMNS:
        cells = {method: published(scenario, split, method) for method in shown}
        ratios = [f"{value:.3f} ({ratio(value, cells['copy_c'])})" for value in list(cells.values())[1:]]
        rows.append([column_title(scenario, split), f"{cells['copy_c']:.3f}", *ratios])
    names = [f"{title(method)}{' ᵉ' if method == 'cophynet' else ''}" for method in shown]
    return markdown(["the paper's MSE, m²", *names], rows)


def readme(results: Results) -> str:
    """A few rows and columns of the leaderboard."""
    header = [
        "test MSE, m²",
        *(column_title(*column) for column in README_COLUMNS),
    ]
    cells = [[results.cell("mse", *column, method) for column in README_COLUMNS] for method in README_METHODS]
    return markdown(
        header,
        [
            [title(method), *(cell.marked() if cell else NOTHING for cell in row)]
            for method, row in zip(README_METHODS, cells, strict=True)
        ],
    )


def every_split(results: Results, scenario: str) -> str:
    """A table per split with every measure."""
    parts = []
    for split in columns(scenario):
        rows = [measures(results, method, scenario, split) for method in (*COMPETING, *GIVEN_MORE)]
        names = ["MSE, m²", "share, %", "twins, %", "right twin, %", "seeds", "CPU minutes", "parameters"]
        parts.append(markdown([column_title(scenario, split), *names], filter(None, rows)))
    return "\n\n".join(parts)


def measures(results: Results, method: str, scenario: str, split: str) -> list[str] | None:
    """Return a method's row with every measure; None where it was not run."""
    names = (scenario, split, method)
    if (mse := results.cell("mse", *names)) is None:
        return None
    others = [results.cell(measure, *names) for measure in ("share", "twin_difference_explained", "right_twin_chosen")]
    of_seeds = [f" (seeds: {cell.seeds})" if cell and cell.seeds < mse.seeds else "" for cell in others]
    minutes, parameters = results.cpu_minutes(*names), results.of(*names)[0]["parameters"]
    is_trained = parameters > 0 or minutes > 0
    return [
        title(method),
        mse.full(),
        *(cell.full(0, 100) + seeds if cell else NOTHING for cell, seeds in zip(others, of_seeds, strict=True)),
        f"{mse.seeds}" + (f", sd {mse.deviation:.3f}" if mse.seeds > 1 else "") if is_trained else NOTHING,
        f"{minutes:.1f}" if minutes > 0 else NOTHING,
        f"{parameters:,.0f}" if parameters > 0 else NOTHING,
    ]


def paper_table(results: Results, table_id: str) -> str:
    """A table of the paper with methods as rows: our number, then the paper's in italics; empty rows are left out."""
    table = next(table for table in paper_tables() if table.id == table_id)
    rows: dict[str, dict[str, str]] = defaultdict(dict)
    for row, column, names, number in table.cells():
        if names.get("model") not in ("oracle_initial_velocity", "oracle_confounders"):
            head, under = (column, row) if table.methods_in == "columns" else (row, column)
            rows[head][under] = paper_cell(results, table, names, number)
    shown = {head: cells for head, cells in rows.items() if set(cells.values()) != {NOTHING}}
    return markdown(
        ["ours *(the paper's)*", *next(iter(shown.values()))],
        [[in_prose(head), *cells.values()] for head, cells in shown.items()],
    )


def paper_cell(results: Results, table: PaperTable, names: dict[str, str], number: float | None) -> str:
    """Return our number and the paper's; nothing where we have none."""
    if "model" not in names:  # human participants
        return NOTHING
    digits = 1 if names["metric"].startswith("pixel") else table.digits
    keys = {key: names[key] for key in ("model", "ablation", "positions")}
    cell = results.cell(names["metric"], names["scenario"], names["split"], keys)
    if cell is None:
        return NOTHING
    if number is None:
        return cell.short(digits, table.scale)
    printed = f"{number:g}" if names["metric"].startswith("pixel") else f"{number:.{digits}f}"
    return cell.short(digits, table.scale) + f" *({printed})*"


def learning_curves(results: Results) -> str:
    """MSE and twin difference explained over the number of training experiments."""
    points = results.learning_curves()
    heads = {count: f"{count:,}" for count in sorted({point["num_train"] for point in points})}
    rows: dict[tuple[str, str], dict[str, str]] = defaultdict(lambda: dict.fromkeys(heads.values(), NOTHING))
    for point in points:
        text = f"{point['mse'].marked()}; {point['twin_difference_explained'].number(0, 100)} %"
        rows[point["scenario"], point["method"]][heads[point["num_train"]]] = text
    named = [[f"{SCENARIOS[scenario]}, {title(method)}", *row.values()] for (scenario, method), row in rows.items()]
    return markdown(["training experiments", *heads.values()], named)


def training_time(results: Results) -> str:
    """CPU minutes of a training of size=small: the median over training seeds."""
    methods = ("in", "cophynet", "alongside", "transformer", "gns")
    rows = []
    for scenario, split in [*CURVES.items(), ("blocktower", "4to4")]:
        minutes = [results.cpu_minutes(scenario, split, method) for method in methods]
        rows.append([column_title(scenario, split), *(f"{each:.0f}" if each else NOTHING for each in minutes)])
    return markdown(["CPU minutes", *map(title, methods)], rows)


def data_seeds(results: Results) -> str:
    """MSE and twin difference explained on two datasets of size=small: a table per split."""
    parts = []
    for scenario, split in HEADLINES:
        rows = []
        for method in (*COMPETING, *GIVEN_MORE):
            cells = {
                (measure, seed): results.cell(measure, scenario, split, method, **names)
                for measure in ("mse", "twin_difference_explained")
                for seed, names in enumerate(({}, {"change": rf"\+data_seed-1({OF_ORACLES})?"}))
            }
            if cells["mse", 1]:
                texts = [
                    cell.full(*((3, 1) if key[0] == "mse" else (0, 100))) if cell else NOTHING
                    for key, cell in cells.items()
                ]
                seeds = (str(cell.seeds) if (cell := cells["mse", seed]) else NOTHING for seed in (0, 1))
                rows.append([title(method), *texts, *seeds])
        names = [f"{name}, data seed {seed}" for name in ("MSE, m²", "twins, %", "training seeds") for seed in (0, 1)]
        parts.append(markdown([column_title(scenario, split), *names], rows))
    return "\n\n".join(parts)


def alongside_parts(results: Results) -> str:
    """One part left out at a time, in the scenarios where every part was."""
    cells = {
        (model, scenario): [
            results.cell(measure, scenario, split, {"model": model, "ablation": "full"})
            for measure in ("mse", "twin_difference_explained")
        ]
        for model, (scenario, split) in product(PARTS, CURVES.items())
    }
    shown = [scenario for scenario in CURVES if all(cells[model, scenario][0] for model in PARTS)]
    rows = []
    for model in PARTS:
        pairs = (cells[model, scenario] for scenario in shown)
        rows.append([f"`{model}`", *(f"{mse.short()}; {twins.number(0, 100)} %" for mse, twins in pairs)])
    heads = (column_title(scenario, CURVES[scenario]) for scenario in shown)
    return markdown(["MSE, m²; twins", *heads], rows)


def estimated(results: Results) -> str:
    """MSE on estimated positions and, in brackets, on true ones: columns of the paper's tables × methods."""
    places = [(scenario, split) for scenario in SCENARIOS for split in columns(scenario)]
    cells = {
        (place, method): results.cell("mse", *place, method, positions=ESTIMATED_IN_TESTING)
        for place, method in product(places, (*COMPETING, "in_sup"))
    }
    methods = dict.fromkeys(method for (_, method), cell in cells.items() if cell)
    rows = []
    for place in dict.fromkeys(place for (place, _), cell in cells.items() if cell):
        texts = [
            f"{cell.short()} ({true.number() if (true := results.cell('mse', *place, method)) else NOTHING})"
            if (cell := cells[place, method])
            else NOTHING
            for method in methods
        ]
        rows.append([column_title(*place), *texts])
    return markdown(["MSE, m²", *map(title, methods)], rows)


if __name__ == "__main__":
    main()
