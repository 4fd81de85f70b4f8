"""Human participants fill Table 1; simulated participants never do; invalid files are named and left out."""

import json
import logging
from collections.abc import Callable
from contextlib import closing
from copy import copy
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cophy.commands.report import ComposedData
from cophy.config import generated_by, settings
from cophy.dataset.states import States
from cophy.report.paper_tables import paper_tables
from cophy.report.pipeline import Configurations, Supplement, write_report
from cophy.report.render import Cell, table_cells
from cophy.report.tables import fill
from cophy.study.answers import SCHEMA, AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.judging import human_rows
from cophy.study.report import StudyAnswers, draw_studies, read_answers, study_tables, table_numbers
from tests.conftest import tiny_spec

MEASURES = {"rank_1": 10.0, "rank_2": 20.0, "rank_3": 60.0, "mean": 30.0}


def rows(kind: str, shift: float = 0.0) -> pd.DataFrame:
    """Return rows as `human_rows` returns them."""
    lines = [
        {
            **{"kind": kind, "setting": setting, "measure": measure, "mean": mean + shift + extra, "sigma": 5.0},
            **{"low_people": 0.0, "high_people": 99.0, "low_pairs": 1.0, "high_pairs": 98.0},
            **{"participants": 7, "answers": 140, "missing": 0.0},
        }
        for setting, extra in (("cf", 0.0), ("non_cf", 4.0))
        for measure, mean in MEASURES.items()
    ]
    return pd.DataFrame(lines)


def study(rows: pd.DataFrame) -> StudyAnswers:
    return StudyAnswers("blocktower", "3to3", "3-tiny-0", 448, Path(), pd.DataFrame(), rows)


def test_human_participants_fill_table_1_next_to_the_papers() -> None:
    table = paper_tables()[0]
    numbers = table_numbers([study(pd.concat([rows("person"), rows("stays", -9.0)]))])
    cells = table_cells(fill(table, pd.DataFrame(), participants=numbers)).map(Cell.line)
    assert cells.loc["Human", "Top"] == "60.00 [0.00, 99.00] / 99.98"
    assert cells.loc["Human", "Mean"] == "30.00 [0.00, 99.00] / 54.54"
    assert cells.loc["Human without AB", "Bottom"] == "14.00 [0.00, 99.00] / 13.67"


def test_simulated_participants_fill_a_table_of_their_own() -> None:
    only_simulated = [study(rows("stays"))]
    assert table_numbers(only_simulated).empty
    cells = table_cells(fill(paper_tables()[0], pd.DataFrame(), participants=table_numbers(only_simulated))).map(
        Cell.line
    )
    assert cells.loc["Human", "Mean"] == "— / 54.54"
    (table,) = study_tables(only_simulated)
    assert "simulated participants" in table.title
    assert table.cells.index.tolist() == ["stays, with AB", "stays, without AB"]


def test_human_participants_do_not_compete_and_have_no_share() -> None:
    numbers = table_numbers([study(rows("person"))])
    values = fill(paper_tables()[0], pd.DataFrame(), participants=numbers).values
    human = values[values["row"] == "Human"]
    assert not human["best"].any()
    assert human["share"].isna().all()


@pytest.fixture(scope="module")
def data(tiny_data: Path) -> ComposedData:
    return ComposedData("generated", tiny_data)


def write_answers(
    outputs: Path, *descriptions: str, experiment: int = 4, kind: str = "person", name: str = "x"
) -> None:
    """Write studies 0, 1, …: one participant of each clicked (10, 20) for slot 0 of an experiment."""
    path = outputs / "study" / name / "answers.sqlite"
    path.parent.mkdir(parents=True)
    with closing(AnswerStore(path)) as store, store.transaction() as db:
        for study, text in enumerate(descriptions):
            db.execute("INSERT INTO studies VALUES (?, ?)", (str(study), text))
            values = (study, str(study), kind, f"h{study}", f"c{study}")
            db.execute("INSERT INTO participants VALUES (?, ?, ?, 0, ?, NULL, ?, 1.0, 2.0)", values)
            db.execute(
                "INSERT INTO answers (participant, position, practice, experiment, setting, opened_at, answered_at) "
                "VALUES (?, 2, 0, ?, 'cf', 1.0, 2.0)",
                (study, experiment),
            )
            db.execute("INSERT INTO clicks VALUES (?, 2, 0, 10.0, 20.0, 500)", (study,))


def description(data: str) -> str:
    content = {"scenario": "blocktower", "split": "3to3", "num_objects": 3, "size": "tiny", "data": data}
    return json.dumps({**content, "resolution": 448, "seconds": 10})


def test_a_report_without_runs_has_the_tables_of_studies(tmp_path: Path, data: ComposedData) -> None:
    configurations = Configurations(data.scenario, data.default_split, data.dataset, data.dataset_ids)
    supplement = Supplement(tables=study_tables([study(rows("stays"))]))
    write_report(tmp_path, tmp_path / "report", configurations, supplement)
    assert "Human study" in (tmp_path / "report" / "tables.md").read_text()


