"""Make, or continue, the results of the docs: python benchmarks/reproduce.py [PART ...] [--scenario NAME] [--workers N] [--plan]

Parts: data (datasets), audit, headline (rows of the headline table: three training seeds on two datasets), oracles, rows (every
method of the paper's tables on every split, from true positions), tables (results.csv, then tables and figures of the docs). All by
default. Prints the plan with the CPU-hours and the disk that are left, then runs the commands side by side. What is finished or has
a row in docs/results/results.csv is skipped (delete the row to make it again; trainings without a recorded optimiser are made
again), and what was interrupted continues. Oracles are needed for the share of the possible gain, so a row does not replace
their files. Logs: reproduce/ in the folder of outputs.
"""

import os
import subprocess
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from cophy.config import folder, generated_by, settings
from cophy.oracles.forecasts import SECONDS_PER_EXPERIMENT
from cophy.report.paper_tables import SIMULATED as SIMULATIONS
from cophy.report.paper_tables import TRUE_POSITIONS, methods, paper_tables
from cophy.schemas import register
from cophy.training.run import METRICS, Run

ROOT = Path(__file__).parents[1]
ROW = ["scenario", "split", "model", "ablation", "size", "variant", "seed"]  # columns of results.csv
RESULTS = ROOT / "docs" / "results" / "results.csv"
OUTPUTS = Path(folder("COPHY_OUTPUTS"))
LOGS = OUTPUTS / "reproduce"
HEADLINE = {
    "blocktower": ["3to3"],
    "balls": ["4to4"],
    "collision": ["all", "sphere_to_cylinder", "cylinder_to_sphere"],
}
UNTRAINED = ["copy_c", "copy_b", "copy_b_displaced", "replay"]
TREES = ["trees", "trees_confounders"]
NETWORKS = ["in", "npe", "cophynet", "alongside", "alongside_statics", "in_sup"]
ONLY = {"replay": "collision", "alongside_statics": "blocktower"}  # rows of one scenario
ONCE = ["cophynet_adam", "in_without_pose", "cophynet_without_pose"]  # one training seed on the default split
ORACLES = ["oracle_feedforward", "oracle_counterfactual", "oracle_initial_velocity", "oracle_confounders"]
SIMULATED = [*ORACLES, "noise_floor_rate", "noise_floor_jitter"]  # they share their simulations
# rows with more than one training seed on every split
SEEDED = ["in", "cophynet", "alongside", "alongside_statics", "gns", "transformer"]
SEEDS, DATA_SEEDS = (0, 1, 2), (0, 1)
DATASETS = {"blocktower": [3, 4], "balls": [2, 3, 4, 5, 6], "collision": [2]}
AUDIT_HOURS = 0.05  # estimated
ORACLE_EXPERIMENTS = 100  # ours: a quarter of the test split of size=small
ORACLE_HOURS = ORACLE_EXPERIMENTS * SECONDS_PER_EXPERIMENT / 3600


@dataclass
class Job:
    """A command, the file that says that it is finished, what is known of its cost, and the names of its row in results.csv."""

    scenario: str
    command: list[str]
    finished: Path
    hours: float = float("nan")
    megabytes: float = 0.0
    row: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return " ".join(self.command)


def main(parts: list[str], scenarios: list[str], size: str, workers: int, plan: bool) -> None:
    """Print the plan and run it, part by part."""
    register()
    failed = []
    rows = pd.read_csv(RESULTS, dtype=str, keep_default_na=False)
    # not trained, or with the chosen optimiser
    is_current = (rows["training_seconds"] == "0") | (rows["optimizer"] != "")
    kept = set(map(tuple, rows[is_current][ROW].to_numpy()))
    for part in [part for part in PARTS if part in (parts or PARTS)]:
        jobs = [job for job in PARTS[part](size) if job.scenario in (scenarios or HEADLINE)]
        left = [job for job in jobs if not job.finished.exists() and job.row not in kept]
        print_plan(part, jobs, left)
        if not plan:
            failed += [job.name for job in run_all(left, workers)]
    if not plan and TABLES in (parts or [TABLES]):
        for script in ("benchmarks/results/keep_results.py", "docs/generate.py"):
            subprocess.run([sys.executable, str(ROOT / script)], check=True)
    if failed:
        sys.exit("failed: " + "\nfailed: ".join(failed))


def data_jobs(size: str) -> Iterator[Job]:
    """Datasets: all with data seed 0, those of the headline table with every data seed."""
    for scenario, counts in DATASETS.items():
        headline = settings("generate", f"scenario={scenario}").split.counts()
        for count, seed in product(counts, DATA_SEEDS):
            if seed == 0 or count in headline:
                keys = [f"scenario={scenario}", f"num_objects=[{count}]", f"size={size}", f"data_seed={seed}"]
                (states,) = generated_by(settings("generate", *keys))
                seconds, megabytes = states.cost(states.spec.num_experiments)
                command = ["generate", *keys, "workers=1"]
                yield Job(scenario, command, states.directory / "manifest.json", seconds / 3600, megabytes)


