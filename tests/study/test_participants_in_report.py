"""People of the study fill Table 1; simulated participants never do; strange files are named and left out."""

import json
import logging
import sqlite3
from pathlib import Path

import pandas as pd
import pytest

from cophy.commands.report import ComposedData
from cophy.config import generated_by, settings
from cophy.dataset import generation
from cophy.dataset.states import States
from cophy.report.paper_tables import paper_tables
from cophy.report.render import Cell, table_cells
from cophy.report.tables import fill
from cophy.study.answers import SCHEMA, AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.judging import human_rows
from cophy.study.report import StudyAnswers, draw_studies, read_answers, study_tables, table_numbers
from tests.conftest import tiny_spec
from tests.study.conftest import SMALL

MEASURES = {"rank_1": 10.0, "rank_2": 20.0, "rank_3": 60.0, "mean": 30.0}


def rows(kind: str, shift: float = 0.0) -> pd.DataFrame:
    """As `human_rows` gives them."""
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


def test_people_fill_table_1_beside_the_papers() -> None:
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
    ((title, table),) = study_tables(only_simulated).items()
    assert "simulated participants" in title
    assert table.index.tolist() == ["stays, with AB", "stays, without AB"]


def test_people_do_not_compete_and_have_no_share() -> None:
    numbers = table_numbers([study(rows("person"))])
    values = fill(paper_tables()[0], pd.DataFrame(), participants=numbers).values
    human = values[values["row"] == "Human"]
    assert not human["best"].any()
    assert human["share"].isna().all()


def write_answers(path: Path, description: str, *, experiment: int = 2) -> None:
    """One participant, who clicked (10, 20) for slot 0 of an experiment."""
    path.parent.mkdir(parents=True)
    AnswerStore(path).close()
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO studies VALUES ('s', ?)", (description,))
        db.execute("INSERT INTO participants VALUES (1, 's', 'person', 0, 'h', NULL, 'c', 1.0, 2.0)")
        db.execute(
            "INSERT INTO answers (participant, position, practice, experiment, setting, opened_at, answered_at) "
            "VALUES (1, 2, 0, ?, 'cf', 1.0, 2.0)",
            (experiment,),
        )
        db.execute("INSERT INTO clicks VALUES (1, 2, 0, 10.0, 20.0, 500)")


def description(data: str) -> str:
    said = {"scenario": "blocktower", "split": "3to3", "num_objects": 3, "size": "tiny", "data": data}
    return json.dumps({**said, "resolution": 448, "seconds": 10})