@pytest.fixture
def left_out(tmp_path: Path, data: ComposedData, caplog: pytest.LogCaptureFixture) -> Callable[[], str]:
    """Read the answers, none of which can be used, and return what is logged."""

    def read() -> str:
        caplog.clear()
        with caplog.at_level(logging.INFO):
            assert read_answers(tmp_path, data.dataset) == []
        return " ".join(caplog.text.split())

    return read


@pytest.mark.parametrize(
    ("name", "experiment", "reason"),
    [("3-tiny-ffff", 2, "are not there"), (None, 99_999, "does not have"), (None, -1, "does not have")],
)
def test_answers_without_their_data_are_named(
    name: str | None, experiment: int, reason: str, tiny_data: Path, tmp_path: Path, left_out: Callable[[], str]
) -> None:
    states = States(tiny_spec("blocktower"), tiny_data)
    write_answers(tmp_path, description(name or states.id), experiment=experiment)
    assert reason in left_out()


@pytest.mark.parametrize("kind", ["../x", ""])
def test_names_of_figures_contain_no_path(
    kind: str, tiny_data: Path, tmp_path: Path, left_out: Callable[[], str]
) -> None:
    write_answers(tmp_path, description(States(tiny_spec("blocktower"), tiny_data).id), kind=kind)
    assert "is left out" in left_out()


def test_files_that_hold_no_answers_are_named(tmp_path: Path, left_out: Callable[[], str]) -> None:
    path = tmp_path / "study" / "x" / "answers.sqlite"
    path.parent.mkdir(parents=True)
    for content in (b"", b"no database" * 100, SCHEMA.encode()):
        path.write_bytes(content)
        assert "is left out" in left_out()


WHOLE = '{"scenario": "blocktower", "split": "3to3", "num_objects": 3, "size": "tiny", "data": "x", "resolution": 64}'
OVERRIDES = (
    *('["hydra.run.dir=/x"]', '["++hydra.searchpath=[/x]"]', '["++scenario.name=${oc.env:HOME}"]', "3", '"abc"', "[3]"),
    *('["++scenario.nothing=3"]', '["++scenario.min_difference=x"]', '["++scenario.a=1,++b=2"]', '["~scenario"]'),
)
INVALID = (
    *("[]", "{", "null", '{"scenario": 3}', '{"scenario": "nothing"}', "[" * 100_000),
    *(WHOLE.replace("blocktower", name) for name in ("nothing", "../x", "x y", "${data_dir}")),
    *(WHOLE.replace("3to3", "../x"), WHOLE.replace("tiny", "nothing"), WHOLE.replace("tiny", "../tiny")),
    *(WHOLE.replace("3,", f"{number},") for number in ("1e400", "-1", "0", "99")),
    *(WHOLE.replace("64", size) for size in ("0", "1e9", "NaN")),
    *(WHOLE.replace("64", f'64, "overrides": {value}') for value in OVERRIDES),
    *(WHOLE.replace("64", f'64, "data_seed": {value}') for value in ('"x"', "-1", "1e400", "[]")),
)


def test_invalid_descriptions_are_named(tmp_path: Path, left_out: Callable[[], str]) -> None:
    write_answers(tmp_path, *INVALID)
    text = left_out()
    assert [study for study in range(len(INVALID)) if f"study {study} of" not in text] == []
    assert text.count("is left out") == len(INVALID)


def test_a_study_without_data_hides_no_other(
    tiny_data: Path, tmp_path: Path, data: ComposedData, caplog: pytest.LogCaptureFixture
) -> None:
    write_answers(tmp_path, description("3-tiny-gone"), description(States(tiny_spec("blocktower"), tiny_data).id))
    with caplog.at_level(logging.INFO):
        assert len(read_answers(tmp_path, data.dataset)) == 1
    assert "study 0 of" in " ".join(caplog.text.split())


def test_data_of_another_seed_and_grid_are_found(
    experiments: StudyExperiments, tmp_path: Path, data: ComposedData
) -> None:
    (states,) = generated_by(settings("generate", "size=tiny", "data_seed=1", "scenario.confounders.friction=[1]"))
    other = copy(experiments)
    other.states = states
    write_answers(tmp_path, other.description)

    datasets: list[States] = []

    def dataset(*names: Any) -> States:
        datasets.append(data.dataset(*names))
        return datasets[-1]

    read_answers(tmp_path, dataset)
    assert [each.id for each in datasets] == [states.id]


def test_answers_are_judged_and_drawn(tiny_data: Path, tmp_path: Path, data: ComposedData) -> None:
    write_answers(tmp_path, *2 * [description(States(tiny_spec("blocktower"), tiny_data).id)])
    first, second = read_answers(tmp_path, data.dataset)
    pd.testing.assert_frame_equal(first.rows, human_rows(first.judged))
    figures = draw_studies([first, second])
    assert list(figures) == ["study-blocktower-3to3-person-cf", "study-blocktower-3to3-person-cf-2"]
    assert len(figures["study-blocktower-3to3-person-cf"].axes) == 2  # twins, side by side