def audit_jobs(size: str) -> Iterator[Job]:
    """Audits of all datasets."""
    for job in data_jobs(size):
        page = Path(OUTPUTS, "audit", job.scenario, job.finished.parent.name, "audit.md")
        yield Job(job.scenario, ["audit", *job.command[1:-1]], page, AUDIT_HOURS)


def headline_jobs(size: str) -> Iterator[Job]:
    """Rows of the headline table: first the first seed of everything, then the next."""
    for seed, data_seed, (scenario, splits) in product(SEEDS, DATA_SEEDS, HEADLINE.items()):
        for split in splits:
            rows = [*TREES, *NETWORKS] if seed else [*UNTRAINED, *TREES, *NETWORKS]
            for row in [*rows, *ONCE] if seed == 0 and split == splits[0] else rows:
                if ONLY.get(row, scenario) == scenario:
                    yield run_job(scenario, split, row, size, seed, data_seed)


def oracle_jobs(size: str) -> Iterator[Job]:
    """Oracles and noise floors on the default splits; the first of a dataset simulates for all."""
    for row, data_seed, (scenario, splits) in product(SIMULATED, DATA_SEEDS, HEADLINE.items()):
        changes = {"max_experiments": ORACLE_EXPERIMENTS}
        job = run_job(scenario, splits[0], row, size, 0, data_seed, changes)
        yield replace(job, hours=ORACLE_HOURS if row == ORACLES[0] else 0.01, row=())


def row_jobs(size: str) -> Iterator[Job]:
    """Every method of the paper's tables and beyond on every split: first one seed, then those of SEEDED."""
    cells = [names for table in paper_tables() for _, _, names, _ in table.cells()]
    rows = {(method.model, method.ablation): name for name, method in methods().items()}
    wanted = dict.fromkeys(
        (names["scenario"], names["split"], rows[names["model"], names["ablation"]])
        for names in cells
        if names["positions"] == TRUE_POSITIONS and not names.get("model", SIMULATIONS[0]).startswith(SIMULATIONS)
    )
    for seed in SEEDS:
        yield from (run_job(*names, size, seed, 0) for names in wanted if seed == 0 or names[-1] in SEEDED)


@cache
def known_hours(size: str) -> "pd.Series[float]":
    """Median duration of the runs of this size by scenario, model and ablation."""
    runs = pd.concat([pd.read_csv(RESULTS.with_name(f"{name}.csv")) for name in ("format_3", "superseded", "results")])
    of_size = runs[(runs["size"] == size) & (runs["predictor"].isna())]
    return of_size.groupby(["scenario", "model", "ablation"])["training_seconds"].median() / 3600


def run_job(
    scenario: str,
    split: str,
    row: str,
    size: str,
    seed: int,
    data_seed: int,
    changes: dict[str, int] | None = None,
) -> Job:
    """Return the job of one run of train.py; `changes` are keys of its model."""
    names = methods()[row].keys()
    changed = {"size": size if size != "small" else None, "data_seed": data_seed or None, **(changes or {})}
    variant = "".join(f"+{key}-{value}" for key, value in changed.items() if value is not None)
    place = Run(
        scenario, split, names["model"], names["ablation"], "ground_truth", seed, size, variant, directory=Path()
    ).place
    command = ["train", f"scenario={scenario}", f"split={split}", f"+row={row}", f"size={size}", f"seed={seed}"]
    command += [f"data_seed={data_seed}", *(f"model.{key}={value}" for key, value in (changes or {}).items())]
    command += ["workers=1", "trainer.enable_progress_bar=false", "figures_every_n_epochs=1000"]
    identity = (scenario, split, names["model"], names["ablation"], size, variant, str(seed))
    hours = known_hours(size).get((scenario, names["model"], names["ablation"]), float("nan"))
    return Job(scenario, command, OUTPUTS / place / METRICS, hours, row=identity)


PARTS = {"data": data_jobs, "audit": audit_jobs, "headline": headline_jobs, "oracles": oracle_jobs, "rows": row_jobs}
TABLES = "tables"


def print_plan(part: str, jobs: list[Job], left: list[Job]) -> None:
    """Print what a part needs."""
    table = Table(title=f"{part}: {len(left)} of {len(jobs)} jobs are left", title_justify="left")
    for column in ("scenario", "left", "CPU-hours", "MB"):
        table.add_column(column)
    for scenario in dict.fromkeys(job.scenario for job in left):
        of = [job for job in left if job.scenario == scenario]
        hours = pd.Series([job.hours for job in of])
        unknown = f" and {hours.isna().sum()} unknown" if hours.isna().any() else ""
        table.add_row(scenario, str(len(of)), f"{hours.sum():.1f}{unknown}", f"{sum(job.megabytes for job in of):.0f}")
    Console().print(table)


def run_all(jobs: list[Job], workers: int) -> list[Job]:
    """Run jobs side by side; return those that failed."""
    LOGS.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(workers) as pool:
        codes = list(pool.map(run, jobs))
    return [job for job, code in zip(jobs, codes, strict=True) if code]


def run(job: Job) -> int:
    """Run a job, with one thread; its output goes to a log."""
    start, (script, *keys) = time.monotonic(), job.command
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
    parser.add_argument("--plan", action="store_true", help="only print the plan")
    main(**vars(parser.parse_args()))
