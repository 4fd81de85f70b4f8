"""Make, or continue, the results of the docs: python benchmarks/reproduce.py [PART ...] [--scenario NAME] [--size NAME] [--plan]

Parts: data (datasets), audit, headline (rows of the headline table: three training seeds, at size=small of all networks; and there
one seed on a second dataset), oracles, rows (every method of the paper's tables on every split, from true positions), derenderers,
estimated (the same rows, tested on positions estimated from images; at size=small by the published de-renderers, with published
weights where there are), curves (learning curves), tables (results.csv, then tables and figures of the docs). All by default.

Prints the plan with the CPU-hours and the disk that are left, then runs the commands side by side, here or each as a job of a
cluster (--launcher slurm). What is finished or has a row in docs/results/results.csv is skipped (delete the row to make it again;
trainings without a recorded optimiser are made again, and oracles without errors in oracles.csv), and what was interrupted
continues. Start it at the root of the project. Logs: reproduce/ in the folder of outputs.
"""

import os
import resource
import subprocess
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain, product
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from cophy.config import composed, folder, generated_by, settings, to_plain, variant
from cophy.dataset.features import declared_inputs, not_derendered
from cophy.dataset.splits import FRACTIONS
from cophy.oracles.forecasts import SECONDS_PER_EXPERIMENT
from cophy.report.paper_tables import ESTIMATED_IN_TESTING, TRUE_POSITIONS, methods, paper_tables
from cophy.schemas import register
from cophy.training.run import METRICS, RUN_NAMES, Run

ROOT = Path(__file__).parents[1]
ROW = list(RUN_NAMES)  # columns of results.csv
ERRORS = ["scenario", "test_dataset", "model"]  # columns of oracles.csv
RESULTS = ROOT / "docs" / "results" / "results.csv"
CHECKPOINTS = ROOT / "checkpoints"
OUTPUTS = Path(folder("COPHY_OUTPUTS"))
LOGS = OUTPUTS / "reproduce"
HEADLINE = {
    "blocktower": ["3to3"],
    "balls": ["4to4"],
    "collision": ["all", "sphere_to_cylinder", "cylinder_to_sphere"],
}
UNTRAINED = ["copy_c", "copy_b", "copy_b_displaced", "replay", "spheres"]
TREES = ["trees", "trees_confounders"]
NETWORKS = ["in", "npe", "cophynet", "alongside", "alongside_canonical", "alongside_posed", "hypotheses", "in_sup"]
ONLY = {  # rows of one scenario
    "replay": "collision",
    "spheres": "balls",
    "alongside_canonical": "collision",
    "alongside_posed": "collision",
    "hypotheses": "blocktower",
}
NEWER = ["gns", "transformer", "cophynet_canonical"]  # headline_jobs has them on the default splits alone
ONCE = ["cophynet_adam", "in_without_pose", "cophynet_without_pose"]  # in headline_jobs one seed, dataset and split
VARIANTS = [*ONCE, "alongside_noisy"]  # at other sizes than small on the default splits alone
ORACLES = ["oracle_feedforward", "oracle_counterfactual", "oracle_initial_velocity", "oracle_confounders"]
ENDS = ("oracle_feedforward", "oracle_counterfactual")  # of the possible gain
SIMULATED = [*ORACLES, "noise_floor_rate", "noise_floor_jitter"]  # they share their simulations
# rows with more than one training seed, on every split at size=small, on those of HEADLINE at other sizes
SEEDED_SMALL = [*NETWORKS, *NEWER, *TREES]
SEEDED_OTHERS = ["in", "cophynet", "alongside", "gns", "transformer"]
SEEDS, DATA_SEEDS = (0, 1, 2), {"small": (0, 1)}  # data seed 0 alone for other sizes
DERENDERER = "derenderer"
# split and changes, so that one has seen all numbers of objects of a scenario
DERENDERERS: dict[str, tuple[str, dict[str, Any]]] = {
    "blocktower": ("3to4", {}),
    "balls": ("4to4", {"num_objects": [2, 3, 4, 5, 6]}),
    "collision": ("all", {}),
}
CURVES = ["in", "in_sup", "cophynet", "alongside"]
CURVE_COUNTS = (700, 2800, 8400)  # training experiments, besides all
DATASETS = {"blocktower": [3, 4], "balls": [2, 3, 4, 5, 6], "collision": [2]}
AUDIT_HOURS = 0.05  # estimated
TEST_HOURS = 0.01  # ours: of published weights, whose test images another run has drawn
DERENDERER_HOURS = 0.3  # 20,000 frames at 112 px (docs/guides/images.md)
ORACLE_EXPERIMENTS = 100  # ours: a quarter of the test split of size=small
FIT_HOURS = {"spheres": 0.2, "trees": 0.01, "trees_confounders": 0.01}  # measured at size=small
ORACLE_HOURS = ORACLE_EXPERIMENTS * SECONDS_PER_EXPERIMENT / 3600


