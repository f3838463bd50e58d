"""Runs the code of docs/ENVIRONMENTS.md and python/README.md from the first to the last line, in a folder of their own."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import eupnea
from eupnea.environments import REGISTERED
from eupnea.reference import SCORES

TOP = Path(__file__).resolve().parents[2]
ENVIRONMENTS = TOP / "docs" / "ENVIRONMENTS.md"
PAGES = (ENVIRONMENTS, TOP / "python" / "README.md")
#: A block of Python, or a command in an indented line.
CODE = re.compile(r"```python\n(?P<block>(?:.|\n)*?)```|^    (?P<command>(?:python|pip) .*?)(?: *#.*)?$", re.MULTILINE)


def run_command(line, folder):
    words = line.replace("'", "").split()
    if words[0] == "pip":
        # What this test stands on: the package is installed, from its wheel or its sources, with extras that it declares.
        package, _, extra = words[-1].rstrip("]").partition("[")
        assert words[:-1] == ["pip", "install"]
        assert package == "./python" or package == f"eupnea-{eupnea.__version__}-*_x86_64.whl"
        assert not extra or f"\n{extra} = [" in (TOP / "python" / "pyproject.toml").read_text(encoding="utf-8")
        return
    subprocess.run([sys.executable, *words[1:]], cwd=folder, check=True, timeout=120)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_page_can_be_walked(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "datasets")
    names = {}
    steps = list(CODE.finditer(page.read_text(encoding="utf-8")))
    assert len(steps) >= 2
    for step in steps:
        if step["command"]:
            run_command(step["command"], tmp_path)
        elif "stable_baselines3" in step["block"] and find_spec("stable_baselines3") is None:
            continue
        else:
            line = page.read_text(encoding="utf-8")[: step.start("block")].count("\n")
            exec(compile("\n" * line + step["block"], str(page), "exec"), names)


def rows(heading):
    """Cells of the rows of the table whose head begins with these words."""
    _, below = ENVIRONMENTS.read_text(encoding="utf-8").split(f"| {heading} |", 1)
    table = below.split("\n\n", 1)[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for row in table]


def test_the_page_names_every_environment_and_option():
    assert [row[0].strip("` ") for row in rows("id | plants")] == list(REGISTERED)
    named = {name for row in rows("option of `make` and `vector`") for name in re.findall(r"`(\w+)`", row[0])}
    # The other two have a section of their own.
    assert named | {"observation", "action"} == set(eupnea.environments.OPTIONS)


def test_the_reference_scores_are_those_of_the_package():
    table = rows("id | PID")
    assert [row[0].strip("` ") for row in table] == [name for name in REGISTERED if name != "eupnea/PressureControl-v0"]
    for name, *cells in table:
        paper, bedside = (SCORES[name.strip("` ")][prescriptions] for prescriptions in ("paper", "bedside"))
        of_policies = [paper["pid"], paper["learned"], paper.get("bound"), bedside["pid"], bedside["learned"]]
        assert [cell.strip() for cell in cells] == ["-" if row is None else f"{row['score']:.3f}" for row in of_policies]


def test_the_spaces_are_those_of_the_page():
    for kind, length, limit in (("ours", 25, 100), ("authors", 10, 100), ("plain", 6, 1000)):
        space = gymnasium.make("eupnea/OneLung-v0", observation=kind).observation_space
        assert (space.shape, space.dtype, space.low.min(), space.high.max()) == ((length,), np.float32, -limit, limit)
    indices = [int(word) for row in rows('`"ours"`, index') for word in re.findall(r"\d+", row[0])]
    assert indices[0] == 0 and indices[-1] == 24 and sorted(indices) == indices


def test_a_first_observation_has_what_the_page_says():
    settings = {"pips": [35], "settings": {"peep": 10, "rise_time": 0.1}, "hold": 1}
    ours = gymnasium.make("eupnea/PressureControl-v0", **settings)
    plain = gymnasium.make("eupnea/PressureControl-v0", observation="plain", **settings)
    action = np.array([0.5], np.float32)
    for environment in (ours, plain):
        environment.reset(seed=1)
    for step in range(1, 30):
        features, values = ours.step(action)[0], plain.step(action)[0]
        pressure, target, pip, peep, command, time = values
        assert (pip, peep, command) == (35, 10, 75) and time == pytest.approx(step * 0.001)
        assert features[0] == pytest.approx((target - pressure) / 10, abs=1e-5)
        assert features[7] == pytest.approx(command / 50)
        assert features[18:21] == pytest.approx([time / (time + tau) for tau in (0.02, 0.1, 0.5)], rel=1e-4)
        assert features[21:23] == pytest.approx([(pip - 20) / 15, (peep - 5) / 5])
        assert features[23:25] == pytest.approx([0.25 * 10 / 10, 0.25 * 40 / 10], abs=1e-4)