@pytest.mark.parametrize(
    ("data", "experiment", "reason"),
    [
        ("3-tiny-ffff", 2, "are not there"),
        ("../../etc", 2, "are not there"),
        (None, 99_999, "the dataset does not have"),
        (None, -1, "the dataset does not have"),
    ],
)
def test_answers_without_their_data_are_named(
    data: str | None, experiment: int, reason: str, tiny_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    states = States(tiny_spec("blocktower"), tiny_data)
    write_answers(tmp_path / "study" / "x" / "answers.sqlite", description(data or states.id), experiment=experiment)
    with caplog.at_level(logging.INFO):
        assert read_answers(tmp_path, ComposedData("generated", tiny_data).dataset) == []
    assert reason in " ".join(caplog.text.split())


@pytest.mark.parametrize("kind", ["../x", "a/b", ""])
def test_figures_are_called_by_no_path(
    kind: str, tiny_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "study" / "x" / "answers.sqlite"
    write_answers(path, description(States(tiny_spec("blocktower"), tiny_data).id))
    with sqlite3.connect(path) as db:
        db.execute("UPDATE participants SET kind=?", (kind,))
    db.close()
    with caplog.at_level(logging.INFO):
        assert read_answers(tmp_path, ComposedData("generated", tiny_data).dataset) == []
    assert "left out" in caplog.text


@pytest.mark.parametrize("content", [b"", b"no database" * 100, SCHEMA.encode()])
def test_strange_files_are_named(
    content: bytes, tiny_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "study" / "x" / "answers.sqlite"
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    with caplog.at_level(logging.INFO):
        assert read_answers(tmp_path, ComposedData("generated", tiny_data).dataset) == []
    assert "left out" in caplog.text


WHOLE = '{"scenario": "blocktower", "split": "3to3", "num_objects": 3, "size": "tiny", "data": "x", "resolution": 64}'

OVERRIDES = (
    *('["hydra.run.dir=/x"]', '["++hydra.searchpath=[/x]"]', '["++scenario.name=${oc.env:HOME}"]', "3", '"abc"', "[3]"),
    *('["++scenario.nothing=3"]', '["++scenario.min_difference=x"]', '["++scenario.a=1,++b=2"]', '["~scenario"]'),
)


@pytest.mark.parametrize(
    "said",
    [
        *("[]", "{", "null", '{"scenario": 3}', '{"scenario": "nothing"}', "[" * 100_000),
        *(WHOLE.replace("blocktower", name) for name in ("nothing", "../x", "x y", "${data_dir}")),
        *(WHOLE.replace("3to3", "../x"), WHOLE.replace("tiny", "nothing"), WHOLE.replace("3,", "1e400,")),
        *(WHOLE.replace("64", size) for size in ("0", "1e9", "NaN")),
        *(WHOLE.replace("64", f'64, "overrides": {value}') for value in OVERRIDES),
        *(WHOLE.replace("64", f'64, "data_seed": {value}') for value in ('"x"', "-1", "1e400", "[]")),
    ],
)
def test_strange_descriptions_are_named(
    said: str, tiny_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_answers(tmp_path / "study" / "x" / "answers.sqlite", said)
    with caplog.at_level(logging.INFO):
        assert read_answers(tmp_path, ComposedData("generated", tiny_data).dataset) == []
    assert "left out" in caplog.text


def test_a_study_whose_data_are_gone_hides_no_other(
    tiny_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A pilot, whose name comes first in the file."""
    path = tmp_path / "study" / "x" / "answers.sqlite"
    write_answers(path, description(States(tiny_spec("blocktower"), tiny_data).id))
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO studies VALUES ('pilot', ?)", (description("3-tiny-gone"),))
        db.execute("INSERT INTO participants VALUES (2, 'pilot', 'person', 0, 'i', NULL, 'd', 1.0, 2.0)")
        db.execute(
            "INSERT INTO answers SELECT 2, position, practice, experiment, setting, opened_at, begun_at, answered_at, "
            "late, undone, names_shown, input, window_width, window_height, digest FROM answers"
        )
        db.execute("INSERT INTO clicks SELECT 2, position, slot, x, y, at_ms FROM clicks")
    db.close()
    with caplog.at_level(logging.INFO):
        assert len(read_answers(tmp_path, ComposedData("generated", tiny_data).dataset)) == 1
    assert "study pilot of" in " ".join(caplog.text.split())


def test_a_study_on_data_of_another_seed_and_grid_is_found(tmp_path: Path) -> None:
    words = ("size=tiny", "data_seed=1", "scenario.confounders.friction=[1]", f"data_dir={tmp_path / 'data'}")
    (states,) = generated_by(settings("generate", *words))
    generation.make(states, workers=2)
    shown = StudyExperiments(states, settings("study").split, SMALL, tmp_path)
    write_answers(tmp_path / "study" / "x" / "answers.sqlite", shown.description)
    (found,) = read_answers(tmp_path, ComposedData("generated", tmp_path / "data").dataset)
    assert found.data == states.id


def test_answers_are_judged_and_drawn(tiny_data: Path, tmp_path: Path) -> None:
    states = States(tiny_spec("blocktower"), tiny_data)
    write_answers(tmp_path / "study" / "x" / "answers.sqlite", description(states.id))
    (found,) = read_answers(tmp_path, ComposedData("generated", tiny_data).dataset)
    pd.testing.assert_frame_equal(found.rows, human_rows(found.judged))
    ((name, figure),) = draw_studies([found])
    assert name == "study-blocktower-3to3-person-cf"
    assert len(figure.axes) == 2  # twins, side by side