@dataclass
class Job:
    """A command, the file that says that it is finished, what is known of its cost, and the names of its row in results.csv.

    Jobs with equal `training` share one: the second uses the weights of the first.
    """

    scenario: str
    command: list[str]
    finished: Path
    hours: float = float("nan")
    megabytes: float = 0.0
    row: tuple[str, ...] = ()
    training: tuple[object, ...] | None = None

    @property
    def name(self) -> str:
        return " ".join(self.command)


def main(parts: list[str], scenarios: list[str], size: str, workers: int, launcher: str | None, plan: bool) -> None:
    """Print the plan, run it part by part, and print what it took."""
    register()
    start = time.monotonic()
    kept = rows_that_are_kept(RESULTS)
    left: dict[str, list[Job]] = {}
    for part in [part for part in PARTS if part in (parts or PARTS)]:
        jobs = [job for job in PARTS[part](size) if job.scenario in (scenarios or HEADLINE)]
        left[part] = [job for job in jobs if not job.finished.exists() and job.row not in kept]
        print_plan(part, jobs, left[part])
    print(
        f"all parts, a training that several jobs share counted once: {in_hours(list(chain(*left.values())))} CPU-hours"
    )
    if plan:
        return
    failed = []
    for jobs in left.values():
        ran = run_all([job for job in jobs if not job.finished.exists()], workers, launcher)
        failed += [job.name for job in ran]
    print_cost(time.monotonic() - start)
    if TABLES in (parts or [TABLES]):
        for script in ("benchmarks/results/keep_results.py", "docs/generate.py"):
            if subprocess.run([sys.executable, str(ROOT / script)], check=False).returncode:
                failed.append(script)
                break
    if failed:
        sys.exit("failed: " + "\nfailed: ".join(failed))


def rows_that_are_kept(results: Path) -> set[tuple[str, ...]]:
    """Return the names of the rows that need not be made again."""
    rows = pd.read_csv(results, dtype=str, keep_default_na=False)
    # not trained, or with the chosen optimiser
    is_current = (rows["training_seconds"] == "0") | (rows["optimizer"] != "")
    oracles = results.with_name("oracles.csv")  # for shares of the possible gain
    errors = set(map(tuple, pd.read_csv(oracles, dtype=str)[ERRORS].to_numpy())) if oracles.exists() else set()
    rows["test_dataset"] = rows["datasets"].str.split().str[-1]
    has_errors = rows[ERRORS].apply(tuple, axis=1).isin(errors)
    return set(map(tuple, rows[is_current & (~rows["model"].isin(ENDS) | has_errors)][ROW].to_numpy()))


def data_jobs(size: str) -> Iterator[Job]:
    """Datasets: all with data seed 0, those of the headline table with every data seed."""
    for scenario, counts in DATASETS.items():
        headline = settings("generate", f"scenario={scenario}").split.counts()
        for count, seed in product(counts, data_seeds(size)):
            if seed == 0 or count in headline:
                keys = [f"scenario={scenario}", f"num_objects=[{count}]", f"size={size}", f"data_seed={seed}"]
                (states,) = generated_by(settings("generate", *keys))
                seconds, megabytes = states.cost(states.spec.num_experiments)
                command = ["generate", *keys, "workers=1"]
                yield Job(scenario, command, states.directory / "manifest.json", seconds / 3600, megabytes)


def data_seeds(size: str) -> tuple[int, ...]:
    """Return the data seeds of the headline table."""
    return DATA_SEEDS.get(size, (0,))


def audit_jobs(size: str) -> Iterator[Job]:
    """Audits of all datasets."""
    for job in data_jobs(size):
        page = Path(OUTPUTS, "audit", job.scenario, job.finished.parent.name, "audit.md")
        yield Job(job.scenario, ["audit", *job.command[1:-1]], page, AUDIT_HOURS)


