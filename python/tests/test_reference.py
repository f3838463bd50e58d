"""The reference scores are those that the package measures, and normalise scores."""

import json
import random

import pytest

import eupnea
from eupnea import __main__, reference
from eupnea.environments import REGISTERED

ROWS = [(*row, policy) for row in reference.rows() for policy in reference.POLICIES]
#: Rows that take a second at most.
QUICK = [row for row in ROWS if row[0] != "eupnea/BreathingPatient-v0"]


def test_every_environment_has_the_scores_of_every_policy_at_all_prescriptions():
    assert list(reference.SCORES) == list(REGISTERED)
    for id, prescriptions, policy in ROWS:
        assert reference.SCORES[id][prescriptions][policy].keys() == {"score", "return", "overshoot", "aborted"}


@pytest.mark.parametrize("row", random.Random(3).sample(QUICK, 4), ids=" ".join)
def test_a_row_is_what_the_package_measures(row):
    id, prescriptions, policy = row
    assert reference.measure(*row) == pytest.approx(reference.SCORES[id][prescriptions][policy], abs=2 * 10**-reference.DECIMALS)


def test_a_normalized_score_is_0_for_the_random_policy_and_1_for_the_best_controller():
    for id, prescriptions in reference.rows():
        rows = reference.SCORES[id][prescriptions]
        scores = [eupnea.normalized_score(rows[policy]["score"], id, prescriptions) for policy in reference.POLICIES]
        assert scores[0] == 0.0 and max(scores) == 1.0 and min(scores[1:]) > 0.8
        least, most = reference.returns(id, prescriptions)
        assert least == rows["random"]["return"] < most <= 0.0
    bound = reference.SCORES["eupnea/OneLung-v0"]["paper"]["bound"]["score"]
    assert eupnea.normalized_score(bound, "eupnea/OneLung-v0") > 1.0
    with pytest.raises(ValueError, match="choose from eupnea/PressureControl-v0"):
        eupnea.normalized_score(1.0, "eupnea/Nothing-v0")
    with pytest.raises(ValueError, match="choose from paper, bedside"):
        eupnea.normalized_score(1.0, prescriptions="aliens")


def test_the_command_prints_the_scores_and_writes_them(tmp_path, capsys):
    assert __main__.main(["reference", "--json", str(tmp_path / "scores.json")]) == 0
    assert "| `eupnea/OneLung-v0` | paper |" in capsys.readouterr().out
    assert json.loads((tmp_path / "scores.json").read_text()) == reference.SCORES


def test_the_command_measures_every_row(monkeypatch, capsys):
    measured = []
    monkeypatch.setattr(reference, "measure", lambda *row: measured.append(row) or {"score": 1.0})
    assert __main__.main(["reference", "--measure", "--json", "-"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert measured == ROWS and list(scores) == list(REGISTERED)
    # Bounds take an hour, and stay.
    assert scores["eupnea/OneLung-v0"]["paper"]["bound"] == reference.SCORES["eupnea/OneLung-v0"]["paper"]["bound"]