def headline_jobs(size: str) -> Iterator[Job]:
    """Rows of the headline table: first the first seed of everything, then the next."""
    for seed, data_seed, (scenario, splits) in product(SEEDS, data_seeds(size), HEADLINE.items()):
        for split in splits:
            rows = [*TREES, *NETWORKS] if seed else [*UNTRAINED, *TREES, *NETWORKS]
            rows += NEWER if split == splits[0] else []
            rows += ONCE if seed == data_seed == 0 and split == splits[0] else []
            if data_seed and (seed or split != splits[0]):
                continue
            for row in rows:
                is_wanted = size == "small" or seed == 0 or row in SEEDED_OTHERS
                if is_wanted and ONLY.get(row, scenario) == scenario:
                    yield run_job(scenario, split, row, size, seed, data_seed)


def oracle_jobs(size: str) -> Iterator[Job]:
    """Oracles and noise floors on the default splits; the first of a dataset simulates for all."""
    for row, data_seed, (scenario, splits) in product(SIMULATED, data_seeds(size), HEADLINE.items()):
        changes = {"model.max_experiments": ORACLE_EXPERIMENTS}
        job = run_job(scenario, splits[0], row, size, 0, data_seed, changes=changes)
        yield replace(job, hours=ORACLE_HOURS if row == ORACLES[0] else 0.01, training=None)


def row_jobs(size: str) -> Iterator[Job]:
    """Every method of the paper's tables and beyond on every split: first one seed, then at size=small those of SEEDED_SMALL."""
    for seed, (scenario, split, row, _) in product(SEEDS, table_rows(size, estimated=False)):
        if seed == 0 or (size == "small" and row in SEEDED_SMALL):
            yield run_job(scenario, split, row, size, seed)


def derenderer_jobs(size: str) -> Iterator[Job]:
    """The networks that estimate positions from images, one per scenario where the published one has not seen all numbers of objects."""
    places = {(scenario, split) for scenario, split, *_ in table_rows(size, estimated=True)}
    for scenario, (split, changes) in DERENDERERS.items():
        if not all(published(*place, DERENDERER, size) for place in places if place[0] == scenario):
            yield replace(run_job(scenario, split, DERENDERER, size, changes=changes), hours=DERENDERER_HOURS)


def estimated_jobs(size: str) -> Iterator[Job]:
    """Every method of the tables on estimated positions, with one seed; weights from true positions are used again."""
    for scenario, split, row, positions in table_rows(size, estimated=True):
        if is_derendered(row):
            derenderer = published(scenario, split, DERENDERER, size)
            predictor = published(scenario, split, row, size) if positions == ESTIMATED_IN_TESTING else None
            yield run_job(scenario, split, row, size, positions=positions, derenderer=derenderer, predictor=predictor)


@cache
def published(scenario: str, split: str, row: str, size: str) -> str | None:
    """Return the published weights of a method with the training data of this split, or of a de-renderer that has seen its objects."""
    for file in pd.read_csv(CHECKPOINTS / "index.csv").itertuples() if size == "small" else ():
        if (file.scenario, file.method) != (scenario, row):
            continue
        if row == DERENDERER:
            fits = {*counts_of(scenario, split)} <= {*counts_of(scenario, file.split)}
        else:
            fits = training_of(scenario, file.split, size) == training_of(scenario, split, size)
        if fits:
            return f"{CHECKPOINTS.name}/{file.file}"
    return None


@cache
def counts_of(scenario: str, split: str) -> list[int]:
    """Return the numbers of objects in the datasets of a split."""
    counts: list[int] = settings("generate", f"scenario={scenario}", f"split={split}").split.counts()
    return counts


@cache
def is_derendered(row: str) -> bool:
    """Return whether a de-renderer estimates all that a method sees of images."""
    return not not_derendered(declared_inputs(to_plain(composed("train", f"+row={row}").model)))


def table_rows(size: str, *, estimated: bool) -> list[tuple[str, str, str, str]]:
    """Return scenario, split, method and positions of all cells of the tables that are trained or copied."""
    names = {(method.model, method.ablation): name for name, method in methods().items() if not method.simulates}
    cells = [cell for table in paper_tables() for _, _, cell, _ in table.cells()]
    rows = dict.fromkeys(
        (cell["scenario"], cell["split"], name, cell["positions"])
        for cell in cells
        if (cell["positions"] != TRUE_POSITIONS) == estimated
        and (name := names.get((cell.get("model", ""), cell.get("ablation", ""))))  # None for human participants
    )
    return [
        (scenario, split, row, positions)
        for scenario, split, row, positions in rows
        if size == "small" or row not in VARIANTS or split == HEADLINE[scenario][0]
    ]


def curve_jobs(size: str) -> Iterator[Job]:
    """Learning curves on the default splits: the points below the whole training split."""
    for (scenario, splits), row, count in product(HEADLINE.items(), CURVES, CURVE_COUNTS):
        (states,) = generated_by(settings("train", f"scenario={scenario}", f"split={splits[0]}", f"size={size}"))
        if count < FRACTIONS[0] * states.spec.num_experiments:
            yield run_job(scenario, splits[0], row, size, changes={"training.num_experiments": count})


@cache
def known_seconds() -> "pd.Series[float]":
    """Median CPU time of a training per experiment and epoch, by scenario, model and ablation; 0 where nothing is trained."""
    runs = pd.concat([pd.read_csv(RESULTS.with_name(f"{name}.csv")) for name in ("format_3", "results")])
    runs = runs[runs["predictor"].isna()]
    seconds = runs["training_cpu_seconds"].fillna(runs["training_seconds"])  # format 3 has wall-clock time alone
    seconds /= runs["num_train"] * runs["max_epochs"].fillna(1)
    return seconds.groupby([runs["scenario"], runs["model"], runs["ablation"]]).median()


@cache
def training_of(scenario: str, split: str, size: str) -> tuple[str, int, int]:
    """Return what tells the training data of a split from those of others, how many experiments these are, and `epochs_factor`."""
    config = settings("train", f"scenario={scenario}", f"split={split}", f"size={size}")
    part = config.split.train
    (spec,) = (states.spec for states in generated_by(config) if states.spec.num_objects == part.num_objects)
    halves = sum(each is not None for each in (part.moving, part.configurations))  # one of two shapes, or seen ones
    experiments = round(FRACTIONS[0] * spec.num_experiments / 2**halves)
    return str(part), experiments, config.split.epochs_factor


@cache
def epochs_of(method: str, size: str) -> int:
    """Return the epochs of a method, written as an override, on all of the data."""
    epochs: int = composed("train", method, f"size={size}").trainer.max_epochs
    return epochs


def run_job(
    scenario: str,
    split: str,
    row: str,
    size: str,
    seed: int = 0,
    data_seed: int = 0,
    positions: str = TRUE_POSITIONS,
    changes: Mapping[str, Any] | None = None,
    derenderer: str | None = None,
    predictor: str | None = None,
) -> Job:
    """Return the job of one run of train.py.

    Args:
        row: A method's name, or DERENDERER.
        changes: Keys of its configuration that matter for training, with their values.
        derenderer: Its checkpoint that estimates positions; None for the one in the folder of outputs.
        predictor: A checkpoint to test instead of training.
    """
    names = {"model": row, "ablation": "full"} if row == DERENDERER else methods()[row].keys()
    changed = {"size": size if size != "small" else None, "data_seed": data_seed or None, **(changes or {})}
    changed = {key: value for key, value in changed.items() if value is not None}
    tested = {"derenderer": derenderer} if derenderer else {}
    change = variant(changed | tested)
    named_run = Run(scenario, split, names["model"], names["ablation"], positions, seed, size, change, Path())
    command = ["train", f"scenario={scenario}", f"split={split}"]
    method = f"model={row}" if row == DERENDERER else f"+row={row}"
    command += [method, f"size={size}", f"seed={seed}"]
    keys = {"data_seed": data_seed, **(changes or {}), **tested, **({"predictor": predictor} if predictor else {})}
    command += [f"{key}={value}".replace(" ", "") for key, value in keys.items()]
    command += [f"positions={positions}"] if positions != TRUE_POSITIONS else []
    command += ["workers=1", "trainer.enable_progress_bar=false", "figures_every_n_epochs=1000"]
    identity = tuple(map(str, named_run.names().values()))
    trained_on, experiments, factor = training_of(scenario, split, size)
    epochs = epochs_of(method, size) * factor
    experiments = (changes or {}).get("training.num_experiments", experiments)
    seconds = known_seconds().get((scenario, names["model"], names["ablation"]), float("nan")) * experiments * epochs
    hours = TEST_HOURS if predictor else FIT_HOURS.get(row, seconds / 3600)
    sees_estimates = positions not in (TRUE_POSITIONS, ESTIMATED_IN_TESTING)
    training = None if predictor else (scenario, trained_on, row, seed, variant(changed), sees_estimates)
    return Job(scenario, command, OUTPUTS / named_run.place / METRICS, hours, row=identity, training=training)


PARTS = {
    "data": data_jobs,
    "audit": audit_jobs,
    "headline": headline_jobs,
    "oracles": oracle_jobs,
    "rows": row_jobs,
    "derenderers": derenderer_jobs,
    "estimated": estimated_jobs,
    "curves": curve_jobs,
}
TABLES = "tables"


def print_plan(part: str, jobs: list[Job], left: list[Job]) -> None:
    """Print what a part needs."""
    table = Table(title=f"{part}: {len(left)} of {len(jobs)} jobs are left", title_justify="left")
    for column in ("scenario", "left", "CPU-hours", "MB"):
        table.add_column(column)
    for scenario in dict.fromkeys(job.scenario for job in left):
        jobs_of_scenario = [job for job in left if job.scenario == scenario]
        megabytes = sum(job.megabytes for job in jobs_of_scenario)
        table.add_row(scenario, str(len(jobs_of_scenario)), in_hours(jobs_of_scenario), f"{megabytes:.0f}")
    Console().print(table)


def in_hours(jobs: list[Job]) -> str:
    """Return the CPU-hours of jobs, a training that several share counted once."""
    hours = pd.Series({job.training or job.name: job.hours for job in jobs}, dtype=float)
    return f"{hours.sum():.1f}" + (f" and {hours.isna().sum()} unknown" if hours.isna().any() else "")


def print_cost(seconds: float) -> None:
    """Print what the commands took on this machine, those of a cluster excepted."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    folders = [Path(folder("COPHY_DATA")), OUTPUTS]
    disk = sum(path.stat().st_size for each in folders for path in each.rglob("*") if path.is_file())
    print(
        f"{seconds / 3600:.2f} hours, {(used.ru_utime + used.ru_stime) / 3600:.2f} CPU-hours, at most "
        f"{used.ru_maxrss / 1024**2:.1f} GiB of memory per process; data and outputs take {disk / 1e9:.1f} GB"
    )


def run_all(jobs: list[Job], workers: int, launcher: str | None = None) -> list[Job]:
    """Run jobs side by side, or with one of Hydra's launchers; return those that failed."""
    LOGS.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(workers) as pool:
        codes = list(pool.map(partial(run, launcher=launcher), jobs))
    return [job for job, code in zip(jobs, codes, strict=True) if code]


def run(job: Job, launcher: str | None = None) -> int:
    """Run a job, with one thread; its output goes to a log."""
    start, (script, *keys) = time.monotonic(), job.command
    keys = ["-m", *keys, f"hydra/launcher={launcher}"] if launcher else keys
    log = LOGS / ("_".join(job.command).replace("/", "-")[:200] + ".log")
    with log.open("ab") as output:
        process = subprocess.run(
            [sys.executable, str(ROOT / "src" / f"{script}.py"), *keys],
            stdout=output, stderr=subprocess.STDOUT, env=os.environ | {"OMP_NUM_THREADS": "1"}, check=False,
        )  # fmt: skip
    outcome = "finished" if process.returncode == 0 else f"FAILED, see {log}"
    print(f"{time.strftime('%H:%M:%S')} {job.name}: {outcome} after {time.monotonic() - start:.0f} s", flush=True)
    return process.returncode


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument(
        "parts", nargs="*", choices=[*PARTS, TABLES, []], metavar="PART", help=", ".join([*PARTS, TABLES])
    )
    parser.add_argument("--scenario", dest="scenarios", action="append", choices=list(HEADLINE), help="only this one")
    parser.add_argument("--size", default="small", help="of the datasets (default: small)")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count(), help="commands side by side (default: all cores)"
    )
    parser.add_argument("--launcher", choices=["slurm"], help="each command as a job of a cluster, --workers at a time")
    parser.add_argument("--plan", action="store_true", help="only print the plan")
    main(**vars(parser.parse_args()))
